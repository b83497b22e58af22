"""Periodic cells."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from pdpetsc.arrays import Float
from pdpetsc.declared import Declared
from pdpetsc.errors import CaseError


def corners(name: str, low: float | Sequence[float], high: float | Sequence[float]) -> tuple[Float, Float]:
    """Return two corners (dim,) each [length]; raise CaseError unless both have 1, 2 or 3 coordinates."""
    first, last = np.atleast_1d(np.asarray(low, dtype=float)), np.atleast_1d(np.asarray(high, dtype=float))
    if first.shape != last.shape or first.ndim != 1 or not 1 <= len(first) <= 3:
        raise CaseError(f"The corners low and high of a {name} need the same 1, 2 or 3 coordinates.")
    return first, last


@dataclass(frozen=True)
class Cell(Declared):
    """A periodic cell.

    The displacements of a particle and its images differ by the mean strain, ``u(x + n L) = u(x) + strain n L``.
    ``MeanStrain`` prescribes it, or it follows from ``MeanStress``.

    Parameters
    ----------
    low, high : float or sequence of float
        Corners of the cell [length]; only the coordinates in periodic directions matter.
    axes : str, optional
        Periodic directions, such as ``"x"`` or ``"xy"``; by default all.

    Examples
    --------
    >>> import pdpetsc as pd
    >>> pd.Cell(low=(0.0, 0.0), high=(10.0, 4.0), axes="x").components
    [(0, 0)]
    """

    low: float | Sequence[float]
    high: float | Sequence[float]
    axes: str | None = None

    def __post_init__(self) -> None:
        super().__post_init__()
        low, high = self._corners()
        letters = "xyz"[: len(low)]
        if self.axes is not None and (not self.axes or sorted(set(self.axes) & set(letters)) != sorted(self.axes)):
            raise CaseError(f"The axes of this Cell are letters of {letters!r}, not {self.axes!r}.")
        for axis in self.periodic:
            if not (np.isfinite([low[axis], high[axis]]).all() and high[axis] > low[axis]):
                raise CaseError(
                    f"Side {'xyz'[axis]} of the Cell goes from {low[axis]:g} to {high[axis]:g}. Its high must be "
                    "finite and above its low."
                )

    @property
    def dim(self) -> int:
        """Return the number of coordinates."""
        return len(self._corners()[0])

    @property
    def periodic(self) -> list[int]:
        """Return the periodic directions, ascending."""
        return sorted("xyz".index(letter) for letter in (self.axes or "xyz"[: self.dim]))

    @property
    def origin(self) -> Float:
        """Return the lower corner (dim,) [length]."""
        return self._corners()[0]

    @property
    def lengths(self) -> Float:
        """Return the period in each direction (dim,) [length]; 0 for directions that are not periodic."""
        low, high = self._corners()
        lengths = np.zeros(len(low))
        lengths[self.periodic] = (high - low)[self.periodic]
        return lengths

    @property
    def components(self) -> list[tuple[int, int]]:
        """Return the components of strain of the cell: pairs of periodic directions ``a <= b``."""
        return [(a, b) for a in self.periodic for b in self.periodic if a <= b]

    def _corners(self) -> tuple[Float, Float]:
        return corners("Cell", self.low, self.high)
