"""Contact between two parts of the surface of bodies."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from pdpetsc.arrays import Float, GlobalIndex, LocalIndex, Mask, entries_of
from pdpetsc.declare.body_contact import BodyContact
from pdpetsc.discrete.communicator import largest, smallest, total
from pdpetsc.errors import CaseError, SolveError
from pdpetsc.gradient.base import StencilMembers
from pdpetsc.gradient.products import Product
from pdpetsc.problem.body import Body
from pdpetsc.problem.state import State
from pdpetsc.terms.facet_contact import OVERLAP, ContactProduct, FacetContact, Points
from pdpetsc.terms.facing import Pairs, Search, sides_of

# Gap up to which facets form a pair, in spacings.
NEAR = 0.5
# Penetration beyond which facets that face each other have the material between them, in spacings.
THROUGH = 0.5


class BodyContactForces(FacetContact):
    """Compute the forces between facets of two parts of the surface that overlap.

    The points are the middles of the overlaps. Their relative displacement is that of the point on the facet of the
    one part less that of the point on the facet of the other. Points, normals and areas are held during a solve, so
    that the gap is linear in the displacements; ``follow`` updates them.

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
    Construction and the methods are collective.
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
        # Displacements of local particles at the last converged step.
        self._before = np.zeros((cloud.n_local, body.dim))
        self._stale = False
        self._form(self._before)
        overlap = largest(cloud.comm, float(np.max(-self._g0, initial=0.0)))
        if overlap > OVERLAP * spacing:
            raise CaseError(f"The bodies of {name} overlap by {overlap:.3g} at the start; begin with a gap or in touch.")

    @property
    def _points(self) -> Points:
        return self._at

    @property
    def _areas_of_particles(self) -> Float:
        one = self._search.one
        return np.bincount(one.owner, one.areas, self.body.cloud.n_owned)

    @property
    def stencils(self) -> tuple[GlobalIndex, LocalIndex]:
        """Return the members of all near facets (not collective)."""
        sides = zip((self._search.one, self._search.other), self._search.near, strict=True)
        ptr, members, _ = _joined(*((side.ptr, side.members, side.N, rows) for side, rows in sides))
        return ptr, members

    def _form(self, u: Float) -> None:
        """Form the pairs of facets for displacements of local particles (n_local, dim) (collective)."""
        pairs = self._search.pairs(u)
        self.pattern = self._search.version
        pairs = pairs.chosen((pairs.gap > -THROUGH * self._spacing) & (pairs.gap < NEAR * self._spacing))
        self._hold(pairs, u)

    def _hold(self, pairs: Pairs, u: Float) -> None:
        """Join pairs to one point for each part of the surface, and use these until the next ones are formed."""
        search, dim = self._search, self.body.dim
        part, of = np.unique(self._part[pairs.one], return_inverse=True)
        n = len(part)

        def mean(values: Float) -> Float:
            return np.stack([np.bincount(of, pairs.area * along, n) / area for along in values.T], axis=1)

        area = np.bincount(of, pairs.area, n)
        normal = mean(pairs.normal)
        self._n = normal / np.linalg.norm(normal, axis=1)[:, None]
        places, keys, weights = [], [], []
        ends = (search.one, pairs.one, pairs.at, 1.0), (search.other, pairs.other, pairs.across, -1.0)
        for side, rows, at, sign in ends:
            corners = side.corners[rows][:, :, :dim] + side.displaced(u)[rows]
            ptr, members, of_members, X = side.weights_at(rows, at, corners)
            pair = np.repeat(np.arange(len(rows)), np.diff(ptr))
            places.append(mean(X))
            keys.append(of[pair] * self.body.cloud.n_local + members)
            weights.append(sign * pairs.area[pair] / area[of[pair]] * of_members)
        key, entry = np.unique(np.concatenate(keys), return_inverse=True)
        point, members = np.divmod(key, self.body.cloud.n_local)
        ptr = np.searchsorted(point, np.arange(n + 1))
        stencils = StencilMembers(self._owner[part], ptr, members.astype(np.int32))
        self._at = Points(places[0], area, part, stencils, np.bincount(entry, np.concatenate(weights), len(key)))
        # The gap of the undeformed points along the normal.
        self._g0 = ((places[0] - places[1]) * self._n).sum(axis=1)
        self._flat = np.zeros((n, dim, dim))
        self.version += 1

    def _gap(self, state: State) -> tuple[Float, Float, Float]:
        u = state.u_local

        def make() -> tuple[Float, Float, Float]:
            return self._g0 + (self._n * self._at.moved(u)).sum(axis=1), self._n, self._flat

        return state.kept((self, "gap", self.version), make)

    def _slip(self, state: State) -> Float:
        u = state.u_local
        if self._mu == 0.0:
            return np.zeros_like(self._n)
        return state.kept((self, "slip", self.version), lambda: self._at.moved(u - self._before))

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

    def begin(self, state: State) -> None:
        """Form the pairs of a restarted run."""
        if self._stale:
            self._stale = False
            self._before = state.u_local.copy()
            self._form(self._before)

    def follow(self, state: State) -> bool:
        """Form the pairs at a state; return False if nothing touches before and after."""
        pressed = self._pressed(state)
        self._form(state.u_local)
        return self._pressed(state) or pressed

    def _pressed(self, state: State) -> bool:
        return int(total(self.body.cloud.comm, len(self._touching(state).rows))) > 0

    def revert_multipliers(self) -> None:
        """Restore multipliers and pairs of the last converged step."""
        super().revert_multipliers()
        self._form(self._before)

    def objection(self, state: State) -> str:
        """Return a reason if facets have passed through each other in the step."""
        u, through = state.u_local, THROUGH * self._spacing
        change = u - self._before
        most = self._apart(change)
        if most < 0.5 * through:
            return ""
        deep = self._search.passed(u, most)
        deep = deep.chosen(deep.gap <= -through)
        self._hold(deep, u)
        before = deep.gap - (self._n * self._at.moved(change)).sum(axis=1)
        self._form(u)
        passed = int(total(self.body.cloud.comm, np.count_nonzero(before > -through)))
        return f"bodies of {self._name} passed through each other in one step" if passed else ""

    def commit(self, state: State) -> None:
        """Store tractions and displacements, and form the pairs of the next step."""
        u = state.u_local
        most = self._apart(u)
        if most > self._reach:
            raise SolveError(
                f"The parts of {self._name} have moved by up to {most:.3g} relative to each other at step time "
                f"{state.t:.6g}, further than reach={self._reach:.3g}. Raise the reach."
            )
        super().commit(state)
        self._before = u.copy()
        self._form(u)

    def _apart(self, u: Float) -> float:
        """Return a bound on the relative displacements of both parts [length] (collective)."""
        comm, ranges = self.body.cloud.comm, []
        for side in (self._search.one, self._theirs):
            flat = side.displaced(u).reshape(-1, self.body.dim)
            least = [smallest(comm, float(along.min(initial=np.inf))) for along in flat.T]
            most = [largest(comm, float(along.max(initial=-np.inf))) for along in flat.T]
            ranges.append((np.array(least), np.array(most)))
        (low, high), (least_other, most_other) = ranges
        return float(np.linalg.norm(np.maximum(high - least_other, most_other - low)))

    def restored(self) -> None:
        """Continue with the multipliers of a checkpoint, and form the pairs when the run begins."""
        super().restored()
        self._stale = True


def _joined(*parts: tuple[GlobalIndex, LocalIndex, Float, GlobalIndex]) -> tuple[GlobalIndex, LocalIndex, Float]:
    """Return stencils that join chosen rows of several ones, row by row."""
    taken = [(*entries_of(ptr, rows), members, weights) for ptr, members, weights, rows in parts]
    row = np.concatenate([np.repeat(np.arange(len(ptr) - 1), np.diff(ptr)) for _, ptr, _, _ in taken])
    order = np.argsort(row, kind="stable")
    members = np.concatenate([members[entry] for entry, _, members, _ in taken])[order]
    weights = np.concatenate([weights[entry] for entry, _, _, weights in taken])[order]
    ptr = np.sum([ptr for _, ptr, _, _ in taken], axis=0)
    return ptr, members.astype(np.int32), weights
