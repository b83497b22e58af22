"""Expected results of a case."""

from __future__ import annotations

import math
from dataclasses import dataclass

from pdpetsc.declared import Declared, Finite, Fraction, NonNegative
from pdpetsc.errors import CaseError


@dataclass(frozen=True)
class Expected(Declared):
    """An expected result from an independent source: a closed form, a paper, finite elements.

    A result is as expected if ``abs(result - value) <= tolerance``; the tolerance is ``absolute``, or ``relative *
    abs(value)``. ``Case(expect={"tip": Expected(...)})`` names the result; ``python -m pdpetsc CASE.py --check``
    compares. For other parameters compute the value from them, or omit it: ``expect={...} if pull == 1.0 else {}``.

    Parameters
    ----------
    value : float
        Expected value, in the unit of the result.
    relative : float, optional
        Tolerance over the value [-]; between 0 and 1.
    absolute : float, optional
        Tolerance in the unit of the result. Declare either ``relative`` or ``absolute``.
    source : str
        Source of the value, in one line.

    Raises
    ------
    CaseError
        Not exactly one tolerance is declared, a tolerance can never fail or never hold, or the source is missing.

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
            raise CaseError("Expected requires one tolerance: relative=... or absolute=....")
        if self.relative is not None and self.value == 0.0:
            raise CaseError("An Expected value of 0 has no relative tolerance. Use absolute=....")
        if not self.source.strip() or len(self.source.splitlines()) > 1:
            raise CaseError('Expected takes its source in one line, as source="closed form of ...".')

    @property
    def tolerance(self) -> float:
        """Return the tolerance in the unit of the result."""
        if self.absolute is not None:
            return float(self.absolute)
        return float(self.relative or 0.0) * abs(float(self.value))

    def holds(self, result: float) -> bool:
        """Return True if a result is within the tolerance; False for nan."""
        return math.isfinite(result) and abs(result - self.value) <= self.tolerance
