"""Static equilibrium of one load step with SNES."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
from petsc4py import PETSc

from pdpetsc.arrays import Float
from pdpetsc.discrete.communicator import total
from pdpetsc.loading import Loading
from pdpetsc.model import Assembler, Model
from pdpetsc.solve.base import StepResult, StepSolver
from pdpetsc.solve.equilibrium import Equilibrium, read_options
from pdpetsc.solve.petsc import effort, full_steps, line_search, linear_solver, set_domain_error, start_anew

# The line search that looks for a zero along the step; it crawls where a loose piece turns, and full steps do not.
SECANTS = "cp"


class StaticSolver(StepSolver):
    """Newton's method for ``f_int(u) = f_ext(t)`` with prescribed displacements, on PETSc's SNES.

    Parameters
    ----------
    model, loading, assembler
        The body and its conditions.
    stop : callable
        Asked after every iteration, collectively; True ends the solve (a signal arrived).

    Notes
    -----
    Construction and every method are collective. Call ``destroy`` before MPI ends.
    """

    unit = "Newton"
    advice = (
        "look for a limit point or zero-energy modes, add or raise the stabilisation, or try "
        "-snes_linesearch_type basic, a smaller smallest step or -snes_rtol 1e-8"
    )

    def __init__(self, model: Model, loading: Loading, assembler: Assembler, stop: Callable[[], bool]) -> None:
        self.model = model
        self.loading = loading
        self._stop = stop
        self._filled_at: Float | None = None
        self._equilibrium = Equilibrium(model, loading, assembler)
        tangent = self._equilibrium.tangent
        self._x = tangent.preconditioner.createVecRight()
        self._r = self._x.duplicate()
        self.snes = PETSc.SNES().create(comm=model.cloud.comm)
        self.snes.setFunction(self._residual, self._r)
        self.snes.setJacobian(self._jacobian, tangent.mat, tangent.preconditioner)
        self.snes.setConvergenceTest(self._test)
        read_options(self.destroy, self.snes)
        self.snes.setLineSearchPreCheck(self._shorten)

    @property
    def tangent_at(self) -> Float | None:
        """Return the displacement of the last Newton iteration but one, whose tangent the next step begins with."""
        sought, failure = self._equilibrium, self.model.failure
        held = not self.model.linear and (failure is None or not failure.frozen)
        return self._filled_at if held and sought.tangent.holds(sought.damping is not None) else None

    @property
    def matrix_bytes(self) -> int:
        """Return the memory of the entries that PETSc allocated, over all ranks [bytes]."""
        return self._equilibrium.tangent.bytes

    def description(self) -> str:
        """Return the solver in force in a few words."""
        return f"snes {self.snes.getType()}, {linear_solver(self.snes.getKSP())}"

    def solve(self, u: Float, t: float) -> tuple[Float, StepResult]:
        """Find equilibrium at step time ``t`` starting from ``u`` (n_rows, dim).

        Returns
        -------
        u : (n_rows, dim) float64
            The new displacement, or an unusable one where the step failed.
        result : StepResult
        """
        sought = self._equilibrium
        old_prescribed = sought.prescribed
        sought.prescribed, sought.external = self.loading.prescribed(t), self.loading.forces(t)
        if sought.begin(u):
            self.snes.setJacobian(self._jacobian, sought.tangent.mat, sought.tangent.preconditioner)
        start, linear = u, 0
        if total(self.model.cloud.comm, np.count_nonzero(sought.prescribed != old_prescribed)):
            start, linear = self._predict(u, sought.prescribed - np.where(self.loading.fixed, u, 0.0))
        linear += self._iterate(start)
        if sought.damping is not None and self.snes.getConvergedReason() > 0:
            # Once more from where it came to rest: the damping has no force there.
            rest = sought.at_prescribed(self._x.array).copy()
            sought.move_springs(rest)
            linear += self._iterate(rest)
        reason = self.snes.getConvergedReason()
        result = sought.result(reason, self.snes.getKSP().getConvergedReason(), linear)
        if reason <= 0:
            sought.prescribed = old_prescribed
            sought.tangent.forget()
        return sought.at_prescribed(self._x.array).copy(), result

    def destroy(self) -> None:
        """Free the PETSc objects, in order."""
        self.snes.destroy()
        self._r.destroy()
        self._x.destroy()
        self._equilibrium.destroy()

    def _iterate(self, start: Float) -> int:
        """Run SNES from ``start``, with full steps where its line search fails; return the linear iterations."""
        linear = self._run(start)
        if self.snes.getConvergedReason() < 0 and line_search(self.snes) == SECANTS and not self._stop():
            self._equilibrium.reason = ""
            with full_steps(self.snes):
                linear += self._run(start)
        return linear

    def _run(self, start: Float) -> int:
        self._x.array = start.ravel()
        self.snes.solve(None, self._x)
        if self.snes.getConvergedReason() == PETSc.SNES.ConvergedReason.DIVERGED_LINEAR_SOLVE:
            start_anew(self.snes.getKSP())
        return int(self.snes.getLinearSolveIterations())

    def _predict(self, u: Float, jump: Float) -> tuple[Float, int]:
        """Return the linear response to new prescribed displacements: Newton's first step, from the old state.

        Setting them alone would strain the layer next to a support by the whole increment. The tangent is that of the
        last iteration before, whose factor is there already, unless bonds have failed since.
        """
        sought, free = self._equilibrium, self._equilibrium.free
        jump = np.where(free, 0.0, jump)
        force = self.model.internal_force(u)
        if force is None:
            return u, 0
        if not sought.tangent.holds(sought.damping is not None):
            self._filled_at = u if self.resumed is None else self.resumed
            sought.tangent.update(self._filled_at, sought.damping, effort(self.snes.getKSP()))
        self.resumed = None
        b = sought.external - force - self.model.tangent_times(u, jump)
        self._r.array = np.where(free, b, 0.0).ravel()
        ksp = self.snes.getKSP()
        ksp.setOperators(sought.tangent.mat, sought.tangent.preconditioner)
        ksp.solve(self._r, self._x)
        change = self._x.array.reshape(u.shape) + jump
        finite = np.isfinite(float(total(self.model.cloud.comm, float(change.sum()))))
        return u + (change if finite else jump), ksp.getIterationNumber()

    def _residual(self, snes: PETSc.SNES, x: PETSc.Vec, r: PETSc.Vec) -> None:
        residual = self._equilibrium.residual(x.array_r)
        if residual is None:
            set_domain_error(snes)
            r.set(np.inf)
            return
        r.array = residual.ravel()

    def _jacobian(self, snes: PETSc.SNES, x: PETSc.Vec, J: PETSc.Mat, P: PETSc.Mat) -> None:
        self._filled_at = self._equilibrium.at_prescribed(x.array_r)
        self._equilibrium.assemble(x.array_r, effort(snes.getKSP()))

    def _shorten(self, x: PETSc.Vec, y: PETSc.Vec) -> None:
        """Halve a Newton step until the whole of it keeps det F > 0, whatever the line search."""
        here, step = x.array_r, y.array_r
        part = self._equilibrium.admissible_part(lambda p: self._equilibrium.at_prescribed(here - p * step))
        if part < 1.0:
            y.scale(part)

    def _test(self, snes: PETSc.SNES, iteration: int, norms: tuple[float, float, float]) -> int | None:
        if self._stop():
            return self._equilibrium.interrupted()
        rtol = float(snes.getTolerances()[0])
        return self._equilibrium.verdict(snes.getSolution().array_r, iteration, norms[2], rtol)
