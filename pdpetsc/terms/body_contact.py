"""Contact between two parts of the surface of bodies."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from pdpetsc.arrays import Float, GlobalIndex, LocalIndex, Mask, entries_of, starts_of
from pdpetsc.declare.body_contact import BodyContact
from pdpetsc.discrete.communicator import all_largest, anywhere, count_nonzero, largest, smallest
from pdpetsc.errors import CaseError, SolveError
from pdpetsc.gradient.base import StencilMembers
from pdpetsc.gradient.pair_product import FacetPairs, PairProduct
from pdpetsc.gradient.products import Product
from pdpetsc.kernels.overlap import AREA, GAP, NORMAL, ONE, OTHER, QUANTITIES
from pdpetsc.problem.body import Body
from pdpetsc.problem.scales import nearest_distances
from pdpetsc.problem.state import State
from pdpetsc.terms.facet_contact import OVERLAP, ContactProduct, FacetContact, Points
from pdpetsc.terms.facing import Pairs, Search, corners_of, sides_of
from pdpetsc.terms.shared_space import bodies_of, shared_point

# Gap up to which facets form a pair, in spacings.
NEAR = 0.5
# Penetration beyond which facets have passed through each other, in spacings at the finer one of both.
THROUGH = 0.9
# Thickness of material up to which facets of both parts that face each other through it never touch, in spacings.
DEEP = 4.0


@dataclass(frozen=True)
class PairPoints(Points):
    """Store the points of pairs of facets.

    Attributes
    ----------
    pairs : FacetPairs
        The pairs.
    """

    pairs: FacetPairs

    def moved(self, u: Float) -> Float:
        return self.pairs.moved(u)

    def spread(self, force: Float, f: Float) -> None:
        self.pairs.spread(-force, f)


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
    bodies : sequence of str
        Names of the bodies for messages, in their order; none for particles of one body.

    Notes
    -----
    The tangent is not symmetric, without friction by a share of the order of the pressure over the modulus of the body:
    the forces are the derivatives of an energy but for the change of the area times that energy. Its symmetric part can
    be indefinite where the equilibrium is stable. Construction and the methods are collective.
    """

    def __init__(
        self, body: Body, declared: BodyContact, one: Mask, other: Mask, stiffness: float, spacing: float, name: str,
        bodies: Sequence[str] = (),
    ) -> None:  # fmt: skip
        cloud = body.cloud
        numbers = [bodies_of(body, facets) for facets in (one, other)]
        named = ["the body"] * 2
        if bodies:
            named = ["body " + " or ".join(repr(bodies[number]) for number in numbers_of) for numbers_of in numbers]
        self._reach = declared.reach_at(cloud.horizon)
        corners, depth = corners_of(body, name)
        mine, self._theirs, theirs = sides_of(body, one, other, self._reach, corners, depth)
        # One multiplier for each flat part of the surface of a particle and each body before it: the displacement
        # cannot follow more of them.
        self._part, self._bodies = mine.parts, 1
        self._body_of_other = np.zeros(len(theirs.x), dtype=np.int64)
        if cloud.body is not None:
            self._bodies = 1 + int(largest(cloud.comm, cloud.body, initial=0))
            self._body_of_other = cloud.body[theirs.particle]
        first = np.unique(self._part, return_index=True)[1]
        owner, title = np.repeat(mine.owner[first], self._bodies), f"{named[0][0].upper()}{named[0][1:]} of {name}"
        super().__init__(body, declared, owner, stiffness, spacing, title, named[1])
        self.symmetric = False
        self.works = self._mu > 0.0
        # Spacing at the facets of both sides: thin walls are not thinner than this.
        apart = cloud.halo.with_ghosts(nearest_distances(body))
        self._local = apart[mine.particle], apart[theirs.particle]
        # Displacements of local particles at the start of this step.
        self._before = np.zeros((cloud.n_local, body.dim))
        self._search = Search(cloud, mine, theirs, NEAR * spacing)
        self._search.leave_out_material(self._before, DEEP * spacing)
        self._search.renew(self._before)
        body.overlap.couple(mine.owner)
        self.pattern = self._search.version
        # Of facets of both parts which one is the first of a pair has no meaning.
        self._of_itself = anywhere(cloud.comm, mine.both)
        overlap = largest(cloud.comm, -self._formed(self._before).gap, initial=0.0)
        if overlap > OVERLAP * spacing:
            raise CaseError(
                f"The bodies of {name} overlap by {overlap:.3g} at the start; begin with a gap or in touch."
            )
        shared = shared_point(body, corners, *numbers)
        if shared is not None:
            both = " and ".join(repr(bodies[number]) if bodies else str(number) for number in shared[:2])
            at = ", ".join(f"{along:.4g}" for along in shared[2])
            raise CaseError(
                f"The bodies {both} of {name} overlap at the start: both contain the point ({at}). Begin with a gap or "
                f"in touch."
            )

    @property
    def stencils(self) -> tuple[GlobalIndex, LocalIndex]:
        """Return the members of the facets of each particle and of all facets near them (not collective).

        They depend on each other: the pressure of a pair is that of the mean gap of all pairs of a particle.
        """
        search, n = self._search, self.body.cloud.n_local
        one, other = search.near
        # All facets of a particle have the same members.
        key = search.one.particle[one].astype(np.int64) * n + search.other.particle[other]
        _, first = np.unique(key, return_index=True)
        keys = []
        for side, rows in ((search.one, one[first]), (search.other, other[first])):
            entry, ptr = entries_of(side.ptr, rows)
            particle = np.repeat(search.one.particle[one[first]].astype(np.int64), np.diff(ptr))
            keys.append(particle * n + side.members[entry])
        particle, members = np.divmod(np.unique(np.concatenate(keys)), n)
        _, count = np.unique(particle, return_counts=True)
        return starts_of(count), members.astype(np.int32)

    # Pairs are of particles without a common family.
    within_families = False

    def _formed(self, u: Float) -> Pairs:
        """Return the pairs of facets that may touch, for displacements of local particles (n_local, dim)."""
        pairs = self._search.pairs(u)
        pairs = pairs.chosen((pairs.gap > -self._through(pairs)) & (pairs.gap < NEAR * self._spacing))
        return pairs.chosen(np.argsort(self._multiplier(pairs), kind="stable"))

    def _multiplier(self, pairs: Pairs) -> GlobalIndex:
        """Return the number of the multiplier of each pair."""
        return np.asarray(self._part[pairs.rows] * self._bodies + self._body_of_other[pairs.other_rows])

    def _through(self, pairs: Pairs) -> Float:
        """Return the penetration beyond which facets have passed through each other (n_pairs,) [length]."""
        return np.asarray(THROUGH * np.minimum(self._local[0][pairs.rows], self._local[1][pairs.other_rows]))

    def _pairs(self, state: State) -> Pairs:
        u = state.u_local
        return state.kept((self, "pairs", self._search.version), lambda: self._formed(u))

    def _points(self, state: State) -> Points:
        pairs = self._pairs(state)
        return state.kept((self, "points", self._search.version), lambda: self._joined_points(pairs))

    def _joined_points(self, pairs: Pairs) -> PairPoints:
        x = self._search.one.x[pairs.rows] + pairs.one
        return PairPoints(x, pairs.area, self._multiplier(pairs), self._joined(pairs))

    def _joined(self, pairs: Pairs) -> FacetPairs:
        """Return pairs with how their facets move."""
        sides, at = (self._search.one.moving, self._search.other.moving), np.stack([pairs.one, pairs.other], axis=1)
        return FacetPairs(sides, (pairs.rows, pairs.other_rows), at)

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
        pairs, n = self._pairs(state).chosen(touching.rows), self.body.cloud.n_owned
        joined, dim, one = self._joined(pairs), self.body.dim, np.eye(self.body.dim)
        J = search.rates(state.u_local, pairs)
        size, flat = len(J), J.reshape(len(J), QUANTITIES, 2 * (1 + dim) * dim)
        by_points = flat[:, ONE : ONE + dim], flat[:, OTHER : OTHER + dim]
        # The force of a pair is A t. It depends on the fields, and by slip on the displacements at both points.
        area, t = pairs.area[:, None, None], touching.traction
        rates = touching.by_normal @ flat[:, NORMAL : NORMAL + dim]
        if self._mu > 0.0:
            change = state.u_local - self._before
            for sign, side, rows, by in zip((1.0, -1.0), joined.sides, joined.rows, by_points, strict=True):
                slopes = side.fields(change)[rows, 1:].transpose(0, 2, 1)
                rates = rates + sign * touching.by_slip @ (slopes @ by)
        by_force = area * rates + t[:, :, None] * flat[:, AREA, None]
        # The pressure of all pairs of a part depends on their mean gap.
        part, first, number = np.unique(self._multiplier(pairs), return_index=True, return_inverse=True)
        whole = np.bincount(number, pairs.area, len(part))[number]
        off = pairs.gap - self._felt(state)[touching.rows]
        by_mean = (pairs.area / whole)[:, None] * flat[:, GAP] + (off / whole)[:, None] * flat[:, AREA]
        owner = search.one.owner[pairs.rows]
        # The points move with the fields, and the forces with the points.
        G = np.concatenate([by_force, *by_points], axis=1).reshape(size, 3 * dim, 2, 1 + dim, dim)
        alone, force = np.arange(size + 1), -pairs.area[:, None] * t
        pressed = (pairs.area[:, None] * touching.by_pressure)[:, None]
        found = [
            PairProduct(joined, owner, alone, n, G, np.tile(-one, (size, 1, 1)), force),
            PairProduct(
                joined,
                owner[first],
                np.append(first, size),
                n,
                self._c * by_mean.reshape(size, 1, 2, 1 + dim, dim),
                pressed,
                stiff=True,
            ),
        ]
        if self._mu > 0.0:
            at = np.concatenate([np.ones((size, 2, 1)), joined.at], axis=2) * np.array([1.0, -1.0])[:, None]
            G = np.einsum("pim,psc->piscm", -area * touching.by_slip, at)
            found.append(PairProduct(joined, owner, alone, n, G, np.tile(one, (size, 1, 1)), stiff=True))
        return found

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

    def start_from(self, state: State) -> None:
        """Continue with the tractions at the end of the last step, and with the facets that are near at its start."""
        super().start_from(state)
        self.follow(state)

    def _step_from(self, state: State) -> None:
        self._before = state.u_local.copy()

    def follow(self, state: State) -> bool:
        """Update which facets are near; return False if nothing touches before and after."""
        u, search = state.u_local, self._search
        if not search.due(u):
            return False
        pressed = self._pressed(state)
        search.renew(u)
        self.pattern = search.version
        self.version += 1
        return self._pressed(state) or pressed

    def _pressed(self, state: State) -> bool:
        return anywhere(self.body.cloud.comm, len(self._touching(state).rows))

    def objection(self, state: State) -> str:
        """Return a reason if facets have passed through each other in the step."""
        u, comm = state.u_local, self.body.cloud.comm
        change = u - self._before
        most = self._apart(change)
        if most < 0.5 * THROUGH * smallest(comm, float(min(one.min(initial=np.inf) for one in self._local))):
            return ""
        deep = self._search.passed(u, most)
        deep = deep.chosen(deep.gap <= -self._through(deep))
        before = deep.gap - (deep.normal * self._joined_points(deep).moved(change)).sum(axis=1)
        passed = count_nonzero(comm, before > -self._through(deep))
        return f"bodies of {self._name} passed through each other in one step" if passed else ""

    def commit(self, state: State) -> None:
        """Store tractions and multipliers; raise SolveError if bodies penetrate, or have moved too far."""
        most = self._apart(state.u_local)
        if most > self._reach:
            raise SolveError(
                f"The parts of {self._name} have moved by up to {most:.3g} relative to each other at step time "
                f"{state.t:.6g}, further than reach={self._reach:.3g}. Raise the reach."
            )
        self._refuse_own_image(state)
        super().commit(state)

    def _refuse_own_image(self, state: State) -> None:
        """Raise SolveError if a body in contact with itself is beyond a mirror plane, into its own image."""
        side, cloud = self._search.one, self.body.cloud
        for axis, at in cloud.places.planes.items() if self._of_itself else ():
            before = side.x[side.both, axis] - at
            now = side.deformed(state.u_local)[side.both, :, axis].mean(axis=1) - at
            beyond = largest(cloud.comm, -np.sign(before) * now)
            if beyond > self._allowed:
                raise SolveError(
                    f"{self._title} is {beyond / self._spacing:.2g} spacings beyond the mirror plane "
                    f"{'xyz'[axis]} = {at:g} at step time {state.t:.6g}, in its own image. Add a Contact with a "
                    f"RigidPlane on the mirror plane."
                )

    def _apart(self, u: Float) -> float:
        """Return a bound on the relative displacements of both parts [length] (collective)."""
        # The largest of both signs of all components.
        most = [
            np.concatenate([sign * moved.reshape(-1, moved.shape[2]) for sign in (1.0, -1.0)], axis=1).max(
                axis=0, initial=-np.inf
            )
            for moved in (
                (side.deformed(u) - side.corners)[:, :, : self.body.dim] for side in (self._search.one, self._theirs)
            )
        ]
        high, other = np.split(all_largest(self.body.cloud.comm, np.concatenate(most)), 2)
        dim = self.body.dim
        for axis in self.body.cloud.places.planes:
            # Images move the other way.
            other[[axis, dim + axis]] = other[[axis, dim + axis]].max()
        return float(np.linalg.norm(np.maximum(high[:dim] + other[dim:], high[dim:] + other[:dim])))

    def numbers(self) -> Mapping[str, Callable[[State], float]]:
        """Return the force on the first part by component, area in contact and violation of the gap.

        The first part has no meaning where facets belong to both: the sum of the normal forces takes its place.
        """
        found = dict(super().numbers())
        if not self._of_itself:
            return found

        def normal_force(state: State) -> float:
            touching = self._touching(state)
            normal = (touching.traction * self._gap(state)[1][touching.rows]).sum(axis=1)
            return float(self._points(state).area[touching.rows] @ normal)

        components = {f"{self._name}_{axis}" for axis in "xyz"[: self.body.dim]}
        return {f"{self._name}_force": normal_force} | {key: one for key, one in found.items() if key not in components}

    def fields(self) -> Mapping[str, Callable[[State], Float]]:
        """Return the mean tractions on the facets of the own particles, of both parts (n_owned, dim) [stress]."""
        cloud, sides = self.body.cloud, (self._search.one, self._theirs)
        area = np.zeros(cloud.n_owned)
        area += np.bincount(sides[0].owner, sides[0].areas, cloud.n_owned)
        alone = ~sides[1].both
        area += np.bincount(sides[1].owner[alone], sides[1].areas[alone], cloud.n_owned)

        def traction(state: State) -> Float:
            rows, pairs, search = self._touching(state).rows, self._pairs(state), self._search
            force = pairs.area[rows, None] * self._in_space(state)
            values = np.zeros((cloud.n_local, self.body.dim))
            np.add.at(values, search.one.particle[pairs.rows[rows]], force)
            np.add.at(values, search.other.particle[pairs.other_rows[rows]], -force)
            cloud.mirror(values)
            cloud.halo.reverse(values)
            return np.asarray(values[: cloud.n_owned] / np.where(area > 0.0, area, 1.0)[:, None])

        return {f"{self._name}_traction": traction}
