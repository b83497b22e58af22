"""Load stepping with cut-back and growth."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from dataclasses import replace

from pdpetsc.arrays import Float
from pdpetsc.declare.steps import AdaptiveSteps, Steps
from pdpetsc.errors import CaseError, Interrupted, SolveError
from pdpetsc.problem.damage import Damage
from pdpetsc.solvers.protocol import Converged, OnFailure, Start, StepResult, StepSolver

SAME_TIME = 1e-9
# What a run that goes on finds the next load step under.
LOAD_STEP = "load_step"
GROWTH = 1.5
# Newton's answer counts where it changes no integrity by more: a longer jump has passed unstable states, and which of
# the states beyond it finds is left to round-off.
GENTLE = 0.3
# Damage has settled where no integrity changes by more in a sweep, and Newton with damage that follows the displacement
# ends close by; where that fails, where no integrity changes by more than LAST. It has this many sweeps.
SETTLED, CLOSE, LAST = 1e-6, 1e-3, 1e-10
SWEEPS = 1000
# Solves in which Newton's answer and the damage there agree; more are left to the sweeps.
FOLLOWING = 50


class LoadStepSolver(StepSolver):
    """Finds equilibrium of one declared load step after another.

    Attributes
    ----------
    steps : Steps or AdaptiveSteps
        How the load is applied.
    stop : callable
        Asked between attempts, collectively; True ends the march (a signal arrived).
    """

    steps: Steps | AdaptiveSteps
    stop: Callable[[], bool]

    def resume(self, start: Start) -> None:
        """Begin the next step as the run did that this one goes on from (collective)."""
        dt = start.resume.get(LOAD_STEP, 1.0)
        if not (dt > 0.0 and start.t + dt > start.t):
            raise CaseError(
                f"The checkpoint's next load step, {dt:g} from step time {start.t:g}, leads nowhere; it is damaged, so "
                f"restart from another one."
            )
        super().resume(start)

    def march(self, start: Start, on_failure: OnFailure) -> Iterator[Converged]:
        """Yield one converged load step after the other (collective)."""
        return load_steps(self, self.steps, start, self.stop, on_failure)


def load_steps(
    solver: StepSolver, steps: Steps | AdaptiveSteps, start: Start, stop: Callable[[], bool], on_failure: OnFailure
) -> Iterator[Converged]:
    """Yield converged steps from ``start`` to step time 1, with the load step that a run before would have gone on.

    Bonds break at equilibrium, the most overstretched ones first, and the same load is solved again until none does.
    Where Newton with damage that follows the displacement fails, or jumps, equilibrium with damage held and damage at
    that equilibrium alternate until neither changes: damage only grows, so this ends. Bonds that heal
    also break where Newton converges gently; in sweeps their damage only grows, and Newton ends them.
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
    u, t = start.u, start.t
    dt = min(start.resume.get(LOAD_STEP, steps.first), steps.largest)
    stops = steps.stops()
    failures: list[StepResult] = []
    while t < 1.0 - SAME_TIME:
        ahead = next(s for s in stops if s > t + SAME_TIME)
        target = ahead if ahead - t < dt * (1.0 + SAME_TIME) else t + dt
        attempt, result, broken, sweeps = equilibrium(solver, steps.bonds_at_once, u, target, stop)
        if result.converged and result.negative_pivots and steps.unstable != "warn":
            result = replace(result, converged=False, reason=_unstable(result.negative_pivots))
            if steps.unstable == "refuse":
                solver.problem.revert()
                raise SolveError(
                    f"At step time {target:.6g} {result.reason}; results are complete up to step time {t:.6g}: perturb "
                    f"the body to find the stable branch, or follow the path."
                )
        if stop():
            solver.problem.revert()
            raise Interrupted(f"Stopped by a signal; results are complete up to step time {t:.6g}.")
        if result.converged:
            u, t = attempt, target
            solver.problem.commit(solver.state(u))
            if result.easy:
                dt = min(dt * GROWTH, steps.largest)
            yield Converged(u, t, result, failures, broken, sweeps, {LOAD_STEP: dt})
            failures = []
            continue
        solver.problem.revert()
        failures.append(result)
        dt = 0.5 * (target - t)
        on_failure(t, dt, result)
        if dt < steps.least:
            last = result.norms[-1] if result.norms else float("nan")
            raise SolveError(
                f"No convergence from step time {t:.6g} to {target:.6g}, the smallest step: {result.reason}, residual "
                f"{last:.3e} against {result.reference:.3e} after {result.iterations} iterations; {solver.advice}."
            )


def _unstable(pivots: int) -> str:
    return f"the equilibrium is unstable, with {pivots} negative pivot{'s' if pivots > 1 else ''}"


