"""Motion by central differences."""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator

import numpy as np

from pdpetsc.arrays import Float
from pdpetsc.declare.solvers import DynamicRelaxation, Explicit
from pdpetsc.declare.steps import Steps
from pdpetsc.discrete.communicator import anywhere, total
from pdpetsc.discrete.communicator import largest as largest_of
from pdpetsc.errors import CaseError, Interrupted, SolveError
from pdpetsc.problem.problem import Problem
from pdpetsc.problem.state import State
from pdpetsc.solvers.dynamics.energy import MOST, MotionBalance, knows_energies
from pdpetsc.solvers.dynamics.motion import (
    END,
    ERROR,
    begin_motion,
    elastic_tangent,
    forces,
    inertia_of,
    preload,
    printed,
    resume_motion,
)
from pdpetsc.solvers.dynamics.stable_step import Frequency, largest_frequency
from pdpetsc.solvers.protocol import Converged, OnFailure, Setting, Solver, Start, StepResult
from pdpetsc.solvers.relaxation import RelaxationSolver
from pdpetsc.solvers.rigid_bodies import RigidBodies

# Largest number of bonds that fail at once: all.
ALL = 2**62
# Time steps between checks for signals.
CHECKED = 20
# Relative difference of numbers of records or time steps that are equal.
SAME_NUMBER = 1e-12
# Smallest stiffness of a particle over the largest, for the added mass.
SOFTEST = 1e-12
# Step time of the first step, for the velocity of held components at the start.
FIRST = 1e-3
# Relative difference of two masses of the same body.
SAME_MASS = 1e-6
# Names in a checkpoint: the added mass [-], and the damping ratio of the viscosity of shocks [-].
ADDED, RATIO = "added_mass", "viscous_ratio"


