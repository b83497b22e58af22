"""Forces between facets and what they touch: augmented Lagrange, Coulomb friction by return mapping."""

from __future__ import annotations

import math
from abc import abstractmethod
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
import scipy

from pdpetsc.arrays import Float, GlobalIndex, LocalIndex, entries_of, row_of_entries
from pdpetsc.declare.body_contact import BodyContact
from pdpetsc.declare.tools import Contact
from pdpetsc.discrete.communicator import counted_once, largest
from pdpetsc.errors import SolveError
from pdpetsc.gradient.base import StencilMembers
from pdpetsc.gradient.products import FacetSprings
from pdpetsc.kernels.facet_pairs import carry_all, spread
from pdpetsc.problem.body import Body
from pdpetsc.problem.state import State
from pdpetsc.problem.term import KeptArray, Term
from pdpetsc.terms.chosen_facets import ChosenFacets

# Pressure over penetration of the default stiffness, in moduli over the spacing [-]. With ten times of it a tool that
# moves by a spacing a step, with friction, needs four times as many load steps.
STIFFNESS = 10.0
# Stiffness of sticking facets over that of pressed facets [-]; at 1 Newton cycles between both directions of sliding.
STICKING = 0.1
# Gap over the spacing up to which surfaces touch [-].
TOUCH = 1e-9
# Tolerance of a penetration that is computed again.
SLACK = 1.0 + 1e-6
# Penetration over the spacing from which surfaces overlap at the start [-].
OVERLAP = 1e-6


class Touching(NamedTuple):
    """Store the tractions at the points in contact, and their derivatives.

    Attributes
    ----------
    rows : (m,) int64
        The points in contact.
    traction : (m, dim) float64
        [stress].
    by_pressure, by_normal, by_trial : (m, dim), (m, dim, dim), (m, dim, dim) float64
        Derivatives by the pressure [-], the normal [stress] and the traction that would stick [-].
    """

    rows: GlobalIndex
    traction: Float
    by_pressure: Float
    by_normal: Float
    by_trial: Float


class ContactProduct(FacetSprings):
    """Couple the particles around each point of contact by ``sum_p w_p (x) w_p B_p``.

    Parameters
    ----------
    facets : StencilMembers
        The members of each point.
    n_owned : int
        Number of own particles.
    N : (n_entries,) float64
        Weights ``w_p`` of the members [-]; they may sum to one, unlike those of a gradient.
    blocks : (n_points, dim, dim) float64
        ``B_p`` [force / length].
    """

    def __init__(self, facets: StencilMembers, n_owned: int, N: Float, blocks: Float) -> None:
        of = row_of_entries(facets.point_ptr)
        h = N[:, None, None] * blocks.transpose(0, 2, 1)[of]
        super().__init__(facets, n_owned, h, N[:, None, None] * np.eye(blocks.shape[1]))


@dataclass(frozen=True)
class Points:
    """Store points of contact on the facets of this rank.

    Attributes
    ----------
    x : (n_points, dim) float64
        Positions in the undeformed body [length].
    area : (n_points,) float64
        Area that each stands for [area].
    of : (n_points,) int64
        Number of the multiplier of each, ascending.
    """

    x: Float
    area: Float
    of: GlobalIndex

    def mean(self, values: Float, n: int, counted: Float | float = 1.0) -> Float:
        """Compute the mean of values of points (n_points,) for each of n multipliers, 0 where there is no point."""
        weight = self.area * counted
        sums, whole = (np.bincount(self.of, of, n) for of in (weight * values, weight))
        return np.asarray(sums / np.where(whole > 0.0, whole, 1.0))


