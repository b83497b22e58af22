"""Rate dependence: flow resistance as a function of the rate of plastic strain.

A law is a declared object; derive from ``RateLaw`` for a new law. It declares the ``duration`` of the load, the time
from load parameter 0 to 1.
"""

from __future__ import annotations

import math
from abc import ABC, abstractmethod
from collections.abc import Callable
from dataclasses import dataclass
from functools import lru_cache

import numpy as np

from pdpetsc.arrays import Float
from pdpetsc.declared import Declared, Finite, NonNegative, Positive
from pdpetsc.errors import CaseError

# Quadrature points for the energy of a law without closed integral.
QUADRATURE = 40


@dataclass(frozen=True)
class RateLaw(Declared, ABC):
    """Flow stress as a function of rate and yield stress of slow flow.

    Parameters
    ----------
    duration : float
        Time from load parameter 0 to 1 [time], positive.
    """

    duration: Positive

    @abstractmethod
    def resistance(self, slow: Float, rate: Float) -> tuple[Float, Float, Float]:
        """Compute the flow stress at a rate, and its derivatives by both arguments.

        Parameters
        ----------
        slow : (n,) float64
            Yield stress of slow flow, with hardening [stress].
        rate : (n,) float64
            Rate of the accumulated plastic strain [1 / time], not negative. The flow stress must not decrease with it.
        """

    @abstractmethod
    def potential(self, slow: Callable[[Float], Float], slow_work: Float, growth: Float, dt: Float) -> Float:
        """Compute the integral of the flow stress over a growth of plastic strain in a step (n,) [energy / volume].

        Parameters
        ----------
        slow : callable
            Yield stress of slow flow after a growth (k, n) of the plastic strain.
        slow_work : (n,) float64
            Integral of ``slow`` from 0 to ``growth``.
        growth, dt : (n,) float64
            Growth of the plastic strain in the step [-] and duration of the step [time]; the rate is their quotient.
        """

    @property
    def fixed_temperature(self) -> float | None:
        """Return the constant temperature of the law, None if it has none."""
        return None


@dataclass(frozen=True)
class Perzyna(RateLaw):
    r"""Overstress: ``d alpha / dt = rate_0 <(q - y) / drag>^exponent`` with the yield stress y of slow flow.

    Parameters
    ----------
    duration : float
        Time from load parameter 0 to 1 [time].
    rate_0 : float
        Rate at which the overstress is ``drag`` [1 / time].
    drag : float
        Overstress at that rate [stress].
    exponent : float
        Exponent, at least 1 [-]; for 1 ``drag / rate_0`` is a viscosity.

    References
    ----------
    Perzyna1966.

    Examples
    --------
    >>> import pdpetsc as pd
    >>> slow = pd.rate.Perzyna(duration=10.0, rate_0=1e-3, drag=50.0, exponent=2.0)
    >>> steel = pd.J2(E=200e3, nu=0.3, yield_stress=250.0, rate=slow)
    """

    rate_0: Positive
    drag: Positive
    exponent: Finite = 1.0

    def __post_init__(self) -> None:
        super().__post_init__()
        if self.exponent < 1.0:
            raise CaseError(f"Perzyna takes an exponent from 1 on, not {self.exponent}.")

    def resistance(self, slow: Float, rate: Float) -> tuple[Float, Float, Float]:
        """Return ``y + drag (rate / rate_0)^(1 / exponent)``."""
        x = np.asarray(rate / self.rate_0)
        over = self.drag * x ** (1.0 / self.exponent)
        with np.errstate(divide="ignore"):
            slope = self.drag / (self.exponent * self.rate_0) * x ** (1.0 / self.exponent - 1.0)
        return slow + over, np.ones_like(over), slope

    def potential(self, slow: Callable[[Float], Float], slow_work: Float, growth: Float, dt: Float) -> Float:
        """Return the work of slow flow plus ``exponent / (exponent + 1)`` times that of the overstress."""
        over = self.drag * (growth / (self.rate_0 * dt)) ** (1.0 / self.exponent)
        return np.asarray(slow_work + over * growth * self.exponent / (self.exponent + 1.0))


