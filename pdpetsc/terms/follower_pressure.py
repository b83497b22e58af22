"""Pressure on the deformed surface."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from pdpetsc.arrays import Float, GlobalIndex, LocalIndex
from pdpetsc.declare.conditions import FollowerPressure
from pdpetsc.discrete.communicator import agreed, total
from pdpetsc.errors import case_errors
from pdpetsc.gradient.products import FacetProduct, Product
from pdpetsc.problem.body import Body
from pdpetsc.problem.state import State
from pdpetsc.terms.chosen_facets import ChosenFacets
from pdpetsc.terms.cofactor import cofactor, cofactor_by_F
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
    proportional = True
    horizons = 2

    def __init__(self, body: Body, declared: FollowerPressure, name: str) -> None:
        self.body, self._declared = body, declared
        surface = body.known_surface
        self._facets = ChosenFacets(surface, surface.select(body.cloud, declared.region, name))
        self._G = surface.gradient(body.cloud)[self._facets.entry]
        with case_errors():
            force = -total(body.cloud.comm, self._pressure(1.0) @ self._facets.area)
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
            return self._facets.sums(at[:, :, None] * self._G[:, None, :]) + np.eye(self.body.dim)

        return state.kept((self, "gradients"), make)

    def _areas(self, state: State) -> Float:
        """Compute the deformed vector areas of the facets (n_facets, dim) [area]."""
        return np.asarray(np.einsum("fiJ,fJ->fi", cofactor(self._gradients(state)), self._facets.area))

    def add_force(self, state: State, f: Float) -> None:
        """Subtract the forces of the pressure."""
        self._facets.spread(-self._pressure(state.t)[:, None] * self._areas(state), f)

    def linearise(self, state: State) -> Sequence[Product]:
        """Return the change of the force of each facet, component by component."""
        facets, dim = self._facets, self.body.dim
        if dim == 1:
            return []
        change = np.einsum("fiJkL,fJ->fikL", cofactor_by_F(self._gradients(state)), facets.area)
        h = (facets.N * self._pressure(state.t)[facets.of])[:, None, None] * np.eye(dim)
        g = np.ascontiguousarray(np.einsum("eikL,eL->eik", change[facets.of], self._G))
        return [FacetProduct(facets.stencils, self.body.cloud.n_owned, h, g)]
