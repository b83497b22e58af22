"""Pressure on the deformed surface."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from pdpetsc.arrays import Float, GlobalIndex, LocalIndex, entries_of
from pdpetsc.declare.conditions import FollowerPressure
from pdpetsc.discrete.communicator import agreed, total
from pdpetsc.errors import CaseError, SolveError
from pdpetsc.gradient.base import StencilMembers
from pdpetsc.gradient.products import Product, RankOneProduct
from pdpetsc.problem.body import Body
from pdpetsc.problem.state import State
from pdpetsc.problem.term import Term


class PressureOnDeformed(Term):
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

    linear = False
    symmetric = False
    load = True
    horizons = 2

    def __init__(self, body: Body, declared: FollowerPressure, name: str) -> None:
        self.body, self._declared, self._name = body, declared, name
        surface = body.surface
        assert surface is not None
        at = np.flatnonzero(surface.select(body.cloud, declared.region, name))
        at = at[np.argsort(surface.owner[at], kind="stable")]
        self._x, self._A = surface.x[at], surface.area[at]
        entry, ptr = entries_of(surface.ptr, at)
        self._facets = StencilMembers(surface.owner[at].astype(np.int32), ptr, surface.members[entry])
        self._N, self._G = surface.N[entry], surface.gradient(body.cloud)[entry]
        self._of = np.repeat(np.arange(len(at)), np.diff(ptr))
        try:
            force = -total(body.cloud.comm, self._pressure(1.0) @ self._A)
        except SolveError as error:
            raise CaseError(str(error)) from error
        self._resultant = name, 1.0, np.asarray(force)

    @property
    def parts(self) -> list[str]:
        """Return an empty list: loads have a separate record."""
        return []

    @property
    def resultants(self) -> list[tuple[str, float, Float]]:
        """Return name, load parameter and total force (dim,) [force] on the undeformed body."""
        return [self._resultant]

    @property
    def stencils(self) -> tuple[GlobalIndex, LocalIndex]:
        """Return the members of the facets (not collective)."""
        return self._facets.point_ptr, self._facets.members

    def _pressure(self, t: float) -> Float:
        """Return the pressures of the facets (n_facets,) [stress]."""
        with agreed(self.body.cloud.comm):
            return self._declared.values(self._x, t)

    def _gradients(self, state: State) -> Float:
        """Compute the deformation gradients of the facets (n_facets, dim, dim)."""
        u = state.u_local

        def make() -> Float:
            dim, size = self.body.dim, len(self._x)
            at = u[self._facets.members]
            F = np.empty((size, dim, dim))
            for i in range(dim):
                for j in range(dim):
                    F[:, i, j] = np.bincount(self._of, at[:, i] * self._G[:, j], size)
            return F + np.eye(dim)

        return state.kept((self, "gradients"), make)

    def _areas(self, state: State) -> Float:
        """Compute the deformed vector areas of the facets (n_facets, dim) [area]."""
        F = self._gradients(state)
        if self.body.dim == 1:
            return self._A
        if self.body.dim == 2:
            return np.asarray(np.einsum("ia,JM,faM,fJ->fi", _TURN, _TURN, F, self._A))
        areas = np.einsum("iab,JMN,faM,fbN,fJ->fi", _TURNS, _TURNS, F, F, self._A, optimize=True)
        return np.asarray(0.5 * areas)

    def add_force(self, state: State, f: Float) -> None:
        """Subtract the forces of the pressure."""
        force = -self._pressure(state.t)[:, None] * self._areas(state)
        np.add.at(f, self._facets.members, -self._N[:, None] * force[self._of])

    def linearise(self, state: State) -> Sequence[Product]:
        """Return one stencil for each component of the force of each facet."""
        dim, n = self.body.dim, len(self._x)
        if dim == 1:
            return []
        if dim == 2:
            change = np.einsum("ik,JL,fJ->fikL", _TURN, _TURN, self._A)
        else:
            F = self._gradients(state)
            change = np.einsum("ikb,JLN,fbN,fJ->fikL", _TURNS, _TURNS, F, self._A, optimize=True)
        facet, axis = np.repeat(np.arange(n), dim), np.tile(np.arange(dim), n)
        entry, ptr = entries_of(self._facets.point_ptr, facet)
        sizes = np.diff(ptr)
        of, row = np.repeat(facet, sizes), np.repeat(axis, sizes)
        g = np.einsum("ekL,eL->ek", change[of, row], self._G[entry])
        h = self._N[entry, None] * np.eye(dim)[row]
        members = StencilMembers(self._facets.owner[facet], ptr, self._facets.members[entry])
        p = np.repeat(self._pressure(state.t), dim)
        return [RankOneProduct(members, self.body.cloud.n_owned, h, np.ascontiguousarray(g), p)]


# Permutation symbols.
_TURN = np.array([[0.0, 1.0], [-1.0, 0.0]])
_TURNS = np.zeros((3, 3, 3))
_TURNS[[0, 1, 2], [1, 2, 0], [2, 0, 1]], _TURNS[[0, 2, 1], [2, 1, 0], [1, 0, 2]] = 1.0, -1.0