@dataclass(frozen=True)
class JohnsonCook(RateLaw):
    """Johnson and Cook's factors: ``y (1 + C ln(rate / rate_0)) (1 - T*^m)``, the first one from ``rate_0`` on.

    ``T* = (temperature - room) / (melting - room)``, 0 below ``room``; the temperature does not change with the flow.
    For a body with a temperature field declare ``pd.Thermal(steel(293.0), ..., law=steel)`` with a function ``steel``
    of the temperature. The hardening ``B alpha^n`` is ``pd.hardening.Power(B, n)``.

    Parameters
    ----------
    duration : float
        Time from load parameter 0 to 1 [time].
    C : float
        Logarithmic sensitivity [-], not negative.
    rate_0 : float
        Rate of the test of the yield stress [1 / time].
    temperature, room, melting : float
        Temperatures of the body, of that test, and of melting [temperature].
    m : float
        Exponent of the temperature [-].

    Raises
    ------
    CaseError
        A constant is out of range, or the body has melted.

    References
    ----------
    Johnson1983.

    Examples
    --------
    >>> import pdpetsc as pd
    >>> copper = pd.J2(
    ...     E=124e3, nu=0.34, yield_stress=90.0, hardening=pd.hardening.Power(292.0, 0.31),
    ...     rate=pd.rate.JohnsonCook(duration=1e-3, C=0.025, rate_0=1.0, temperature=500.0, melting=1356.0, m=1.09),
    ... )
    """

    C: NonNegative
    rate_0: Positive
    temperature: float = 293.0
    room: float = 293.0
    melting: float = 1800.0
    m: Positive = 1.0

    def __post_init__(self) -> None:
        super().__post_init__()
        if not (self.room < self.melting and self.temperature < self.melting and math.isfinite(self.heat)):
            raise CaseError(
                f"JohnsonCook takes room and body temperatures below that of melting, not {self.room}, "
                f"{self.temperature} and {self.melting}."
            )

    @property
    def fixed_temperature(self) -> float:
        """Return ``temperature``."""
        return self.temperature

    @property
    def heat(self) -> float:
        """Return ``1 - T*^m``."""
        share = max(self.temperature - self.room, 0.0) / (self.melting - self.room)
        return float(1.0 - share**self.m)

    def resistance(self, slow: Float, rate: Float) -> tuple[Float, Float, Float]:
        """Return the yield stress times both factors."""
        x = np.maximum(rate / self.rate_0, 1.0)
        factor = self.heat * (1.0 + self.C * np.log(x))
        slope = np.where(rate > self.rate_0, self.heat * self.C * slow / np.maximum(rate, self.rate_0), 0.0)
        return slow * factor, factor, slope

    def potential(self, slow: Callable[[Float], Float], slow_work: Float, growth: Float, dt: Float) -> Float:
        """Return the work of slow flow plus that of the logarithm above ``rate_0``, times the temperature factor.

        The latter is ``C`` times the integral of ``y ln(s / s_0)`` from ``s_0 = rate_0 dt`` to the growth.
        """
        first = self.rate_0 * dt
        reach = np.log(np.maximum(growth / first, 1.0))
        x, w = _gauss()
        z = x[:, None] * reach
        s = first * np.exp(z)
        more = (w[:, None] * slow(s) * z * s).sum(axis=0) * reach
        return np.asarray(self.heat * (slow_work + self.C * more))


@lru_cache
def _gauss() -> tuple[Float, Float]:
    """Return Gauss points and weights on [0, 1]."""
    x, w = np.polynomial.legendre.leggauss(QUADRATURE)  # type: ignore[no-untyped-call]
    return 0.5 * (x + 1.0), 0.5 * w
