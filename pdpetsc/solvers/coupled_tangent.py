"""The tangent by displacements of particles and motions of loaded rigid bodies, and its inverse."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from functools import cached_property

import numpy as np

from pdpetsc.arrays import Float, Mask
from pdpetsc.discrete.communicator import total
from pdpetsc.errors import SolveError
from pdpetsc.problem.problem import Problem, Tangent
from pdpetsc.problem.rigid_body import RigidBody
from pdpetsc.problem.state import State
from pdpetsc.solvers.protocol import Flexibility

# Singular values below this share of the largest belong to motions that nothing resists.
FREE = 1e-10
UNRESISTED = (
    "No force resists a motion of a rigid region with a force or a moment, so that the equilibrium is not unique. Hold "
    "the body in that direction, or prescribe the motion of the region."
)


@dataclass
class Side:
    """Store the forces of a rigid body on the particles at a state, and their derivatives.

    Attributes
    ----------
    rigid : RigidBody
        Tool or region.
    force : (n_rows, dim) float64
        Its forces on the particles [force].
    velocities : (n_free, n_rows, dim) float64
        Motions of the particles with the body.
    tangent : Tangent or None
        Tangent of the contact of a tool; None for a region, and if it is not needed.
    """

    rigid: RigidBody
    force: Float
    velocities: Float
    tangent: Tangent | None

    def resultants(self, force: Float) -> Float:
        """Return force and moment, free components only, of forces on this rank (n_free,)."""
        return np.asarray(np.einsum("kpi,pi->k", self.velocities, force))

    def columns(self) -> Float:
        """Return the change of the residual with the motions of a tool, the body held (n_free, n_rows, dim)."""
        if self.tangent is None:
            return np.zeros_like(self.velocities)
        return -np.stack([self.tangent(one).copy() for one in self.velocities]) - self.rigid.spun(self.force)


class CoupledTangent:
    """The tangent at a state by the displacements of the particles and the motions of the rigid bodies.

    Parameters
    ----------
    problem : Problem
        The problem.
    sides : sequence of Side
        Forces of the bodies there.
    state : State
        The state.
    rates : (n, n) float64, optional
        Velocities and angular velocities of the bodies for unit rates of the motions; by default they are the motions.
    scale : (n,) float64, optional
        Factors on the resultants; 1 by default.
    external : (n_rows, dim) float64, optional
        Loads on particles at load factor 1, for derivatives by the load factor [force].

    Attributes
    ----------
    carried : (n, n_rows, dim) float64
        Displacements that particles of regions, and those tied to them, have with each motion.

    Notes
    -----
    Construction and the methods are collective.
    """

    def __init__(
        self, problem: Problem, sides: Sequence[Side], state: State, rates: Float | None = None,
        scale: Float | None = None, external: Float | None = None,
    ) -> None:  # fmt: skip
        self._problem, self._sides, self._external = problem, sides, external
        self._tangent, self._t = problem.linearised(state), state.t
        # The change of the residual with the motions of each tool.
        self._held = [side.columns() for side in sides]
        n = sum(len(held) for held in self._held)
        self._rates = np.eye(n) if rates is None else rates
        self._scale = np.ones(n) if scale is None else scale
        zero = np.zeros_like(state.u)
        carried = [
            problem.supports.completed(zero, one) if side.rigid.rows is not None else zero
            for side in sides
            for one in side.velocities
        ]
        self.carried = np.einsum("kpi,kl->lpi", np.array(carried).reshape(-1, *zero.shape), self._rates)

    def force(self, du: Float, motions: Float, load: float = 0.0) -> Float:
        """Compute the change of the residual before constraints (n_rows, dim) [force].

        Parameters
        ----------
        du : (n_rows, dim) float64
            Displacements of all particles, those of regions with the motions [length].
        motions : (n,) float64
            Motions of the bodies.
        load : float
            Change of the load factor, with which loads grow and prescribed components move.
        """
        force: Float = self._tangent(du) + sum(self._by_tools(self._parts(motions)))
        return force if self._external is None else force - load * self._external

    def change(self, du: Float, motions: Float, load: float = 0.0) -> tuple[Float, Float]:
        """Compute ``force`` and the change of the resultants less loads (n,)."""
        force = self.force(du, motions, load)
        if not self._sides:
            return force, np.zeros(0)
        parts, found = self._parts(motions), []
        for side, part, by_tool in zip(self._sides, parts, self._by_tools(parts), strict=True):
            if side.tangent is None:
                rows = side.rigid.rows
                assert rows is not None
                df = np.where(rows[:, None], self._problem.supports.on_independent(force), 0.0)
            else:
                df = -side.tangent(du) - by_tool
            # The arms of moments change with the displacement relative to the point of the load.
            n = int(np.count_nonzero(side.rigid.free[: self._problem.dim]))
            moved = du - np.einsum("k,kpi->pi", part[:n], side.velocities[:n]) - load * side.rigid.driven
            found.append(side.resultants(df) + np.einsum("kpi,pi->k", side.rigid.spun(moved), side.force))
        bodies = [side.rigid for side in self._sides]
        by_load = [rigid.load_stiffness(self._t) @ part for rigid, part in zip(bodies, parts, strict=True)]
        if load:
            by_load = [one + load * rigid.load(1.0) for one, rigid in zip(by_load, bodies, strict=True)]
        change = total(self._problem.body.cloud.comm, np.concatenate(found)) - np.concatenate(by_load)
        return force, np.asarray(self._scale * change)

    @cached_property
    def _on_regions(self) -> Float:
        """Return ``carried`` of the particles of regions alone (n, n_rows, dim)."""
        return np.where(self.regions[:, None], self.carried, 0.0)

    @cached_property
    def _moving(self) -> tuple[Float, Float]:
        """Return the sums of squared displacements of motions that move particles (k,), and these motions (n, k)."""
        moved = self._on_regions
        values, axes = np.linalg.eigh(total(self._problem.body.cloud.comm, np.einsum("kpi,lpi->kl", moved, moved)))
        kept = values > FREE * values.max(initial=0.0)
        return values[kept], axes[:, kept]

    @cached_property
    def spread(self) -> Float:
        """Return forces on the particles of regions with a unit resultant for each motion (n, n_rows, dim) [-]."""
        values, axes = self._moving
        return np.asarray(np.einsum("kv,v,lv,lpi->kpi", axes, 1.0 / values, axes, self._on_regions))

    @property
    def idle(self) -> Float:
        """Return the projection on motions that move no particle (n, n), such as the rotation of a single one."""
        axes = self._moving[1]
        return np.asarray(np.eye(len(axes)) - axes @ axes.T)

    @cached_property
    def regions(self) -> Mask:
        """Return the particles of regions (n_rows,)."""
        found = np.zeros(len(self._problem.supports.fixed), dtype=bool)
        for side in self._sides:
            if side.rigid.rows is not None:
                found |= side.rigid.rows
        return found

    def completed(self, y: Float) -> tuple[Float, Float]:
        """Return the displacements (n_rows, dim) and motions (n,) of independent entries ``y`` (n_rows, dim).

        Those of the particles of a region have the motion of their least squares.
        """
        motions = self._sums(self.spread, y)
        return self._problem.supports.completed(y) + np.einsum("k,kpi->pi", motions, self.carried), motions

    def off_motions(self, y: Float) -> Float:
        """Return the part of entries (n_rows, dim) on particles of regions that is no motion of a region."""
        rigid = np.einsum("k,kpi->pi", self._sums(self.spread, y), self.carried)
        return np.where(self.regions[:, None], y - rigid, 0.0)

    def product(self, y: Float) -> Float:
        """Compute the product with independent entries (n_rows, dim), symmetric if the tangent is."""
        force, resultants = self.change(*self.completed(y))
        return np.asarray(self._problem.supports.reduced(force) + np.einsum("k,kpi->pi", resultants, self.spread))

    def loads_of(self, forces: Float) -> Float:
        """Return the resultants (n,) of forces on particles (n_rows, dim)."""
        return self._sums(self.carried, forces)

    def free_motion(self, S: Float) -> bool:
        """Return True if nothing resists a motion that moves particles, for the derivative S of the resultants."""
        moving = self._moving[1]
        resisted = np.abs(np.linalg.eigvalsh(moving.T @ (0.5 * (S + S.T)) @ moving))
        return bool(np.any(resisted <= FREE * resisted.max(initial=0.0)))

    def responses(self, answer: Callable[[Float], Float]) -> tuple[Float, Float]:
        """Return the derivative of the resultants by the motions (n, n), and the ways of the particles for each motion.

        ``answer`` solves the tangent with still bodies for forces (n_rows, dim).
        """
        ways, columns, supports = [], [], self._problem.supports
        for motion, carried in zip(np.eye(len(self.carried)), self.carried, strict=True):
            force = supports.reduced(self.force(carried, motion))
            ways.append(supports.completed(answer(-force)) + carried)
            columns.append(self.change(ways[-1], motion)[1])
        return np.stack(columns, axis=1), np.stack(ways)

    def _sums(self, ways: Float, values: Float) -> Float:
        """Return the sums of products with each way (n,)."""
        return np.asarray(total(self._problem.body.cloud.comm, np.einsum("kpi,pi->k", ways, values)))

    def _parts(self, motions: Float) -> list[Float]:
        """Return velocities and angular velocities of each body."""
        return np.split(self._rates @ motions, np.cumsum([len(held) for held in self._held]))[:-1]

    def _by_tools(self, parts: Sequence[Float]) -> list[Float]:
        """Return the change of the residual by each tool (n_rows, dim), 0 for regions."""
        return [np.einsum("k,kpi->pi", part, held) for part, held in zip(parts, self._held, strict=True)]


class CoupledInverse(Flexibility):
    """The inverse of the tangent by displacements and motions of rigid regions.

    Parameters
    ----------
    tangent : CoupledTangent
        The tangent.
    inverse : Flexibility
        Its inverse with still bodies.

    Notes
    -----
    Construction is collective.
    """

    def __init__(self, tangent: CoupledTangent, inverse: Flexibility) -> None:
        self._tangent, self._inverse = tangent, inverse
        self._S, self._ways = tangent.responses(inverse)
        if tangent.free_motion(self._S):
            raise SolveError(UNRESISTED)

    def __call__(self, force: Float) -> Float:
        tangent, held = self._tangent, self._inverse(force)
        off = tangent.loads_of(force) - tangent.change(held, np.zeros(len(self._S)))[1]
        motions = np.linalg.lstsq(self._S, off, rcond=FREE)[0]
        return np.asarray(held + np.einsum("k,kpi->pi", motions, self._ways))

    def negative_pivots(self) -> int | None:
        found = self._inverse.negative_pivots()
        return None if found is None else found + negative(self._S)

    def stable(self) -> bool | None:
        found = self._inverse.stable()
        return found and negative(self._S) == 0


def negative(S: Float) -> int:
    """Return the number of negative eigenvalues of the symmetric part of a matrix."""
    values = np.linalg.eigvalsh(0.5 * (S + S.T))
    return int(np.count_nonzero(values < -FREE * np.abs(values).max()))
