"""What a case should give."""

from __future__ import annotations

import math
from dataclasses import dataclass

from pdpetsc.declared import Declared, Finite, Fraction, NonNegative
from pdpetsc.errors import CaseError


@dataclass(frozen=True)
class Expected(Declared):
    """A result as it should be, from somewhere else than this program: a closed form, a paper, finite elements.

    It holds where ``abs(result - value) <= tolerance`` with the tolerance ``absolute``, or ``relative * abs(value)``.
    ``Case(expect={"tip": Expected(...)})`` names the result; ``python -m pdpetsc CASE.py --check`` compares. What is
    expected for other parameters is computed from them, or left out: ``expect={...} if pull == 1.0 else {}``.

    Parameters
    ----------
    value : float
        What the result should be, in its unit.
    relative : float, optional
        How far it may be off, over the value [-]; between 0 and 1.
    absolute : float, optional
        How far it may be off, in its unit. One of both is given.
    source : str
        Where the value is from, in one line.

    Raises
    ------
    CaseError
        None or both of the tolerances are given, one that cannot fail or cannot hold, or no source.

    Examples
    --------
    >>> import pdpetsc as pd
    >>> tip = pd.Expected(7.4, relative=0.02, source="F L^3 / 3 E I")
    >>> round(tip.tolerance, 3), tip.holds(7.5), tip.holds(7.6)
    (0.148, True, False)
    >>> pd.Expected(0.0, absolute=1e-9, source="a patch test").holds(float("nan"))
    False
    """

    value: Finite
    relative: Fraction | None = None
    absolute: NonNegative | None = None
    source: str = ""

    def __post_init__(self) -> None:
        super().__post_init__()
        if (self.relative is None) == (self.absolute is None):
            raise CaseError("Expected takes one tolerance, relative=... or absolute=....")
        if self.relative is not None and self.value == 0.0:
            raise CaseError("Nothing is relative to an Expected value of 0; give absolute=....")
        if not self.source.strip() or len(self.source.splitlines()) > 1:
            raise CaseError('Expected takes its source in one line, as source="closed form of ...".')

    @property
    def tolerance(self) -> float:
        """Return how far a result may be off, in its unit."""
        if self.absolute is not None:
            return float(self.absolute)
        return float(self.relative or 0.0) * abs(float(self.value))

    def holds(self, result: float) -> bool:
        """Return whether a result is what was expected; nan never is."""
        return math.isfinite(result) and abs(result - self.value) <= self.tolerance
