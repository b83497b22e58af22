"""Two parts of the surface that move as one."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence

import numpy as np

from pdpetsc.arrays import Float, GlobalIndex, LocalIndex, Mask
from pdpetsc.declare.body_contact import Tied
from pdpetsc.discrete.communicator import total
from pdpetsc.errors import CaseError
from pdpetsc.gradient.base import StencilMembers
from pdpetsc.gradient.products import Product
from pdpetsc.problem.body import Body
from pdpetsc.problem.state import State
from pdpetsc.problem.term import Term
from pdpetsc.terms.facet_contact import Points
from pdpetsc.terms.facing import Search, both_ends, sides_of

# Default stiffness over that of contact [-].
TIED = 100.0


class TiedForces(Term):
    """Compute the forces ``-c A (u - u')`` at the middles of the overlaps of undeformed facets.

    Parameters
    ----------
    body : Body
        Particles with their surface.
    declared : Tied
        Declared tie.
    one, other : (n_facets,) bool
        Facets of both parts.
    stiffness, spacing, name
        As for ``BodyContactForces``.

    Notes
    -----
    Construction and the methods are collective.
    """

    energy_of = "tie"
    stiff = True
    horizons = 2

    def __init__(
        self, body: Body, declared: Tied, one: Mask, other: Mask, stiffness: float, spacing: float, name: str
    ) -> None:
        cloud = body.cloud
        self.body, self._c, self._name = body, stiffness, declared.name
        mine, _, theirs = sides_of(body, one, other, cloud.horizon, name)
        search = Search(cloud, mine, theirs, declared.gap * spacing)
        rest = np.zeros((cloud.n_local, body.dim))
        search.renew(rest)
        pairs = search.pairs(rest)
        pairs = pairs.chosen(np.abs(pairs.gap) <= declared.gap * spacing)
        if int(total(cloud.comm, len(pairs.rows))) == 0:
            raise CaseError(f"No facets of {name} overlap within a gap of {declared.gap:g} spacings; raise the gap.")
        ends = both_ends(mine.ends(pairs.rows, pairs.one), theirs.ends(pairs.other_rows, pairs.other))
        stencils = StencilMembers(mine.owner[pairs.rows], ends.ptr, ends.members)
        body.overlap.couple(stencils.owner)
        x = mine.x[pairs.rows] + pairs.one
        self._points = Points(x, pairs.area, np.arange(len(pairs.rows)), stencils, ends.weights)
        # An own particle at both ends of each pair.
        self._joined = np.stack([ends.members[ends.ptr[:-1]], ends.members[ends.ptr[1:] - 1]], axis=1)

    @property
    def stencils(self) -> tuple[GlobalIndex, LocalIndex]:
        """Return the members of the points (not collective)."""
        return self._points.stencils.point_ptr, self._points.stencils.members

    @property
    def within_families(self) -> bool:
        """Return False: pairs are of particles without a common family (not collective)."""
        return False

    @property
    def joined(self) -> LocalIndex:
        """Return a particle of both facets of each pair (not collective)."""
        found: LocalIndex = self._joined
        return found

    def _traction(self, state: State) -> Float:
        """Compute the tractions on the facets of the one part (n_points, dim) [stress] (collective)."""
        return -self._c * self._points.moved(state.u_local)

    def add_force(self, state: State, f: Float) -> None:
        """Subtract the forces of the tie."""
        self._points.spread(self._points.area[:, None] * self._traction(state), f)

    def linearise(self, state: State) -> Sequence[Product]:
        """Return ``c A`` at all points."""
        n, dim = len(self._points.area), self.body.dim
        blocks = np.tile(self._c * np.eye(dim), (n, 1, 1))
        return [self._points.product(self.body.cloud.n_owned, np.arange(n), blocks)]

    def energy(self, state: State) -> float:
        """Return ``sum c A |u - u'|^2 / 2`` of this rank [energy]."""
        return float(0.5 / self._c * self._points.area @ (self._traction(state) ** 2).sum(axis=1))

    def numbers(self) -> Mapping[str, Callable[[State], float]]:
        """Return the force on the one part by component."""

        def component(axis: int) -> Callable[[State], float]:
            return lambda state: float(self._points.area @ self._traction(state)[:, axis])

        return {f"{self._name}_{'xyz'[axis]}": component(axis) for axis in range(self.body.dim)}
