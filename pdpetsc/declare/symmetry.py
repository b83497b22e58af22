"""Mirror planes."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Literal

from pdpetsc.declared import Declared, Finite


@dataclass(frozen=True)
class Symmetry(Declared):
    """A mirror plane normal to an axis: the particles are one side of a body, the other side is their mirror image.

    Families extend across the plane. Images have the displacement of their particles, with the opposite component along
    the axis, and the same bonds, which break together. Results equal those of the whole body to round-off if material
    and scheme are symmetric too; no condition is needed on the plane. All particles must be on one side of the plane,
    at half a cell from it if cells fill the body. Forces, volumes, energies, reactions and loads are those of the part:
    half of the body per plane.

    Parameters
    ----------
    axis : {"x", "y", "z"}
        The normal of the plane.
    at : float
        Position of the plane along the axis [length].

    Raises
    ------
    CaseError
        The position is not finite.

    Examples
    --------
    The quarter of a plate, with its centre at the origin:

    >>> import pdpetsc as pd
    >>> planes = [pd.Symmetry("x"), pd.Symmetry("y")]
    >>> planes[0].number
    0
    """

    axis: Literal["x", "y", "z"]
    at: Finite = 0.0

    @property
    def number(self) -> int:
        """Return the number of the axis."""
        return "xyz".index(self.axis)
