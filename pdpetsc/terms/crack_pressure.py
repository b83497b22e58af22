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
    """Apply ``-G^T W p (1 - phi) (m (x) m) cof F`` with the normal ``m = cof(F) n / |cof(F) n|`` of the deformed crack.

    At small strain the stress is ``-p (1 - phi) n (x) n``. Pressed areas are ``cof(F) n``, and moments balance.

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

    def _normals(self, state: State) -> tuple[Float, Float, Float]:
        """Return ``cof F`` (n_points, dim, dim), m (n_points, dim), and ``|cof(F) n|`` or 1 (n_points,)."""
        cof = cofactor(self._points.point_gradient(state))
        area = np.einsum("pij,pj->pi", cof, self._points.points.normal)
        size = np.linalg.norm(area, axis=1)
        size[size == 0.0] = 1.0
        return cof, area / size[:, None], size

    def _pressed(self, state: State) -> Float:
        """Return ``(m (x) m) cof F`` (n_points, dim, dim) [-]."""
        if self._points.small_strain:
            n = self._points.points.normal
            return np.asarray(n[:, :, None] * n[:, None, :])
        cof, m, _ = self._normals(state)
        return np.asarray(np.einsum("pi,pa,pam->pim", m, m, cof))

    def _pressed_by(self, state: State) -> Float:
        """Return its derivative by F (n_points, dim, dim, dim, dim)."""
        cof, m, size = self._normals(state)
        by_F = cofactor_by_F(self._points.point_gradient(state))
        turned = np.einsum("pajkl,pj->pakl", by_F, self._points.points.normal) / size[:, None, None, None]
        turned = turned - np.einsum("pi,pa,pakl->pikl", m, m, turned)  # m by F
        along = np.einsum("pa,pam->pm", m, cof)
        change = np.einsum("pikl,pm->pimkl", turned, along)
        change += np.einsum("pi,pakl,pam->pimkl", m, turned, cof) + np.einsum("pi,pa,pamkl->pimkl", m, m, by_F)
        return np.asarray(change)

    def add_force(self, state: State, f: Float) -> None:
        share = self._pressure(state) * (1.0 - self._points.driven(state).phi)
        self._points.operator.divergence(-share[:, None, None] * self._pressed(state), f)

    def linearise(self, state: State) -> Sequence[Product]:
        """Return the stiffness of the pressure and, unless damage is held, the change of the pressed faces."""
        points, p, found = self._points, self._pressure(state), list[Product]()
        if not points.small_strain:
            share = (p * (1.0 - points.driven(state).phi))[:, None, None, None, None]
            found.append(PointProduct(points.operator, Moduli(-share * self._pressed_by(state))))
        return found if points.frozen else [*found, points.softened(state, p[:, None, None] * self._pressed(state))]
