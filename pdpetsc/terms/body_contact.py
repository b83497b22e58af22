"""Contact between two parts of the surface of bodies."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence

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


# Share of the moment of friction that the pressure on each facet balances, with its sign.
HALVES = np.array([0.5, -0.5])


def _parts(pairs: Pairs, traction: Float) -> tuple[Float, Float]:
    """Return pressure (n,) and friction (n, dim) of tractions (n, dim) [stress]."""
    p = (traction * pairs.normal).sum(axis=1)
    return p, traction - p[:, None] * pairs.normal


def _over(values: Float, pressure: Float) -> Float:
    """Return values (n, ...) over pressures (n,), 0 without a pressure."""
    p = pressure.reshape(-1, *(1,) * (values.ndim - 1))
    return np.asarray(np.where(p > 0.0, values, 0.0) / np.where(p > 0.0, p, 1.0))


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
        self._search = Search(cloud, mine, theirs, NEAR * spacing)
        # Displacements of local particles at the start of this step, and the normals of the facets.
        self._before = np.zeros((cloud.n_local, body.dim))
        self._normals = self._search.normals(self._before)
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

    def _joined_points(self, pairs: Pairs) -> Points:
        return Points(self._search.one.x[pairs.rows] + pairs.one, pairs.area, self._multiplier(pairs))

    def _joined(self, pairs: Pairs, shift: Float | float = 0.0) -> FacetPairs:
        """Return pairs with how their facets move; their points may be shifted (n_pairs, 2, dim) [length]."""
        sides, at = (self._search.one.moving, self._search.other.moving), np.stack([pairs.one, pairs.other], axis=1)
        return FacetPairs(sides, (pairs.rows, pairs.other_rows), at + shift)

    def _gap(self, state: State) -> tuple[Float, Float]:
        pairs = self._pairs(state)
        return pairs.gap, pairs.normal

    def _felt(self, state: State) -> Float:
        points = self._points(state)
        return points.mean(self._gap(state)[0], len(self._owner))[points.of]

    def _slip(self, state: State) -> Float:
        pairs = self._pairs(state)
        if self._mu == 0.0:
            return np.zeros_like(pairs.normal)
        change = state.u_local - self._before

        def make() -> Float:
            apart = self._joined(pairs).moved(change) - pairs.gap[:, None] * pairs.normal
            return np.asarray(np.einsum("pij,pj->pi", self._across(pairs), apart))

        return state.kept((self, "slip", self.version), make)

    def _across(self, pairs: Pairs) -> Float:
        """Return the projections across the mean normals at the start of the step (n_pairs, dim, dim)."""
        n = self._normals[1][pairs.other_rows] - self._normals[0][pairs.rows]
        size = (n**2).sum(axis=1)
        return np.asarray(np.eye(self.body.dim) - n[:, :, None] * (n / np.where(size > 0.0, size, 1.0)[:, None])[:, None])

    def add_force(self, state: State, f: Float) -> None:
        """Subtract the forces of the contact."""
        touching = self._touching(state)
        if not len(touching.rows):
            return
        pairs = self._pairs(state).chosen(touching.rows)
        pressure, friction = _parts(pairs, touching.traction)
        area, shift = pairs.area[:, None], 0.0
        if self._mu > 0.0:
            shift = self._shifted(state, pairs, _over(friction, pressure))[0]
            self._joined(pairs).spread(-area * friction, f)
        self._joined(pairs, shift).spread(-area * pressure[:, None] * pairs.normal, f)

    def _shifted(self, state: State, pairs: Pairs, slope: Float) -> tuple[Float, Float, Float]:
        """Compute the shifts of the pressure that balance the moment of friction, for friction over pressure (n, dim).

        Returns
        -------
        shift : (n, 2, dim) float64
            Undeformed vectors in both facets [length].
        height : (n, 2) float64
            Distances along the normal that seen along it vanish [length].
        S : (n, 2, dim, 1 + dim) float64
            As of ``Search.shifts``.
        """
        S, way = self._search.shifts(state.u_local, pairs), pairs.gap[:, None] * slope
        found = np.einsum("psij,pi,s->psj", S, way, HALVES)
        return found[:, :, :-1], found[:, :, -1], S

    def linearise(self, state: State) -> Sequence[Product]:
        """Return the derivatives of forces, points and weights."""
        touching, search, u = self._touching(state), self._search, state.u_local
        pairs, n_owned, dim = self._pairs(state).chosen(touching.rows), self.body.cloud.n_owned, self.body.dim
        p, tau = _parts(pairs, touching.traction)
        size, one, area, n, gap = len(p), np.eye(dim), pairs.area[:, None, None], pairs.normal, pairs.gap[:, None, None]
        fields = 2, 1 + dim, dim
        J = search.rates(u, pairs).reshape(size, QUANTITIES, 2 * (1 + dim) * dim)
        by_area, by_gap = J[:, AREA, None], J[:, GAP, None]
        by_normal, by_points = J[:, NORMAL : NORMAL + dim], [J[:, at : at + dim] for at in (ONE, OTHER)]
        # The pressure of all pairs of a part depends on their mean gap.
        part, first, number = np.unique(self._multiplier(pairs), return_index=True, return_inverse=True)
        whole = np.bincount(number, pairs.area, len(part))[number][:, None, None]
        off = (pairs.gap - self._felt(state)[touching.rows])[:, None, None]
        by_mean = self._c * (area / whole * by_gap + off / whole * by_area)
        owner = search.one.owner[pairs.rows]
        parts = owner[first], np.append(first, size)

        def moving(joined: FacetPairs, by_force: Float, by_points: list[Float], force: Float) -> Product:
            """Return the product of forces at points that move with the fields, without that of the pressure."""
            G = np.concatenate([by_force, *by_points], axis=1).reshape(size, 3 * dim, *fields)
            h = np.tile(-one, (size, 1, 1))
            return PairProduct(joined, owner, np.arange(size + 1), n_owned, G, h, -pairs.area[:, None] * force)

        def pressed(joined: FacetPairs, by_pressure: Float) -> Product:
            h = area * by_pressure[:, None]
            return PairProduct(joined, *parts, n_owned, by_mean.reshape(size, 1, *fields), h, stiff=True)

        normal = p[:, None] * n
        by_force = p[:, None, None] * (area * by_normal + n[:, :, None] * by_area)
        if self._mu == 0.0:
            joined = self._joined(pairs)
            return [moving(joined, by_force, by_points, normal), pressed(joined, n)]
        # Slip is that of both points, less that of a gap that turns; the points move with the fields.
        joined, across, change = self._joined(pairs), self._across(pairs), u - self._before
        by_slip = touching.by_slip @ across
        at = np.concatenate([np.ones((size, 2, 1)), joined.at], axis=2) * np.array([1.0, -1.0])[:, None]
        by_motion = np.einsum("pim,psc->piscm", by_slip, at)
        apart = -n[:, :, None] * by_gap - gap * by_normal
        for sign, side, rows, by in zip((1.0, -1.0), joined.sides, joined.rows, by_points, strict=True):
            apart += sign * side.fields(change)[rows, 1:].transpose(0, 2, 1) @ by
        by_tau = (touching.by_normal - p[:, None, None] * one) @ by_normal + by_slip @ apart
        # The shift of the pressure.
        slope, by_pressure = _over(tau, p), touching.by_pressure - n
        shift, height, S = self._shifted(state, pairs, slope)
        by_slope = _over(by_tau + by_motion.reshape(apart.shape), p)
        by_way = HALVES[:, None, None] * (slope[:, :, None] * by_gap + gap * by_slope)[:, None]
        by_way = (by_way - height[:, :, None, None] * by_normal[:, None]).reshape(size, 2, dim, *fields)
        for side in range(2):
            for axis in range(dim):
                by_way[:, side, axis, side, 1:, axis] -= shift[:, side]
        by_shift = np.einsum("psij,psif->psjf", S[..., :-1], by_way.reshape(size, 2, *apart.shape[1:]))
        by_shifted = [by + by_shift[:, side] for side, by in enumerate(by_points)]
        by_friction = area * by_tau + tau[:, :, None] * by_area
        slid = np.tile(one, (size, 1, 1))
        return [
            moving(self._joined(pairs, shift), by_force, by_shifted, normal),
            moving(joined, by_friction, by_points, tau),
            pressed(self._joined(pairs, self._shifted(state, pairs, by_pressure)[0]), n),
            pressed(joined, by_pressure),
            PairProduct(
                joined, owner, np.arange(size + 1), n_owned, -area[:, :, :, None, None] * by_motion, slid, stiff=True
            ),
        ]

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
        self._normals = self._search.normals(self._before)

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
        before = deep.gap - (deep.normal * self._joined(deep).moved(change)).sum(axis=1)
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
