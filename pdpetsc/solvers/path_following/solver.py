"""Path following: equilibrium at an unknown load factor, with prescribed growth of a measure."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from dataclasses import replace

import numpy as np
from petsc4py import PETSc

from pdpetsc.arrays import Float
from pdpetsc.declare.solvers import PathFollowing
from pdpetsc.discrete.communicator import anywhere, norm, scalar_product
from pdpetsc.errors import CaseError, Interrupted, SolveError
from pdpetsc.petsc.library import linear_solver, with_tolerance
from pdpetsc.problem.assembly import Filler
from pdpetsc.problem.problem import Problem
from pdpetsc.problem.state import State
from pdpetsc.solvers.balance import EnergyBalance
from pdpetsc.solvers.coupled_tangent import UNRESISTED
from pdpetsc.solvers.eigenvectors import EXACT
from pdpetsc.solvers.load_steps import GROWTH, LAST, damage_of, equilibrium, followed, settle
from pdpetsc.solvers.path_following.bordered import Bordered
from pdpetsc.solvers.path_following.measures import BAND, MEASURES, Constraint
from pdpetsc.solvers.protocol import Converged, OnFailure, Setting, Start, StepResult
from pdpetsc.solvers.snes import ROUGH, SnesSolver

# A load factor above this multiple of the highest one so far indicates a body without load capacity.
LEAP = 10.0
# A step that changes the load factor by more than JUMP times the highest one has probably left the branch. A shorter
# step is tried if the step was longer than PATIENCE times the largest step.
JUMP, PATIENCE = 0.4, 0.05
# A load factor that changes its sign between more than this share of the highest one has left the branch for certain.
REVERSED = 0.1
# Largest number of sweeps until damage has settled; then a shorter step is tried.
SWEEPS = 100
# Largest number of solves that reduce the driving variable of bonds that take over from broken ones.
BACK = 20
# Tolerance of the growth of the measure in a solve, over the step.
MISSED = 0.02
# Linear solves need not reduce the residual below this share of the tolerance of Newton's method.
ENOUGH = 0.1
# With failing points, Newton's method has to reduce the smallest residual by this factor in so many iterations.
TURN, TURNS = 0.1, 5
# Names in a checkpoint of the step of the measure, the largest forces [force], the highest load factor [-], and the
# forces of the last equilibrium [force].
RESUMED = ("measure_step", "largest_reference", "highest_load", "last_reference")


class PathSolver(SnesSolver):
    """Solve ``f_int(u) = lambda f_ext(u)``, ``u = lambda U`` if prescribed, and one constraint by Newton's method.

    Unknowns are the displacements, the load factor ``lambda``, and the motions of rigid regions with a load, whose
    equations are the balance of that load. Each linear solve needs one solve with the tangent for the residual, one for
    the load and one for each motion. SNES solves the bordered system; the options of KSP and PC are those of the
    tangent.

    Loads are dead, or follow the deformation and are proportional to ``lambda`` at every displacement. The tangent then
    contains ``lambda`` times their stiffness, and the column of ``lambda`` is their force at the present displacement.

    Parameters
    ----------
    problem, assembler
        The problem, and the object that fills its matrix.
    options : PathFollowing
        Declared solver.
    stop : callable
        Called after every iteration, collectively; True ends the solve (a signal arrived).

    Raises
    ------
    CaseError
        The measure does not fit the body.

    Notes
    -----
    Construction and every method are collective. Call ``destroy`` before MPI ends.

    References
    ----------
    deBorst1987 on control by chosen displacements; Chen1990 on control by the zone that softens.
    """

    of_minima = False
    advice = "take smaller steps of the measure, or a measure that grows all along the path"

    def __init__(self, problem: Problem, assembler: Filler, options: PathFollowing, stop: Callable[[], bool]) -> None:
        super().__init__(problem, assembler, stop)
        fixed = problem.supports.fixed
        self.load = 0.0
        self._options = options
        self._whole = (
            problem.supports.prescribed(1.0),
            problem.external_force(problem.state(np.zeros(fixed.shape), 1.0)),
        )
        # Loads of load factor 1 at the start of a solve [force], and whether loads depend on the displacement.
        self._loads = self._whole[1]
        self._load_follows = any(term.load and term.proportional for term in problem.terms)
        # Change of the unknowns with the load factor if the independent ones do not move [length].
        self._held = problem.supports.completed(np.zeros(fixed.shape), self._whole[0])
        self._bodies.follow_load()
        # Loads on them at load factor 1 [force].
        self._on_bodies = self._bodies.loads
        self._measure = MEASURES[type(options.measure)](problem, options.measure)
        # Whether tools move with the load factor, and whether it acts on anything else.
        self._has_tools = bool(problem.driven_tools)
        self._acts = anywhere(self._comm, self._whole) or bool(self._on_bodies.any())
        # Forces of the last converged step, and the scale of the constraint relative to forces.
        self._carried, self._force = 0.0, 1.0
        self._highest_load = 0.0
        self._target = 0.0
        # Load factor at the start of a solve, and forces against the prescribed unknowns of load factor 1 there.
        self._begun = 0.0, np.zeros(fixed.shape)
        self._constraint = Constraint(np.zeros(fixed.shape), True, np.zeros(fixed.shape), 0.0)
        # The last converged unknowns, and the changes of displacements, load factor and motions in the last step over
        # the growth of the measure.
        self._last: tuple[Float, Float, float, Float] | None = None
        self._bordered = Bordered(self._equilibrium.tangent, self.snes, 1 + len(self._on_bodies))
        self._set_up(self._bordered.mat.createVecRight(), self._bordered.mat, self._bordered.mat, self._bordered.ksp)

    def description(self) -> str:
        """Return a short description of the measure, the nonlinear and the linear solver."""
        measure = type(self._options.measure).__name__
        return f"path following by {measure}, snes {self.snes.getType()}, {linear_solver(self._bordered.ksp)}"

    def destroy(self) -> None:
        """Free the PETSc objects, in order."""
        self.snes.destroy()
        self._bordered.free()
        super().destroy()

    @classmethod
    def make(cls, setting: Setting) -> PathSolver:
        """Build the solver of a setting (collective)."""
        return cls(setting.problem, setting.assembler, setting.declared, setting.stop)

    def resume(self, start: Start) -> None:
        """Restore the numbers of a checkpoint, so that the run continues as if it had not stopped (collective)."""
        super().resume(start)
        found = [start.resume[name] for name in RESUMED if name in start.resume]
        if min(found, default=0.0) < 0.0 or start.resume.get(RESUMED[0], 1.0) <= 0.0:
            raise CaseError(
                "The checkpoint is damaged: a negative step, force or load factor of the path has no meaning; restart "
                "from another checkpoint."
            )

    def march(self, start: Start, on_failure: OnFailure) -> Iterator[Converged]:
        """Yield the equilibria along the path, from the load factor of ``start`` (collective).

        Raises
        ------
        SolveError
            The smallest step failed, or there are too many steps. The states yielded before are valid.
        Interrupted
            A signal requested a stop.
        """
        options = self._options
        u, load = start.u, start.t
        self.load = load
        # A checkpoint of load stepping does not contain these numbers.
        at_first = (options.measure.step, 0.0, 0.0, 0.0)
        known = [start.resume.get(name, value) for name, value in zip(RESUMED, at_first, strict=True)]
        step, largest_force, self._highest_load, self._carried = known
        # Step and value of another measure have no meaning for this one.
        of_measure = f"measure_{type(options.measure).__name__}"
        if of_measure in start.resume:
            self._measure.restore(start.resume[of_measure])
        else:
            step = options.measure.step
        self._equilibrium.reference = self._carried
        failures: list[StepResult] = []
        self._balance = balance = EnergyBalance(self.problem, self.problem.state(u, load), start.resume)
        converged = 0
        while converged < options.most:
            size = self._aim(u, step)
            attempt, result = self._advance(u, size)
            wrong = self._wrong(attempt, load, step) if result.converged else ""
            result = result.refused(wrong) if wrong else result
            if self.stop():
                self.problem.revert()
                raise Interrupted(f"Stopped by a signal; results are complete up to load factor {load:.6g}.")
            if not result.converged:
                self.problem.revert()
                balance.go_back()
                self.load = load
                failures.append(result)
                step = 0.5 * step if self._constraint.by_load else 0.5 * size
                on_failure(load, step, result)
                if step < options.smallest * options.measure.step:
                    raise SolveError(
                        f"The path is lost at load factor {load:.6g} with the smallest step of the measure: "
                        f"{result.reason}; {self.advice}."
                    )
                continue
            if not converged:
                self.refuse_mechanism(attempt)
            last = attempt, (attempt - u) / size, (self.load - load) / size, self._bodies.motions / size
            self._last = None if self._constraint.by_load else last
            u, load, converged = attempt, self.load, converged + 1
            self.t = load
            self.problem.commit(self.state(u))
            self._carried = result.reference
            if self._has_tools:
                self._carried = max(self._carried, norm(self._comm, self.problem.force_of_tools(self.state(u))))
            largest_force = max(largest_force, self._carried)
            self._highest_load = max(self._highest_load, abs(load))
            if result.easy:
                step = min(step * GROWTH, options.measure.step)
            work = balance.work
            balance.keep()
            now = zip(RESUMED, (step, largest_force, self._highest_load, self._carried), strict=True)
            resume = {**dict(now), of_measure: self._measure.reached(u, load), **balance.resume}
            yield Converged(u, load, result, failures, resume, work=work)
            failures = []
            fallen = self._carried <= options.until * largest_force and largest_force > 0.0
            if fallen or self._measure.at_end(u, load):
                left = f"{self._carried / largest_force if largest_force > 0.0 else 0.0:.2g} of their largest"
                why = f"the forces fell to {left} (until={options.until:g})"
                why = why if fallen else f"its measure reached its end; the forces are {left}"
                self.ended = f"the path ended because {why}"
                return
        raise SolveError(f"More than {options.most} steps up to load factor {load:.6g}; raise most of PathFollowing.")

    def _wrong(self, u: Float, load: float, step: float) -> str:
        """Return the reason for refusing an equilibrium at the end of a step from a load factor; empty for none."""
        by_load = self._constraint.by_load
        far = abs(self.load - load) > JUMP * self._highest_load > 0.0
        if far and step > PATIENCE * self._options.measure.step and not by_load:
            return "the load factor jumped"
        if load * self.load < 0.0 < REVERSED * self._highest_load < min(abs(load), abs(self.load)):
            return "the load factor jumped to the other sign"
        if by_load and self._measure.overshot(u, self.load):
            return "the measure grew by more than a step"
        self._balance.pass_by(self.state(u))
        return self._balance.broken_by(self.state(u))

    def solve(self, u: Float, t: float) -> tuple[Float, StepResult]:
        """Find equilibrium at which the measure has grown by ``t`` since the last converged step, from ``u``."""
        sought, of = self._equilibrium, self._constraint
        self._target = t
        unit = self._options.first if of.by_load else self._options.measure.step
        self._force = max(self._carried, self._scales.force * float(np.finfo(float).eps)) / unit
        self._loads = self._loads_by_factor(State(self.problem.body, u, self.problem.clock(self.load)))
        self._impose(self.load)
        if sought.begin(u):
            self._use_tangent()
        sought.resist(self._held)
        self._begun = self.load, sought.resisted
        motions = self._bodies.motions
        linear = self._as_before(u, t)
        if linear is None:
            self._bodies.place(motions)
            linear = self._iterate_from(u, self.load, motions)
        resting, more = self._rested()
        reason = self.snes.getConvergedReason()
        values, load = self._take(self._x)
        # Only the convergence test of this solver includes the constraint.
        converged = reason > 0 and resting and bool(sought.accepted) and sought.judge(values, self.rtol)
        if converged and not abs(self._missed(values, load)) <= MISSED * unit:
            converged, sought.objection = False, "the measure did not grow by what it should"
        self.load = self.t = load if converged else of.load0
        if not converged:
            self._bodies.place(motions)
        result = sought.result(converged, reason, self._bordered.ksp.getConvergedReason(), linear + more)
        if converged:
            result = replace(result, negative_pivots=self._pivots())
        return sought.at_prescribed(values), result

    def _as_before(self, u: Float, growth: float) -> int | None:
        """Run SNES from the extrapolated last step; return the linear iterations, None if that fails.

        At the converged unknowns the tangent is that of unloading. Points that continue to fail have the tangent of
        further loading at the extrapolated ones.
        """
        damage, sought = self.problem.damage, self._equilibrium
        follows = damage is None or (damage.of_bonds is None and not damage.frozen)
        if self._last is None or u is not self._last[0] or self._constraint.by_load or not follows:
            return None
        _, change, of_load, of_motions = self._last
        load, motions = self.load + growth * of_load, growth * of_motions
        self._bodies.place(motions)
        self._impose(load)
        ahead = sought.at_prescribed(u + growth * change)
        if not self.problem.admissible(self.problem.state(ahead, load)):
            return None
        linear = self._iterate_from(ahead, load, motions)
        if self.snes.getConvergedReason() > 0 or self.stop():
            return linear
        sought.start_over()
        return None

    def _iterate_from(self, u: Float, load: float, motions: Float) -> int:
        """Run SNES from unknowns, a load factor and motions; return the linear iterations."""
        self._bordered.put(self._x, u / self._scales.length, np.append(load, motions / self._scales.length))
        return self._iterate(u)

    def _impose(self, load: float) -> None:
        """Set the conditions of a load factor, with the bodies at their present places."""
        prescribed, loads = load * self._whole[0], load * self._loads
        if self._bodies:
            prescribed = self.problem.supports.prescribed(load)
            self._equilibrium.carry(abs(load) * float(np.abs(self._on_bodies).sum()), self._bodies.way)
        self._equilibrium.impose(load, prescribed, loads, self._load_follows)

    def _use_tangent(self) -> None:
        """Border the new matrices of the tangent."""
        self._bordered.renew()

    def _advance(self, u: Float, size: float) -> tuple[Float, StepResult]:
        """Let the measure grow by ``size``; return unknowns and outcome."""
        options, problem, broken, swept = self._options, self.problem, 0, 0
        if self._measure.holds_while_bonds_break:
            return equilibrium(self, options.bonds_at_once, u, size)
        attempt, result = self._settle(u, size)
        most = self._measure.reached(attempt, self.load) if result.converged else 0.0
        while result.converged:
            attempt, result = self._brought_back(attempt, result, most)
            swept += result.sweeps
            self._balance.pass_by(self.state(attempt))
            more = problem.break_bonds(self.state(attempt), options.bonds_at_once)
            if not more:
                break
            # Hold the stretch of the currently most stretched bonds while the others adapt.
            broken += more
            self._aim(attempt, 1.0)
            before, at = attempt, self.at
            attempt, result = self._settle(before, 0.0)
            if not result.converged or abs(self.load) > LEAP * self._highest_load:
                # There is no equilibrium with that stretch any more: search it at a fixed load factor instead.
                self.return_to(at)
                self._constraint = Constraint(np.zeros_like(u), True, before, self.load)
                attempt, result = self._settle(before, 0.0)
        return attempt, replace(result, broken=broken, sweeps=swept)

    def _brought_back(self, u: Float, result: StepResult, most: float) -> tuple[Float, StepResult]:
        """Reduce the measure to ``most`` if it is larger; return that equilibrium and its outcome, with all sweeps.

        While the most driven bonds are held, bonds that take over from broken ones may be driven far beyond them.
        Breaking them in this state would load the body beyond its capacity, and that energy leads to other branches.
        The given equilibrium remains if no closer one is found.
        """
        for _ in range(BACK):
            reached, at = self._measure.reached(u, self.load), self.at
            if reached <= most * (1.0 + BAND):
                break
            stored = damage_of(self).stored()
            self._aim(u, 1.0)
            attempt, again = self._settle(u, most - reached)
            if not again.converged or self._measure.reached(attempt, self.load) >= reached:
                self.problem.reset_bonds(stored)
                self.return_to(at)
                break
            u, result = attempt, replace(again, sweeps=result.sweeps + again.sweeps)
        return u, result

    def _settle(self, u: Float, size: float) -> tuple[Float, StepResult]:
        """Find equilibrium and damage after growth of the measure by ``size``, without breaking bonds.

        Newton with damage that follows the displacement is tried first. If bonds that unload and reload prevent
        convergence, equilibrium with damage held and damage at that equilibrium alternate.
        """
        problem, at = self.problem, self.at
        problem.freeze(False)
        attempt, result = self.solve(u, size)
        if not problem.softens or self.stop():
            return attempt, result
        stored = damage_of(self).stored()
        if result.converged:
            attempt, result, change = followed(self, attempt, result, size)
            if self.stop() or (result.converged and change <= LAST):
                return attempt, result
        problem.reset_bonds(stored)
        self.return_to(at)
        return settle(self, u, size, SWEEPS, lambda v: 0)

    @property
    def at(self) -> tuple[float, Float]:
        return self.load, self._bodies.motions

    def return_to(self, at: tuple[float, Float]) -> None:
        self.load = self.t = at[0]
        self._bodies.place(at[1])

    def _aim(self, u: Float, step: float) -> float:
        """Set up the constraint of the next step from the converged ``u``; return the growth of the measure."""
        self._bordered.forget()
        self._constraint = self._measure.constraint(u, self.load)
        if self._has_tools and not (self._acts and self._carried) and not self._pressed(u):
            # Only the load factor brings tools into touch.
            self._constraint = Constraint(np.zeros_like(u), True, u, self.load)
        if self._constraint.by_load:
            return self._options.first * step / self._options.measure.step
        return min(step, self._measure.left(u, self.load))

    def _pressed(self, u: Float) -> bool:
        """Return True if a tool that moves presses the body."""
        problem = self.problem
        return anywhere(self._comm, problem.force_of(problem.driven_tools, problem.state(u, self.load)))

    def _take(self, x: PETSc.Vec) -> tuple[Float, float]:
        """Return unknowns and load factor of a vector, and set motions and conditions to it."""
        sought = self._equilibrium
        values, last = self._bordered.split(x)
        load = float(last[0])
        if np.isfinite(last).all():
            self._bodies.place(last[1:] * self._scales.length)
            self._impose(load)
        else:
            # The bordered system has no solution, so that its residual is no number, and the solve fails.
            load = np.nan
            sought.impose(self.load, load * self._whole[0], load * self._loads)
        at, resisted = self._begun
        sought.resisted = (load - at) * resisted
        return values * self._scales.length, load

    @property
    def _tangent_solver(self) -> PETSc.KSP:
        return self._bordered.ksp

    def _equip(self) -> None:
        self._bordered.equip()

    def _iterate(self, start: Float) -> int:
        self._bordered.iterations = 0
        self._x.array_w[: self._n_u] = start.ravel() / self._scales.length
        self.snes.solve(None, self._x)
        return self._bordered.iterations

    def _test(self, snes: PETSc.SNES, iteration: int, norms: tuple[float, float, float]) -> int | None:
        verdict, damage = super()._test(snes, iteration, norms), self.problem.damage
        if verdict is not None or damage is None or not damage.forces_have_energy or iteration < 2 * TURNS:
            return verdict
        # If points fail and unload in turn, sweeps take over.
        seen = self._equilibrium.norms[-iteration - 1 :]
        turns = min(seen[-TURNS:]) > TURN * min(seen[:-TURNS])
        return int(PETSc.SNES.ConvergedReason.DIVERGED_MAX_IT) if turns else None

    def _read(self, x: PETSc.Vec) -> Float:
        return self._take(x)[0]

    def _missed(self, values: Float, load: float) -> float:
        """Return the growth of the measure minus its target (collective)."""
        return self._constraint.grown(self._comm, self._equilibrium.at_prescribed(values), load) - self._target

    def _other_residuals(self, x: PETSc.Vec) -> Float:
        """Return the residuals of the constraint and of the balance of rigid bodies, on the last rank."""
        values, load = self._take(x)
        off = self._bodies.unbalanced_at(self._equilibrium.state(values)) if self._bodies else ()
        found = np.append(self._force * self._missed(values, load), off) / self._scales.force
        return found[: x.getLocalSize() - self._n_u]

    def _others_converged(self, x: PETSc.Vec) -> bool:
        """Return True if the rigid bodies are in equilibrium with their loads."""
        return not self._bodies or self._bodies.balanced(self._equilibrium.state(self._read(x)), self.rtol)

    def _balanced(self, state: State) -> None:
        """Return None: the motions of rigid bodies are among the unknowns."""

    def _reply(self, force: Float, rtol: float = ROUGH) -> Float:
        with with_tolerance(self._bordered.ksp, rtol):
            answer = self._bordered.answer(force.ravel() / self._scales.force)
        return answer.reshape(force.shape) * self._scales.length

    def refuse_mechanism(self, u: Float) -> None:
        """Raise SolveError on all ranks if the body or a loaded region with it is free to move at ``u``."""
        super().refuse_mechanism(u)
        if self._bodies:
            sought, state = self._equilibrium, self.state(u)
            sought.update(state)
            bodies = self._bodies.coupled(state)
            free = bodies.free_motion(bodies.responses(lambda force: self._reply(force, EXACT))[0])
            sought.forget()
            if free:
                self.problem.revert()
                raise SolveError(UNRESISTED)

    def _loads_by_factor(self, state: State) -> Float:
        """Return the derivative of the loads by the load factor (n_rows, dim) [force]."""
        if not self._load_follows:
            return self._whole[1]
        return self.problem.external_force(State(state.body, state.u, self.problem.clock(1.0)))

    def _jacobian(self, snes: PETSc.SNES, x: PETSc.Vec, J: PETSc.Mat, P: PETSc.Mat) -> None:
        sought, row, scales, supports = self._equilibrium, self._constraint, self._scales, self.problem.supports
        state = sought.state(self._read(x))
        sought.update(state)
        # Loads less the forces of moving tools, by the load factor.
        loads = self._loads_by_factor(state)
        if self._has_tools:
            loads = loads - self.problem.force_by_tools(state)
        bodies = self._bodies.coupled(state, self._bodies.spins, loads)
        # Load factor, then motions: displacements if independent unknowns do not move, and the change of the loads.
        held, motions = np.concatenate([self._held[None], bodies.carried]), np.eye(len(bodies.carried) + 1)[:, 1:]
        whole = np.concatenate([self._whole[0][None], bodies.carried])
        by_load = np.eye(len(held))[0]
        columns, changes = [], []
        for du, given, motion, load in zip(held, whole, motions, by_load, strict=True):
            force, resultants = bodies.change(du, motion, load)
            columns.append(np.where(sought.supported, -scales.stiffness * given, supports.reduced(force)))
            changes.append(resultants)
        of, still = supports.reduced(row.of), motions[0]

        def rows(y: Float) -> Float:
            u = y.reshape(of.shape)
            grown = scalar_product(self._comm, of, u)
            of_bodies = bodies.change(supports.completed(u), still)[1] if len(still) else still
            return np.append(self._force * grown, of_bodies) * by_unit

        by_unit = scales.length / scales.force
        grown = row.by_load * by_load + [scalar_product(self._comm, row.of, du) for du in held]
        of_bodies = np.stack(changes, axis=1)
        if len(still):
            # A rotation that moves no particle stays.
            of_bodies[:, 1:] += scales.stiffness * bodies.idle
        corner = np.concatenate([self._force * grown[None], of_bodies]) / scales.force
        # Motions are in units of the displacements.
        units = np.where(by_load > 0.0, 1.0, scales.length)
        self._bordered.enough = ENOUGH * sought.tolerance / scales.force
        self._bordered.border(
            [unit * c / scales.force for unit, c in zip(units, columns, strict=True)], rows, corner * units
        )
