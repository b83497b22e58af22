"""Hardening laws: increase of the yield stress with the accumulated plastic strain ``alpha``.

A law is a declared object with three functions of ``alpha``; laws can be added. Derive from ``Hardening`` for a new
law.
"""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Sequence
from dataclasses import dataclass
from itertools import pairwise

import numpy as np

from pdpetsc.arrays import Float
from pdpetsc.declared import Declared, Finite, NonNegative, Positive
from pdpetsc.errors import CaseError


class Hardening(Declared, ABC):
    """Increase of the yield stress with the accumulated plastic strain.

    The increase is 0 at 0 and does not decrease. With a decrease plastic flow localises in a band of the width of the
    particles, and results depend on the spacing.

    Examples
    --------
    >>> import pdpetsc as pd
    >>> law = pd.hardening.Linear(129.24) + pd.hardening.Voce(265.0, 16.93)
    >>> round(float(law.increase(0.1)), 3)
    229.173
    """

    @abstractmethod
    def increase(self, alpha: Float) -> Float:
        """Compute the increase ``R(alpha)`` of the yield stress (n,) [stress], for ``alpha`` (n,) from 0 on [-]."""

    @abstractmethod
    def slope(self, alpha: Float) -> Float:
        """Compute ``dR/dalpha`` (n,) [stress], not negative; it may be infinite at 0."""

    @abstractmethod
    def integral(self, alpha: Float) -> Float:
        """Compute the integral of R from 0 to ``alpha`` (n,) [energy / volume]."""

    def __add__(self, other: Hardening) -> Sum:
        """Return the sum of both laws."""
        if not isinstance(other, Hardening):
            return NotImplemented
        return Sum((*_parts(self), *_parts(other)))


@dataclass(frozen=True)
class Linear(Hardening):
    """``R = H alpha``.

    Parameters
    ----------
    H : float
        Slope [stress], not negative.

    Examples
    --------
    >>> import pdpetsc as pd
    >>> float(pd.hardening.Linear(1e3).increase(0.01))
    10.0
    """

    H: NonNegative

    def increase(self, alpha: Float) -> Float:
        """Return ``H alpha``."""
        return np.asarray(self.H * alpha)

    def slope(self, alpha: Float) -> Float:
        return np.full(np.shape(alpha), float(self.H))

    def integral(self, alpha: Float) -> Float:
        """Return ``H alpha^2 / 2``."""
        return np.asarray(0.5 * self.H * alpha * alpha)


@dataclass(frozen=True)
class Voce(Hardening):
    """``R = Q (1 - exp(-b alpha))``, with the limit Q.

    Parameters
    ----------
    Q : float
        Largest increase [stress], not negative.
    b : float
        Rate of saturation [-], positive.

    References
    ----------
    Voce1948.

    Examples
    --------
    >>> import pdpetsc as pd
    >>> round(float(pd.hardening.Voce(265.0, 16.93).increase(1.0)), 3)
    265.0
    """

    Q: NonNegative
    b: Positive

    def increase(self, alpha: Float) -> Float:
        """Return ``Q (1 - exp(-b alpha))``."""
        return np.asarray(-self.Q * np.expm1(-self.b * alpha))

    def slope(self, alpha: Float) -> Float:
        """Return ``Q b exp(-b alpha)``."""
        return np.asarray(self.Q * self.b * np.exp(-self.b * alpha))

    def integral(self, alpha: Float) -> Float:
        """Return ``Q (alpha - (1 - exp(-b alpha)) / b)``."""
        return np.asarray(self.Q * (alpha + np.expm1(-self.b * alpha) / self.b))


@dataclass(frozen=True)
class Power(Hardening):
    """``R = K ((alpha_0 + alpha)^n - alpha_0^n)``: Ludwik's law if ``alpha_0`` is 0, else Swift's.

    Swift's yield stress is ``K (alpha_0 + alpha)^n``: declare its initial value ``K alpha_0^n`` as yield stress of the
    material.

    Parameters
    ----------
    K : float
        Factor [stress], not negative.
    n : float
        Exponent [-], positive and at most 1.
    alpha_0 : float
        Initial plastic strain [-], not negative.

    References
    ----------
    Ludwik1909; Swift1952.

    Examples
    --------
    >>> import pdpetsc as pd
    >>> round(float(pd.hardening.Power(500.0, 0.5).increase(0.04)), 6)
    100.0
    """

    K: NonNegative
    n: Positive
    alpha_0: NonNegative = 0.0

    def __post_init__(self) -> None:
        super().__post_init__()
        if self.n > 1.0:
            raise CaseError(f"Power takes an exponent n of at most 1, not {self.n}.")

    def increase(self, alpha: Float) -> Float:
        """Return ``K ((alpha_0 + alpha)^n - alpha_0^n)``."""
        if self.alpha_0 == 0.0:
            return np.asarray(self.K * np.asarray(alpha, dtype=float) ** self.n)
        return np.asarray(self.K * self.alpha_0**self.n * np.expm1(self.n * np.log1p(alpha / self.alpha_0)))

    def slope(self, alpha: Float) -> Float:
        """Return ``K n (alpha_0 + alpha)^(n - 1)``, infinite at 0 of Ludwik's law."""
        with np.errstate(divide="ignore"):
            return np.asarray(self.K * self.n * np.asarray(self.alpha_0 + alpha, dtype=float) ** (self.n - 1.0))

    def integral(self, alpha: Float) -> Float:
        """Return ``K ((alpha_0 + alpha)^(n + 1) - alpha_0^(n + 1)) / (n + 1) - K alpha_0^n alpha``."""
        more = self.n + 1.0
        if self.alpha_0 == 0.0:
            return np.asarray(self.K * np.asarray(alpha, dtype=float) ** more / more)
        x = alpha / self.alpha_0
        return np.asarray(self.K * self.alpha_0**more * (np.expm1(more * np.log1p(x)) / more - x))


