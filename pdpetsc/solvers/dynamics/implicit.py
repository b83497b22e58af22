"""Motion by generalised-alpha steps with SNES."""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator
from dataclasses import replace

import numpy as np

from pdpetsc.arrays import Float
from pdpetsc.declare.solvers import Implicit
from pdpetsc.declare.steps import AdaptiveSteps, Steps
from pdpetsc.discrete.communicator import anywhere, total
from pdpetsc.errors import SolveError
from pdpetsc.problem.assembly import Filler
from pdpetsc.problem.blend import Blend
from pdpetsc.problem.problem import Problem
from pdpetsc.solvers.dynamics.energy import MOST, MotionBalance, knows_energies
from pdpetsc.solvers.dynamics.motion import (
    END,
    ERROR,
    begin_motion,
    elastic_tangent,
    forces,
    held_velocity,
    inertia_of,
    preload,
    printed,
    resume_motion,
)
from pdpetsc.solvers.load_steps import SAME_TIME, equilibrium
from pdpetsc.solvers.newton import StaticSolver
from pdpetsc.solvers.protocol import NONE, Converged, OnFailure, Setting, Start, StepResult

# Name of the largest displacement in a checkpoint [length].
MOST_MOVED = "most_moved"


class TimeStepSolver(StaticSolver):
    """Solve one time step after another, each from the motion with constant acceleration.

    Parameters are those of ``StaticSolver``; the problem has an inertia.
    """

    def _ahead(self, u: Float, t: float) -> Float | None:
        """Return the unknowns (n_rows, dim) of the motion with constant acceleration; None for a repeated step."""
        inertia = inertia_of(self.problem)
        n = len(inertia.mass)
        if anywhere(self._comm, u[:n] != inertia.u) or not inertia.active:
            return None  # the step is solved again with other damage
        ahead = u.copy()
        ahead[:n] = inertia.ahead(t)
        return ahead


