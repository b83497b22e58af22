"""Static equilibrium of one load step with SNES."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace

import numpy as np
from petsc4py import PETSc

from pdpetsc.arrays import Float
from pdpetsc.declare.steps import AdaptiveSteps, Steps
from pdpetsc.discrete.communicator import anywhere, total
from pdpetsc.errors import SolveError
from pdpetsc.petsc.library import (
    effort,
    full_steps,
    line_search,
    linear_solver,
    met_indefinite,
    negative_pivots,
    start_anew,
    with_indefinite,
    with_solves_to,
)
from pdpetsc.problem.assembly import Filler
from pdpetsc.problem.problem import Problem
from pdpetsc.problem.state import State
from pdpetsc.solvers.branch import BranchSwitch
from pdpetsc.solvers.coupled_tangent import CoupledInverse
from pdpetsc.solvers.eigenvectors import EXACT
from pdpetsc.solvers.equilibrium import SETTLINGS, UNBALANCED
from pdpetsc.solvers.growth import growing_deviation
from pdpetsc.solvers.load_steps import SAME_TIME, LoadStepSolver
from pdpetsc.solvers.protocol import Flexibility, Setting, StepResult
from pdpetsc.solvers.snes import SnesSolver

# Line search for a zero of the residual along the step. If a loose piece rotates, its steps become tiny; full steps do
# not.
SECANTS = "cp"
ONE_STEP = Steps()


class StaticSolver(SnesSolver, LoadStepSolver):
    """Solve ``f_int(u) = f_ext(t)`` with prescribed displacements by Newton's method, with PETSc's SNES.

    Parameters
    ----------
    problem, assembler
        The problem, and the object that fills its matrix.
    stop : callable
        Called after every iteration, collectively; True ends the solve (a signal arrived).
    steps : Steps or AdaptiveSteps
        Load steps.

    Notes
    -----
    Construction and every method are collective. Call ``destroy`` before MPI ends.
    """

    advice = (
        "look for a limit point or zero-energy modes, add or raise the zero-energy control, or try "
        "-snes_linesearch_type basic, a smaller smallest step or -snes_rtol 1e-8"
    )

    def __init__(
        self, problem: Problem, assembler: Filler, stop: Callable[[], bool], steps: Steps | AdaptiveSteps = ONE_STEP
    ) -> None:
        super().__init__(problem, assembler, stop)
        self.steps = steps
        self.asks_for_stability = steps.unstable != "warn"
        self._fixed = problem.supports.fixed
        self._all_prescribed = not anywhere(self._comm, ~self._fixed)
        tangent = self._equilibrium.tangent
        self._set_up(self._create(), tangent.mat, tangent.preconditioner)

    @property
    def ends(self) -> bool:
        return self.t >= 1.0 - SAME_TIME

    @property
    def tangent_at(self) -> Float | None:
        """Return the displacement at which the tangent was updated last, which the next step starts with."""
        damage = self.problem.damage
        held = not self.problem.linear and (damage is None or not damage.frozen)
        return self._equilibrium.filled_at if held and self._equilibrium.tangent.holds() else None

    @classmethod
    def make(cls, setting: Setting) -> StaticSolver:
        """Build the solver of a setting (collective)."""
        return cls(setting.problem, setting.assembler, setting.stop, setting.steps)

    def description(self) -> str:
        """Return a short description of the nonlinear and the linear solver."""
        return f"snes {self.snes.getType()}, {linear_solver(self.snes.getKSP())}"

    def solve(self, u: Float, t: float) -> tuple[Float, StepResult]:
        """Find equilibrium at load parameter ``t`` starting from ``u`` (n_rows, dim).

        Returns
        -------
        u : (n_rows, dim) float64
            The new displacement; unusable if the step failed.
        result : StepResult
        """
        sought = self._equilibrium
        self.t = t
        self._crossed = False
        sought.impose(t)
        if sought.begin(u):
            self._use_tangent()
        jump = np.where(self._fixed, sought.at_prescribed(u) - u, 0.0)
        sought.resist(jump)
        if self._all_prescribed:
            return self._without_solve()
        ahead = self._ahead(u, t)
        linear = None if ahead is None else self._tried(sought.at_prescribed(ahead))
        if linear is None:
            start, linear = u, 0
            if anywhere(self._comm, jump):
                start, linear = self._predict(u, jump)
            linear += self._iterate(start)
        resting, more = self._rested()
        reason, found = self.snes.getConvergedReason(), self._read(self._x)
        # The convergence test of this solver has seen the residual, unless SNES passes the norm of another vector.
        seen = sought.accepted and not self.snes.hasNPC()
        converged = reason > 0 and resting and bool(seen or self._judged(self._x))
        result = sought.result(converged, reason, self.snes.getKSP().getConvergedReason(), linear + more)
        if converged:
            result = replace(result, negative_pivots=self._pivots(), crossed=self._crossed)
        else:
            sought.forget()
        self.resumed = None
        return sought.at_prescribed(found), result

    @property
    def _tangent_solver(self) -> PETSc.KSP | None:
        return None if self._all_prescribed else self.snes.getKSP()

    def deviation(self, u: Float) -> tuple[float, Float]:
        """Return the deviation that grows most from sweep to sweep (``growing_deviation``)."""
        ksp = self._tangent_solver
        return super().deviation(u) if ksp is None else growing_deviation(self._equilibrium, ksp, u, self.t)

    def switched(self, u: Float, result: StepResult) -> tuple[Float, StepResult]:
        """Return a stable equilibrium under the load of the unstable equilibrium ``u``, and its outcome."""
        return BranchSwitch(self, self._equilibrium, self._inverse_at).stable(u, result)

    def _inverse_at(self, u: Float, rtol: float = EXACT) -> Flexibility:
        """Return the inverse of the tangent at ``u`` and the load parameter of the last solve, to a tolerance."""
        state = self.state(u)
        self._equilibrium.update(state)
        return _Inverse(self, u, state, rtol)

    def flexibility(self, u: Float, t: float, rtol: float) -> Flexibility:
        """Return the inverse of the tangent at an equilibrium."""
        self.t = t
        self._equilibrium.impose(t)
        held = self._inverse_at(u, rtol)
        return CoupledInverse(self._bodies.coupled(self.state(u)), held) if self._bodies else held

    def _ahead(self, u: Float, t: float) -> Float | None:
        """Return the unknowns (n_rows, dim) of the extrapolated last step; None if it cannot be extrapolated."""
        last = self.problem.last_step
        if last is None:
            return None
        last.begin(u)
        return last.moved_on(u, t)

    def _tried(self, start: Float) -> int | None:
        """Run SNES from ``start``; return the linear iterations, or None and keep nothing if that fails."""
        linear = self._run(start)
        if not self._failed() or self.stop():
            return linear
        self._equilibrium.start_over()
        self._crossed = False
        return None

    def _without_solve(self) -> tuple[Float, StepResult]:
        """Return the prescribed displacements if all unknowns are prescribed; only rigid bodies are iterated."""
        sought, reason = self._equilibrium, PETSc.SNES.ConvergedReason
        for _ in range(SETTLINGS):
            u = sought.prescribed.copy()
            if sought.residual(u.ravel()) is None:
                return u, sought.result(False, int(reason.DIVERGED_FUNCTION_DOMAIN), 0, 0)
            # Nothing of the body gives way.
            if self._bodies.moved(self.state(u), lambda: np.zeros_like, self.rtol) is None:
                break
            sought.impose(sought.t)
        else:
            sought.objection = UNBALANCED
        sought.objection = self._bodies.objection or sought.objection or self.problem.objection(self.state(u))
        if sought.objection:
            return u, sought.result(False, 0, 0, 0)
        result = sought.result(True, int(sought.verdict(u, 0, 0.0, 0.0) or 0), 0, 0)
        if not self.asks_for_stability:
            return u, result
        pivots = self._bodies.negative_pivots(self.state(u), np.zeros_like, 0) if self._bodies else 0
        return u, replace(result, negative_pivots=pivots)

    def _iterate(self, start: Float) -> int:
        """Run SNES from ``start``, with full steps if its line search fails; return the linear iterations."""
        linear = self._run(start)
        if self._failed() and line_search(self.snes) == SECANTS and not self.stop():
            self._equilibrium.accepted = ""
            with full_steps(self.snes):
                linear += self._run(start)
        return linear

    def _failed(self) -> bool:
        """Return True if SNES has ended without an equilibrium, for any reason."""
        if self.snes.getConvergedReason() < 0:
            return True
        return not (self._equilibrium.accepted or self._judged(self._x))

    def _create(self) -> PETSc.Vec:
        """Create a PETSc vector of the unknowns."""
        return self._equilibrium.tangent.preconditioner.createVecRight()

    def _equip(self) -> None:
        self._equilibrium.tangent.equip(self.snes.getKSP())

    def _run(self, start: Float) -> int:
        return self._solve_from(start.ravel() / self._scales.length)

    def _solve_from(self, unknowns: Float) -> int:
        self._x.array, self._indefinite = unknowns, False
        ksp, failed = self.snes.getKSP(), PETSc.SNES.ConvergedReason.DIVERGED_LINEAR_SOLVE
        self.snes.solve(None, self._x)
        linear = int(self.snes.getLinearSolveIterations())
        if self.snes.getConvergedReason() == failed and self.problem.damage is None and met_indefinite(ksp):
            self._indefinite = True
            with with_indefinite(ksp):
                self.snes.solve(None, self._x)
            linear += int(self.snes.getLinearSolveIterations())
        if self.snes.getConvergedReason() == failed:
            start_anew(ksp)
        return linear

    def _predict(self, u: Float, jump: Float) -> tuple[Float, int]:
        """Compute the linear response to new prescribed displacements: the first Newton step, from the old state.

        Prescribed displacements alone would strain the layer next to a support by the whole increment. The tangent is
        that of the last iteration before, whose factor exists already, unless bonds have failed since.
        """
        sought = self._equilibrium
        if sought.unbalanced is None:
            return u, 0
        if not sought.tangent.holds():
            at = u if self.resumed is None else self.resumed
            sought.update(self.problem.state(at, sought.t), effort(self.snes.getKSP()))
        self.resumed = None
        b = -(sought.unbalanced + sought.resisted)
        more, iterations = self._linear_step(u, self.problem.state(u, sought.t), self.problem.supports.reduced(b))
        change = sought.held_in_place(more.ravel(), u, self._answer, self.rtol).reshape(u.shape) + jump
        finite = np.isfinite(float(total(self._comm, float(change.sum()))))
        return sought.at_prescribed(u + (change if finite else jump)), iterations

    def _linear_step(self, u: Float, state: State, b: Float) -> tuple[Float, int]:
        """Solve the tangent for forces ``b``; return displacements and iterations."""
        # Cached quantities of the state are not needed during the factorisation, which uses the most memory.
        state.forget()
        self._r.array = b.ravel() / self._scales.force
        ksp, tangent = self.snes.getKSP(), self._equilibrium.tangent
        ksp.setOperators(tangent.mat, tangent.preconditioner)
        ksp.solve(self._r, self._x)
        if met_indefinite(ksp):
            with with_indefinite(ksp):
                ksp.solve(self._r, self._x)
        return self._displacement(self._x).reshape(u.shape), ksp.getIterationNumber()

    def _jacobian(self, snes: PETSc.SNES, x: PETSc.Vec, J: PETSc.Mat, P: PETSc.Mat) -> None:
        self._equilibrium.update(self._equilibrium.state(self._displacement(x)), effort(snes.getKSP()))


class _Inverse(Flexibility):
    """The inverse of the tangent that a solver holds."""

    def __init__(self, solver: StaticSolver, u: Float, state: State, rtol: float) -> None:
        self._solver, self._u, self._state, self._rtol = solver, u, state, rtol

    def __call__(self, force: Float) -> Float:
        solver, supports = self._solver, self._solver.problem.supports
        if solver._all_prescribed:
            return np.zeros_like(self._u)
        with with_solves_to(solver.snes, self._rtol):
            found, _ = solver._linear_step(self._u, self._state, supports.reduced(force))
        if solver.snes.getKSP().getConvergedReason() < 0:
            raise SolveError("The tangent of the last equilibrium cannot be solved: the linear solver failed.")
        return supports.completed(found)

    def negative_pivots(self) -> int | None:
        return negative_pivots(self._solver.snes.getKSP(), self._solver._equilibrium.tangent.mat)

    def stable(self) -> bool | None:
        pivots = self.negative_pivots()
        if pivots is None:
            pivots = self._solver._equilibrium.negative_curvature(self._state, self._solver.snes.getKSP(), False)
        return None if pivots is None else pivots == 0
