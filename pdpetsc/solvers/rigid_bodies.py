"""Equilibrium of loaded rigid tools and regions with the body."""

from __future__ import annotations

from collections.abc import Callable, Sequence

import numpy as np
from scipy.linalg import block_diag, eigh

from pdpetsc.arrays import Float
from pdpetsc.discrete.communicator import anywhere, total
from pdpetsc.problem.inertia import Inertia
from pdpetsc.problem.problem import Problem, Tangent
from pdpetsc.problem.rigid_body import MOST_TURN, RigidBody
from pdpetsc.problem.state import State
from pdpetsc.problem.term import Term
from pdpetsc.solvers.coupled_tangent import FREE, CoupledTangent, Side, negative

# Loads and forces on the body agree if they differ by at most this share of the larger.
TOLERANCE = 1e-8
# They need not agree better than this multiple of the tolerance of the particles.
LOOSER = 10.0
# Share of the load that the body cannot carry, from which nothing holds a rigid body.
UNHELD = 1e-3
# Smallest step of a tool towards the body over the size of the body, relative accuracy of its way, and largest number
# of halvings for it.
APPROACH, EXACT, TRIALS = 1e-3, 1e-9, 60


class RigidBodies:
    """Find the motions of loaded tools and regions for which they are in equilibrium.

    Newton's method on the motions alone. With the forces ``f`` of a rigid body on the particles, and the velocities
    ``W_k`` of the particles with its motion ``k``, resultants ``W_k . f`` balance the loads. Their derivative contains
    the response of the body, one linear solve for each motion.

    Parameters
    ----------
    problem : Problem
        The problem.
    size : float
        Size of the body [length], by which angles become lengths; explicit motions do not use it.

    Attributes
    ----------
    objection : str
        Reason why no motion balances the loads at the last ``moved``; empty for none.

    Notes
    -----
    Methods are collective. An object without bodies is false, and its methods do nothing.
    """

    def __init__(self, problem: Problem, size: float = 1.0) -> None:
        self._problem, self._size = problem, size
        self._bodies = problem.rigid_bodies
        self._inertia = problem.inertia
        self.objection = ""

    def __len__(self) -> int:
        """Return the number of bodies."""
        return len(self._bodies)

    @property
    def way(self) -> float:
        """Return the largest displacement of a body since the start of the run [length] (not collective)."""
        return max((rigid.way for _, rigid in self._bodies), default=0.0)

    def follow_load(self) -> None:
        """Let motions be the same at every load parameter, as unknowns of a path (not collective)."""
        for _, rigid in self._bodies:
            rigid.follow_load()

    @property
    def motions(self) -> Float:
        """Return the motions since the start of the step, rotation vectors times the size of the body (n,) [length].

        Not collective.
        """
        return np.concatenate([np.zeros(0), *[rigid.placed / self._lengths(rigid) for _, rigid in self._bodies]])

    def place(self, motions: Float) -> None:
        """Move the bodies to ``motions`` (n,) [length] (not collective)."""
        for (_, rigid), part in zip(self._bodies, self._parts(motions * self._scale), strict=True):
            rigid.place(part)

    @property
    def loads(self) -> Float:
        """Return the loads at load parameter 1, moments over the size of the body (n,) [force] (not collective)."""
        parts = [rigid.load(1.0) * self._lengths(rigid) for _, rigid in self._bodies]
        return np.concatenate([np.zeros(0), *parts])

    def unbalanced_at(self, state: State) -> Float:
        """Return resultants less loads (n,) [force]; moments over the size of the body."""
        return np.asarray(-self._imbalance(self._sides(state, linear=False), state)[0] * self._scale)

    def balanced(self, state: State, rtol: float) -> bool:
        """Return True if the loads are in equilibrium, with the relative tolerance of that of the particles."""
        return _agree(*self._imbalance(self._sides(state, linear=False), state), rtol)

    def coupled(self, state: State, rates: Float | None = None, external: Float | None = None) -> CoupledTangent:
        """Return the derivatives of the residual and of ``unbalanced_at``.

        They are those by displacements and further motions, angles times the size of the body, or by motions with these
        ``rates``; and by the load factor, with the loads on particles at load factor 1 (n_rows, dim) [force].
        """
        sides, scale = self._sides(state), self._scale
        rates = np.diag(scale) if rates is None else rates * scale
        return CoupledTangent(self._problem, sides, state, rates, scale, external)

    def mass_roots(self, state: State) -> Float:
        """Return columns R (n, n_rows, dim) for which ``R R^T`` are the declared masses of regions."""
        if not self._bodies:
            return np.zeros((0, *state.u.shape))
        masses = block_diag(*[rigid.added_masses(state.t) for _, rigid in self._bodies]) * self._scale[:, None]
        values, axes = eigh(masses * self._scale)
        kept = values > FREE * values.max()
        roots = (axes * np.sqrt(np.maximum(values, 0.0)))[:, kept]
        return np.asarray(np.einsum("km,kpi->mpi", roots, self.coupled(state).spread))

    def on_particles(self, state: State) -> Float:
        """Return forces on the particles of regions with the loads on them as resultants (n_rows, dim) [force]."""
        if not self._bodies:
            return np.zeros_like(state.u)
        loads = np.concatenate([rigid.load(state.t) for _, rigid in self._bodies]) * self._scale
        return np.asarray(np.einsum("k,kpi->pi", loads, self.coupled(state).spread))

    @property
    def spins(self) -> Float:
        """Return the velocities and angular velocities for unit rates of displacements and rotation vectors (n, n)."""
        return np.asarray(block_diag(np.zeros((0, 0)), *[rigid.spins for _, rigid in self._bodies]))

    def moved(self, state: State, inverse: Callable[[], Callable[[Float], Float]], rtol: float) -> Float | None:
        """Move the bodies towards equilibrium with their loads, by one Newton step.

        Parameters
        ----------
        state : State
            An equilibrium of the particles.
        inverse : callable
            Returns a function that solves the tangent at the state for forces (n_rows, dim), and returns displacements
            (n_rows, dim).
        rtol : float
            Relative tolerance of the equilibrium of the particles [-].

        Returns
        -------
        (n_rows, dim) float64 or None
            Unknowns to solve from again [length]; None if the bodies are in equilibrium, or ``objection`` is not empty.
        """
        self.objection = ""
        if not self._bodies:
            return None
        comm, dt = self._problem.body.cloud.comm, 0.0 if self._inertia is None else state.clock.dt
        fast = [rigid for _, rigid in self._bodies if dt > 0.0 and rigid.turned_in_step(dt) > MOST_TURN]
        if fast:
            self.objection = f"{fast[0].what} turns by more than {MOST_TURN:g} rad in one time step"
            return None
        sides = self._sides(state)
        off, size = self._imbalance(sides, state)
        if _agree(off, size, rtol):
            return None
        at_rest = self._inertia is None
        tools = [i for i, side in enumerate(sides) if at_rest and side.rigid.rows is None]
        untouched = [i for i in tools if not anywhere(comm, sides[i].force)]
        if untouched:
            if not all([self._approach(*self._bodies[i], state) for i in untouched]):
                self.objection = f"{sides[untouched[0]].rigid.what} touches nothing that carries its load"
                return None
            return state.u.copy()
        S, ways = self._stiffness(sides, state, inverse())
        scale = self._scale
        step = np.linalg.lstsq(S * scale[:, None] * scale, off * scale, rcond=FREE)[0] * scale
        left = np.abs(off - S @ step) > UNHELD * size
        if np.any(left):
            owners = np.repeat(np.arange(len(sides)), [len(side.velocities) for side in sides])
            self.objection = f"nothing holds {sides[owners[np.argmax(left)]].rigid.what} against its load"
            return None
        for (term, rigid), part in zip(self._bodies, self._parts(step), strict=True):
            rigid.move(part)
            term.version += 1
        return np.asarray(state.u + np.einsum("k,kpi->pi", step, ways))

    def negative_pivots(self, state: State, answer: Callable[[Float], Float], held: int) -> int | None:
        """Return the negative pivots of the whole tangent at an equilibrium, from those at held motions.

        Further ones are motions along which the loads do more work than the body resists. With loads that have no
        energy they are those of the symmetric part, which decide nothing unless there are none: None.
        """
        scale = self._scale
        found = held + negative(self._stiffness(self._sides(state), state, answer)[0] * scale[:, None] * scale)
        return found if not found or all(rigid.conservative for _, rigid in self._bodies) else None

    def _sides(self, state: State, linear: bool = True) -> list[Side]:
        """Return ``_side`` of all bodies."""
        return [self._side(*body, state, linear) for body in self._bodies]

    def _side(self, term: Term, rigid: RigidBody, state: State, linear: bool = True) -> Side:
        """Return the forces and velocities of a body at a state, and its tangent if ``linear``."""
        problem = self._problem
        cloud = problem.body.cloud
        n, y = cloud.n_owned, np.zeros_like(state.u)
        y[:n] = cloud.x[:n] + state.u[:n]
        velocities = rigid.velocities(y, state.t)
        velocities[:, n:] = 0.0
        if rigid.rows is not None:
            velocities[:, ~rigid.rows] = 0.0
            inner = problem.internal_force(state)
            assert inner is not None
            force = problem.supports.on_independent(inner - problem.external_force(state))
            force = np.where(rigid.rows[:, None], force, 0.0)
            return Side(rigid, force, velocities, None)
        force = -problem.force_of([term], state)
        tangent = Tangent(problem.body, term.linearise(state)) if linear else None
        return Side(rigid, force, velocities, tangent)

    def _imbalance(self, sides: Sequence[Side], state: State) -> tuple[Float, Float]:
        """Return loads less resultants, and the sizes to compare them with (n_motions,)."""
        comm = self._problem.body.cloud.comm
        found = total(comm, np.concatenate([side.resultants(side.force) for side in sides]))
        most = total(comm, [float(np.abs(side.force).sum()) for side in sides])
        loads, sizes, dt = [], [], state.clock.dt
        for side, forces in zip(sides, most, strict=True):
            load, arm = side.rigid.load(state.t), 1.0 / self._lengths(side.rigid)
            # At the end of unloading, forces and load are round-off.
            size = max(float(forces), float(np.max(side.rigid.largest_load / arm, initial=0.0)))
            if dt > 0.0 and self._inertia is not None:
                load = load - side.rigid.accelerate(self._inertia.blend, dt)
                size = max(size, float(np.max(side.rigid.stopping(dt) / arm, initial=0.0)))
            loads.append(load)
            sizes.append(size * arm)
        return np.concatenate(loads) - found, np.concatenate(sizes)

    @property
    def _scale(self) -> Float:
        """Return ``_lengths`` of all bodies (n,)."""
        return np.concatenate([np.zeros(0), *[self._lengths(rigid) for _, rigid in self._bodies]])

    def _parts(self, motions: Float) -> list[Float]:
        """Return the motions of each body from those of all (n,)."""
        return np.split(motions, np.cumsum([np.count_nonzero(rigid.free) for _, rigid in self._bodies]))[:-1]

    def _lengths(self, rigid: RigidBody) -> Float:
        """Return 1 for displacements, and the angle that moves the size of the body by 1 for rotations (n_free,)."""
        dim = self._problem.dim
        return np.where(np.arange(len(rigid.free)) < dim, 1.0, 1.0 / self._size)[rigid.free]

    def _stiffness(self, sides: Sequence[Side], state: State, answer: Callable[[Float], Float]) -> tuple[Float, Float]:
        """Return the derivative of the resultants by the motions, and the ways of the particles for each motion."""
        S, ways = CoupledTangent(self._problem, sides, state).responses(answer)
        if self._inertia is not None and state.clock.dt > 0.0:
            blend = self._inertia.blend
            S += block_diag(*[side.rigid.stiffness_in_step(blend, state.clock.dt) for side in sides])
        return S, ways

    def unbalanced(self, state: State, forces: tuple[Float, Float], damping: Float) -> list[tuple[RigidBody, Float]]:
        """Return each body with the loads that nothing balances (n_free,).

        Parameters
        ----------
        state : State
            A state.
        forces : two (n_rows, dim) float64
            Internal and external forces there [force].
        damping : (n_owned, dim) float64
            Forces of damping [force].
        """
        cloud, found = self._problem.body.cloud, []
        for term, rigid in self._bodies:
            if rigid.rows is None:
                force = -self._problem.force_of([term], state)[: cloud.n_owned]
            else:
                internal, external = forces
                force = (internal - external)[: cloud.n_owned] + damping
                force = np.where(rigid.rows[: cloud.n_owned, None], force, 0.0)
            # Only a few particles touch a tool.
            rows = np.flatnonzero(force.any(axis=1))
            velocities = rigid.velocities(cloud.x[rows] + state.u[rows], state.t)
            resultants = total(cloud.comm, np.einsum("kpi,pi->k", velocities, force[rows]))
            found.append((rigid, rigid.load(state.t) - resultants))
        return found

    def begin(self, state: State, forces: tuple[Float, Float]) -> None:
        """Set the accelerations at the start of a motion, with internal and external forces (n_rows, dim) [force]."""
        inertia = self._moving
        for rigid, off in self.unbalanced(state, forces, inertia.damped(inertia.v)):
            rigid.begin(off)

    def predict(self, t: float) -> None:
        """Move to the end of a generalised-alpha step with the forces of its start (not collective)."""
        problem = self._problem
        for term, rigid in self._bodies:
            rigid.start_from(problem.converged, t)
            rigid.predict(self._moving.blend, (t - problem.converged) * problem.duration)
            term.version += 1

    def fly(self, t: float, dt: float) -> None:
        """Move by a time step of central differences from the last converged step."""
        for _, rigid in self._bodies:
            rigid.fly(self._problem.converged, t, dt)

    def land(self, state: State, forces: tuple[Float, Float], damping: Float, dt: float) -> None:
        """Set the rates at the end of a time step of central differences; arguments as for ``unbalanced``."""
        for rigid, off in self.unbalanced(state, forces, damping):
            rigid.land(off, dt)
        inertia = self._moving
        inertia.v[:] = inertia.with_bodies(inertia.v, state.own, state.t)

    def push(self, state: State, forces: tuple[Float, Float], damping: Float, dt: float = 0.0) -> float:
        """Set other forces at the end of a converged time step; arguments as for ``unbalanced``.

        Return the change of the kinetic energy of central differences of the step ``dt`` [energy].
        """
        return sum(rigid.push(off, dt) for rigid, off in self.unbalanced(state, forces, damping))

    @property
    def _moving(self) -> Inertia:
        assert self._inertia is not None
        return self._inertia

    def frequency_squared(self, state: State) -> float:
        """Return a bound on the part of the motions in the largest squared frequency of the body [1 / time^2].

        The largest eigenvalue of a positive matrix is at most the sum of those of its diagonal blocks.
        """
        if not self._bodies:
            return 0.0
        problem, most = self._problem, 0.0
        stiffest = problem.stiffest(state)
        for term, rigid in self._bodies:
            side = self._side(term, rigid, state, linear=False)
            W = side.velocities
            tangent = stiffest if rigid.rows is not None else Tangent(problem.body, term.stiffest(state))
            S = total(problem.body.cloud.comm, np.stack([side.resultants(tangent(one)) for one in W]))
            most += max(float(eigh(0.5 * (S + S.T), rigid.masses(state.t), eigvals_only=True).max()), 0.0)
        return most

    def _approach(self, term: Term, rigid: RigidBody, state: State) -> bool:
        """Move a tool that touches nothing along its force until the body, held in place, carries it.

        Return True if it does.
        """
        problem = self._problem
        n_moves = np.count_nonzero(rigid.free[: problem.dim])
        load = rigid.load(state.t)
        along = np.where(np.arange(len(load)) < n_moves, load, 0.0)
        size = float(np.linalg.norm(along))
        if size == 0.0:
            return False
        along /= size

        def moved(by: float) -> State:
            rigid.move(by * along)
            term.version += 1
            found = problem.state(state.u, state.t)
            term.start_friction(found)
            return problem.state(state.u, state.t)

        def carried(found: State) -> bool:
            side = self._side(term, rigid, found, linear=False)
            return float(total(problem.body.cloud.comm, side.resultants(side.force)) @ along) >= size

        found = moved(0.0)
        gap, least, way, step = term.tool_gap(found), APPROACH * self._size, 0.0, 0.0
        most = 2.0 * (max(gap, 0.0) + 2.0 * self._size)
        while not carried(found):
            if way > most:
                moved(-way)
                return False
            # The tool moves by its distance at most, so that it does not pass through the body.
            step = gap if gap > least else max(least, 2.0 * step if gap < 0.0 else 0.0)
            way, found = way + step, moved(step)
            gap = term.tool_gap(found)
        low, high = way - step, way
        for _ in range(TRIALS):
            if high - low <= EXACT * high:
                break
            middle = 0.5 * (low + high)
            found, way = moved(middle - way), middle
            low, high = (low, middle) if carried(found) else (middle, high)
        moved(high - way)
        return True


def _agree(off: Float, size: Float, rtol: float) -> bool:
    """Return True if loads and resultants agree, with the relative tolerance of the equilibrium of the particles."""
    return bool(np.all(np.abs(off) <= max(TOLERANCE, LOOSER * rtol) * size))