@dataclass(frozen=True)
class FixedPoints(Points):
    """Store points that the same particles move in every state.

    Attributes
    ----------
    stencils : StencilMembers
        Particles of which the relative displacement of each point is composed.
    weights : (n_entries,) float64
        Their weights [-].
    """

    stencils: StencilMembers
    weights: Float

    @classmethod
    def on(cls, facets: ChosenFacets) -> FixedPoints:
        """Return the middles of facets, each with its own multiplier."""
        area = np.linalg.norm(facets.area, axis=1)
        return cls(facets.x, area, np.arange(len(area)), facets.stencils, facets.N)

    def chosen(self, rows: GlobalIndex) -> FixedPoints:
        """Return some of the points."""
        entry, ptr = entries_of(self.stencils.point_ptr, rows)
        stencils = StencilMembers(self.stencils.owner[rows], ptr, self.stencils.members[entry])
        return FixedPoints(self.x[rows], self.area[rows], self.of[rows], stencils, self.weights[entry])

    def moved(self, u: Float) -> Float:
        """Compute the relative displacements (n_points, dim) [length] from those of local particles (n_local, dim)."""
        found = np.empty((len(self.area), 1, u.shape[1]))
        carry_all(self.stencils.point_ptr, self.stencils.members, self.weights[:, None], u, found)
        return found[:, 0]

    def spread(self, force: Float, f: Float) -> None:
        """Subtract forces on the points (n_points, dim) from a residual of local particles (n_local, dim)."""
        of = self.stencils
        spread(of.point_ptr, of.members, self.weights[:, None], force.any(axis=1), -force[:, None], f)

    def resistance(self, each: float, n: int) -> scipy.sparse.csr_matrix:
        """Compute the matrix ``each sum_p A_p w_p (x) w_p`` of numbers of n local particles."""
        shape = len(self.area), n
        w = scipy.sparse.csr_matrix((self.weights, self.stencils.members, self.stencils.point_ptr), shape=shape)
        return scipy.sparse.csr_matrix(w.T @ scipy.sparse.diags(each * self.area) @ w)

    def product(self, n_owned: int, rows: GlobalIndex, stiffness: Float) -> ContactProduct:
        """Return the tangent of some points with blocks (m, dim, dim) [stress / length]."""
        points = self.chosen(rows)
        return ContactProduct(points.stencils, n_owned, points.weights, points.area[:, None, None] * stiffness)


