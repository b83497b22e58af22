"""Inertia of the particles: masses, velocities, and the blend of a generalised-alpha step."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from typing import Protocol

import numpy as np

from pdpetsc.arrays import Float, Mask
from pdpetsc.discrete.communicator import counted_once, total
from pdpetsc.errors import CaseError
from pdpetsc.gradient.products import PointBlocks, Product, ScaledProduct
from pdpetsc.problem.blend import Blend
from pdpetsc.problem.body import Body
from pdpetsc.problem.rigid_body import RigidBody
from pdpetsc.problem.state import State
from pdpetsc.problem.term import KeptArray, Term

# Largest relative difference of two time steps with the same tangent: step times are rounded.
SAME_STEP = 1e-9


class Resistance(Protocol):
    """Define the interface of the stiffness ``K_0`` in damping: a sum of ``products``, applied to unknowns."""

    products: list[Product]

    def __call__(self, du: Float) -> Float:
        """Return ``K_0 du`` (n_rows, dim) [force] (collective)."""
        ...


class ShockViscosity(Protocol):
    """Define the interface of a viscosity of shocks.

    ``ratio`` is the largest damping ratio of waves as short as the spacing [-], by which the stable step shortens.
    """

    ratio: float

    def force(self, state: State, velocity: Float) -> Float:
        """Return the resisting forces (n_rows, dim) [force] at a state, for velocities (n_rows, dim) (collective)."""
        ...


class Inertia(Term):
    """Add ``(M ((1 - alpha_m) a + alpha_m a_0) + alpha_f s_0) / (1 - alpha_f)`` to the residual, and damping ``C v``.

    Index 0 is the last converged step, ``s_0`` the sum of all other forces and of damping there. The residual is that
    of a generalised-alpha step over ``1 - alpha_f``. Its forces are those of the end of the step and of the start, so
    that materials are evaluated where their history is updated. Velocity and acceleration follow from Newmark's
    formulas. M is lumped: the masses of the particles. Held components have no inertia here; that of particles of a
    rigid region in motion belongs to the region.

    Parameters
    ----------
    body : Body
        The body.
    mass : (n_owned,) float64
        Masses of the own particles [mass].
    velocity : (n_owned, dim) float64
        Initial velocities [length / time].
    held : (n_rows, dim) bool
        Held components, without inertia.
    rate : (n_owned,) float64, optional
        Damping proportional to the mass [1 / time].
    dashpots : (n_owned, dim, dim) float64, optional
        Further damping of each own particle [force time / length].
    damping_time : float
        Factor of the stiffness in the damping [time].
    duration : float
        Physical time from load parameter 0 to 1 [time].

    Attributes
    ----------
    mass, damping_time
        As above; ``raise_mass`` may add to the mass.
    own_mass : (n_owned,) float64
        Masses without what is added.
    added : float
        Added mass of the free components over that of these components [-].
    damper : (n_owned, dim, dim) float64 or None
        ``C`` of each own particle [force time / length].
    u, v, a : (n_owned, dim) float64
        Displacement [length], velocity and acceleration of the last converged step.
    begin : (n_owned, dim) float64
        ``s_0``, 0 for held components [force]; set by ``begin_step``.
    blend : Blend
        Constants of the step; set by the solver.
    active : bool
        If False, the term adds nothing: the body is in equilibrium before it moves.
    step : float or None
        Time since the last converged step in a motion at constant load [time]; None if the load parameter determines
        it.
    held : (n_owned, dim) float64 or None
        Velocities of the held components at the end of the step [length / time]; None for the means of the step.
    resistance : Resistance or None
        ``K_0`` of implicit steps; set by the solver.
    viscosity : ShockViscosity or None
        Viscosity of shocks in explicit steps.
    bodies : list of RigidBody
        Loaded rigid bodies with mass; set by ``carry``.
    carried : (n_owned,) bool
        Particles that move with one.
    error : float
        Error of the energy balance at the last record over the largest energy so far [-]; set by the solver.
    judged : bool
        Whether all energies of this balance are known; set by the solver.

    References
    ----------
    Chung1993.
    """

    of_solver = True
    energy_of = "kinetic"

    def __init__(
        self, body: Body, mass: Float, velocity: Float, held: Mask, rate: Float | None, dashpots: Float | None,
        damping_time: float, duration: float,
    ) -> None:  # fmt: skip
        self._body, self.mass, self.own_mass, self._duration = body, mass, mass, duration
        self._rate, self._dashpots, self.damping_time = rate, dashpots, damping_time
        self.damper, self.added = self._damper(), 0.0
        n, dim = body.cloud.n_owned, body.dim
        self.u, self.v, self.a = np.zeros((n, dim)), velocity.copy(), np.zeros((n, dim))
        self.blend = Blend.of(1.0)
        self._free = ~held[:n]
        self._t, self._dt = 0.0, 0.0
        self.active, self.error, self.judged = True, 0.0, True
        self.step: float | None = None
        self.held: Float | None = None
        self.resistance: Resistance | None = None
        self.viscosity: ShockViscosity | None = None
        self.begin = np.zeros((n, dim))
        self.bodies: list[RigidBody] = []
        self.carried = np.zeros(n, dtype=bool)

    def carry(self, bodies: Sequence[RigidBody]) -> None:
        """Move rigid bodies: regions have the masses and initial velocities of their particles (collective)."""
        n, x = len(self.mass), self._body.cloud.x
        self.bodies = list(bodies)
        for rigid in self.bodies:
            if rigid.rows is not None:
                rows = rigid.rows[:n]
                rigid.weigh(self.mass[rows], x[:n][rows], self.v[rows])
                self.carried |= rows
        self.v[:] = self.with_bodies(self.v, self.u, 0.0)

    def with_bodies(self, v: Float, u: Float, t: float, dt: float = 0.0) -> Float:
        """Return velocities (n_owned, dim), of particles of rigid regions those of the regions (not collective).

        They are those at the end of the last converged step, or of an implicit step of the length ``dt``.
        """
        if not self.carried.any():
            return v
        found, x = v.copy(), self._body.cloud.x
        for rigid in self.bodies:
            if rigid.rows is not None:
                rows = rigid.rows[: len(v)]
                found[rows] = rigid.carried(x[: len(v)][rows], u[rows], t, self.blend if dt > 0.0 else None, dt)
        return found

    def _damper(self) -> Float | None:
        if self._rate is None:
            return self._dashpots
        found = (self._rate * self.mass)[:, None, None] * np.eye(self._body.dim)
        return found if self._dashpots is None else found + self._dashpots

    def raise_mass(self, least: Float) -> None:
        """Raise the masses of particles that are not held to ``least`` (n_owned,) [mass] (collective)."""
        if self._dashpots is not None:
            raise CaseError(
                "least_step of Explicit does not go with AbsorbingBoundary, whose dashpots fit the density."
            )
        free = self._free.any(axis=1)
        self.mass = np.where(free, np.maximum(self.mass, least), self.mass)
        self.damper = self._damper()
        sums = [float(one[free].sum()) for one in (self.mass, self.own_mass)]
        raised, before = total(self._body.cloud.comm, sums).tolist()
        self.added = raised / before - 1.0 if before > 0.0 else 0.0

    @property
    def rate_of_rigid(self) -> float:
        """Return a bound on the rate at which dampers slow rigid regions on this rank [1 / time] (not collective)."""
        if self.damper is None:
            return 0.0
        sizes = np.linalg.norm(self.damper[self.carried], ord=2, axis=(1, 2))
        return float((sizes / self.mass[self.carried]).max(initial=0.0))

    @property
    def parts(self) -> list[str]:
        """Return the names of the parts (not collective)."""
        return ["inertia"]

    def step_to(self, t: float) -> None:
        """Prepare a step to load parameter ``t``, which changes the tangent if its size is another (not collective)."""
        self._take_step((t - self._t) * self._duration)

    def step_by(self, dt: float) -> None:
        """Prepare a step of the size ``dt`` [time] at constant load (not collective)."""
        self.step = dt
        self._take_step(dt)

    def _take_step(self, dt: float) -> None:
        if abs(dt - self._dt) > SAME_STEP * dt:
            self._dt = dt
            self.version += 1

    def _elapsed(self, t: float) -> float:
        """Return the time since the last converged step."""
        return (t - self._t) * self._duration if self.step is None else self.step

    def place(self, u: Float, v: Float, a: Float, t: float) -> None:
        """Set displacement, velocity and acceleration (n_owned, dim) at load parameter ``t`` (not collective)."""
        self.u[:], self.v[:], self.a[:], self._t = u, v, a, t

    def motion(self, state: State) -> tuple[Float, Float]:
        """Return velocity and acceleration (n_owned, dim) at the end of a step, or of the last one (not collective)."""
        dt = self._elapsed(state.t)
        if dt <= 0.0:
            return self.v, self.a
        beta, gamma = self.blend.beta, self.blend.gamma
        moved = state.own - self.u
        a = (moved - dt * self.v) / (beta * dt**2) - (0.5 / beta - 1.0) * self.a
        v = self.v + dt * ((1.0 - gamma) * self.a + gamma * a)
        mean = moved / dt
        held = self.with_bodies(mean if self.held is None else self.held, state.own, state.t, dt)
        return np.where(self._free, v, held), np.where(self._free, a, (held - self.v) / dt)

    def ahead(self, t: float) -> Float:
        """Return the displacements of the free components if the acceleration remains (n_owned, dim) [length]."""
        dt = self._elapsed(t)
        return np.asarray(self.u + dt * self.v + 0.5 * dt**2 * self.a)

    def inertial(self, state: State) -> Float:
        """Return ``M a`` of the free components (n_owned, dim) [force] (not collective)."""
        return np.where(self._free, self.mass[:, None] * self.motion(state)[1], 0.0)

    def damped(self, velocity: Float) -> Float:
        """Return the forces of damping of the free components and of rigid regions (n_owned, dim) [force].

        Collective with a ``resistance``.
        """
        force = np.zeros_like(velocity)
        if self.damper is not None:
            force += np.einsum("nij,nj->ni", self.damper, velocity)
        if self.resistance is not None:
            rows = np.zeros((self._body.cloud.n_rows, self._body.dim))
            rows[: len(velocity)] = velocity
            force += self.damping_time * self.resistance(rows)[: len(velocity)]
        return np.where(self._free | self.carried[:, None], force, 0.0)

    def begin_step(self, internal: Float, external: Float) -> None:
        """Store the forces (n_rows, dim) [force] at the start of the next step."""
        static = (internal - external)[: len(self.u)] + self.damped(self.v)
        self.begin[:] = np.where(self._free, static, 0.0)

    def accelerated_by(self, force: Float, half: Float, dt: float) -> Float:
        """Return the acceleration a of ``M a + C (v_1/2 + dt a / 2) = f`` of the free components (n_owned, dim).

        Parameters
        ----------
        force, half : (n_owned, dim) float64
            f [force], and velocities half a step before [length / time].
        dt : float
            Time step [time].

        Notes
        -----
        Not collective.
        """
        if self.damper is None:
            a = force / self.mass[:, None]
        else:
            rest = force - np.einsum("nij,nj->ni", self.damper, half)
            blocks = self.mass[:, None, None] * np.eye(self._body.dim) + 0.5 * dt * self.damper
            a = np.linalg.solve(blocks, rest[:, :, None])[:, :, 0]
        return np.where(self._free, a, 0.0)

    def add_row_force(self, state: State, r: Float) -> None:
        if not self.active:
            return
        v, a = self.motion(state)
        blend, m = self.blend, self.mass[:, None]
        force = m * ((1.0 - blend.alpha_m) * a + blend.alpha_m * self.a) + blend.alpha_f * self.begin
        r[: len(self.u)] += np.where(self._free, force / (1.0 - blend.alpha_f), 0.0) + self.damped(v)

    def linearise(self, state: State) -> Sequence[Product]:
        """Return ``M (1 - alpha_m) / ((1 - alpha_f) beta dt^2) + C gamma / (beta dt)``."""
        blend, dt = self.blend, self._elapsed(state.t)
        if dt <= 0.0 or not self.active:
            return []
        rate = (1.0 - blend.alpha_m) / ((1.0 - blend.alpha_f) * blend.beta * dt**2)
        blocks = np.where(self.carried, 0.0, rate * self.mass)[:, None, None] * np.eye(self._body.dim)
        per_displacement = blend.gamma / (blend.beta * dt)
        if self.damper is not None:
            blocks += per_displacement * self.damper
        of_stiffness = [] if self.resistance is None else self.resistance.products
        factor = per_displacement * self.damping_time
        return [PointBlocks(blocks), *(ScaledProduct(one, factor) for one in of_stiffness)]

    def energy(self, state: State) -> float:
        """Return the kinetic energy of this rank [energy] (not collective); that of declared masses on the first."""
        added = counted_once(self._body.cloud.comm, sum(rigid.added_kinetic for rigid in self.bodies))
        return added + 0.5 * float(self.mass @ (self.motion(state)[0] ** 2).sum(axis=1))

    def energy_of_free(self, dt: float = 0.0) -> float:
        """Return ``sum m (v - dt a / 2) (v + dt a / 2) / 2`` of the free components on this rank [energy].

        They are those of the last converged step. Without ``dt`` it is the kinetic energy. With the time step of
        central differences, these are the velocities half a step before and after; a linear motion conserves its energy
        with them (not collective).
        """
        squares = np.where(self._free, self.v**2 - (0.5 * dt * self.a) ** 2, 0.0)
        return 0.5 * float(self.mass @ squares.sum(axis=1))

    def commit(self, state: State) -> None:
        """Store the motion at the end of the step."""
        if self._elapsed(state.t) > 0.0:
            v, a = self.motion(state)
            self.place(state.own, v, a, state.t)
            if self.step is not None:
                self.step = 0.0

    # The forces depend on the last converged step.
    has_history = True

    def arrays(self) -> Mapping[str, KeptArray]:
        """Return displacement, velocity and acceleration of the last converged step."""
        owner = np.arange(len(self.u), dtype=np.int32)
        return {"u": KeptArray(owner, self.u), "v": KeptArray(owner, self.v), "a": KeptArray(owner, self.a)}

    def restored_at(self, t: float) -> None:
        """Continue from load parameter ``t`` (not collective)."""
        self._t = t

    def numbers(self) -> Mapping[str, Callable[[State], float]]:
        """Return the physical time for the history."""
        return {"time": lambda state: counted_once(self._body.cloud.comm, state.t * self._duration)}
