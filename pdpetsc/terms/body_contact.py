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
from pdpetsc.kernels.overlap import AREA, GAP, NORMAL, ONE, OTHER
from pdpetsc.problem.body import Body
from pdpetsc.problem.scales import nearest_distances
from pdpetsc.problem.state import State
from pdpetsc.problem.term import KeptArray
from pdpetsc.terms.facet_contact import OVERLAP, STICKING, ContactProduct, FacetContact, Points
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


def _shifts(S: Float, pairs: Pairs, slope: Float) -> tuple[Float, Float]:
    """Compute the shifts of the pressure that balance the moment of friction, for friction over pressure (n, dim).

    The tractions ``p n + tau`` and their opposite, a gap g apart, have the moment ``g n x tau``. Without it, the
    pressure acts at points that are ``g tau / p`` apart across the normal.

    Returns
    -------
    (n, 2, dim), (n, 2) float64
        Undeformed vectors in both facets, and their height as of ``Search.within`` [length].
    """
    found = np.einsum("psij,pi,s->psj", S, pairs.gap[:, None] * slope, HALVES)
    return found[:, :, :-1], found[:, :, -1]


class _Rates:
    """Derivatives of the quantities of pairs by the fields of both facets, in one row each.

    Parameters
    ----------
    J : (n, 11, 2, 1 + dim, dim) float64
        As of ``Search.rates``.
    """

    def __init__(self, J: Float, dim: int) -> None:
        self._fields = J.shape[2:]
        J = J.reshape(*J.shape[:2], 2 * (1 + dim) * dim)
        self.area, self.gap, self.normal = J[:, AREA, None], J[:, GAP, None], J[:, NORMAL : NORMAL + dim]
        self.points = [J[:, at : at + dim] for at in (ONE, OTHER)]

    def shaped(self, by_fields: Float) -> Float:
        """Return derivatives (..., 2 (1 + dim) dim) by displacement and gradient (..., 2, 1 + dim, dim)."""
        return by_fields.reshape(*by_fields.shape[:-1], *self._fields)