def equilibrium(
    solver: StepSolver, bonds_at_once: int | None, u: Float, target: float, stop: Callable[[], bool]
) -> tuple[Float, StepResult, int, int]:
    """Find equilibrium at ``target`` with damage; return it, how it went, bonds broken and sweeps with damage held.

    ``bonds_at_once`` is how many bonds break at once (``Steps``).
    """
    problem, broken = solver.problem, 0
    problem.freeze(False)
    attempt, result = solver.solve(u, target)
    if not problem.softens:
        while result.converged and (more := problem.break_bonds(solver.state(attempt), bonds_at_once)):
            broken += more
            attempt, result = solver.solve(attempt, target)
        return attempt, result, broken, 0
    heals = problem.damage is not None and problem.damage.heals
    while not stop() and result.converged:
        attempt, result, change = followed(solver, attempt, result, target)
        if not result.converged or change > LAST:
            break
        more = problem.break_bonds(solver.state(attempt), bonds_at_once if heals else 1)
        if not more:
            return attempt, result, broken, 0
        if not heals:
            break
        broken += more
        attempt, result = solver.solve(attempt, target)
    if stop():
        return attempt, result, broken, 0
    problem.revert()
    return settle(solver, u, target, SWEEPS, lambda v: problem.break_bonds(solver.state(v), bonds_at_once))


def damage_of(solver: StepSolver) -> Damage:
    """Return the damage of what a solver solves, whose bonds soften."""
    assert solver.problem.damage is not None
    return solver.problem.damage


def followed(
    solver: StepSolver, u: Float, result: StepResult, target: float, most: float = GENTLE
) -> tuple[Float, StepResult, float]:
    """Take the damage at ``u`` and solve again until that changes nothing; return the last change of an integrity.

    A control has the damage of the last equilibrium, so what Newton found is no equilibrium with the damage there. A
    change of more than ``most`` is not taken and ends the search.

    Returns
    -------
    u, result
        The last equilibrium and how it went.
    change : float
        At most ``LAST`` where it is one with the damage that has been taken [-].
    """
    iterations, linear, change = result.iterations, result.linear_iterations, 1.0
    damage = damage_of(solver)
    for _ in range(FOLLOWING):
        change = damage.fading(solver.state(u))
        if change > most:
            break
        damage.soften(solver.state(u))
        if change <= LAST:
            break
        u, again = solver.solve(u, target)
        iterations, linear = iterations + again.iterations, linear + again.linear_iterations
        result = replace(again, iterations=iterations, linear_iterations=linear, easy=result.easy)
        if not again.converged:
            break
    return u, result, change


def settle(
    solver: StepSolver, u: Float, target: float, most: int, fail: Callable[[Float], int]
) -> tuple[Float, StepResult, int, int]:
    """Alternate equilibrium at ``target`` with damage held and damage at that equilibrium until neither changes.

    The last sweep leaves equilibrium with the damage before it, so Newton with damage that follows the displacement
    ends the search: what is returned is equilibrium with the damage that is kept. Bonds that heal do not in sweeps,
    which would not end then, and break only where damage has settled; that Newton lets them, and must converge.

    Parameters
    ----------
    most : int
        Sweeps in which this happens.
    fail : callable
        Breaks bonds at an equilibrium and returns how many.

    Returns
    -------
    As ``equilibrium``.
    """
    damage = damage_of(solver)
    heals = damage.heals
    damage.freeze(True)
    broken, iterations, linear = 0, 0, 0
    for sweep in range(1, most + 1):
        u, result = solver.solve(u, target)
        iterations, linear = iterations + result.iterations, linear + result.linear_iterations
        if not result.converged:
            return u, result, broken, sweep
        change = damage.soften(solver.state(u))
        more = 0 if heals and change >= SETTLED else fail(u)
        if change < SETTLED and not more:
            damage.freeze(False)
            load = solver.load
            attempt, closed = solver.solve(u, target)
            if closed.converged:
                attempt, closed, change = followed(solver, attempt, closed, target, 1.0 if heals else CLOSE)
            damage.freeze(True)
            iterations, linear = iterations + closed.iterations, linear + closed.linear_iterations
            if closed.converged and change <= LAST:
                u, result = attempt, closed
                more = fail(u)
            elif heals:
                reason = "no equilibrium was found in which bonds heal after the damage had settled without"
                return u, replace(closed, converged=False, reason=reason), broken, sweep
            else:
                solver.load = load
        broken += more
        if change < LAST and not more:
            reason = "damage settled"
            result = replace(result, reason=reason, iterations=iterations, linear_iterations=linear, easy=False)
            return u, result, broken, sweep
    return u, replace(result, converged=False, reason=f"damage did not settle in {most} sweeps"), broken, most