class ExplicitSolver(Solver):
    """Integrate ``M a + C v + c K_0 v + f_int = f_ext`` by velocity Verlet steps.

    ``v_1/2 = v + dt a / 2``, ``u + dt v_1/2``, ``v_1/2 + dt a / 2``. The force of ``C`` takes the velocity at the end
    of the step, that of ``K_0`` takes ``v_1/2``. Damage and histories are updated at the end of every step.

    Parameters
    ----------
    problem : Problem
        The problem, with inertia.
    declared : Explicit
        End, safety and records.
    stop : callable
        Called repeatedly and collectively; True ends the march (a signal arrived).

    Notes
    -----
    Every method is collective.
    """

    unit = "time step"
    advice = "take a smaller safety, look for zero-energy modes, or add or raise the zero-energy control"

    def __init__(self, problem: Problem, declared: Explicit, stop: Callable[[], bool]) -> None:
        self._problem, self._declared, self._stop = problem, declared, stop
        self._inertia = inertia_of(problem)
        self._inertia.judged = knows_energies(problem, tells=True) or bool(self._inertia.bodies)
        self._bodies = RigidBodies(problem)
        if declared.least_step is not None:
            self._add_mass(declared.least_step)
        self._rigid_damping = largest_of(problem.body.cloud.comm, self._inertia.rate_of_rigid)
        self._held = anywhere(problem.body.cloud.comm, problem.supports.fixed)
        self._resistance = elastic_tangent(problem) if self._inertia.damping_time > 0.0 else None

    @classmethod
    def make(cls, setting: Setting) -> ExplicitSolver:
        """Build the solver of a setting."""
        return cls(setting.problem, setting.declared, setting.stop)

    @classmethod
    def refuse(cls, problem: Problem) -> None:
        """Raise CaseError for a problem of fields that are solved for."""
        if problem.fields:
            raise CaseError("Explicit does not solve for a temperature. Use Implicit, or prescribe it.")

    def description(self) -> str:
        """Return a short description of the solver."""
        added = f", {100.0 * self._inertia.added:.3g} % of the mass added" if self._declared.least_step else ""
        return f"central differences, {self._declared.safety:g} of the stable time step{added}"

    def march(self, start: Start, on_failure: OnFailure) -> Iterator[Converged]:
        problem, inertia, declared = self._problem, self._inertia, self._declared
        first = FIRST / declared.records
        u = start.u
        if start.t == 0.0:
            if declared.preload:
                relaxed = RelaxationSolver(problem, DynamicRelaxation(), Steps(), self._stop)
                u = preload(problem, u, lambda v: relaxed.solve(v, 0.0), self._stop)
            u = begin_motion(problem, u, first)
        balance = MotionBalance(problem, inertia, start.resume, tells=True)
        problem.start_from(problem.state(u, start.t))
        state = problem.state(u, start.t)
        if start.t == 0.0 and self._bodies:
            self._bodies.begin(state, forces(problem, state))
        frequency = Frequency(problem, self._frequency, declared.safety, state, start.resume)
        # Bonds fail at the end of a step, not within it.
        of_bonds = problem.bond_damage is not None
        problem.freeze(of_bonds)
        t, begun = start.t, False
        while t < 1.0 - SAME_NUMBER:
            target = (math.floor(t * declared.records * (1.0 + SAME_NUMBER)) + 1) / declared.records
            broken, taken = 0, 0
            # Steps of equal size from ``base`` on, until the stable step changes.
            base, number, count = t, 0, self._count(target - t, frequency.largest)
            if not begun:
                acting, size = forces(problem, state), (target - t) * declared.end / count
                balance.begin(state, *acting, size, self._viscous_before(*acting))
                begun = True
            while number < count:
                number += 1
                size = (target - base) * declared.end / count
                at = target if number == count else base + (target - base) * number / count
                u, failed = self._step(u, at, size, balance)
                broken, taken = broken + failed, taken + 1
                changed = frequency.follow(u, at, failed > 0)
                if frequency.steps % CHECKED == 0 and self._stop():
                    raise Interrupted(
                        f"Stopped by a signal; results are complete up to step time {t:.6g}; go on with --restart."
                    )
                shocked = inertia.viscosity is not None and self._stable(frequency.largest) < size
                if number < count and (changed or shocked):
                    base, number, count = at, 0, self._count(target - at, frequency.largest)
            problem.freeze(False)
            work, state = balance.step_work, problem.state(u, target)
            inertia.error = balance.record(state, size)
            self._refuse_unbalanced(inertia.error, balance.amplified, target)
            result = StepResult(True, "end of the time steps", iterations=taken, broken=broken)
            numbers = {**frequency.carry(state), ADDED: inertia.added, END: declared.end, ERROR: inertia.error}
            if inertia.viscosity is not None:
                numbers[RATIO] = inertia.viscosity.ratio
            yield Converged(u, target, result, resume={**balance.resume, **numbers}, work=work)
            problem.freeze(of_bonds)
            t = target

    def _refuse_unbalanced(self, error: float, amplified: float, t: float) -> None:
        """Raise SolveError if the energy of a record does not balance, or the motion is unstable."""
        if not (math.isfinite(error) and math.isfinite(amplified)) or abs(error) > MOST:
            raise SolveError(
                f"At step time {t:.6g} the energy does not balance by {abs(error):.2g} of the largest so far; "
                f"{self.advice}."
            )
        # A linear motion conserves this energy also beyond the stable step, although its parts grow without bound.
        expands = self._problem.body.expansion is not None
        if amplified > 2.0 / (1.0 - self._declared.safety**2) and not expands:
            raise SolveError(
                f"At step time {t:.6g} the motion is unstable: the body has {amplified:.3g} times the energy that it "
                f"was given; {self.advice}."
            )

    def resume(self, start: Start) -> None:
        """Restore the numbers of a checkpoint; raise CaseError if it is of another motion."""
        resume_motion(self._problem, start.resume, self._declared.end)
        was, now = start.resume.get(ADDED, 0.0), self._inertia.added
        if abs(was - now) > SAME_MASS * (1.0 + now):
            raise CaseError(
                f"The checkpoint is of a motion with {100.0 * was:.3g} % of the mass added, not {100.0 * now:.3g} %. "
                f"Use the same least_step."
            )
        if self._inertia.viscosity is not None:
            self._inertia.viscosity.ratio = start.resume.get(RATIO, self._inertia.viscosity.ratio)
        super().resume(start)

    def line(self, number: int, converged: Converged) -> str | None:
        """Return the printed line of a record, None for most of many records."""
        each = 1.0 / self._declared.records
        if not printed(converged.t, each):
            return None
        count, broken = converged.result.iterations, converged.result.broken
        off = f", energy off by {self._inertia.error:.1e}" if self._inertia.judged else ""
        return (
            f"step {number:4d}  t = {converged.t:<8.6g} time {converged.t * self._declared.end:.4g}, "
            f"{count} time step{'s' if count > 1 else ''} of {each * self._declared.end / count:.3g}"
            f"{off}{f', {broken} bonds broke' if broken else ''}"
        )

    def _count(self, span: float, frequency: float) -> int:
        """Return the number of stable time steps over a span of the step time."""
        return max(1, math.ceil(span * self._declared.end / self._stable(frequency) * (1.0 - SAME_NUMBER)))

    def _add_mass(self, dt: float) -> None:
        """Raise masses until the time step of the undeformed body is ``dt``.

        With masses ``c k_i`` the largest frequency is that of the tangent relative to ``k_i`` over ``sqrt(c)``, and
        more mass only lowers it.
        """
        problem, inertia, comm = self._problem, self._inertia, self._problem.body.cloud.comm
        rest = problem.state(np.zeros(problem.supports.fixed.shape), 0.0)
        k = np.trace(problem.stiffest(rest).point_blocks(), axis1=1, axis2=2) / problem.dim
        k = np.maximum(k, SOFTEST * largest_of(comm, k, initial=0.0))
        half = 0.5 * dt / self._declared.safety
        square = 1.0 / (half**2 + half * inertia.damping_time)
        square -= self._bodies.frequency_squared(rest)
        if square <= 0.0:
            raise CaseError(
                "A rigid body is too light for the least_step of Explicit. Use a smaller one, or a larger mass."
            )
        inertia.raise_mass(k * largest_frequency(problem, rest, k) ** 2 / square)

    def _frequency(self, state: State) -> float:
        found = largest_frequency(self._problem, state, self._inertia.mass)
        return math.sqrt(found**2 + self._bodies.frequency_squared(state)) if self._bodies else found

    def _stable(self, frequency: float) -> float:
        """Return the time step for a largest frequency, with the damping ratio of its mode."""
        ratio = 0.5 * self._inertia.damping_time * frequency
        if self._inertia.viscosity is not None:
            ratio += self._inertia.viscosity.ratio
        # Dampers on rigid regions take a velocity from the step before.
        rate = 0.5 * frequency * (math.sqrt(1.0 + ratio**2) + ratio) + self._rigid_damping
        return self._declared.safety / rate if rate > 0.0 else self._declared.end

    def _step(self, u: Float, t: float, dt: float, balance: MotionBalance) -> tuple[Float, int]:
        """Move by one time step to load parameter ``t``; return the unknowns and the number of bonds that broke."""
        problem, inertia, fixed = self._problem, self._inertia, self._problem.supports.fixed
        n, held = len(inertia.mass), fixed[: len(inertia.mass)]
        problem.start_from(problem.state(u, problem.converged))
        half = inertia.v + 0.5 * dt * inertia.a
        self._bodies.fly(t, dt)
        moved = u.copy()
        moved[:n] += dt * half
        if self._held:
            moved = np.where(fixed, problem.supports.prescribed(t), moved)
            half = np.where(held, (moved[:n] - u[:n]) / dt, half)
        viscous = self._viscous(u, half)
        # Dampers on rigid regions: the velocity at the end of the step if the acceleration remains.
        damping = viscous + inertia.damped(2.0 * half - inertia.v) if self._bodies else viscous

        def place(internal: Float, external: Float) -> None:
            a = inertia.accelerated_by((external - internal)[:n] - viscous, half, dt)
            inertia.place(moved[:n], half + 0.5 * dt * a, a, t)

        state = problem.state(moved, t)
        acting = forces(problem, state)
        place(*acting)
        if self._bodies:
            self._bodies.land(state, acting, damping, dt)
        balance.move(state, *acting, viscous)
        damage = problem.bond_damage
        if damage is None or not damage.fails(state):
            problem.commit(state)
            return moved, 0
        # The second half of the kick at this time is that of the forces after the failure.
        before, kinetic, v = balance.stored(state), inertia.energy_of_free(dt), inertia.v.copy()
        problem.freeze(False)
        broken = problem.break_bonds(problem.state(moved, t), ALL)
        problem.commit(problem.state(moved, t))
        problem.freeze(True)
        after = problem.state(moved, t)
        acting = forces(problem, after)
        place(*acting)
        inertia.v[:] = v
        kinetic = float(total(problem.body.cloud.comm, kinetic - inertia.energy_of_free(dt)))
        pushed = self._bodies.push(after, acting, damping, dt)
        balance.fail(before - balance.stored(after) + kinetic, after, *acting, pushed)
        return moved, broken

    def _viscous_before(self, internal: Float, external: Float) -> Float | None:
        """Return the viscous forces of the step before, from its acceleration (n_owned, dim) [force]; None if none."""
        inertia, n = self._inertia, len(self._inertia.mass)
        if self._resistance is None and inertia.viscosity is None:
            return None
        force = (external - internal)[:n] - inertia.damped(inertia.v) - inertia.mass[:, None] * inertia.a
        return np.where(self._problem.supports.fixed[:n], 0.0, force)

    def _viscous(self, u: Float, velocity: Float) -> Float:
        """Return ``c K_0 v`` and the viscosity of shocks of free components and rigid regions (n_owned, dim) [force].

        ``u`` are the unknowns at the start of the step, ``velocity`` those of the own particles (n_owned, dim).
        """
        problem, n, viscosity = self._problem, len(velocity), self._inertia.viscosity
        rows, force = np.zeros_like(u), np.zeros_like(velocity)
        rows[:n] = velocity
        if self._resistance is not None:
            force += self._inertia.damping_time * self._resistance(rows)[:n]
        if viscosity is not None:
            force += viscosity.force(problem.state(u, problem.converged), rows)[:n]
        return np.where(problem.supports.fixed[:n] & ~self._inertia.carried[:, None], 0.0, force)