class BodyContactForces(FacetContact):
    """Compute the forces between facets of two parts of the surface that overlap.

    The points are the middles of the overlaps of the deformed facets. The facet of the one part feels ``A (p n + tau)``
    at its point, the facet of the other the opposite force, with the area A of the overlap. The pressure p is that of
    the mean gap over all overlaps of the facets of one particle that look alike: on unlike curved surfaces the gap
    differs from overlap to overlap.

    Friction acts at both points, a gap g apart along n. So that both forces have no moment, the pressure acts beside
    them, seen along n: at ``g tau / (2 p)`` on the one facet and at the opposite on the other. The slip s is that of
    the two points, less the turn of the gap between them. Slip and ``tau_0`` are those in the surfaces at the start of
    the step, and turn with the first facet: a rigid motion of both bodies changes no force.

    All of these follow the displacement. Which facets are near enough is held during a solve, since it determines the
    sparsity of the matrix; ``follow`` updates it.

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
        # Displacements of local particles at the start of this step, and axes that turn with the facets.
        self._before = np.zeros((cloud.n_local, body.dim))
        self._frames = self._search.frames(self._before)
        # True at the end of the last step of a checkpoint, until the facets that are near there are known.
        self._resumed = False
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

    def _sticking(self, state: State) -> Float:
        pairs, points = self._pairs(state), self._points(state)
        apart = self._joined(pairs).moved(state.u_local - self._before) - pairs.gap[:, None] * pairs.normal
        slip = np.einsum("pij,pj->pi", self._across(pairs), apart)
        turned = self._turned(state, pairs)
        return np.asarray(np.einsum("pij,pj->pi", turned, self._tau[points.of] - STICKING * self._c * slip))

    def _across(self, pairs: Pairs) -> Float:
        """Return the projections across the mean normals at the start of the step (n_pairs, dim, dim)."""
        one, other = (frames[:, 2, : self.body.dim] for frames in self._frames)
        n = other[pairs.other_rows] - one[pairs.rows]
        size = (n**2).sum(axis=1)[:, None]
        n_over_size = n / np.where(size > 0.0, size, 1.0)
        return np.asarray(np.eye(self.body.dim) - n[:, :, None] * n_over_size[:, None])

    def _turned(self, state: State, pairs: Pairs) -> Float:
        """Return the rotations of the first facets of pairs since the start of the step (n_pairs, dim, dim)."""
        now, before = self._search.frames(state.u_local)[0], self._frames[0]
        turned = now[pairs.rows].transpose(0, 2, 1) @ before[pairs.rows]
        return np.asarray(turned[:, : self.body.dim, : self.body.dim])

    def add_force(self, state: State, f: Float) -> None:
        """Subtract the forces of the contact."""
        touching = self._touching(state)
        if not len(touching.rows):
            return
        pairs = self._pairs(state).chosen(touching.rows)
        p, tau = _parts(pairs, touching.traction)
        area, joined = pairs.area[:, None], self._joined(pairs)
        if self._mu > 0.0:
            joined.spread(-area * tau, f)
            shift, _ = _shifts(self._search.within(state.u_local, pairs), pairs, _over(tau, p))
            joined = self._joined(pairs, shift)
        joined.spread(-area * p[:, None] * pairs.normal, f)

    def linearise(self, state: State) -> Sequence[Product]:
        """Return the derivatives of forces, points and weights."""
        touching, search, u = self._touching(state), self._search, state.u_local
        pairs, dim = self._pairs(state).chosen(touching.rows), self.body.dim
        rates = _Rates(search.rates(u, pairs), dim)
        (p, tau), n, area, joined = _parts(pairs, touching.traction), pairs.normal, pairs.area, self._joined(pairs)
        by_pressure: Float = p[:, None, None] * (area[:, None, None] * rates.normal + n[:, :, None] * rates.area)
        # The pressure of all pairs of a part depends on their mean gap.
        part, first, number = np.unique(self._multiplier(pairs), return_index=True, return_inverse=True)
        share = area / np.bincount(number, area, len(part))[number]
        off = share / area * (pairs.gap - self._felt(state)[touching.rows])
        by_mean = self._c * (share[:, None, None] * rates.gap + off[:, None, None] * rates.area)
        owner, n_owned, each = search.one.owner[pairs.rows], self.body.cloud.n_owned, np.arange(len(p) + 1)
        opposite = np.tile(-np.eye(dim), (len(p), 1, 1))

        def moving(joined: FacetPairs, by_force: Float, by_points: list[Float], traction: Float) -> PairProduct:
            """Return the product of forces that depend on the fields, and move with their points."""
            G = rates.shaped(np.concatenate([by_force, *by_points], axis=1))
            return PairProduct(joined, owner, each, n_owned, G, opposite, -area[:, None] * traction)

        def pressed(joined: FacetPairs, by_pressure: Float) -> PairProduct:
            """Return the product of forces that depend on the pressure."""
            h = area[:, None, None] * by_pressure[:, None]
            return PairProduct(
                joined, owner[first], np.append(first, len(p)), n_owned, rates.shaped(by_mean), h, stiff=True
            )

        if self._mu == 0.0:
            return [moving(joined, by_pressure, rates.points, p[:, None] * n), pressed(joined, n)]
        # Slip depends on the displacements at both points, on these, and on the gap that turns.
        by_slip = -STICKING * self._c * touching.by_trial @ self._turned(state, pairs) @ self._across(pairs)
        gap, change = pairs.gap[:, None, None], u - self._before
        by_place = -n[:, :, None] * rates.gap - gap * rates.normal
        for sign, side, rows, by in zip((1.0, -1.0), joined.sides, joined.rows, rates.points, strict=True):
            by_place += sign * side.fields(change)[rows, 1:].transpose(0, 2, 1) @ by
        turns = search.turns(u, pairs, self._sticking(state)[touching.rows]).reshape(by_place.shape)
        by_place = by_slip @ by_place + touching.by_trial @ turns
        by_place += (touching.by_normal - p[:, None, None] * np.eye(dim)) @ rates.normal
        at = np.concatenate([np.ones((len(p), 2, 1)), joined.at], axis=2) * np.array([1.0, -1.0])[:, None]
        by_motion = np.einsum("pim,psc->piscm", by_slip, at)
        # The pressure is shifted by friction over pressure.
        S, slope, tau_by_pressure = search.within(u, pairs), _over(tau, p), touching.by_pressure - n
        by_slope = _over(by_place + by_motion.reshape(by_place.shape), p)
        shift, height = _shifts(S, pairs, slope)
        by_shift = HALVES[:, None, None] * (slope[:, :, None] * rates.gap + gap * by_slope)[:, None]
        by_shift = rates.shaped(by_shift - height[:, :, None, None] * rates.normal[:, None])
        for facet in range(2):
            for axis in range(dim):
                by_shift[:, facet, axis, facet, 1:, axis] -= shift[:, facet]
        by_shift = np.einsum("psij,psif->psjf", S[..., :-1], by_shift.reshape(len(p), 2, *by_place.shape[1:]))
        shifted = [by + by_shift[:, facet] for facet, by in enumerate(rates.points)]
        along = area[:, None, None] * by_place + tau[:, :, None] * rates.area
        G = -area[:, None, None, None, None] * by_motion
        return [
            moving(self._joined(pairs, shift), by_pressure, shifted, p[:, None] * n),
            moving(joined, along, rates.points, tau),
            pressed(self._joined(pairs, _shifts(S, pairs, tau_by_pressure)[0]), n),
            pressed(joined, tau_by_pressure),
            PairProduct(joined, owner, each, n_owned, G, -opposite, stiff=True),
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
        if not self._resumed:
            super().start_from(state)
        self._resumed = False
        self.follow(state)

    def _step_from(self, state: State) -> None:
        self._begin_at(state.u_local.copy())

    def _begin_at(self, u: Float) -> None:
        """Measure slip from the displacements of local particles (n_local, dim)."""
        self._before, self._frames = u, self._search.frames(u)

    def arrays(self) -> Mapping[str, KeptArray]:
        """Return also tractions and displacements at the start of the last step, on which its friction depends."""
        found = dict(super().arrays())
        if self._mu > 0.0:
            n = self.body.cloud.n_owned
            found[f"{self._name}_tau_before"] = KeptArray(self._owner, self._tau)
            found[f"{self._name}_before"] = KeptArray(np.arange(n, dtype=np.int32), self._before[:n])
        return found

    def restored(self) -> None:
        """Continue at the end of the last step of a checkpoint (collective)."""
        super().restored()
        if self._mu > 0.0:
            self._resumed = True
            self._begin_at(self.body.with_ghosts(self._before[: self.body.cloud.n_owned]))

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
