"""Extrapolation of damage that settles slowly."""

from __future__ import annotations

import numpy as np

from pdpetsc.arrays import Float
from pdpetsc.discrete.communicator import total
from pdpetsc.problem.problem import Problem

# Two successive changes are those of a geometric series if the cosine of the angle between them is at least this.
ALIGNED = 0.999
# Damage is moved by this share of the rest of the series. A degradation factor that changes by more than MOST in a
# sweep, or would be moved by more, belongs to a cascade of failing bonds, whose order determines the bonds that break.
SHARE, MOST = 0.9, 1e-3


class GeometricSeries:
    """Extrapolate degradation factors whose changes ``d_k`` from sweep to sweep are a geometric series.

    If ``d_k = rho d_k-1``, the changes that follow sum to ``rho / (1 - rho) d_k``. A slow settling is soon that of its
    slowest mode, for which this holds. A bond that settles faster moves by its own ratio, because damage that is too
    large would stay. Damage with an energy, for which Newton's method settles the rest, and reversible
    damage are left as they are.

    Parameters
    ----------
    problem : Problem
        A problem with damage.
    """

    def __init__(self, problem: Problem) -> None:
        damage = problem.damage
        assert damage is not None
        self._problem, self._damage = problem, damage
        applies = not (damage.forces_have_energy or damage.reversible)
        self._phi: Float | None = damage.stored()[0] if applies else None
        self._change: Float | None = None

    def extrapolate(self, largest: float) -> None:
        """Extrapolate after damage was accepted, with ``largest`` change of a degradation factor [-] (collective)."""
        if self._phi is None or largest == 0.0:
            return
        phi, *others = self._damage.stored()
        change, before = self._phi - phi, self._change
        self._phi, self._change = phi, change
        if before is None:
            return
        products = [float(change @ before), float(change @ change), float(before @ before)]
        both, now, then = total(self._problem.body.cloud.comm, products)
        if largest > MOST or not 0.0 < now < then or both < ALIGNED * np.sqrt(now * then):
            return
        ratio = np.minimum(change / np.where(before > 0.0, before, np.inf), np.sqrt(now / then))
        ahead = np.minimum(SHARE * ratio / (1.0 - ratio) * change, MOST)
        # A bond without remaining force breaks at equilibrium, not here.
        moved = np.where(phi > 0.0, np.maximum(phi - ahead, np.minimum(phi, np.finfo(float).tiny)), 0.0)
        self._problem.reset_bonds((moved, *others))
        self._phi, self._change = moved, None
