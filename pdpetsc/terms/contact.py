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
from pdpetsc.terms.facet_contact import OVERLAP, FacetContact, FixedPoints, Points
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


class Seen(NamedTuple):
    """Store the smallest gap of the facets of this rank at a state.

    Attributes
    ----------
    u : (n, dim) float64
        Displacements of the particles that the facets move with [length].
    R, d : (dim, dim), (dim,) float64
        Rotation and displacement of the tool [-], [length].
    arm : float
        Largest distance of a facet from the point about which the tool turns [length].
    gap : float
        Smallest gap [length].
    """

    u: Float
    R: Float
    d: Float
    arm: float
    gap: float


class ContactForces(FacetContact):
    """Compute the forces of a rigid tool on the facets of a surface.

    The points are the facets at ``x_f + sum_k N_f(x_k) u_k``. Gap, slip and tractions are those seen from the tool, and
    turned with it.

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
        # The gap last evaluated, the particles that the facets move with, and the most that a facet moves with these.
        self._particles = np.unique(facets.stencils.members)
        self._most = float(facets.sums(np.abs(facets.N)).max(initial=0.0))
        self._last = Seen(
            np.zeros((len(self._particles), body.dim)), np.eye(body.dim), np.zeros(body.dim), 0.0, -np.inf
        )
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
        near = self._gap(rest)[0][of] < spacing
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

    def _points(self, state: State) -> Points:
        return self._at

    def _seen(self, state: State) -> tuple[Float, Float]:
        """Compute the displacements of the facets as seen from the tool, and its rotation (collective)."""
        u = state.u_local

        def make() -> tuple[Float, Float]:
            return self._moving.relative(self._x, self._at.moved(u), state.t)

        return state.kept((self, "seen"), make)

    def _distance(self, state: State) -> tuple[Float, Float, Float]:
        """Compute gap, normal and curvature of the facets as seen from the tool (collective)."""
        moved = self._seen(state)[0]

        def make() -> tuple[Float, Float, Float]:
            found = self._tool.gap(self._x, moved)
            R, d = self._moving.motion(state.t)
            arm = float(np.linalg.norm(self._x - self._moving.about + moved, axis=1).max(initial=0.0))
            self._last = Seen(state.u_local[self._particles], R, d, arm, float(found[0].min(initial=np.inf)))
            return found

        return state.kept((self, "gap"), make)

    def _is_clear(self, state: State) -> bool:
        """Return True if the smallest gap at the last evaluation exceeds the motion since (collective).

        A facet moves by ``sum_k N_f(x_k) du_k``, and from the tool it is seen to move by at most ``|dd| + |dR| arm``
        more: the distance of a point from the tool changes by at most its way.
        """
        u, last = state.u_local[self._particles], self._last
        R, d = self._moving.motion(state.t)
        way = self._most * np.sqrt(((u - last.u) ** 2).sum(axis=1).max(initial=0.0))
        way += np.linalg.norm(d - last.d) + np.linalg.norm(R - last.R) * last.arm
        rounding = CLEAR * (self._spacing + CLEAR * abs(last.gap))
        return bool(last.gap - way > self._p.max(initial=0.0) / self._c + rounding)

    def _gap(self, state: State) -> tuple[Float, Float]:
        return self._distance(state)[:2]

    def _slip(self, state: State) -> Float:
        return self._seen(state)[0] - self._slid

    def _rotation(self, state: State) -> Float:
        return self._seen(state)[1]

    def linearise(self, state: State) -> Sequence[Product]:
        """Return the blocks of the facets in contact."""
        touching, R, (_, n, H) = self._touching(state), self._rotation(state), self._distance(state)
        n, H = n[touching.rows], H[touching.rows]
        blocks = self._c * touching.by_pressure[:, :, None] * n[:, None, :] - touching.by_normal @ H - touching.by_slip
        return [self._at.product(self.body.cloud.n_owned, touching.rows, R @ blocks @ R.T)]

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
        return smallest(self.body.cloud.comm, self._gap(state)[0])

    def start_friction(self, state: State) -> None:
        """Measure slip from a state in which the tool comes into touch."""
        self._slid[:] = self._seen(state)[0]
        self.version += 1

    def tool_forces(self, state: State) -> Float:
        """Return the forces of the tool on the facets (n_facets, dim) [force], unless it rests."""
        return super().tool_forces(state) if self._tool.rests else self._forces(state)

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
        g, n = self._gap(state)
        seen = self._seen(state)[0]
        start, end = moving.absolute(self._x, self._slid, t0), moving.absolute(self._x, seen, state.t)
        through = np.zeros(len(g), dtype=bool)
        way = largest(self.body.cloud.comm, np.abs(seen - self._slid), initial=0.0)
        places = min(max(PLACES, math.ceil(2.0 * way / self._spacing)), MOST_PLACES)
        for share in np.arange(1, places) / places:
            u, _ = moving.relative(self._x, start + share * (end - start), t0 + share * (state.t - t0))
            between, normal, _ = tool.gap(self._x, u)
            through |= (between < -self._allowed) & ((g > 0.0) | ((n * normal).sum(axis=1) < 0.0))
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
            self._nearest = min(self._nearest, self.tool_gap(state))

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
            rows, points = self._touching(state).rows, self._at
            owner, n = points.stencils.owner, self.body.cloud.n_owned
            values = np.zeros((n, self.body.dim))
            np.add.at(values, owner[rows], points.area[rows, None] * self._in_space(state))
            area = np.bincount(owner, points.area, n)
            return np.asarray(values / np.where(area > 0.0, area, 1.0)[:, None])

        return {f"{self._name}_traction": traction}
