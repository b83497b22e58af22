"""Pressure on the deformed surface."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from pdpetsc.arrays import Float, GlobalIndex, LocalIndex
from pdpetsc.declare.conditions import FollowerPressure
from pdpetsc.discrete.communicator import agreed, total
from pdpetsc.errors import CaseError, SolveError
from pdpetsc.gradient.products import Product, RankOneProduct
from pdpetsc.problem.body import Body
from pdpetsc.problem.state import State
from pdpetsc.terms.chosen_facets import ChosenFacets, by_component
from pdpetsc.terms.following_load import FollowingLoad


class PressureOnDeformed(FollowingLoad):
    """Apply ``f_k = -sum_f N_f(x_k) p a_f`` with ``a_f = cof(F_f) A_f`` and ``F_f = 1 + sum_k u_k (x) G_f(x_k)``.

    Parameters
    ----------
    body : Body
        Particles and bonds, with their surface.
    declared : FollowerPressure
        Declared pressure.
    name : str
        Name of the condition in messages.

    Notes
    -----
    Construction and the methods are collective.
    """

    symmetric = False
    horizons = 2

    def __init__(self, body: Body, declared: FollowerPressure, name: str) -> None:
        self.body, self._declared = body, declared
        surface = body.surface
        assert surface is not None
        self._facets = ChosenFacets(surface, surface.select(body.cloud, declared.region, name))
        self._G = surface.gradient(body.cloud)[self._facets.entry]
        try:
            force = -total(body.cloud.comm, self._pressure(1.0) @ self._facets.area)
        except SolveError as error:
            raise CaseError(str(error)) from error
        super().__init__(name, force)

    @property
    def stencils(self) -> tuple[GlobalIndex, LocalIndex]:
        """Return the members of the facets (not collective)."""
        return self._facets.stencils.point_ptr, self._facets.stencils.members

    def _pressure(self, t: float) -> Float:
        """Return the pressures of the facets (n_facets,) [stress]."""
        with agreed(self.body.cloud.comm):
            return self._declared.values(self._facets.x, t)

    def _gradients(self, state: State) -> Float:
        """Compute the deformation gradients of the facets (n_facets, dim, dim)."""
        u = state.u_local

        def make() -> Float:
            at = u[self._facets.stencils.members]
            columns = [self._facets.sums(at * along[:, None]) for along in self._G.T]
            return np.stack(columns, axis=2) + np.eye(self.body.dim)

        return state.kept((self, "gradients"), make)

    def _areas(self, state: State) -> Float:
        """Compute the deformed vector areas of the facets (n_facets, dim) [area]."""
        F = self._gradients(state)
        if self.body.dim == 1:
            return self._facets.area
        if self.body.dim == 2:
            return np.asarray(np.einsum("ia,JM,faM,fJ->fi", _TURN, _TURN, F, self._facets.area))
        areas = np.einsum("iab,JMN,faM,fbN,fJ->fi", _TURNS, _TURNS, F, F, self._facets.area, optimize=True)
        return np.asarray(0.5 * areas)

    def add_force(self, state: State, f: Float) -> None:
        """Subtract the forces of the pressure."""
        self._facets.spread(-self._pressure(state.t)[:, None] * self._areas(state), f)

    def linearise(self, state: State) -> Sequence[Product]:
        """Return one stencil for each component of the force of each facet."""
        dim = self.body.dim
        if dim == 1:
            return []
        if dim == 2:
            change = np.einsum("ik,JL,fJ->fikL", _TURN, _TURN, self._facets.area)
        else:
            F = self._gradients(state)
            change = np.einsum("ikb,JLN,fbN,fJ->fikL", _TURNS, _TURNS, F, self._facets.area, optimize=True)
        members, entry, of, row = by_component(self._facets.stencils, dim)
        g = np.einsum("ekL,eL->ek", change[of, row], self._G[entry])
        h = self._facets.N[entry, None] * np.eye(dim)[row]
        p = np.repeat(self._pressure(state.t), dim)
        return [RankOneProduct(members, self.body.cloud.n_owned, h, np.ascontiguousarray(g), p)]


# Permutation symbols.
_TURN = np.array([[0.0, 1.0], [-1.0, 0.0]])
_TURNS = np.zeros((3, 3, 3))
_TURNS[[0, 1, 2], [1, 2, 0], [2, 0, 1]], _TURNS[[0, 2, 1], [2, 1, 0], [1, 0, 2]] = 1.0, -1.0
