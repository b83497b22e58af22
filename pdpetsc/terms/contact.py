"""Contact of the facets of a surface with a rigid tool: augmented Lagrange, Coulomb friction by return mapping."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from typing import NamedTuple

import numpy as np

from pdpetsc.arrays import Float, GlobalIndex, LocalIndex, Mask, entries_of
from pdpetsc.declare.tools import Contact
from pdpetsc.discrete.communicator import largest
from pdpetsc.errors import CaseError, SolveError
from pdpetsc.gradient.base import StencilMembers
from pdpetsc.gradient.products import Product, RankOneProduct
from pdpetsc.problem.body import Body
from pdpetsc.problem.state import State
from pdpetsc.problem.term import KeptArray, Term
from pdpetsc.terms.chosen_facets import ChosenFacets, by_component

# Pressure over penetration of the default stiffness, in moduli over the spacing [-]. With ten times of it a tool that
# moves by a spacing a step, with friction, needs four times as many load steps.
STIFFNESS = 10.0
# Stiffness of sticking facets over that of pressed facets [-]; at 1 Newton cycles between both directions of sliding.
STICKING = 0.1
# Places between the ends of a step at which a tool may not lie within the body.
PLACES = 16
# Largest turn of a tool with friction in a step [rad]: friction sees the chord of the path.
TURN = 0.5
# Tolerance of a penetration that is computed again.
SLACK = 1.0 + 1e-6
# Penetration over the spacing from which a tool overlaps the body at the start [-].
OVERLAP = 1e-6


class _Touching(NamedTuple):
    """Store tractions (m, dim) [stress] on the facets in contact, and minus their derivatives (m, dim, dim)."""

    rows: GlobalIndex
    traction: Float
    blocks: Float


class ContactProduct(RankOneProduct):
    """Couple the particles of each facet, whose weights ``N_f`` sum to one, by ``sum_f N_f (x) N_f B_f``.

    Parameters
    ----------
    facets : StencilMembers
        The members of each facet.
    n_owned : int
        Number of own particles.
    N : (n_entries,) float64
        Weights of the members [-].
    blocks : (n_facets, dim, dim) float64
        ``B_f`` [force / length].
    """

    def __init__(self, facets: StencilMembers, n_owned: int, N: Float, blocks: Float) -> None:
        n, dim = blocks.shape[:2]
        # One stencil for each component of the displacement of a facet.
        members, entry, of, column = by_component(facets, dim)
        h = N[entry, None] * blocks[of, :, column]
        g = N[entry, None] * np.eye(dim)[column]
        super().__init__(members, n_owned, h, g, np.ones(n * dim))
        self._facets, self._N, self._blocks = facets, N, blocks
        self._of = np.repeat(np.arange(n), np.diff(facets.point_ptr))

    def add_product(self, du: Float, f: Float, particles: LocalIndex) -> None:
        """Add the forces of the facets of the particles; unlike a gradient, facets resist translations."""
        here = np.isin(self._facets.owner, particles)
        members, N = self._facets.members, self._N
        at = N[:, None] * du[members]
        moved = np.stack([np.bincount(self._of, along, len(here)) for along in at.T], axis=1)
        force = np.where(here[:, None], np.einsum("fij,fj->fi", self._blocks, moved), 0.0)
        np.add.at(f, members, N[:, None] * force[self._of])


class ContactForces(Term):
    """Compute forces ``f_k = sum_f N_f(x_k) |a_f| (p n + tau)`` of a rigid tool on the facets of a surface.

    With the gap g of a facet at ``x_f + sum_k N_f(x_k) u_k``, ``p = <p0 - c g>`` with the multiplier ``p0``. Friction
    has the trial traction ``tau* = (1 - n (x) n) (tau_0 - c_t (u - u_0))`` with displacements as seen from the tool,
    since the last converged step. It sticks, ``tau = tau*``, while ``|tau*| <= mu p``, and slides with
    ``tau = mu p tau* / |tau*|``. All of this is computed as seen from the tool, and turned with it.

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

    linear = False
    energy_of = "contact"
    horizons = 2

    def __init__(
        self, body: Body, declared: Contact, mask: Mask, stiffness: float, spacing: float, name: str
    ) -> None:  # fmt: skip
        self.body, self._declared, self._name = body, declared, name
        self._tool, self._mu, self._c, self._spacing = declared.tool, declared.friction, stiffness, spacing
        self._allowed = declared.penetration * spacing
        self.symmetric = self._mu == 0.0
        self.works = self._mu > 0.0 or not declared.tool.rests
        surface = body.surface
        assert surface is not None
        self._facets = ChosenFacets(surface, mask)
        self._x, self._area = self._facets.x, np.linalg.norm(self._facets.area, axis=1)
        # At the last converged step: tangential tractions and displacements as seen from the tool, and multipliers.
        self._tau, self._slid = np.zeros_like(self._x), np.zeros_like(self._x)
        self._p0 = np.zeros(len(self._x))
        # Multipliers of the current solve.
        self._p = self._p0.copy()
        rest = State(body, np.zeros((body.cloud.n_rows, body.dim)))
        deepest = self._deepest(rest)
        if deepest > OVERLAP * spacing:
            raise CaseError(
                f"The tool of {name} overlaps the body by {deepest:.3g} at the start; begin with a gap or in touch."
            )

    @property
    def stencils(self) -> tuple[GlobalIndex, LocalIndex]:
        """Return the members of the facets (not collective)."""
        return self._facets.stencils.point_ptr, self._facets.stencils.members

    def _moved(self, state: State) -> Float:
        """Compute the displacements of the facets as seen from the tool (n_facets, dim) [length] (collective)."""
        return self._seen(state)[0]

    def _seen(self, state: State) -> tuple[Float, Float]:
        """Compute the displacements of the facets as seen from the tool, and its rotation (collective)."""
        u = state.u_local

        def make() -> tuple[Float, Float]:
            return self._tool.relative(self._x, self._facets.interpolated(u), state.t)

        return state.kept((self, "seen"), make)

    def _gap(self, state: State) -> tuple[Float, Float, Float]:
        """Compute gap, normal and curvature of all facets as seen from the tool (collective)."""
        moved = self._moved(state)
        return state.kept((self, "gap"), lambda: self._tool.gap(self._x, moved))

    def _deepest(self, state: State) -> float:
        """Compute the largest penetration [length] (collective)."""
        g = self._gap(state)[0]
        return largest(self.body.cloud.comm, float(np.max(-g, initial=0.0)))

    def _touching(self, state: State) -> _Touching:
        """Compute the tractions on the facets in contact, as seen from the tool (collective)."""
        gap, moved = self._gap(state), self._moved(state)
        return state.kept((self, "touching", self.version), lambda: self._tractions(moved, *gap))

    def _tractions(self, moved: Float, g: Float, n: Float, H: Float) -> _Touching:
        pressure = self._p - self._c * g
        rows = np.flatnonzero(pressure > 0.0)
        n, H, p = n[rows], H[rows], pressure[rows]
        nn = n[:, :, None] * n[:, None, :]
        traction = p[:, None] * n
        # Minus the derivative of p n.
        blocks = self._c * nn - p[:, None, None] * H
        if self._mu > 0.0:
            along = self._tau[rows] - STICKING * self._c * (moved[rows] - self._slid[rows])
            across = np.eye(self.body.dim) - nn
            trial = np.einsum("pij,pj->pi", across, along)
            size = np.linalg.norm(trial, axis=1)
            # Derivative of the trial, which turns with the normal.
            turned = (n * along).sum(axis=1)[:, None, None] * H
            turned = turned + n[:, :, None] * np.einsum("pij,pj->pi", H, along)[:, None, :]
            by = STICKING * self._c * across + turned
            slides = size > self._mu * p
            e = trial / np.where(size > 0.0, size, 1.0)[:, None]
            share = np.where(slides, self._mu * p / np.where(size > 0.0, size, 1.0), 1.0)
            sliding = np.einsum("pij,pjk->pik", np.eye(self.body.dim) - e[:, :, None] * e[:, None, :], by)
            sliding = share[:, None, None] * sliding + self._mu * self._c * e[:, :, None] * n[:, None, :]
            blocks = blocks + np.where(slides[:, None, None], sliding, by)
            traction = traction + share[:, None] * trial
        return _Touching(rows, traction, blocks)

    def _in_space(self, state: State) -> _Touching:
        """Compute the tractions on the facets in contact (collective)."""
        touching, R = self._touching(state), self._seen(state)[1]
        return _Touching(touching.rows, touching.traction @ R.T, R @ touching.blocks @ R.T)

    def add_force(self, state: State, f: Float) -> None:
        """Subtract the forces of the tool."""
        touching = self._in_space(state)
        force = np.zeros_like(self._x)
        force[touching.rows] = self._area[touching.rows, None] * touching.traction
        self._facets.spread(force, f)

    def linearise(self, state: State) -> Sequence[Product]:
        """Return the blocks of the facets in contact."""
        touching = self._in_space(state)
        return [self._product(touching.rows, touching.blocks)]

    def stiffest(self, state: State) -> Sequence[Product]:
        """Return the blocks of all facets as if they were pressed and stuck."""
        rows = np.arange(len(self._x))
        return [self._product(rows, np.tile(self._c * np.eye(self.body.dim), (len(rows), 1, 1)))]

    def _product(self, rows: GlobalIndex, stiffness: Float) -> ContactProduct:
        """Return the tangent of facets with blocks (m, dim, dim) [stress / length]."""
        stencils = self._facets.stencils
        entry, ptr = entries_of(stencils.point_ptr, rows)
        facets = StencilMembers(stencils.owner[rows], ptr, stencils.members[entry])
        blocks = self._area[rows, None, None] * stiffness
        return ContactProduct(facets, self.body.cloud.n_owned, self._facets.N[entry], blocks)

    def energy(self, state: State) -> float:
        """Return ``sum_f |a_f| ((p^2 - p0^2) / c + |tau|^2 / c_t) / 2`` of this rank [energy]."""
        touching, n = self._touching(state), self._gap(state)[1]
        p = (touching.traction * n[touching.rows]).sum(axis=1)
        tau = (touching.traction**2).sum(axis=1) - p**2
        stored = self._area[touching.rows] @ (p**2 + tau / STICKING) - self._area @ self._p**2
        return float(stored / (2.0 * self._c))

    def _off(self, state: State) -> float:
        """Compute the violation ``|min(g, p / c)|`` of ``g >= 0, p >= 0, g p = 0`` [length] (collective)."""
        g = self._gap(state)[0]
        p = np.maximum(self._p - self._c * g, 0.0)
        off = np.where(g < 0.0, -g, np.minimum(g, p / self._c))
        return largest(self.body.cloud.comm, float(off.max(initial=0.0)))

    def update_multipliers(self, state: State) -> bool:
        """Make the pressures the multipliers; return False if no facet penetrates or is pressed from afar."""
        if self._off(state) <= self._allowed:
            return False
        self._p = np.maximum(self._p - self._c * self._gap(state)[0], 0.0)
        self.version += 1
        return True

    def objection(self, state: State) -> str:
        """Return a reason if the tool has passed through a facet, or turned too far for the path of friction."""
        tool, t0 = self._tool, state.clock.before
        g, n, _ = self._gap(state)
        start, end = tool.absolute(self._x, self._slid, t0), tool.absolute(self._x, self._moved(state), state.t)
        through = np.zeros(len(g), dtype=bool)
        for share in np.arange(1, PLACES) / PLACES:
            u, _ = tool.relative(self._x, start + share * (end - start), t0 + share * (state.t - t0))
            between, normal, _ = tool.gap(self._x, u)
            through |= (between < -self._allowed) & ((g > 0.0) | ((n * normal).sum(axis=1) < 0.0))
        if largest(self.body.cloud.comm, float(np.count_nonzero(through))) > 0.0:
            return f"the tool of {self._name} passed through the surface in one step"
        if self._mu > 0.0 and self._tool.angle(state.clock.before, state.t) > TURN:
            return f"the tool of {self._name} turned by more than {TURN:g} rad in one step, too far for friction"
        return ""

    def revert_multipliers(self) -> None:
        """Restore the multipliers of the last converged step."""
        self._p = self._p0.copy()
        self.version += 1

    def commit(self, state: State) -> None:
        """Store tangential tractions and multipliers; raise SolveError if the tool penetrates the body too far."""
        deepest = self._deepest(state)
        if deepest > self._allowed * SLACK:
            raise SolveError(
                f"The tool of {self._name} is {deepest / self._spacing:.2g} spacings deep in the body at step time "
                f"{state.t:.6g}; raise its stiffness above {self._c:.3g}, or its penetration."
            )
        touching, n = self._touching(state), self._gap(state)[1]
        self._p0[:] = self._p
        self._slid[:] = self._moved(state)
        if self._mu > 0.0:
            self._tau[:] = 0.0
            normal = n[touching.rows]
            along = (touching.traction * normal).sum(axis=1)[:, None] * normal
            self._tau[touching.rows] = touching.traction - along
            self.version += 1

    @property
    def has_history(self) -> bool:
        """Return True if there is friction, which depends on the last converged step."""
        return self._mu > 0.0

    def arrays(self) -> Mapping[str, KeptArray]:
        """Return multipliers, and tractions and displacements of friction, at the last converged step."""
        found = {"p": self._p0, "slid": self._slid} | ({"tau": self._tau} if self._mu > 0.0 else {})
        return {
            f"{self._declared.name}_{of}": KeptArray(self._facets.stencils.owner, values)
            for of, values in found.items()
        }

    def restored(self) -> None:
        """Continue with the multipliers of a checkpoint."""
        self.revert_multipliers()

    def numbers(self) -> Mapping[str, Callable[[State], float]]:
        """Return the force of the tool on the body by component, the area in contact, and the violation of the gap."""
        prefix, comm = self._declared.name, self.body.cloud.comm

        def component(axis: int) -> Callable[[State], float]:
            def force(state: State) -> float:
                touching = self._in_space(state)
                return float(self._area[touching.rows] @ touching.traction[:, axis])

            return force

        def depth(state: State) -> float:
            # The history sums over the ranks.
            off = self._off(state) / self._spacing
            return off if comm.rank == 0 else 0.0

        found = {f"{prefix}_{'xyz'[axis]}": component(axis) for axis in range(self.body.dim)}
        found[f"{prefix}_area"] = lambda state: float(self._area[self._touching(state).rows].sum())
        return found | {f"{prefix}_depth": depth}

    def of_facets(self, state: State) -> tuple[Float, Float, Float]:
        """Return positions, tractions and areas of the facets of this rank in contact (collective).

        (m, dim) [length], (m, dim) [stress] and (m,) [area].
        """
        touching = self._in_space(state)
        return self._x[touching.rows], touching.traction, self._area[touching.rows]

    def fields(self) -> Mapping[str, Callable[[State], Float]]:
        """Return the mean tractions on the facets of the own particles (n_owned, dim) [stress]."""

        def traction(state: State) -> Float:
            touching, owner = self._in_space(state), self._facets.stencils.owner
            values = np.zeros((self.body.cloud.n_owned, self.body.dim))
            np.add.at(values, owner[touching.rows], self._area[touching.rows, None] * touching.traction)
            area = np.bincount(owner, self._area, len(values))
            return np.asarray(values / np.where(area > 0.0, area, 1.0)[:, None])

        return {f"{self._declared.name}_traction": traction}