class ImplicitSolver(TimeStepSolver):
    """Integrate a motion by generalised-alpha steps, each an equilibrium with inertia.

    Parameters
    ----------
    problem, assembler, stop, steps
        As for ``StaticSolver``.
    declared : Implicit
        Time step, end and damping of short waves.
    """

    advice = "take a shorter dt, look for zero-energy modes, or try -snes_linesearch_type basic or -snes_rtol 1e-8"

    def __init__(
        self, problem: Problem, assembler: Filler, stop: Callable[[], bool], steps: Steps | AdaptiveSteps,
        declared: Implicit,
    ) -> None:  # fmt: skip
        super().__init__(problem, assembler, stop, steps)
        self._count = f"{declared.count}" if declared.error is None else f"at least {declared.count}"
        self._declared, self._inertia = declared, inertia_of(problem)
        # Root mean square of the displacement over the mass, the largest so far [length].
        self._most = 0.0
        self._last = 0.0
        self._inertia.judged = knows_energies(problem, tells=False) or bool(self._inertia.bodies)
        self._inertia.blend = Blend.of(declared.radius)
        if self._inertia.damping_time > 0.0:
            self._inertia.resistance = elastic_tangent(problem)

    @classmethod
    def make(cls, setting: Setting) -> ImplicitSolver:
        """Build the solver of a setting (collective)."""
        declared: Implicit = setting.declared
        steps = Steps(declared.count) if declared.error is None else setting.steps
        return cls(setting.problem, setting.assembler, setting.stop, steps, declared)

    def description(self) -> str:
        """Return a short description of the time integration and its solvers."""
        return f"generalised-alpha, radius {self._declared.radius:g}, {self._count} steps, {super().description()}"

    def solve(self, u: Float, t: float) -> tuple[Float, StepResult]:
        """Find the end of the time step to load parameter ``t`` (collective)."""
        self._inertia.step_to(t)
        self._bodies.predict(t)
        self._inertia.held = held_velocity(self.problem, t, t - self.problem.converged)
        return super().solve(u, t)

    def _equilibrate(self, u: Float) -> tuple[Float, StepResult]:
        """Find the equilibrium at step time 0, without inertia."""
        found, result = equilibrium(self, None, u, 0.0)
        if result.converged:
            self.refuse_mechanism(found)
        self._equilibrium.forget()
        return found, result

    def too_long(self, u: Float) -> tuple[float, str]:
        """Return the cube root of the local error over the allowed one: the error is of third order in the step."""
        if self._declared.error is None:
            return super().too_long(u)
        inertia, state = self._inertia, self.state(u)
        n = len(inertia.mass)
        dt = (state.t - self.problem.converged) * self._declared.end
        free = ~self._fixed[:n]
        a = inertia.motion(state)[1]
        missed = np.where(free, (inertia.blend.beta - 1.0 / 6.0) * dt**2 * (a - inertia.a), 0.0)
        # A body that begins to move is compared with its way in the largest step: its own way is as small as the error.
        ahead = np.where(free, 0.5 * self._declared.dt**2 * a, 0.0)
        sums = total(self._comm, [float(inertia.mass @ (one**2).sum(axis=1)) for one in (missed, state.own, ahead)])
        for rigid in inertia.bodies:
            sums = sums + rigid.local_error(inertia.blend, dt, self._declared.dt)
        error, moved, expected = np.sqrt(sums).tolist()
        most = max(self._most, moved)
        size = most if self._most > 0.0 else max(most, expected)
        off = error / size if size > 0.0 else 0.0
        growth = (off / self._declared.error) ** (1.0 / 3.0)
        if growth <= 1.0:
            self._most = most
        return growth, f"the local error was {off:.2g} of the largest displacement"

    def resume(self, start: Start) -> None:
        """Restore the numbers of a checkpoint; raise CaseError if it is of another motion."""
        resume_motion(self.problem, start.resume, self._declared.end)
        self._most = start.resume.get(MOST_MOVED, 0.0)
        super().resume(start)

    def march(self, start: Start, on_failure: OnFailure) -> Iterator[Converged]:
        """Yield the recorded steps (collective)."""
        problem, inertia = self.problem, self._inertia
        u = start.u
        if start.t == 0.0:
            if self._declared.preload:
                u = preload(problem, u, self._equilibrate, self.stop)
            u = begin_motion(problem, u, self.steps.first)
            if self._declared.conserving:  # the first step begins at this deformation
                problem.material_term.commit(problem.state(u, 0.0))
        balance = MotionBalance(problem, inertia, start.resume, tells=False)
        state = problem.state(u, start.t)
        if start.t == 0.0:
            problem.start_from(state)
            state = problem.state(u, start.t)
        found = forces(problem, state)
        if start.t == 0.0:
            self._bodies.begin(state, found)
        inertia.begin_step(*found)
        balance.begin(state, *found)
        recorded = start.t
        number, failures, result = 0, [], NONE
        for converged in super().march(replace(start, u=u), on_failure):
            state = problem.state(converged.u, converged.t)
            inertia.begin_step(*(found := forces(problem, state)))
            balance.move(state, *found)
            if self._declared.conserving and self._bodies:
                # The stress of a step is not that at its end.
                self._bodies.push(state, found, inertia.damped(inertia.v))
            number += 1
            failures += converged.failures
            result = converged.result.after(result)
            if number % self._declared.every and converged.t < 1.0 - SAME_TIME:
                continue
            work, self._last = balance.step_work, converged.t - recorded
            recorded = converged.t
            inertia.error = balance.record(state)
            self._refuse_unbalanced(inertia.error, converged.t)
            own = {END: self._declared.end, ERROR: inertia.error, MOST_MOVED: self._most}
            resume = {**converged.resume, **balance.resume, **own}
            yield replace(converged, result=result, failures=failures, work=work, resume=resume)
            failures, result = [], NONE

    def line(self, number: int, converged: Converged) -> str | None:
        """Return the printed line of a record, None for most of many records."""
        return super().line(number, converged) if printed(converged.t, self._last) else None

    def _refuse_unbalanced(self, error: float, t: float) -> None:
        """Raise SolveError if the body has gained energy, or lost some that the integrator does not damp."""
        if not math.isfinite(error) or error > MOST or (error < -MOST and self._declared.radius == 1.0):
            raise SolveError(
                f"At step time {t:.6g} the energy does not balance by {abs(error):.2g} of the largest so far; take a "
                f"shorter dt."
            )
