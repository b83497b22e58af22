"""Contact of the facets of a surface with a rigid tool."""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping, Sequence
from itertools import chain
from typing import NamedTuple

import numpy as np

from pdpetsc.arrays import Float, GlobalIndex, LocalIndex, Mask, row_of_entries
from pdpetsc.clock import START
from pdpetsc.declare.tools import Contact
from pdpetsc.discrete.communicator import anywhere, largest, smallest
from pdpetsc.errors import CaseError
from pdpetsc.gradient.products import Product
from pdpetsc.problem.body import Body
from pdpetsc.problem.rigid_body import RigidBody
from pdpetsc.problem.scales import nearest_distances
from pdpetsc.problem.state import State
from pdpetsc.problem.term import KeptArray
from pdpetsc.terms.chosen_facets import ChosenFacets
from pdpetsc.terms.facet_contact import OVERLAP, STICKING, FacetContact, FixedPoints
from pdpetsc.terms.shared_space import bodies_of

# Smallest and largest number of places between the ends of a step at which a tool may not lie within the body; they are
# half a spacing apart, as far as the largest number allows.
PLACES, MOST_PLACES = 16, 1000
# Largest turn of a tool with friction in a step [rad]: friction sees the chord of the path.
TURN = 0.5
# A tool in the body at the start. Depth of points of the surface in a wide tool that are not in it, in spacings; width
# of a tool, in spacings, below which no particle is in it; points on each side of a facet; distance of the particles
# next to that of a facet, in nearest distances, and how far they may be off its plane, in their distance.
SHALLOW, WIDE, PER_SIDE, BESIDE, FLAT = 0.5, 4.0, 8, 1.25, 0.25
# Gap over the spacing above which a facet has no force, with the rounding of the motion.
CLEAR = 1e-6
# Share of the facets that may be in contact from which the gaps of all are computed.
MOST_NEAR = 0.25


class Seen(NamedTuple):
    """Store the gaps of the facets of this rank at a state.

    Attributes
    ----------
    moved : (n_facets, dim) float64
        Displacements of the facets [length].
    R, d : (dim, dim), (dim,) float64
        Rotation and displacement of the tool [-], [length].
    arm : (n_facets,) float64
        Distances of the facets from the point about which the tool turns [length].
    gap : (n_facets,) float64
        [length].
    """

    moved: Float
    R: Float
    d: Float
    arm: Float
    gap: Float


