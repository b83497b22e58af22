"""Pressure on the faces of cracks at gradient points."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from pdpetsc.arrays import Float, GlobalIndex, LocalIndex, Mask
from pdpetsc.declare.conditions import CrackPressure
from pdpetsc.discrete.communicator import agreed
from pdpetsc.gradient.base import Moduli
from pdpetsc.gradient.products import PointProduct, Product
from pdpetsc.problem.state import State
from pdpetsc.terms.cofactor import cofactor, cofactor_by_F
from pdpetsc.terms.degraded_points import DegradedPoints
from pdpetsc.terms.following_load import FollowingLoad


class CrackPressureLoad(FollowingLoad):
    """Apply ``-G^T W p (1 - phi) cof F``, at small strain ``-G^T W p (1 - phi)``.

    Parameters
    ----------
    points : DegradedPoints
        The points that fail.
    declared : CrackPressure
        Declared pressure.
    mask : (n_owned,) bool
        Own particles on whose points it acts.
    name : str
        Name of the condition in messages.

    Notes
    -----
    The methods are collective.
    """

    symmetric = False
    horizons = 2

    def __init__(self, points: DegradedPoints, declared: CrackPressure, mask: Mask, name: str) -> None:
        owner = points.operator.owner
        self._points, self._declared, self._acts = points, declared, mask[owner]
        self._x = points.body.cloud.x[owner]
        super().__init__(name, np.zeros(points.body.dim))

    @property
    def stencils(self) -> tuple[GlobalIndex, LocalIndex] | None:
        """Return the stencils of the points."""
        return self._points.stencils

    @property
    def within_families(self) -> bool:
        """Return True if those of the points are."""
        return self._points.within_families

    def _pressure(self, state: State) -> Float:
        """Return the pressure at the points (n_points,) [stress]."""
        found = np.zeros(len(self._x))
        with agreed(self._points.body.cloud.comm):
            found[self._acts] = self._declared.values(self._x[self._acts], state.t)
        return found

    def _cofactor(self, state: State) -> Float:
        """Return ``cof F``, 1 at small strain (n_points, dim, dim)."""
        F = self._points.point_gradient(state)
        return np.broadcast_to(np.eye(F.shape[-1]), F.shape) if self._points.small_strain else cofactor(F)

    def add_force(self, state: State, f: Float) -> None:
        share = self._pressure(state) * (1.0 - self._points.driven(state).phi)
        self._points.operator.divergence(-share[:, None, None] * self._cofactor(state), f)

    def linearise(self, state: State) -> Sequence[Product]:
        """Return the stiffness of the pressure and, unless damage is held, the change of the pressed faces."""
        points, p, found = self._points, self._pressure(state), list[Product]()
        if not points.small_strain:
            share = p * (1.0 - points.driven(state).phi)
            by_F = -share[:, None, None, None, None] * cofactor_by_F(points.point_gradient(state))
            found.append(PointProduct(points.operator, Moduli(by_F)))
        return found if points.frozen else [*found, points.softened(state, p[:, None, None] * self._cofactor(state))]
