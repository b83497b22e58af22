"""Softening curves of gradient points: stress over strain, scaled by the fracture energy."""

from __future__ import annotations

from abc import ABC, abstractmethod
from dataclasses import dataclass

import numpy as np

from pdpetsc.arrays import Float
from pdpetsc.declared import Declared, Fraction, Positive


@dataclass(frozen=True)
class SofteningCurve(Declared, ABC):
    """Stress over strength as a function ``s(xi)``, from the onset of damage, xi = 0, to zero stress, xi = 1.

    Derive from this class for a new curve: ``s(0) = 1``, ``s(1) = 0``, and s does not increase.
    """

    @abstractmethod
    def stress(self, xi: Float) -> Float:
        """Return ``s`` (n,) [-] for xi between 0 and 1."""

    @abstractmethod
    def slope(self, xi: Float) -> Float:
        """Return ``ds/dxi`` (n,) [-]."""

    @abstractmethod
    def integral(self, xi: Float) -> Float:
        """Return the integral of s from 0 to xi (n,) [-]."""

    @property
    def area(self) -> float:
        """Return the integral of s from 0 to 1 [-]."""
        return float(self.integral(np.ones(1))[0])


@dataclass(frozen=True)
class Linear(SofteningCurve):
    """``s = 1 - xi``.

    Examples
    --------
    >>> import pdpetsc as pd
    >>> pd.softening.Linear().area
    0.5
    """

    def stress(self, xi: Float) -> Float:
        """Return ``1 - xi``."""
        return 1.0 - xi

    def slope(self, xi: Float) -> Float:
        return -np.ones_like(xi)

    def integral(self, xi: Float) -> Float:
        """Return ``xi - xi^2 / 2``."""
        return np.asarray(xi - 0.5 * xi**2)


@dataclass(frozen=True)
class Exponential(SofteningCurve):
    """``s = (exp(-k xi) - exp(-k)) / (1 - exp(-k))``.

    Parameters
    ----------
    rate : float
        ``k`` [-], positive: for 5 the curve is cut off at 0.7 % of the strength.

    Examples
    --------
    >>> import pdpetsc as pd
    >>> round(pd.softening.Exponential(rate=5.0).area, 4)
    0.1932
    """

    rate: Positive = 5.0

    def stress(self, xi: Float) -> Float:
        return np.asarray((np.exp(-self.rate * xi) - np.exp(-self.rate)) / -np.expm1(-self.rate))

    def slope(self, xi: Float) -> Float:
        return np.asarray(-self.rate * np.exp(-self.rate * xi) / -np.expm1(-self.rate))

    def integral(self, xi: Float) -> Float:
        falling = -np.expm1(-self.rate * xi) / self.rate
        return np.asarray((falling - np.exp(-self.rate) * xi) / -np.expm1(-self.rate))


@dataclass(frozen=True)
class Bilinear(SofteningCurve):
    """Two straight lines that meet at ``xi = kink``, ``s = share``.

    Parameters
    ----------
    kink, share : float
        Between 0 and 1 [-]; the default is that of concrete: 0.8 and 3.6 times the fracture energy over the strength.

    References
    ----------
    Petersson1981.

    Examples
    --------
    >>> import pdpetsc as pd
    >>> concrete = pd.softening.Bilinear(kink=0.2, share=0.3)
    """

    kink: Fraction = 0.8 / 3.6
    share: Fraction = 1.0 / 3.0

    def stress(self, xi: Float) -> Float:
        return np.asarray(np.interp(xi, [0.0, self.kink, 1.0], [1.0, self.share, 0.0]))

    def slope(self, xi: Float) -> Float:
        """Return the slope of the line at xi."""
        return np.where(xi < self.kink, (self.share - 1.0) / self.kink, -self.share / (1.0 - self.kink))

    def integral(self, xi: Float) -> Float:
        """Return the area of the trapezia up to xi."""
        first = np.minimum(xi, self.kink)
        area = 0.5 * first * (1.0 + self.stress(first))
        return np.asarray(area + 0.5 * (xi - first) * (self.share + self.stress(xi)) * (xi > self.kink))


@dataclass(frozen=True)
class Cornelissen(SofteningCurve):
    """``s = (1 + (c1 xi)^3) exp(-c2 xi) - xi (1 + c1^3) exp(-c2)``, for concrete.

    Parameters
    ----------
    c1, c2 : float
        Positive [-]; 3 and 6.93 for normal concrete.

    References
    ----------
    Cornelissen1986.

    Examples
    --------
    >>> import pdpetsc as pd
    >>> round(pd.softening.Cornelissen().area, 3)
    0.195
    """

    c1: Positive = 3.0
    c2: Positive = 6.93

    @property
    def _end(self) -> float:
        return float((1.0 + self.c1**3) * np.exp(-self.c2))

    def stress(self, xi: Float) -> Float:
        return np.asarray((1.0 + (self.c1 * xi) ** 3) * np.exp(-self.c2 * xi) - xi * self._end)

    def slope(self, xi: Float) -> Float:
        rising = 3.0 * self.c1**3 * xi**2 - self.c2 * (1.0 + (self.c1 * xi) ** 3)
        return np.asarray(rising * np.exp(-self.c2 * xi) - self._end)

    def integral(self, xi: Float) -> Float:
        c, falling = self.c2, np.exp(-self.c2 * xi)
        cubic = 6.0 / c**4 - falling * (xi**3 / c + 3.0 * xi**2 / c**2 + 6.0 * xi / c**3 + 6.0 / c**4)
        return np.asarray((1.0 - falling) / c + self.c1**3 * cubic - 0.5 * xi**2 * self._end)
