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
from pdpetsc.terms.facing import Ends, Pairs, Search, sides_of

# Gap up to which facets form a pair, in spacings.
NEAR = 0.5
# Penetration beyond which facets that face each other have the material between them, in spacings.
THROUGH = 0.5


class BodyContactForces(FacetContact):
    """Compute the forces between facets of two parts of the surface that overlap.

    The points are the middles of the overlaps of the deformed facets. The facet of the one part feels ``A (p n + tau)``
    at its point, the facet of the other the opposite force, with the area A of the overlap. All of these follow the
    displacement. Which facets are near enough is held during a solve, since it determines the sparsity of the matrix;
    ``follow`` updates it.

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
    Without friction the tangent is its symmetric part. The rest is of the order of the penetration over the spacing:
    the forces are the derivatives of an energy but for the change of the area times that energy. Construction and the
    methods are collective.
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
        (ptr, entry), (other_ptr, other_entry) = (
            entries_of(side.ptr, rows)[::-1]
            for side, rows in zip((self._search.one, self._search.other), self._search.near, strict=True)
        )
        joined, order = _joined(ptr, other_ptr)
        members = np.concatenate([self._search.one.members[entry], self._search.other.members[other_entry]])
        return joined, members[order]

    @property
    def _areas_of_particles(self) -> Float:
        one = self._search.one
        return np.bincount(one.owner, one.areas, self.body.cloud.n_owned).astype(float)

    def _formed(self, u: Float) -> Pairs:
        """Return the pairs of facets that may touch, for displacements of local particles (n_local, dim)."""
        pairs = self._search.pairs(u)
        return pairs.chosen((pairs.gap > -THROUGH * self._spacing) & (pairs.gap < NEAR * self._spacing))

    def _pairs(self, state: State) -> Pairs:
        u = state.u_local
        return state.kept((self, "pairs", self._search.version), lambda: self._formed(u))

    def _points(self, state: State) -> Points:
        pairs = self._pairs(state)
        return state.kept((self, "points", self._search.version), lambda: self._joined_points(pairs))

    def _joined_points(self, pairs: Pairs) -> Points:
        one, other, joined, order = self._ends(pairs)
        members = np.concatenate([one.members, other.members])[order]
        signed = np.concatenate([one.weights, -other.weights])[order]
        stencils = StencilMembers(self._search.one.owner[pairs.rows], joined, members)
        x = self._search.one.x[pairs.rows] + pairs.one
        return Points(x, pairs.area, self._part[pairs.rows], stencils, signed)

    def _ends(self, pairs: Pairs) -> tuple[Ends, Ends, GlobalIndex, GlobalIndex]:
        """Return the particles of both points of pairs; where those of each pair begin, and the order of all."""
        one, other = (
            self._search.one.ends(pairs.rows, pairs.one),
            self._search.other.ends(pairs.other_rows, pairs.other),
        )
        return one, other, *_joined(one.ptr, other.ptr)

    def _gap(self, state: State) -> tuple[Float, Float]:
        pairs = self._pairs(state)
        return pairs.gap, pairs.normal

    def _slip(self, state: State) -> Float:
        if self._mu == 0.0:
            return np.zeros_like(self._gap(state)[1])
        u, points = state.u_local, self._points(state)
        return state.kept((self, "slip", self.version), lambda: points.moved(u - self._before))

    def linearise(self, state: State) -> Sequence[Product]:
        """Return the derivatives of forces, points and weights, without friction their symmetric part."""
        touching, search = self._touching(state), self._search
        pairs, dim = self._pairs(state).chosen(touching.rows), self.body.dim
        J = search.by_corners(state.u_local, pairs)
        points = J[:, ONE : ONE + dim], J[:, OTHER : OTHER + dim]
        # The force of a pair is A t. It depends on the corners, and by slip on the displacements at both points.
        area, t = pairs.area[:, None, None], touching.traction
        rates = touching.by_gap[:, :, None] * J[:, GAP, None] + touching.by_normal @ J[:, NORMAL : NORMAL + dim]
        if self._mu > 0.0:
            change = state.u_local - self._before
            slopes, other_slopes = search.one.fields(change)[1], search.other.fields(change)[1]
            moved = slopes[pairs.rows] @ points[0] - other_slopes[pairs.other_rows] @ points[1]
            rates = rates + touching.by_slip @ moved
        by_corners = np.asarray(area * rates + t[:, :, None] * J[:, AREA, None])
        return [self._product(pairs, pairs.area[:, None] * t, by_corners, area * touching.by_slip, points)]

    def _product(
        self, pairs: Pairs, force: Float, by_corners: Float, by_slip: Float, points: tuple[Float, Float]
    ) -> RankOneProduct:
        """Return minus the derivative of forces ``w_k F`` with ``w_k = N_k + G_k . X`` on the members of both facets.

        Parameters
        ----------
        pairs : Pairs
            The pairs.
        force : (n, dim) float64
            F [force].
        by_corners, by_slip : (n, dim, 2 k dim), (n, dim, dim) float64
            Derivatives of F by the corners and by the displacements at the points [force / length].
        points : tuple of (n, dim, 2 k dim) float64
            Derivatives of the points X of both facets by the corners [-].
        """
        dim, n = self.body.dim, len(pairs.rows)
        *both, joined, order = self._ends(pairs)
        of = np.concatenate([end.of for end in both])[order]
        w = np.concatenate([sign * end.weights for end, sign in zip(both, (1.0, -1.0), strict=True)])[order]

        def by_members(derivative: Float) -> Float:
            """Return derivatives by the displacements of the members from those by the corners of both facets."""
            rate = derivative.reshape(n, 2, derivative.shape[1] // (2 * dim), dim)
            found = [np.einsum("ec,ecj->ej", end.corners, rate[end.of, number]) for number, end in enumerate(both)]
            return np.asarray(np.concatenate(found)[order])

        hs = [w[:, None] * axis for axis in np.eye(dim)]
        gs = [by_members(by_corners[:, i]) + w[:, None] * by_slip[:, i][of] for i in range(dim)]
        for number, by_point in enumerate(points):
            G = np.concatenate([(-1.0) ** number * end.G * (place == number) for place, end in enumerate(both)])[order]
            hs += [G[:, a, None] * force[of] for a in range(dim)]
            gs += [by_members(by_point[:, a]) for a in range(dim)]
        if self.symmetric:
            hs, gs = hs + gs, gs + hs
        # One stencil for each product of two vectors.
        count, sizes = len(hs), np.diff(joined)
        entry, ptr = entries_of(joined, np.repeat(np.arange(n), count))
        which = np.repeat(np.tile(np.arange(count), n), np.repeat(sizes, count))
        owner = np.repeat(self._search.one.owner[pairs.rows], count)
        members = np.concatenate([end.members for end in both])[order]
        stencils = StencilMembers(owner, ptr, members[entry])
        h, g = (np.ascontiguousarray(np.stack(vectors)[which, entry]) for vectors in (hs, gs))
        b = np.full(n * count, -0.5 if self.symmetric else -1.0)
        return RankOneProduct(stencils, self.body.cloud.n_owned, h, g, b)

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


def _joined(ptr: GlobalIndex, other: GlobalIndex) -> tuple[GlobalIndex, GlobalIndex]:
    """Return where the rows of two joined lists begin, and the order of their entries, one list after the other."""
    row = np.concatenate([np.repeat(np.arange(len(one) - 1), np.diff(one)) for one in (ptr, other)])
    return ptr + other, np.argsort(row, kind="stable")
