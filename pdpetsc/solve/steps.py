"""Load stepping with cut-back and growth."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from dataclasses import dataclass, field

from pdpetsc.arrays import Float
from pdpetsc.errors import Interrupted, SolveError
from pdpetsc.scene.steps import AdaptiveSteps, Steps
from pdpetsc.solve.base import StepResult, StepSolver

SAME_TIME = 1e-9
GROWTH = 1.5


@dataclass(frozen=True)
class Converged:
    """A converged step.

    Attributes
    ----------
    u : (n_rows, dim) float64
        Unknowns [length].
    t : float
        Step time [-].
    result : StepResult
        How it went.
    failures : list of StepResult
        Failed attempts before it.
    broken : int
        Bonds that broke in it.
    write_fields : bool
        Whether it is one of those whose fields are written.
    """

    u: Float
    t: float
    result: StepResult
    failures: list[StepResult] = field(default_factory=list)
    broken: int = 0
    write_fields: bool = True


def load_steps(
    solver: StepSolver,
    steps: Steps | AdaptiveSteps,
    u: Float,
    t: float,
    stop: Callable[[], bool],
    on_failure: Callable[[float, float, StepResult], None],
) -> Iterator[Converged]:
    """Yield converged steps from step time ``t`` to 1.

    Bonds break at equilibrium, the most overstretched ones first, and the same load is solved again until none does.
    A step that fails is halved and starts again from the last converged state; after a success the step grows by half,
    up to the largest, if it was easy.

    Raises
    ------
    SolveError
        The smallest step failed; what was yielded before stands.
    Interrupted
        A signal asked to stop.

    Notes
    -----
    Collective.
    """
    dt = steps.first
    stops = steps.stops()
    failures: list[StepResult] = []
    while t < 1.0 - SAME_TIME:
        ahead = next(s for s in stops if s > t + SAME_TIME)
        target = ahead if ahead - t < dt * (1.0 + SAME_TIME) else t + dt
        attempt, result = solver.solve(u, target)
        if stop():
            raise Interrupted(f"Stopped by a signal; results are complete up to step time {t:.6g}.")
        broken = 0
        while result.converged and (more := solver.break_bonds(attempt)):
            broken += more
            attempt, result = solver.solve(attempt, target)
        if result.converged:
            u, t = attempt, target
            solver.accept(u)
            yield Converged(u, t, result, failures, broken)
            failures = []
            if result.easy:
                dt = min(dt * GROWTH, steps.largest)
            continue
        solver.revert()
        failures.append(result)
        dt = 0.5 * (target - t)
        on_failure(t, dt, result)
        if dt < steps.least:
            last = result.norms[-1] if result.norms else float("nan")
            raise SolveError(
                f"No convergence from step time {t:.6g} to {target:.6g}, the smallest step: {result.reason}, residual "
                f"{last:.3e} against {result.reference:.3e} after {result.iterations} iterations; {solver.advice}."
            )
