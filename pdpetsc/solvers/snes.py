"""Newton's method with PETSc's SNES: common base of load stepping, monolithic coupling and path following."""

from __future__ import annotations

from abc import abstractmethod
from collections.abc import Callable, Iterator
from contextlib import contextmanager

import numpy as np
from petsc4py import PETSc

from pdpetsc.arrays import Float
from pdpetsc.petsc.library import forces_iteration, met_indefinite, set_domain_error, with_solves_to, with_tolerance
from pdpetsc.problem.assembly import Filler
from pdpetsc.problem.problem import Problem
from pdpetsc.problem.state import State
from pdpetsc.solvers.equilibrium import RESTS, SETTLINGS, UNBALANCED, UNSETTLED, Equilibrium, read_options
from pdpetsc.solvers.protocol import LOOSE, StepSolver
from pdpetsc.solvers.rigid_bodies import RigidBodies
from pdpetsc.solvers.unique import refuse_mechanism

# From this number of iterations on the last tangent is that of the equilibrium but for a small part of the step.
SEVERAL = 2
# Tolerance of solves for the motion of loose particles, of which this share then stays in a Newton step.
ROUGH = 1e-5
# Tolerance of solves for the response to motions of rigid bodies. With 1e-5 those of slender strips do not balance.
RESPONSE = 1e-9