class FacetContact(Term):
    """Compute the forces ``f_k = sum_p w_p(x_k) A_p (p n + tau)`` at points of contact on facets.

    With the gap g of a point, ``p = <p0 - c g>`` with the multiplier ``p0``. Friction has the trial traction
    ``tau* = (1 - n (x) n) (tau_0 - c_t s)`` with the slip s since the last converged step. It sticks, ``tau = tau*``,
    while ``|tau*| <= mu p``, and slides with ``tau = mu p tau* / |tau*|``. With infinite mu it sticks while ``p > 0``.

    Parameters
    ----------
    body : Body
        Particles with their surface.
    declared : Contact or BodyContact
        Declared contact.
    owner : (n,) int32
        Own particle of each multiplier, ascending.
    stiffness : float
        ``c`` [stress / length].
    spacing : float
        Mean spacing of the particles [length].
    title, into : str
        What touches and what it touches, in messages.

    Notes
    -----
    Construction and the methods are collective.
    """

    linear = False
    stiff = True
    energy_of = "contact"
    horizons = 2

    def __init__(
        self, body: Body, declared: Contact | BodyContact, owner: LocalIndex, stiffness: float, spacing: float,
        title: str, into: str,
    ) -> None:  # fmt: skip
        self.body, self._title, self._into, self._name = body, title, into, declared.name
        self._mu, self._c, self._spacing = declared.friction, stiffness, spacing
        self._allowed = declared.penetration * spacing
        self.symmetric = self._mu == 0.0
        self._owner = owner
        # Tangential tractions at the start of this step, and at its end after it has converged.
        self._tau, self._tau_end = np.zeros((2, len(owner), body.dim))
        self._ended = False
        # Multipliers of the last converged step, and of the current solve.
        self._p0 = np.zeros(len(owner))
        self._p = self._p0.copy()

    @abstractmethod
    def _points(self, state: State) -> Points:
        """Return the points of contact (collective)."""

    @abstractmethod
    def _gap(self, state: State) -> tuple[Float, Float]:
        """Compute gaps (n_points,) [length] and normals (n_points, dim) of the points (collective)."""

    @abstractmethod
    def _sticking(self, state: State) -> Float:
        """Compute the tractions ``tau_0 - c_t s`` of points that stick, across the normal after projection.

        (n_points, dim) [stress] (collective).
        """

    def _rotation(self, state: State) -> Float:
        """Return the rotation from the axes of normals and tractions to those of space (collective)."""
        return np.eye(self.body.dim)

    def _touching(self, state: State) -> Touching:
        """Compute the tractions at the points in contact, in the axes of the normals (collective)."""
        _ = state.u_local
        return state.kept((self, "touching", self.version), lambda: self._tractions(state))

    def _felt(self, state: State) -> Float:
        """Compute the gap that determines the pressure of each point (n_points,) [length] (collective)."""
        return self._gap(state)[0]

    def _tractions(self, state: State) -> Touching:
        of, n = self._points(state).of, self._gap(state)[1]
        pressure = self._p[of] - self._c * self._felt(state)
        # Points that just touch have no pressure yet, and resist.
        rows = np.flatnonzero(pressure > -TOUCH * self._c * self._spacing)
        n, p, one = n[rows], np.maximum(pressure[rows], 0.0), np.eye(self.body.dim)
        traction, by_pressure, by_normal = p[:, None] * n, n, p[:, None, None] * one
        by_trial = np.zeros_like(by_normal)
        if self._mu > 0.0:
            along = self._sticking(state)[rows]
            across = one - n[:, :, None] * n[:, None, :]
            trial = np.einsum("pij,pj->pi", across, along)
            size = np.linalg.norm(trial, axis=1)
            turned = -(n * along).sum(axis=1)[:, None, None] * one - n[:, :, None] * along[:, None, :]
            # Infinite friction, except of points without pressure.
            most = np.where(p > 0.0, self._mu, 0.0) * p
            slides = size > most
            e = trial / np.where(size > 0.0, size, 1.0)[:, None]
            share = np.where(slides, most / np.where(size > 0.0, size, 1.0), 1.0)
            # Derivative of the traction by the trial.
            kept = one - np.where(slides[:, None, None], e[:, :, None] * e[:, None, :], 0.0)
            kept = share[:, None, None] * kept
            traction = traction + share[:, None] * trial
            by_pressure = n + np.where(slides & math.isfinite(self._mu), self._mu, 0.0)[:, None] * e
            by_normal = by_normal + kept @ turned
            by_trial = kept @ across
        return Touching(rows, traction, by_pressure, by_normal, by_trial)

    def _in_space(self, state: State) -> Float:
        """Compute the tractions at the points in contact (m, dim) [stress] (collective)."""
        return np.asarray(self._touching(state).traction @ self._rotation(state).T)

    def energy(self, state: State) -> float:
        """Return ``sum_p A_p ((p^2 - p0^2) / c + |tau|^2 / c_t) / 2`` of this rank [energy]."""
        touching, n, points = self._touching(state), self._gap(state)[1], self._points(state)
        p = (touching.traction * n[touching.rows]).sum(axis=1)
        tau = (touching.traction**2).sum(axis=1) - p**2
        stored = points.area[touching.rows] @ (p**2 + tau / STICKING) - points.area @ self._p[points.of] ** 2
        return float(stored / (2.0 * self._c))

    def _pressures(self, state: State) -> Float:
        """Compute the mean pressure of the points of each multiplier [stress] (collective)."""
        points = self._points(state)
        return points.mean(np.maximum(self._p[points.of] - self._c * self._felt(state), 0.0), len(self._owner))

    def _off(self, state: State) -> float:
        """Compute the violation ``|min(g, p / c)|`` of ``g >= 0, p >= 0, g p = 0`` [length] (collective).

        With the mean pressure p of the points of a multiplier, and ``g = (p0 - p) / c``.
        """
        p = self._pressures(state)
        off = np.minimum(np.abs(p - self._p), p) / self._c
        return largest(self.body.cloud.comm, off, initial=0.0)

    def update_multipliers(self, state: State) -> bool:
        """Make the pressures the multipliers; return False if no point penetrates or is pressed from afar."""
        if self._off(state) <= self._allowed:
            return False
        self._p = self._pressures(state)
        self.version += 1
        return True

    def revert_multipliers(self) -> None:
        """Restore the multipliers of the last converged step."""
        self._p = self._p0.copy()
        self.version += 1

    def commit(self, state: State) -> None:
        """Store tangential tractions and multipliers; raise SolveError if a penetration is too large."""
        deepest = self._off(state)
        if deepest > self._allowed * SLACK:
            raise SolveError(
                f"{self._title} is {deepest / self._spacing:.2g} spacings deep in {self._into} at step "
                f"time {state.t:.6g}; raise its stiffness above {self._c:.3g}, or its penetration."
            )
        self._p0[:] = self._p
        if self._mu > 0.0:
            touching, n, points = self._touching(state), self._gap(state)[1], self._points(state)
            normal = n[touching.rows]
            along = (touching.traction * normal).sum(axis=1)[:, None] * normal
            tau, pressed = np.zeros((len(points.area), self.body.dim)), np.zeros(len(points.area))
            tau[touching.rows], pressed[touching.rows] = touching.traction - along, 1.0
            for axis, values in enumerate(tau.T):
                self._tau_end[:, axis] = points.mean(values, len(self._owner), pressed)
        self._ended = True

    def start_from(self, state: State) -> None:
        """Continue with the tractions at the end of the last step."""
        if self._ended:
            self._ended = False
            self._tau[:] = self._tau_end
            self._step_from(state)
            self.version += self._mu > 0.0

    @abstractmethod
    def _step_from(self, state: State) -> None:
        """Measure slip from the last converged step on (collective)."""

    @property
    def has_history(self) -> bool:
        """Return True if there is friction, which depends on the last converged step."""
        return self._mu > 0.0

    def arrays(self) -> Mapping[str, KeptArray]:
        """Return multipliers, and tractions of friction, at the last converged step."""
        found = {"p": self._p0} | ({"tau": self._tau_end} if self._mu > 0.0 else {})
        return {f"{self._name}_{of}": KeptArray(self._owner, values) for of, values in found.items()}

    def restored(self) -> None:
        """Continue with the multipliers and tractions of a checkpoint."""
        self.revert_multipliers()
        self._ended = True

    def numbers(self) -> Mapping[str, Callable[[State], float]]:
        """Return the force on the facets by component, the area in contact, and the violation of the gap."""

        def component(axis: int) -> Callable[[State], float]:
            def force(state: State) -> float:
                rows, area = self._touching(state).rows, self._points(state).area
                return float(area[rows] @ self._in_space(state)[:, axis])

            return force

        def depth(state: State) -> float:
            return counted_once(self.body.cloud.comm, self._off(state) / self._spacing)

        found = {f"{self._name}_{'xyz'[axis]}": component(axis) for axis in range(self.body.dim)}
        found[f"{self._name}_area"] = self._area
        return found | {f"{self._name}_depth": depth}

    def _area(self, state: State) -> float:
        """Compute the area of the points that are pressed on this rank [area] (collective)."""
        touching = self._touching(state)
        return float(self._points(state).area[touching.rows[touching.traction.any(axis=1)]].sum())

    def of_facets(self, state: State) -> tuple[Float, Float, Float]:
        """Return positions, tractions and areas of the points of this rank in contact (collective).

        (m, dim) [length], (m, dim) [stress] and (m,) [area]. Positions are those in the undeformed body.
        """
        rows, points = self._touching(state).rows, self._points(state)
        return points.x[rows], self._in_space(state), points.area[rows]
