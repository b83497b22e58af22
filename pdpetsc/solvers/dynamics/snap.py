"""Load steps, of which one without equilibrium goes on as a motion until the body is at rest."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import replace

import numpy as np

from pdpetsc.arrays import Float
from pdpetsc.declare.solvers import SnapThrough
from pdpetsc.declare.steps import AdaptiveSteps, Steps
from pdpetsc.discrete.communicator import largest, total
from pdpetsc.errors import Interrupted, SolveError
from pdpetsc.problem.assembly import Filler
from pdpetsc.problem.blend import Blend
from pdpetsc.problem.problem import Problem
from pdpetsc.solvers.balance import EnergyBalance
from pdpetsc.solvers.dynamics.energy import MOST, MotionBalance
from pdpetsc.solvers.dynamics.implicit import TimeStepSolver
from pdpetsc.solvers.dynamics.motion import forces, set_in_motion
from pdpetsc.solvers.load_steps import equilibrium
from pdpetsc.solvers.newton import StaticSolver
from pdpetsc.solvers.protocol import NONE, Converged, OnFailure, Setting, Start, StepResult

# Kinetic energy over the largest so far at which an equilibrium is first sought; its square root bounds the inertia
# forces. After an equilibrium elsewhere the share is SMALLER times it.
REST, SMALLER = 1e-3, 0.1
# Distance of that equilibrium over the distance that the body has moved.
NEAR = 0.1
# Share of the energy of a step that a body releases in a jump. The trapezoidal rule is off by far less along a path of
# equilibria, even up to a limit point.
JUMPS = 0.05
# Kinetic energy over the largest from which a body that does not rest gets faster.
FASTER = 0.9
# Smallest time step over the declared one.
LEAST = 1e-4


class SnapSolver(StaticSolver):
    """Solve load steps as ``StaticSolver``, and the smallest step that finds no equilibrium as a motion.

    Parameters
    ----------
    problem, assembler, stop, steps
        As for ``StaticSolver``; the problem has an inertia for snaps.
    declared : SnapThrough
        Time step, longest time and damping of the motion.
    """

    def __init__(
        self, problem: Problem, assembler: Filler, stop: Callable[[], bool], steps: Steps | AdaptiveSteps,
        declared: SnapThrough,
    ) -> None:  # fmt: skip
        super().__init__(problem, assembler, stop, steps)
        assert problem.snap_inertia is not None
        self._assembler, self._declared, self._inertia = assembler, declared, problem.snap_inertia
        self._inertia.blend = Blend.of(declared.radius)
        # Whether the energies of the body are known and nothing dissipates.
        self._judges = not problem.outside and problem.damage is None and problem.body.expansion is None

    @classmethod
    def make(cls, setting: Setting) -> SnapSolver:
        """Build the solver of a setting (collective)."""
        return cls(setting.problem, setting.assembler, setting.stop, setting.steps, setting.declared)

    def march(self, start: Start, on_failure: OnFailure) -> Iterator[Converged]:
        """Yield the converged load steps (collective)."""
        self._balance = EnergyBalance(self.problem, self.problem.state(start.u, start.t), {})
        yield from super().march(start, on_failure)

    def too_long(self, u: Float) -> tuple[float, str]:
        """Refuse an equilibrium that is not reached through others: the body would release energy on the way."""
        growth, reason = super().too_long(u)
        if growth > 1.0 or not self._judges:
            return growth, reason
        state = self.state(u)
        self._balance.pass_by(state)
        released = self._balance.released(state)
        if released > JUMPS:
            self._balance.go_back()
            return 2.0, f"the body jumps, and would release {100.0 * released:.2g} % of the energy of the step"
        self._balance.keep()
        return growth, reason

    def moved_to_rest(self, u: Float, t: float) -> tuple[Float, StepResult] | None:
        """Move with the conditions of load parameter ``t`` from rest at ``u`` until the body is at rest."""
        motion = _Motion(self, u, t)
        share = REST
        while True:
            with self._with_inertia():
                motion.move(share)
            at = motion.u
            found, result = equilibrium(self, self.steps.bonds_at_once, at, t)
            self.refuse_stopped()
            stable = self.steps.unstable == "warn" or not result.negative_pivots
            if result.converged and stable and self._distance(found, at) <= NEAR * self._distance(at, u):
                result = replace(result.after(motion.result), easy=False, moved=motion.time)
                self._balance = EnergyBalance(self.problem, self.state(found), {})
                return found, result
            self.problem.revert()
            self._equilibrium.forget()
            share *= SMALLER

    def refuse_stopped(self) -> None:
        """Raise Interrupted if a signal requested a stop."""
        if self.stop():
            self.problem.revert()
            raise Interrupted(
                f"Stopped by a signal while the body moved at step time {self.t:.6g}; results are complete up to the "
                f"last step; go on with --restart."
            )

    def _distance(self, u: Float, v: Float) -> float:
        return largest(self._comm, np.abs(u - v), initial=0.0)

    @contextmanager
    def _with_inertia(self) -> Iterator[None]:
        """Give the problem its inertia in the ``with`` block (collective)."""
        problem = self.problem
        kept, problem.last_step = problem.last_step, None
        problem.inertia = self._inertia
        problem.terms.append(self._inertia)
        try:
            yield
        finally:
            problem.terms.remove(self._inertia)
            problem.inertia, problem.last_step = None, kept
            self._equilibrium.forget()


class _Motion:
    """Move a body at constant load, step by step.

    Attributes
    ----------
    u : (n_rows, dim) float64
        Unknowns now [length].
    time : float
        Time since the start [time].
    result : StepResult
        Outcome of the last time step, with the iterations of all and the bonds that broke.
    """

    def __init__(self, of: SnapSolver, u: Float, t: float) -> None:
        self._of, self.u, self._t = of, u, t
        self.time, self._dt = 0.0, of._declared.dt
        self.result = NONE
        self._balance = MotionBalance(of.problem, of._inertia, {}, tells=False)
        # The largest kinetic energy [energy] and norm of the inertia forces [force] so far.
        self._most = np.zeros(2)

    def move(self, share: float) -> None:
        """Move until the kinetic energy and the inertia forces are a small share of their largest values (collective).

        Raises
        ------
        SolveError
            A time step fails, the energy does not balance, or the time is up.
        Interrupted
            A signal requested a stop.
        """
        of, declared = self._of, self._of._declared
        solver = TimeStepSolver(of.problem, of._assembler, of.stop)
        try:
            if self.time == 0.0:
                self._begin()
            while self.time < declared.end:
                self._step(solver)
                now = self._size()
                self._most = np.maximum(self._most, now)
                if np.all(now <= np.array([share, np.sqrt(share)]) * self._most):
                    return
        finally:
            solver.destroy()
        kinetic = self._size()[0] / self._most[0] if self._most[0] > 0.0 else 0.0
        advice = "Take a longer end, more damping or a smaller radius"
        if kinetic > FASTER:
            advice = "It gets faster: hold every part of it, or end the load before it comes apart"
        raise SolveError(
            f"At step time {self._t:.6g} there is no equilibrium, and the body is not at rest after moving for "
            f"{declared.end:g}: its kinetic energy is {kinetic:.2g} of the largest. {advice}."
        )

    def _begin(self) -> None:
        """Start from rest."""
        problem, inertia = self._of.problem, self._of._inertia
        self.u = np.where(problem.supports.fixed, problem.supports.prescribed(self._t), self.u)
        inertia.step = 0.0
        internal, external = set_in_motion(problem, self.u, np.zeros_like(inertia.v), self._t)
        self._balance.begin(problem.state(self.u, self._t), internal, external)
        inertia.begin_step(internal, external)

    def _step(self, solver: TimeStepSolver) -> None:
        """Make one time step, halved until it converges."""
        of, problem, inertia = self._of, self._of.problem, self._of._inertia
        problem.start_from(problem.state(self.u, self._t))
        while True:
            inertia.step_by(self._dt)
            attempt, result = equilibrium(solver, of.steps.bonds_at_once, self.u, self._t)
            # Sweeps on the way are not those of the load step, and bonds of a failed time step mend.
            self.result = replace(result, sweeps=0, broken=result.broken if result.converged else 0).after(self.result)
            of.refuse_stopped()
            if result.converged:
                break
            problem.revert()
            self._dt *= 0.5
            if self._dt < LEAST * of._declared.dt:
                raise SolveError(
                    f"At step time {self._t:.6g} there is no equilibrium, and the motion fails after {self.time:.3g}: "
                    f"{result.reason}; take a shorter dt, or look for zero-energy modes."
                )
        self.u, self.time = attempt, self.time + self._dt
        problem.commit(problem.state(self.u, self._t))
        self._dt = min(2.0 * self._dt, of._declared.dt)
        state = problem.state(self.u, self._t)
        internal, external = forces(problem, state)
        self._balance.move(state, internal, external)
        error = self._balance.record(state)
        if not np.isfinite(error) or error > MOST:
            raise SolveError(
                f"In the motion at step time {self._t:.6g} the body gained {error:.2g} of its largest energy; take a "
                f"shorter dt."
            )
        inertia.begin_step(internal, external)

    def _size(self) -> Float:
        """Return the kinetic energy [energy] and the norm of the inertia forces [force]."""
        inertia = self._of._inertia
        force = inertia.inertial(self._of.problem.state(self.u, self._t))
        sums = total(self._of.problem.body.cloud.comm, [inertia.energy_of_free(), float((force**2).sum())])
        return np.array([sums[0], np.sqrt(sums[1])])