class SnesSolver(StepSolver):
    """Find a zero of the residual of ``Equilibrium`` and of further unknowns with SNES.

    A PETSc vector stores the displacements of a rank over their scale, followed by its other unknowns.

    Parameters
    ----------
    problem, assembler
        The problem, and the object that fills its matrix.
    stop : callable
        Called after every iteration, collectively; True ends the solve (a signal arrived).

    Attributes
    ----------
    snes : SNES
        PETSc's solver.

    Notes
    -----
    Construction and every method are collective. Call ``destroy`` before MPI ends.
    """

    unit = "Newton"

    def __init__(self, problem: Problem, assembler: Filler, stop: Callable[[], bool]) -> None:
        self.problem = problem
        self.stop = stop
        self._comm = problem.body.cloud.comm
        self._n_u = problem.supports.fixed.size
        self._equilibrium = Equilibrium(problem, assembler)
        self._scales = self._equilibrium.scales
        self._bodies = RigidBodies(problem, self._equilibrium.size)
        self.snes = PETSc.SNES().create(comm=self._comm)
        # Whether the energy rises along the last step of the linear solver, and whether a tangent of this solve with
        # damage that follows had negative eigenvalues.
        self._rises = self._crossed = False
        # Whether conjugate gradients failed in the last solve, since a matrix was not definite.
        self._indefinite = False

    def _set_up(self, x: PETSc.Vec, mat: PETSc.Mat, preconditioner: PETSc.Mat, *linear: PETSc.KSP) -> None:
        """Set the functions of SNES, and the options of SNES and linear solvers."""
        self._x, self._r = x, x.duplicate()
        self.snes.setFunction(self._residual, self._r)
        self.snes.setJacobian(self._jacobian, mat, preconditioner)
        self.snes.setConvergenceTest(self._test)
        read_options(self.destroy, self.snes, *linear, equip=self._equip)
        self.snes.setLineSearchPreCheck(self._shorten)

    @property
    def matrix_bytes(self) -> int:
        """Return the memory of the entries that PETSc allocated, over all ranks [bytes]."""
        return self._equilibrium.tangent.bytes

    def refuse_mechanism(self, u: Float) -> None:
        """Raise SolveError on all ranks if the tangent at the equilibrium ``u`` has a mechanism."""
        sought, ksp = self._equilibrium, self._tangent_solver
        if ksp is None:
            return
        anew = not sought.tangent.holds()
        if anew:
            sought.update(self.state(u))
        refuse_mechanism(self.problem, sought.tangent, ksp, self._scales.stiffness, self.t)
        if anew:  # the next step starts as without this check
            sought.forget()

    def destroy(self) -> None:
        """Free the PETSc objects, in order."""
        self.snes.destroy()
        self._r.destroy()
        self._x.destroy()
        self._equilibrium.destroy()

    @property
    @abstractmethod
    def _tangent_solver(self) -> PETSc.KSP | None:
        """Return the linear solver of the tangent; None if there is none."""

    @abstractmethod
    def _equip(self) -> None:
        """Set properties of the linear solver that options cannot set."""

    @abstractmethod
    def _iterate(self, start: Float) -> int:
        """Run SNES from displacements (n_rows, dim) [length]; return the linear iterations."""

    @abstractmethod
    def _jacobian(self, snes: PETSc.SNES, x: PETSc.Vec, J: PETSc.Mat, P: PETSc.Mat) -> None:
        """Update the matrices to ``x``."""

    def _read(self, x: PETSc.Vec) -> Float:
        """Return the displacements (n,) of a vector [length], and set the other unknowns of the problem."""
        return self._displacement(x)

    def _other_residuals(self, x: PETSc.Vec) -> Float:
        """Return the residuals of the other unknowns of this rank, in PETSc's scale."""
        return np.empty(0)

    def _others_converged(self, x: PETSc.Vec) -> bool:
        """Return True if the residuals of the other unknowns are within the tolerance."""
        return True

    def _norm(self, of_all: float) -> float:
        """Return the norm for the convergence test [force], from PETSc's norm of the whole residual."""
        return of_all * self._scales.force

    @contextmanager
    def loosely(self, rtol: float | None = None) -> Iterator[None]:
        """Relax the tolerance of SNES in the ``with`` block, by default to ``LOOSE`` with that of its linear solver."""
        ksp, exact = self.snes.getKSP(), self.rtol
        of_linear = ksp.getTolerances()[0]
        self.snes.setTolerances(rtol=max(exact, LOOSE if rtol is None else rtol))
        with with_tolerance(ksp, max(of_linear, 0.1 * LOOSE) if rtol is None else of_linear):
            try:
                yield
            finally:
                self.snes.setTolerances(rtol=exact)

    @property
    def rtol(self) -> float:
        """Return the relative tolerance of the residual [-]."""
        return float(self.snes.getTolerances()[0])

    def _displacement(self, x: PETSc.Vec) -> Float:
        """Return the displacements (n,) of a vector [length]."""
        return np.asarray(x.array_r[: self._n_u] * self._scales.length)

    def _rested(self) -> tuple[bool, int]:
        """Solve again with moved springs, other near facets, new multipliers and moved rigid bodies until none changes.

        Return True if forces balance without the springs, the contacts have settled and no term objects to the step,
        and the linear iterations.
        """
        sought, linear = self._equilibrium, 0
        resting = sought.resting or (
            self.snes.getConvergedReason() > 0 and sought.at_rest(self._read(self._x), self.rtol)
        )
        for _ in range(RESTS):
            if resting or self.snes.getConvergedReason() <= 0:
                break
            # Solve again from this state, in which the moved springs have no force.
            rest = sought.at_prescribed(self._read(self._x))
            sought.move_springs(rest)
            sought.accepted = sought.objection = ""
            linear += self._iterate(rest)
            resting = sought.at_rest(self._read(self._x), self.rtol)
        moved: Float | None = None
        for _ in range(SETTLINGS):
            found = sought.at_prescribed(self._read(self._x))
            if not resting or self.snes.getConvergedReason() <= 0:
                return resting, linear
            state = self.problem.state(found, sought.t)
            unchanged = self._unchanged(state) and not self.problem.update_multipliers(state)
            moved = self._balanced(state) if unchanged else None
            if moved is not None:
                sought.impose(sought.t)
                found = sought.at_prescribed(moved)
                sought.rebalance(found, self._bodies.way)
            elif unchanged:
                state = self.problem.state(found, sought.t)
                sought.objection = self._bodies.objection or self.problem.objection(state)
                return not sought.objection, linear
            sought.accepted = ""
            linear += self._iterate(found)
            resting = sought.at_rest(self._read(self._x), self.rtol)
        sought.objection = UNBALANCED if moved is not None else UNSETTLED
        return False, linear

    def _balanced(self, state: State) -> Float | None:
        """Move loaded rigid bodies; return the unknowns to solve from again, None if they are in equilibrium."""

        def reply() -> Callable[[Float], Float]:
            sought, ksp = self._equilibrium, self.snes.getKSP()
            sought.update(state)
            ksp.setOperators(sought.tangent.mat, sought.tangent.preconditioner)
            return self._reply

        return self._bodies.moved(state, reply, self.rtol)

    def _reply(self, force: Float) -> Float:
        """Solve the last tangent for forces (n_rows, dim) [force]; return the displacements (n_rows, dim) [length]."""
        return self._answer(force, RESPONSE)[: self._n_u].reshape(force.shape)

    def _unchanged(self, state: State) -> bool:
        """Let the terms follow an equilibrium; return True if it is one of the changed forces too."""
        pattern = self.problem.pattern
        followed = self.problem.follow(state)
        if self.problem.pattern != pattern and self._equilibrium.tangent.renew():
            self._use_tangent()
        return not followed or self._judged(self._x)

    def _use_tangent(self) -> None:
        """Pass matrices of the tangent to SNES, after they were replaced."""
        tangent = self._equilibrium.tangent
        self.snes.setJacobian(self._jacobian, tangent.mat, tangent.preconditioner)
        self._equip()

    def _judged(self, x: PETSc.Vec) -> bool:
        """Return True if the residuals at a vector are within the tolerance."""
        return self._equilibrium.judge(self._read(x), self.rtol) and self._others_converged(x)

    def _pivots(self) -> int | None:
        """Return the negative pivots of the tangent at an equilibrium; None if they are unknown.

        The tangent of the second iteration and of later ones is close to that of the equilibrium. That of the first one
        belongs to the start of the solve. If it matters (``asks_for_stability``, the end of the load, or negative
        pivots, of rigid bodies too), the tangent of the equilibrium is factored here; not if the body softens, whose
        tangent there is that of unloading. Iterative solvers indicate at least one negative pivot: conjugate gradients
        that met negative curvature or gave a step along which the energy rises, and a solve of its own if it matters
        (``has_negative_eigenvalue``), which is cheap with two levels.
        """
        ksp = self._tangent_solver
        indefinite = PETSc.KSP.ConvergedReason.DIVERGED_INDEFINITE_MAT
        several, solved = (self.snes.getIterationNumber() >= least for least in (SEVERAL, 1))
        if ksp is None:
            return None
        if self.meets_curvature and solved and (self._rises or ksp.getConvergedReason() == indefinite):
            return 1
        sought, problem, asks = self._equilibrium, self.problem, self.asks_for_stability
        state = sought.state(self._read(self._x))

        changes = not (problem.linear or problem.softens) and problem.inertia is None
        held = sought.negative_pivots(self.snes, ksp)
        if held is not None:
            found = self._with_bodies(held, state, ksp)
            if changes and not several and (asks or self.ends or found != 0):
                sought.factor(state, ksp)
                found = self._with_bodies(sought.negative_pivots(self.snes, ksp), state, ksp)
            return found
        cheap = self.ends and changes and ksp.getPC().getType() == "mg"
        if (asks or cheap or self._indefinite) and problem.symmetric and (several or not problem.softens):
            return self._with_bodies(sought.negative_curvature(state, ksp, changes and not several), state, ksp)
        return sought.pivots_of_unsymmetric(state, ksp) if asks and not self._bodies else None

    def _with_bodies(self, held: int | None, state: State, ksp: PETSc.KSP) -> int | None:
        """Add the negative pivots of rigid bodies to those at held motions; None if they are unknown."""
        if held is None or not self._bodies:
            return held
        failed = False

        def reply(force: Float) -> Float:
            nonlocal failed
            found = self._reply(force)
            failed |= ksp.getConvergedReason() < 0
            return found

        found = self._bodies.negative_pivots(state, reply, held)
        return None if failed and not found else found

    def _answer(self, b: Float, rtol: float = ROUGH) -> Float:
        """Solve the last tangent for forces ``b`` to a tolerance; return the unknowns (n,) [length]."""
        forces, found = self._r.duplicate(), self._x.duplicate()
        forces.set(0.0)
        forces.array_w[: b.size] = b.ravel() / self._scales.force
        ksp = self.snes.getKSP()
        with with_solves_to(self.snes, rtol):
            ksp.solve(forces, found)
        if ksp.getConvergedReason() < 0:
            found.set(0.0)
        answer = np.asarray(found.array_r * self._scales.length)
        forces.destroy()
        found.destroy()
        return answer

    def _residual(self, snes: PETSc.SNES, x: PETSc.Vec, r: PETSc.Vec) -> None:
        residual = self._equilibrium.residual(self._read(x))
        if residual is None:
            set_domain_error(snes)
            r.set(np.inf)
            return
        r.array = np.concatenate([residual.ravel() / self._scales.force, self._other_residuals(x)])

    @property
    def ends(self) -> bool:
        """Return True if the last solve was at the end of the load (not collective)."""
        return False

    @property
    def meets_curvature(self) -> bool:
        ksp = self._tangent_solver
        return ksp is not None and ksp.getType() == "cg"

    def _shorten(self, x: PETSc.Vec, y: PETSc.Vec) -> None:
        """Remove motion that only springs of loose particles resist, and halve a Newton step until it keeps det F > 0.

        If forces have an energy, including damage, a step along which it rises is reversed.
        """
        sought, damage = self._equilibrium, self.problem.damage
        self._rises = False
        if damage is not None and damage.forces_have_energy and self.problem.symmetric and self.of_minima:
            # The step is -y, and the residual the derivative of the energy.
            self._rises = self.snes.getFunction()[0].dot(y) < 0.0
            if self._rises:
                y.scale(-1.0)
            ksp = self._tangent_solver
            if not damage.frozen and ksp is not None:
                self._crossed |= self._rises or met_indefinite(ksp) or bool(sought.negative_pivots(self.snes, ksp))
        if not sought.resting:
            step = y.array_r * self._scales.length
            y.array = sought.held_in_place(step, self._read(x), self._answer, self.rtol) / self._scales.length
        moved = x.duplicate()

        def after(part: float) -> Float:
            moved.waxpy(-part, y, x)
            return sought.at_prescribed(self._read(moved))

        part = sought.admissible_part(after)
        moved.destroy()
        self._read(x)
        if part < 1.0:
            y.scale(part)

    def _test(self, snes: PETSc.SNES, iteration: int, norms: tuple[float, float, float]) -> int | None:
        sought, x = self._equilibrium, snes.getSolution()
        if self.stop():
            return sought.interrupted()
        values, others = self._read(x), self._others_converged(x)
        verdict = sought.verdict(values, iteration, self._norm(norms[2]), self.rtol)
        if verdict is None or verdict < 0:
            return verdict
        if not others:
            sought.accepted = ""
            return None
        # -snes_force_iteration: do not end a solve before its first iteration.
        return None if iteration == 0 and forces_iteration(snes) else verdict