@dataclass(frozen=True)
class Tabular(Hardening):
    """Straight lines between measured points, constant after the last one.

    Parameters
    ----------
    strains : sequence of float
        Accumulated plastic strains [-], ascending from 0.
    increases : sequence of float
        Increase of the yield stress at each strain [stress], starting at 0 and not decreasing.

    Raises
    ------
    CaseError
        A table does not start at 0, or decreases.

    Examples
    --------
    >>> import pdpetsc as pd
    >>> float(pd.hardening.Tabular([0.0, 0.1, 0.3], [0.0, 50.0, 60.0]).increase(0.2))
    55.0
    """

    strains: Sequence[Finite]
    increases: Sequence[Finite]

    def __post_init__(self) -> None:
        super().__post_init__()
        x, y = self.strains, self.increases
        if len(x) != len(y) or len(x) < 2:
            raise CaseError("Tabular needs at least two plastic strains and as many increases.")
        if any(b <= a for a, b in pairwise(x)) or any(b < a for a, b in pairwise(y)) or x[0] != 0.0 or y[0] != 0.0:
            raise CaseError(
                f"Tabular needs plastic strains that ascend from 0 and increases of the yield stress that start with 0 "
                f"and do not fall, not {_short(x)} and {_short(y)}."
            )
        # Not arrays, so that materials can be compared.
        object.__setattr__(self, "strains", tuple(float(value) for value in x))
        object.__setattr__(self, "increases", tuple(float(value) for value in y))

    def increase(self, alpha: Float) -> Float:
        return np.asarray(np.interp(alpha, self.strains, self.increases))

    def slope(self, alpha: Float) -> Float:
        """Return the slope of the line to the right."""
        slopes = np.append(np.diff(self.increases) / np.diff(self.strains), 0.0)
        return np.asarray(slopes[np.searchsorted(self.strains, alpha, side="right") - 1])

    def integral(self, alpha: Float) -> Float:
        """Return the area below the lines."""
        x, y = np.asarray(self.strains), np.asarray(self.increases)
        before = np.append(0.0, np.cumsum(0.5 * (y[1:] + y[:-1]) * np.diff(x)))
        line = np.searchsorted(x, alpha, side="right") - 1
        return np.asarray(before[line] + 0.5 * (y[line] + self.increase(alpha)) * (alpha - x[line]))


@dataclass(frozen=True)
class Sum(Hardening):
    """The sum of laws, the result of ``+``.

    Parameters
    ----------
    laws : sequence of Hardening
        At least one.

    Examples
    --------
    >>> import pdpetsc as pd
    >>> float((pd.hardening.Linear(10.0) + pd.hardening.Linear(5.0)).slope(0.0))
    15.0
    """

    laws: Sequence[Hardening]

    def __post_init__(self) -> None:
        super().__post_init__()
        if not self.laws:
            raise CaseError("A Sum of hardening laws takes at least one.")
        object.__setattr__(self, "laws", tuple(self.laws))

    def increase(self, alpha: Float) -> Float:
        """Return the sum of the increases."""
        return np.asarray(sum(law.increase(alpha) for law in self.laws))

    def slope(self, alpha: Float) -> Float:
        """Return the sum of the slopes."""
        return np.asarray(sum(law.slope(alpha) for law in self.laws))

    def integral(self, alpha: Float) -> Float:
        """Return the sum of the integrals."""
        return np.asarray(sum(law.integral(alpha) for law in self.laws))


def law_of(hardening: float | Hardening) -> Hardening:
    """Return a hardening law, ``Linear`` for a number."""
    return hardening if isinstance(hardening, Hardening) else Linear(hardening)


def _parts(law: Hardening) -> Sequence[Hardening]:
    return law.laws if isinstance(law, Sum) else (law,)


def _short(values: Sequence[float]) -> str:
    text = ", ".join(f"{value:g}" for value in values[:4])
    return f"[{text}{', ...' if len(values) > 4 else ''}]"