class ContactForces(FacetContact):
    """Compute the forces of a rigid tool on the facets of a surface.

    The points are facets at ``x_f + sum_k N_f(x_k) u_k``: those that may be in contact, since they have moved by more
    than their gap at an earlier state. Gap, slip and tractions are those seen from the tool, and turned with it.

    Parameters
    ----------
    body : Body
        Particles with their surface.
    declared : Contact
        Declared contact.
    mask : (n_facets,) bool
        Facets that may come into contact.
    stiffness : float
        ``c`` [stress / length].
    spacing : float
        Mean spacing of the particles [length].
    name : str
        Name of the condition in messages.

    Notes
    -----
    Construction and the methods are collective.
    """

    def __init__(
        self, body: Body, declared: Contact, mask: Mask, stiffness: float, spacing: float, name: str
    ) -> None:  # fmt: skip
        facets = ChosenFacets(body.known_surface, mask)
        title = f"The tool of {name}"
        super().__init__(body, declared, facets.stencils.owner, stiffness, spacing, title, "the body")
        self._tool = declared.tool
        self._moving = RigidBody(declared.tool, body.cloud.comm, body.dim, self._owner, title)
        self.rigid = self._moving if declared.tool.loaded else None
        self.works = self._mu > 0.0 or not declared.tool.rests
        self.tool_way = None if declared.tool.rests or declared.tool.loaded else self._moving.driven
        self._x, self._at = facets.x, FixedPoints.on(facets)
        # Displacements as seen from the tool at the start of this step, and at its end after it has converged.
        self._slid, self._slid_end = np.zeros_like(self._x), np.zeros_like(self._x)
        # The gaps of all facets that were computed last.
        nothing = np.zeros(len(self._x))
        self._last = Seen(np.zeros_like(self._x), np.eye(body.dim), np.zeros(body.dim), nothing, nothing - np.inf)
        rest = State(body, np.zeros((body.cloud.n_rows, body.dim)))
        bodies = bodies_of(body, mask)
        depths = self._depth_at_particles(bodies, facets.area), self._depth_between_facets(rest, facets.area)
        deepest = max(self._off(rest), *depths)
        if deepest > OVERLAP * spacing:
            raise CaseError(f"{title} overlaps the body by {deepest:.3g} at the start; begin with a gap or in touch.")
        # Smallest gap of all converged states.
        self._nearest = self.tool_gap(rest)

    @property
    def stencils(self) -> tuple[GlobalIndex, LocalIndex]:
        """Return the members of the facets (not collective)."""
        return self._at.stencils.point_ptr, self._at.stencils.members

    def _depth_at_particles(self, bodies: list[int], area: Float) -> float:
        """Compute the depth of the particles of bodies in the tool at the start [length] (collective).

        The deepest particle counts if it is behind the nearest facet of the contact. One in front of it is in another
        part of the body, which the tool does not see.
        """
        cloud, comm = self.body.cloud, self.body.cloud.comm
        inside = np.ones(cloud.n_owned, dtype=bool)
        if cloud.body is not None:
            inside &= np.isin(cloud.body[: cloud.n_owned], bodies)
        if "fictitious" in cloud.sets:
            inside &= ~cloud.sets["fictitious"][: cloud.n_owned]
        x = cloud.x[: cloud.n_owned][inside]
        depth = self._depth(x, WIDE)
        here = [(float(depth[k]), x[k].tolist()) for k in depth.argsort()[-1:]]
        deepest, place = max(chain.from_iterable(comm.allgather(here)), default=(0.0, []))
        if deepest == 0.0:
            return 0.0
        way = np.array(place) - self._x
        far = np.linalg.norm(way, axis=1)
        nearest = [(float(far[k]), float(way[k] @ area[k])) for k in far.argsort()[:1]]
        return deepest if min(chain.from_iterable(comm.allgather(nearest)))[1] < 0.0 else 0.0

    def _depth_between_facets(self, rest: State, area: Float) -> float:
        """Compute the depth of the sides of the facets in a tool that is narrower than these [length] (collective).

        The points are in the plane of a facet, up to half-way to the particles next to its own. No crack is between.
        """
        x, at, of = self.body.cloud.x, self._at.stencils, row_of_entries(self._at.stencils.point_ptr)
        spacing, normal = nearest_distances(self.body)[at.owner[of]], (area / self._at.area[:, None])[of]
        step = x[at.members] - x[at.owner[of]]
        size, off = np.linalg.norm(step, axis=1), (step * normal).sum(axis=1)
        near = self._all(rest)[0][of] < spacing
        beside = near & (size > 0.0) & (size < BESIDE * spacing) & (np.abs(off) < FLAT * size)
        step = (step - off[:, None] * normal)[beside]
        shares = np.arange(1, PER_SIDE + 1) / (2 * PER_SIDE)
        points = self._x[of[beside], None] + shares[:, None] * step[:, None]
        depth = self._depth(points.reshape(-1, self.body.dim), 1.0)
        return largest(self.body.cloud.comm, depth, initial=0.0)

    def _depth(self, x: Float, width: float) -> Float:
        """Compute the depth of points (n, dim) of the body in the tool at the start (n,) [length], 0 if it is harmless.

        Points near the surface may be in a tool that is wider than ``width`` spacings, up to ``SHALLOW``: it touches
        the centroids of facets only, and a surface is curved or has steps. A tool is narrower if that distance against
        its normal leads out of it, or nowhere from a point in its middle, which has no normal.
        """
        seen = self._moving.relative(x, np.zeros_like(x), START.load)[0]
        g, n, _ = self._tool.gap(x, seen)
        into = np.flatnonzero(g < 0.0)
        beyond = self._tool.gap(x[into], seen[into] - width * self._spacing * n[into])[0]
        deep = (g[into] < -SHALLOW * self._spacing) | (beyond > 0.0) | (beyond == g[into])
        depth = np.zeros(len(x))
        depth[into[deep]] = -g[into[deep]]
        return depth

    def _points(self, state: State) -> FixedPoints:
        rows = self._near(state)[0]
        return state.kept((self, "points", self.version), lambda: self._at.chosen(rows))

    def _moved(self, state: State) -> Float:
        """Compute the displacements of the facets (n_facets, dim) [length] (collective)."""
        u = state.u_local
        return state.kept((self, "moved"), lambda: self._at.moved(u))

    def _seen(self, state: State) -> tuple[Float, Float]:
        """Compute the displacements of the facets as seen from the tool, and its rotation (collective)."""
        moved = self._moved(state)
        return state.kept((self, "seen"), lambda: self._moving.relative(self._x, moved, state.t))

    def _all(self, state: State) -> tuple[Float, Float, Float]:
        """Compute gap, normal and curvature of all facets as seen from the tool (collective)."""
        moved, seen = self._moved(state), self._seen(state)[0]

        def make() -> tuple[Float, Float, Float]:
            found = self._tool.gap(self._x, seen)
            arm = np.linalg.norm(self._x - self._moving.about + seen, axis=1)
            self._last = Seen(moved, *self._moving.motion(state.t), arm, found[0])
            return found

        return state.kept((self, "all"), make)

    def _within(self, moved: Float, t: float, limit: Float | float) -> GlobalIndex:
        """Return the facets with displacements ``moved`` whose gap may be below a limit [length] (not collective).

        A facet that moves by ``du`` is seen from the tool to move by at most ``|du| + |dd| + |dR| arm``: its distance
        from the tool changes by at most that.
        """
        last, (R, d) = self._last, self._moving.motion(t)
        way = (
            np.linalg.norm(moved - last.moved, axis=1)
            + np.linalg.norm(d - last.d)
            + np.linalg.norm(R - last.R) * last.arm
        )
        return np.flatnonzero(last.gap - way <= limit + CLEAR * (self._spacing + CLEAR * np.abs(last.gap)))

    def _near(self, state: State) -> tuple[GlobalIndex, tuple[Float, Float, Float]]:
        """Return the facets that may be in contact or have a multiplier, and their gap, normal and curvature.

        Collective.
        """
        moved, seen = self._moved(state), self._seen(state)[0]

        def make() -> tuple[GlobalIndex, tuple[Float, Float, Float]]:
            limit = np.where(self._p > 0.0, np.inf, 0.0)
            rows = self._within(moved, state.t, limit)
            if len(rows) <= MOST_NEAR * len(self._x):
                return rows, self._tool.gap(self._x[rows], seen[rows])
            g, n, H = self._all(state)
            rows = self._within(moved, state.t, limit)
            return rows, (g[rows], n[rows], H[rows])

        return state.kept((self, "near", self.version), make)

    def _gap(self, state: State) -> tuple[Float, Float]:
        return self._near(state)[1][:2]

    def _sticking(self, state: State) -> Float:
        rows = self._near(state)[0]
        slip = self._seen(state)[0][rows] - self._slid[rows]
        return np.asarray(self._tau[self._points(state).of] - STICKING * self._c * slip)

    def _rotation(self, state: State) -> Float:
        return self._seen(state)[1]

    def add_force(self, state: State, f: Float) -> None:
        """Subtract the forces of the contact."""
        if len(self._touching(state).rows):
            self._points(state).spread(self._forces(state), f)

    def _forces(self, state: State) -> Float:
        """Compute the forces on the points (n_points, dim) [force] (collective)."""
        rows, area = self._touching(state).rows, self._points(state).area
        force = np.zeros((len(area), self.body.dim))
        force[rows] = area[rows, None] * self._in_space(state)
        return force

    def linearise(self, state: State) -> Sequence[Product]:
        """Return the blocks of the facets in contact."""
        touching, R, (_, n, H) = self._touching(state), self._rotation(state), self._near(state)[1]
        n, H = n[touching.rows], H[touching.rows]
        blocks = STICKING * touching.by_trial + touching.by_pressure[:, :, None] * n[:, None, :]
        blocks = self._c * blocks - touching.by_normal @ H
        return [self._points(state).product(self.body.cloud.n_owned, touching.rows, R @ blocks @ R.T)]

    def stiffest(self, state: State) -> Sequence[Product]:
        """Return the blocks of all facets as if they were pressed and stuck."""
        rows = np.arange(len(self._x))
        pressed = np.tile(self._c * np.eye(self.body.dim), (len(rows), 1, 1))
        return [self._at.product(self.body.cloud.n_owned, rows, pressed)]

    def tool_displacements(self, t: float) -> Float:
        """Return the displacements of points that move with the tool, at the facets in the undeformed body."""
        return self._moving.absolute(self._x, np.zeros_like(self._x), t)

    def tool_gap(self, state: State) -> float:
        """Return the smallest distance of the tool from the facets [length]."""
        return smallest(self.body.cloud.comm, self._all(state)[0])

    def start_friction(self, state: State) -> None:
        """Measure slip from a state in which the tool comes into touch."""
        self._slid[:] = self._seen(state)[0]
        self.version += 1

    def tool_forces(self, state: State) -> Float:
        """Return the forces of the tool on the facets (n_facets, dim) [force], unless it rests."""
        if self._tool.rests:
            return super().tool_forces(state)
        force = np.zeros_like(self._x)
        force[self._points(state).of] = self._forces(state)
        return force

    def tool_work(self, forces: Float, before: State, after: State) -> float:
        """Return the work of mean forces on the mean way of the points of the tool that are at the facets."""
        if self._tool.rests:
            return 0.0
        x, way = self._x, np.zeros_like(self._x)
        for seen in (self._seen(before)[0], self._seen(after)[0]):
            way += self._moving.absolute(x, seen, after.t) - self._moving.absolute(x, seen, before.t)
        return 0.25 * float((forces * way).sum())

    def objection(self, state: State) -> str:
        """Return a reason if the tool has passed through a facet, or turned too far for the path of friction."""
        title = self._title[0].lower() + self._title[1:]
        tool, moving, t0 = self._tool, self._moving, state.clock.before
        seen, x, end = self._seen(state)[0], self._x, self._moved(state)
        start, through = moving.absolute(x, self._slid, t0), False
        way = largest(self.body.cloud.comm, np.abs(seen - self._slid), initial=0.0)
        places = min(max(PLACES, math.ceil(2.0 * way / self._spacing)), MOST_PLACES)
        for share in np.arange(1, places) / places:
            at, t = start + share * (end - start), t0 + share * (state.t - t0)
            rows = self._within(at, t, 0.0)
            if len(rows):
                between, normal, _ = tool.gap(x[rows], moving.relative(x[rows], at[rows], t)[0])
                g, n, _ = tool.gap(x[rows], seen[rows])
                turned = (n * normal).sum(axis=1) < 0.0
                through |= bool(((between < -self._allowed) & ((g > 0.0) | turned)).any())
        if anywhere(self.body.cloud.comm, through):
            return f"{title} passed through the surface in one step"
        if self._mu > 0.0 and self._moving.angle(state.clock.before, state.t) > TURN:
            return f"{title} turned by more than {TURN:g} rad in one step, too far for friction"
        return ""

    def commit(self, state: State) -> None:
        """Store tangential tractions, multipliers and displacements; raise SolveError if the tool is too deep."""
        super().commit(state)
        self._slid_end[:] = self._seen(state)[0]
        if self._nearest > self._allowed:
            rows = self._within(self._moved(state), state.t, self._nearest)
            g, *_ = self._tool.gap(self._x[rows], self._seen(state)[0][rows])
            self._nearest = min(self._nearest, smallest(self.body.cloud.comm, g))

    @property
    def untouched(self) -> float:
        """Return the smallest gap up to the last converged state if the tool never touched, else 0 (not collective)."""
        return self._nearest if self._nearest > self._allowed else 0.0

    def _step_from(self, state: State) -> None:
        self._slid[:] = self._slid_end

    def arrays(self) -> Mapping[str, KeptArray]:
        """Return multipliers, and tractions and displacements of friction, at the last converged step."""
        found = {**super().arrays(), f"{self._name}_slid": KeptArray(self._owner, self._slid_end)}
        if self._tool.loaded:
            found[f"{self._name}_rigid"] = KeptArray(self._owner, self._moving.kept)
        return found

    def numbers(self) -> Mapping[str, Callable[[State], float]]:
        """Return also the motion of a loaded tool, ``NAME_move_x`` [length] and ``NAME_turn`` [rad]."""
        return {**super().numbers(), **{f"{self._name}_{of}": value for of, value in self._moving.numbers().items()}}

    def fields(self) -> Mapping[str, Callable[[State], Float]]:
        """Return the mean tractions on the facets of the own particles (n_owned, dim) [stress]."""

        def traction(state: State) -> Float:
            n, owner = self.body.cloud.n_owned, self._points(state).stencils.owner
            values = np.zeros((n, self.body.dim))
            np.add.at(values, owner, self._forces(state))
            area = np.bincount(self._at.stencils.owner, self._at.area, n)
            return np.asarray(values / np.where(area > 0.0, area, 1.0)[:, None])

        return {f"{self._name}_traction": traction}
