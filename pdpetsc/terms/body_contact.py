"""Contact between two parts of the surface of bodies."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from pdpetsc.arrays import Float, GlobalIndex, LocalIndex, Mask, entries_of
from pdpetsc.declare.body_contact import BodyContact
from pdpetsc.discrete.communicator import largest, smallest, total
from pdpetsc.errors import CaseError, SolveError
from pdpetsc.gradient.base import StencilMembers
from pdpetsc.gradient.products import Product, RankOneProduct
from pdpetsc.kernels.overlap import AREA, GAP, NORMAL, ONE, OTHER
from pdpetsc.problem.body import Body
from pdpetsc.problem.state import State
from pdpetsc.terms.facet_contact import OVERLAP, ContactProduct, FacetContact, Points
from pdpetsc.terms.facing import Ends, Pairs, Search, both_ends, sides_of

# Gap up to which facets form a pair, in spacings.
NEAR = 0.5
# Penetration beyond which facets that face each other have the material between them, in spacings.
THROUGH = 0.9


class BodyContactForces(FacetContact):
    """Compute the forces between facets of two parts of the surface that overlap.

    The points are the middles of the overlaps of the deformed facets. The facet of the one part feels ``A (p n + tau)``
    at its point, the facet of the other the opposite force, with the area A of the overlap. The pressure p is that of
    the mean gap over all overlaps of the facets of one particle that look alike: on unlike curved surfaces the gap
    differs from overlap to overlap. All of these follow the displacement. Which facets are near enough is held during a
    solve, since it determines the sparsity of the matrix; ``follow`` updates it.

    Parameters
    ----------
    body : Body
        Particles with their surface.
    declared : BodyContact
        Declared contact.
    one, other : (n_facets,) bool
        Facets of both parts.
    stiffness, spacing, name
        As for ``ContactForces``.

    Notes
    -----
    The tangent is not symmetric, without friction by a share of the order of the pressure over the modulus of the body:
    the forces are the derivatives of an energy but for the change of the area times that energy. Its symmetric part can
    be indefinite where the equilibrium is stable. Construction and the methods are collective.
    """

    def __init__(
        self, body: Body, declared: BodyContact, one: Mask, other: Mask, stiffness: float, spacing: float, name: str
    ) -> None:
        cloud = body.cloud
        self._reach = declared.reach_at(cloud.horizon)
        mine, self._theirs, theirs = sides_of(body, one, other, self._reach, name)
        # One point for each flat part of the surface of a particle: the displacement cannot follow more of them.
        self._part = mine.parts
        first = np.unique(self._part, return_index=True)[1]
        super().__init__(
            body, mine.owner[first], declared.friction, stiffness, spacing, declared.penetration, f"A body of {name}",
            declared.name,
        )  # fmt: skip
        self.symmetric = False
        self.works = self._mu > 0.0
        self._search = Search(cloud, mine, theirs, NEAR * spacing)
        # Displacements of local particles at the start of this step.
        self._before = np.zeros((cloud.n_local, body.dim))
        self._search.renew(self._before)
        self.pattern = self._search.version
        overlap = float(np.max(-self._formed(self._before).gap, initial=0.0))
        overlap = largest(cloud.comm, overlap)
        if overlap > OVERLAP * spacing:
            raise CaseError(
                f"The bodies of {name} overlap by {overlap:.3g} at the start; begin with a gap or in touch."
            )

    @property
    def stencils(self) -> tuple[GlobalIndex, LocalIndex]:
        """Return the members of all near facets (not collective)."""
        pairs = self._search.near_pairs
        ends = self._ends(pairs)
        return ends.ptr, ends.members

    @property
    def _areas_of_particles(self) -> Float:
        one = self._search.one
        return np.bincount(one.owner, one.areas, self.body.cloud.n_owned).astype(float)

    def _formed(self, u: Float) -> Pairs:
        """Return the pairs of facets that may touch, for displacements of local particles (n_local, dim)."""
        pairs = self._search.pairs(u)
        pairs = pairs.chosen((pairs.gap > -THROUGH * self._spacing) & (pairs.gap < NEAR * self._spacing))
        return pairs.chosen(np.argsort(self._part[pairs.rows], kind="stable"))

    def _pairs(self, state: State) -> Pairs:
        u = state.u_local
        return state.kept((self, "pairs", self._search.version), lambda: self._formed(u))

    def _points(self, state: State) -> Points:
        pairs = self._pairs(state)
        return state.kept((self, "points", self._search.version), lambda: self._joined_points(pairs))

    def _joined_points(self, pairs: Pairs) -> Points:
        ends = self._ends(pairs)
        stencils = StencilMembers(self._search.one.owner[pairs.rows], ends.ptr, ends.members)
        x = self._search.one.x[pairs.rows] + pairs.one
        return Points(x, pairs.area, self._part[pairs.rows], stencils, ends.weights)

    def _ends(self, pairs: Pairs) -> Ends:
        """Return the particles that both points of pairs move with."""
        search = self._search
        return both_ends(search.one.ends(pairs.rows, pairs.one), search.other.ends(pairs.other_rows, pairs.other))

    def _gap(self, state: State) -> tuple[Float, Float]:
        pairs = self._pairs(state)
        return pairs.gap, pairs.normal

    def _felt(self, state: State) -> Float:
        points = self._points(state)
        return points.mean(self._gap(state)[0], len(self._owner))[points.of]

    def _slip(self, state: State) -> Float:
        if self._mu == 0.0:
            return np.zeros_like(self._gap(state)[1])
        u, points = state.u_local, self._points(state)
        return state.kept((self, "slip", self.version), lambda: points.moved(u - self._before))

    def linearise(self, state: State) -> Sequence[Product]:
        """Return the derivatives of forces, points and weights."""
        touching, search = self._touching(state), self._search
        pairs, dim = self._pairs(state).chosen(touching.rows), self.body.dim
        J = search.by_corners(state.u_local, pairs)
        by_points = J[:, ONE : ONE + dim], J[:, OTHER : OTHER + dim]
        # The force of a pair is A t. It depends on the corners, and by slip on the displacements at both points.
        area, t = pairs.area[:, None, None], touching.traction
        rates = touching.by_normal @ J[:, NORMAL : NORMAL + dim]
        if self._mu > 0.0:
            change = state.u_local - self._before
            slopes, other_slopes = search.one.fields(change)[1], search.other.fields(change)[1]
            moved = slopes[pairs.rows] @ by_points[0] - other_slopes[pairs.other_rows] @ by_points[1]
            rates = rates + touching.by_slip @ moved
        by_corners = np.asarray(area * rates + t[:, :, None] * J[:, AREA, None])
        ends, owner = self._ends(pairs), search.one.owner[pairs.rows]
        force, of_slip = pairs.area[:, None] * t, area * touching.by_slip
        hs = [ends.weights[:, None] * axis for axis in np.eye(dim)]
        gs = [ends.rates(by_corners[:, i]) + ends.weights[:, None] * of_slip[ends.of, i] for i in range(dim)]
        # The weights depend on the points.
        for side, by_point in enumerate(by_points):
            hs += [ends.G[:, side, axis, None] * force[ends.of] for axis in range(dim)]
            gs += [ends.rates(by_point[:, axis]) for axis in range(dim)]
        # The pressure of all pairs of a part depends on their mean gap.
        part, first, number = np.unique(self._part[pairs.rows], return_index=True, return_inverse=True)
        whole = np.bincount(number, pairs.area, len(part))[number]
        off = pairs.gap - self._felt(state)[touching.rows]
        by_mean = (pairs.area / whole)[:, None] * J[:, GAP] + (off / whole)[:, None] * J[:, AREA]
        h = ends.weights[:, None] * (pairs.area[:, None] * touching.by_pressure)[ends.of]
        of_parts = ends.ptr[np.append(first, len(owner))]
        return [
            self._product(StencilMembers(owner, ends.ptr, ends.members), hs, gs),
            self._product(StencilMembers(owner[first], of_parts, ends.members), [h], [-self._c * ends.rates(by_mean)]),
        ]

    def _product(self, stencils: StencilMembers, hs: list[Float], gs: list[Float]) -> RankOneProduct:
        """Return ``-sum h (x) g`` over vectors (n_entries, dim) of stencils."""
        # One stencil for each product of two vectors.
        ptr, n, count = stencils.point_ptr, len(stencils.owner), len(hs)
        entry, repeated = entries_of(ptr, np.repeat(np.arange(n), count))
        which = np.repeat(np.tile(np.arange(count), n), np.repeat(np.diff(ptr), count))
        members = StencilMembers(np.repeat(stencils.owner, count), repeated, stencils.members[entry])
        h, g = (np.ascontiguousarray(np.stack(vectors)[which, entry]) for vectors in (hs, gs))
        return RankOneProduct(members, self.body.cloud.n_owned, h, g, np.full(n * count, -1.0))

    def stiffest(self, state: State) -> Sequence[Product]:
        """Return blocks of all facets of both parts as if each was pressed and stuck.

        They bound those of the pairs: ``|u_s - u_m|^2 <= 2 |u_s|^2 + 2 |u_m|^2``.
        """
        found: list[Product] = []
        cloud, block = self.body.cloud, 2.0 * self._c * np.eye(self.body.dim)
        for side in (self._search.one, self._theirs):
            members = StencilMembers(side.owner, side.ptr, side.members)
            found.append(ContactProduct(members, cloud.n_owned, side.N, side.areas[:, None, None] * block))
        return found

    def _step_from(self, state: State) -> None:
        self._before = state.u_local.copy()
        self.follow(state)

    def follow(self, state: State) -> bool:
        """Update which facets are near; return False if nothing touches before and after."""
        pressed = self._pressed(state)
        if not self._search.renew(state.u_local):
            return False
        self.pattern = self._search.version
        self.version += 1
        return self._pressed(state) or pressed

    def _pressed(self, state: State) -> bool:
        return int(total(self.body.cloud.comm, len(self._touching(state).rows))) > 0

    def objection(self, state: State) -> str:
        """Return a reason if facets have passed through each other in the step."""
        u, through = state.u_local, THROUGH * self._spacing
        change = u - self._before
        most = self._apart(change)
        if most < 0.5 * through:
            return ""
        deep = self._search.passed(u, most)
        deep = deep.chosen(deep.gap <= -through)
        before = deep.gap - (deep.normal * self._joined_points(deep).moved(change)).sum(axis=1)
        passed = int(total(self.body.cloud.comm, np.count_nonzero(before > -through)))
        return f"bodies of {self._name} passed through each other in one step" if passed else ""

    def commit(self, state: State) -> None:
        """Store tractions and multipliers; raise SolveError if bodies penetrate, or have moved too far."""
        most = self._apart(state.u_local)
        if most > self._reach:
            raise SolveError(
                f"The parts of {self._name} have moved by up to {most:.3g} relative to each other at step time "
                f"{state.t:.6g}, further than reach={self._reach:.3g}. Raise the reach."
            )
        super().commit(state)

    def _apart(self, u: Float) -> float:
        """Return a bound on the relative displacements of both parts [length] (collective)."""
        comm, ranges = self.body.cloud.comm, []
        for side in (self._search.one, self._theirs):
            flat = (side.deformed(u) - side.corners)[:, :, : self.body.dim].reshape(-1, self.body.dim)
            least = [smallest(comm, float(along.min(initial=np.inf))) for along in flat.T]
            most = [largest(comm, float(along.max(initial=-np.inf))) for along in flat.T]
            ranges.append((np.array(least), np.array(most)))
        (low, high), (least_other, most_other) = ranges
        return float(np.linalg.norm(np.maximum(high - least_other, most_other - low)))
