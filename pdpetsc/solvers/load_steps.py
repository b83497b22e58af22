"""Load stepping: failed steps are halved, and steps grow after easy ones."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from contextlib import nullcontext
from dataclasses import replace

from pdpetsc.arrays import Float
from pdpetsc.declare.steps import AdaptiveSteps, Steps
from pdpetsc.errors import CaseError, Interrupted, SolveError
from pdpetsc.problem.damage import DamageModel
from pdpetsc.solvers.geometric_series import GeometricSeries
from pdpetsc.solvers.protocol import LOOSE, Converged, OnFailure, Start, StepResult, StepSolver

# Load parameters that differ by less are equal.
SAME_TIME = 1e-9
# Name of the next load step in a checkpoint.
LOAD_STEP = "load_step"
# Growth of the step after an easy step.
GROWTH = 1.5
# A solution of Newton's method is accepted if it changes no degradation factor by more than this. A larger change has
# passed unstable states, and round-off decides which of the states beyond them is found.
GENTLE = 0.3
# Damage has settled if a sweep changes no degradation factor by more than LAST. There are at most SWEEPS sweeps.
LAST = 1e-10
SWEEPS = 1000
# If forces have an energy, Newton with damage that follows the displacement is tried when a sweep changes no
# degradation factor by more than NEAR, or NEAR_MINIMUM if only a minimum is accepted. Otherwise sweeps and Newton reach
# the same equilibrium with different damage. Newton is then tried when damage has settled to SETTLED, and accepted if
# it changes no factor by more than CLOSE.
NEAR, NEAR_MINIMUM, SETTLED, CLOSE = 0.03, 0.1, 1e-6, 1e-3
# Sweeps leave a saddle point from where a degradation factor differs by OFF. The damage there stays. Sweeps that change
# more than LEFT, after one that changed less than CLOSE, have left it themselves.
OFF, LEFT = 0.03, 0.01
# If forces have an energy, damage is first updated at an equilibrium of this tolerance. Directions of cracks that begin
# there change by about as much, and rounding with them.
FIRST = 1e-8
# Otherwise a sweep is solved to this tolerance times the last change of a degradation factor. Damage that is too large
# in a sweep stays if the bond is unloaded later: with 1e-4, displacements differ by 1e-4.
SWEPT = 1e-5
# Largest number of solves until Newton's solution and the damage agree; then sweeps replace it.
FOLLOWING = 50


class LoadStepSolver(StepSolver):
    """Find equilibrium of one declared load step after another.

    Attributes
    ----------
    steps : Steps or AdaptiveSteps
        Load steps.
    """

    steps: Steps | AdaptiveSteps

    def resume(self, start: Start) -> None:
        """Restore the numbers of a checkpoint, so that the run continues as if it had not stopped (collective)."""
        dt = start.resume.get(LOAD_STEP, 1.0)
        if not (dt > 0.0 and start.t + dt > start.t):
            raise CaseError(
                f"The checkpoint is damaged: its next load step, {dt:g} from step time {start.t:g}, leads nowhere; "
                f"restart from another checkpoint."
            )
        super().resume(start)

    def march(self, start: Start, on_failure: OnFailure) -> Iterator[Converged]:
        """Yield the converged load steps from ``start`` to load parameter 1, with the step size of a checkpoint.

        Bonds break at equilibrium, the most overstretched first. The same load is solved again until no bond breaks.

        If Newton with damage that follows the displacement fails or jumps, sweeps replace it. Sweeps alternate
        equilibrium with damage held and damage at that equilibrium, until neither changes. They end because damage only
        grows. Bonds with reversible damage also break if Newton converges without a jump. In sweeps they do not regain
        force; a last solve by Newton lets them.

        A failed step is halved and restarts from the last converged state. After an easy step the size grows by half,
        up to the largest. Solvers with inertia (``moved_to_rest``) continue the smallest step as a motion.

        From an unstable equilibrium the solver switches to a stable one at the same load, if the steps declare it.

        Raises
        ------
        SolveError
            The smallest step failed, or the first equilibrium is not unique. The states yielded before are valid.
        Interrupted
            A signal requested a stop.

        Notes
        -----
        Collective.
        """
        steps = self.steps
        u, t = start.u, start.t
        dt = min(start.resume.get(LOAD_STEP, steps.first), steps.largest)
        stops = steps.stops()
        failures: list[StepResult] = []
        converged_once = False
        while t < 1.0 - SAME_TIME:
            ahead = next(s for s in stops if s > t + SAME_TIME)
            target = ahead if ahead - t < dt * (1.0 + SAME_TIME) else t + dt
            self.problem.advance(t, target)
            attempt, result = equilibrium(self, steps.bonds_at_once, u, target)
            attempt, result = self._stable(attempt, result, t, target)
            growth = 0.0
            if result.converged:
                growth, reason = self.too_long(attempt)
                if growth > 1.0:
                    result = result.refused(reason)
            if self.stop():
                self.problem.revert()
                raise Interrupted(
                    f"Stopped by a signal; results are complete up to step time {t:.6g}; go on with --restart."
                )
            if result.converged:
                if not converged_once:
                    self.refuse_mechanism(attempt)
                    converged_once = True
                if result.easy:
                    dt = min(dt * (GROWTH if growth * GROWTH <= 1.0 else 1.0 / growth), steps.largest)
            else:
                self.problem.revert()
                failures.append(result)
                dt = 0.5 * (target - t)
                on_failure(t, dt, result)
                if dt >= steps.least:
                    continue
                moved = self.moved_to_rest(u, target)
                if moved is None:
                    last = result.norms[-1] if result.norms else float("nan")
                    raise SolveError(
                        f"No convergence from step time {t:.6g} to {target:.6g}, the smallest step: {result.reason}, "
                        f"residual {last:.3e} against {result.reference:.3e} after {result.iterations} iterations; "
                        f"{self.advice}."
                    )
                attempt, result = moved
                dt = steps.first
            u, t = attempt, target
            self.problem.commit(self.state(u))
            yield Converged(u, t, result, failures, {LOAD_STEP: dt})
            failures = []

    def too_long(self, u: Float) -> tuple[float, str]:
        """Return the size of the step to an equilibrium over the size that is allowed, and the reason if it is above 1.

        By default the growth of the plastic strain decides (collective).
        """
        most = self.steps.plastic_growth
        if most is None:
            return 0.0, ""
        growth = self.problem.plastic_growth(self.state(u))
        return growth / most, f"plastic strain grew by {growth:.3g} in one step"

    def _stable(self, u: Float, result: StepResult, t: float, target: float) -> tuple[Float, StepResult]:
        """Refuse an unstable equilibrium at ``target``, or switch to a stable one, as ``Steps.unstable`` declares.

        Raises
        ------
        SolveError
            The equilibrium is unstable and the run ends, or nothing tells whether it is; ``t`` is the last step.
        """
        unstable = self.steps.unstable
        if unstable == "warn" or not result.converged:
            return u, result
        if result.negative_pivots is None and self.asks_for_stability:
            self.problem.revert()
            raise SolveError(
                f"At step time {target:.6g} nothing tells whether the equilibrium is stable, which Steps(unstable="
                f'"{unstable}") asks for: damage was held during a jump, an iterative solve failed, loads on a rigid '
                f"body have no energy, or the tangent is unsymmetric and was not factored, or its symmetric part has "
                f"negative pivots; "
                f"results are complete up to step time {t:.6g}; take unstable='warn' to go on without."
            )
        if result.negative_pivots and unstable == "switch":
            u, result = self.switched(u, result)
        if result.converged and (pivots := result.negative_pivots):
            result = result.refused(
                f"the equilibrium is unstable, with {pivots} negative pivot{'s' if pivots > 1 else ''}"
            )
            if unstable == "refuse":
                self.problem.revert()
                raise SolveError(
                    f"At step time {target:.6g} {result.reason}; results are complete up to step time {t:.6g}: perturb "
                    f"the body to find the stable branch, or follow the path."
                )
        return u, result


def equilibrium(solver: StepSolver, bonds_at_once: int | None, u: Float, target: float) -> tuple[Float, StepResult]:
    """Find equilibrium with damage at ``target``; return unknowns and outcome.

    ``bonds_at_once`` is the number of bonds that break at once (``Steps``).
    """
    problem, broken = solver.problem, 0
    problem.freeze(False)
    has_energy = problem.softens and damage_of(solver).forces_have_energy
    with solver.loosely(FIRST if has_energy else None) if problem.softens else nullcontext():
        attempt, result = solver.solve(u, target)
    if not problem.softens:
        while result.converged and (more := problem.break_bonds(solver.state(attempt), bonds_at_once)):
            broken += more
            attempt, result = solver.solve(attempt, target)
        return attempt, replace(result, broken=broken)
    damage = damage_of(solver)
    reversible = damage.reversible
    if not has_energy and result.converged and damage.fading(solver.state(attempt)) <= GENTLE:
        attempt, exact = solver.solve(attempt, target)
        result = exact.after(result)
    while not solver.stop() and is_acceptable(solver, result):  # otherwise sweeps find a minimum of the energy
        attempt, result, change = followed(solver, attempt, result, target, largest_change(solver, result))
        if change > LAST or not is_acceptable(solver, result):
            break
        more = problem.break_bonds(solver.state(attempt), bonds_at_once if reversible or has_energy else 1)
        if not more:
            return attempt, replace(result, broken=broken)
        if not (reversible or has_energy):
            break
        broken += more
        attempt, result = again_from(solver, attempt, result, target)
    if solver.stop():
        return attempt, result
    problem.revert_bonds()  # fields that were solved for stay
    return settle(solver, u, target, SWEEPS, lambda v: problem.break_bonds(solver.state(v), bonds_at_once))


def seeks_minimum(solver: StepSolver) -> bool:
    """Return True if an equilibrium has to be a minimum of an energy."""
    return damage_of(solver).forces_have_energy and solver.problem.symmetric and solver.of_minima


def is_saddle(solver: StepSolver, result: StepResult) -> bool:
    """Return True if a minimum is sought and the equilibrium is known to be a saddle point."""
    return seeks_minimum(solver) and bool(result.negative_pivots)


def is_minimum(solver: StepSolver, result: StepResult) -> bool:
    """Return True if an equilibrium is accepted as a minimum of the energy, by its pivots or by conjugate gradients."""
    told = result.negative_pivots is not None or solver.meets_curvature
    return seeks_minimum(solver) and told and not result.negative_pivots


def is_acceptable(solver: StepSolver, result: StepResult, tried: float = 1.0) -> bool:
    """Return True if a solution of Newton's method may end a load step.

    It is no saddle point. If bonds fail, no unstable state was on the way: beyond them there are many minima, and the
    linear solver decides which one is found. This does not matter after a sweep that changed no degradation factor by
    more than ``CLOSE``. ``tried`` is the change of that sweep [-].
    """
    is_arbitrary = result.crossed and damage_of(solver).of_bonds is not None and tried > CLOSE
    return result.converged and not is_saddle(solver, result) and not is_arbitrary


def largest_change(solver: StepSolver, result: StepResult, swept: bool = False) -> float:
    """Return by how much a solution of Newton's method may change a degradation factor [-].

    If only points fail, a minimum may be at any distance. Along a path every solution may be: the energy balance
    limits the step. If bonds fail, the loads of minima beyond a larger change depend on the size of the step, unless
    sweeps have come near (``swept``). Without an energy, sweeps come closer.
    """
    damage = damage_of(solver)
    of_points = damage.forces_have_energy and damage.of_bonds is None
    if (of_points or swept) and is_minimum(solver, result):
        return 1.0
    if (of_points and not solver.of_minima) or (swept and damage.reversible):
        return 1.0
    return CLOSE if swept and not damage.forces_have_energy else GENTLE


def again_from(solver: StepSolver, u: Float, result: StepResult, target: float) -> tuple[Float, StepResult]:
    """Solve again from an equilibrium in which bonds broke; if that takes no iteration its pivots stay."""
    u, again = solver.solve(u, target)
    pivots = again.negative_pivots if again.iterations else result.negative_pivots
    return u, replace(again.after(result), negative_pivots=pivots)


def moved_off(solver: StepSolver, u: Float, v: Float) -> Float | None:
    """Return unknowns beside a saddle point ``u``, along a deviation ``v`` that grows in sweeps (collective).

    A degradation factor differs there by more than ``OFF``. None if the deviation changes no factor so much.
    """
    damage, ways = damage_of(solver), [sign * 2.0**power for power in range(-40, 1) for sign in (1.0, -1.0)]
    sides = (u + way * v for way in ways)
    at = damage.fading(solver.state(u))
    return next((beside for beside in sides if damage.fading(solver.state(beside)) > at + OFF), None)


def damage_of(solver: StepSolver) -> DamageModel:
    """Return the damage of the problem of a solver, which must soften."""
    assert solver.problem.damage is not None
    return solver.problem.damage


def followed(
    solver: StepSolver, u: Float, result: StepResult, target: float, most: float = GENTLE
) -> tuple[Float, StepResult, float]:
    """Update damage and solve again from ``u`` until neither changes; return also the last change of ``phi``.

    A zero-energy control uses the damage of the equilibrium before. Newton's solution is therefore not yet in
    equilibrium with its own damage. If forces have an energy, ``u`` may be an equilibrium of a looser tolerance, and is
    solved again in any case. A change of more than ``most`` is not accepted and ends the search.

    Returns
    -------
    u, result
        The last equilibrium and the outcome of its solve.
    change : float
        Last change of a degradation factor [-]; at most ``LAST`` if ``u`` is in equilibrium with its own damage.
    """
    damage, series, change, easy = damage_of(solver), GeometricSeries(solver.problem), 1.0, result.easy
    for number in range(FOLLOWING):
        change = damage.fading(solver.state(u))
        if change > most:
            break
        solver.problem.soften(solver.state(u))
        if change <= LAST and (number > 0 or not damage.forces_have_energy):
            break
        series.extrapolate(change)
        u, again = solver.solve(u, target)
        # Once damage is accepted, the first tangent of a solve is that of unloading.
        result = replace(again.after(result), easy=easy, negative_pivots=result.negative_pivots)
        if not again.converged:
            break
    return u, result, change


def settle(
    solver: StepSolver, u: Float, target: float, most: int, fail: Callable[[Float], int]
) -> tuple[Float, StepResult]:
    """Alternate equilibrium at ``target`` with damage held and damage at that equilibrium until neither changes.

    A sweep leaves an equilibrium with the damage before it. If the sweep changes little, Newton with damage that
    follows the displacement starts from it. Newton's solution is in equilibrium with its own damage and ends the
    search.

    Sweeps are solved loosely. If forces have an energy, sweeps lower it. After a solution that is not acceptable
    (``is_acceptable``), sweeps continue until they change ten times less, at last until damage has settled. With
    conjugate gradients, Newton's method is that of Dembo1983: they stop if the curvature changes sign, and a step along
    which the energy rises is reversed.

    In a symmetric body sweeps approach a saddle point of the energy. Sweeps continue beside it (``moved_off``), if
    Newton's method finds it from a sweep that changed less than ``CLOSE``, or if nothing but the growth of a deviation
    tells that it is one. Loose sweeps may also leave it themselves.

    Bonds with reversible damage do not regain force in sweeps, which might not end otherwise, and break only if damage
    has settled. The last Newton solve lets them regain force and must converge.

    Parameters
    ----------
    most : int
        Largest number of sweeps.
    fail : callable
        Breaks bonds at an equilibrium and returns their number.

    Returns
    -------
    As ``equilibrium``.
    """
    damage, problem = damage_of(solver), solver.problem
    reversible, energy = damage.reversible, damage.forces_have_energy
    near = NEAR_MINIMUM if seeks_minimum(solver) else NEAR if energy else SETTLED
    # If forces have an energy, the tolerance becomes ten times smaller after a sweep that changed nothing.
    series, change, least, loose = GeometricSeries(problem), 1.0, 1.0, LOOSE
    # The last solve, with the iterations of all.
    broken, last = 0, StepResult(True, "", easy=False)
    for sweep in range(1, most + 1):
        damage.freeze(True)
        with solver.loosely(loose if energy else SWEPT * change) if near >= LAST else nullcontext():
            u, result = solver.solve(u, target)
        idle = energy and result.iterations == 0 and near >= LAST and loose > LAST
        last = result = result.after(last)
        if not result.converged:
            return u, result
        before, change = change, problem.soften(solver.state(u))
        series.extrapolate(change)
        more = 0 if reversible and change >= SETTLED else fail(u)
        broken += more
        if change <= LAST and near < LAST and not more:
            found = replace(result, reason="damage settled", negative_pivots=None, growth=solver.deviation(u)[0])
            return u, replace(found, broken=broken, sweeps=sweep)
        if idle:  # the sweep before was in equilibrium already, to this tolerance
            loose *= 0.1
            continue
        least = min(least, change)
        last = replace(last, crossed=last.crossed or (seeks_minimum(solver) and least < CLOSE and change > LEFT))
        # Without an energy Newton starts from an exact sweep. With one, bonds break after they have lost all force.
        if (more and not energy) or max(change, 0.0 if energy else before) > near or near < LAST:
            continue
        damage.freeze(False)
        taken, at, tried = damage.stored(), solver.at, change
        attempt, closed = solver.solve(u, target)
        if closed.iterations < 2 and not closed.negative_pivots:  # of bonds, the tangent of unloading from the sweep
            closed = replace(closed, negative_pivots=None)
        unstable = closed.crossed or is_saddle(solver, closed)
        beside = None
        if tried <= CLOSE and is_saddle(solver, closed):  # sweeps would leave it only after round-off has grown
            beside = moved_off(solver, attempt, solver.deviation(attempt)[1])
        elif is_acceptable(solver, closed, tried):
            most_changed = largest_change(solver, closed, swept=True)
            attempt, closed, change = followed(solver, attempt, closed, target, most_changed)
        accepted = is_acceptable(solver, closed, tried) and change <= LAST
        closed = closed.after(last)
        if accepted:
            damage.freeze(not energy)
            more = fail(attempt)
            broken += more
            if more and energy:  # spent bonds: an equilibrium that needs no iteration without them stays
                before_breaking, (attempt, closed) = closed, again_from(solver, attempt, closed, target)
                more = 0 if closed.converged and closed.iterations == before_breaking.iterations else more
            if not more:
                judged = energy and closed.negative_pivots is not None
                growth, v = (0.0, attempt) if judged else solver.deviation(attempt)
                if growth > 1.0 and seeks_minimum(solver):
                    beside = moved_off(solver, attempt, v)
                if beside is None:
                    return attempt, replace(closed, growth=growth, broken=broken, sweeps=sweep)
        if beside is not None:
            problem.soften(solver.state(beside))
            u, last, near = beside, replace(closed, crossed=True), NEAR_MINIMUM
        elif accepted:
            u, last = attempt, closed
        elif reversible:
            reason = "damage settled with no bond healing, but no equilibrium was found in which bonds heal"
            return u, closed.refused(reason)
        else:
            near, last = 0.1 * tried, replace(closed, crossed=last.crossed or unstable)
            solver.return_to(at)
            problem.reset_bonds(taken)
    return u, result.refused(f"damage did not settle in {most} sweeps")
