"""Plastic flow of a metal in a step for an equivalent stress."""

from __future__ import annotations

from typing import ClassVar, NamedTuple

import numpy as np

from pdpetsc.arrays import Float, GlobalIndex
from pdpetsc.material.hardening import Hardening, law_of
from pdpetsc.material.rate import RateLaw
from pdpetsc.material.roots import falling_roots


class Flow(NamedTuple):
    """Resistance to flow: yield stress, hardening and rate dependence.

    Attributes
    ----------
    yield_stress : float
        Initial yield stress [stress].
    hardening : Hardening
        Increase of the yield stress.
    rate : RateLaw or None
        Rate dependence; None without.
    """

    yield_stress: float
    hardening: Hardening
    rate: RateLaw | None

    def slow(self, alpha: Float) -> Float:
        """Return the yield stress of slow flow (n,) [stress]."""
        return self.yield_stress + self.hardening.increase(alpha)

    def growth(self, q: Float, alpha: Float, dt: Float, stiffness: float) -> tuple[GlobalIndex, Float, Float]:
        """Compute the points that flow, the growth d of alpha there, and the slope of their resistance.

        Parameters
        ----------
        q, alpha, dt : (n,) float64
            Trial stress [stress], plastic strain [-] and duration of the step [time]. A rate-dependent material does
            not flow in a step of zero duration.
        stiffness : float
            s in ``q - s d = resistance(alpha + d)`` [stress].
        """
        slow = self.slow(alpha)
        if self.rate is None:
            rows = np.flatnonzero(q > slow)
        else:
            rows = np.flatnonzero((q > self.rate.resistance(slow, np.zeros(len(q)))[0]) & (dt > 0.0))
        if not len(rows):
            return rows, np.zeros(0), np.zeros(0)
        q, alpha, dt = q[rows], alpha[rows], dt[rows]

        def excess(d: Float, some: GlobalIndex) -> tuple[Float, Float]:
            stress, slope = self._resistance(alpha[some], d, dt[some])
            return q[some] - stiffness * d - stress, -stiffness - slope

        first = excess(np.zeros(len(q)), np.arange(len(q)))
        # The first Newton step is exact for linear hardening.
        found = falling_roots(excess, -first[0] / first[1], q / stiffness, q)
        return rows, found, self._resistance(alpha, found, dt)[1]

    def work(self, alpha: Float, growth: Float, dt: Float) -> Float:
        """Return the integral of the resistance over a growth of alpha in a step (n,) [energy / volume]."""
        law = self.hardening
        work = self.yield_stress * growth + law.integral(alpha + growth) - law.integral(alpha)
        if self.rate is None:
            return np.asarray(work)
        return self.rate.potential(lambda more: self.slow(alpha + more), work, growth, dt)

    def _resistance(self, alpha: Float, growth: Float, dt: Float) -> tuple[Float, Float]:
        """Return the flow resistance after a growth of alpha in a step, and its slope over the growth."""
        slow, slope = self.slow(alpha + growth), self.hardening.slope(alpha + growth)
        if self.rate is None:
            return slow, slope
        stress, by_slow, by_rate = self.rate.resistance(slow, growth / dt)
        return stress, by_slow * slope + by_rate / dt


class Yields:
    """Mixin of metals with a yield stress that does not decrease.

    Attributes
    ----------
    yield_stress, hardening, rate
        As declared by the material.
    """

    yield_stress: float
    hardening: float | Hardening
    rate: RateLaw | None

    # The yield stress does not decrease, so the solution lies between two bounds.
    may_fail: ClassVar[bool] = False

    @property
    def flow(self) -> Flow:
        """Return the resistance to flow."""
        return Flow(self.yield_stress, law_of(self.hardening), self.rate)

    @property
    def duration(self) -> float | None:
        """Return the duration of the rate law."""
        return None if self.rate is None else self.rate.duration
