"""Equilibrium and heat conduction of a load step together, in one Newton's method."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
from petsc4py import PETSc

from pdpetsc.arrays import Float
from pdpetsc.declare.steps import AdaptiveSteps, Steps
from pdpetsc.discrete.communicator import largest, total
from pdpetsc.errors import CaseError
from pdpetsc.petsc.library import effort, set_domain_error
from pdpetsc.problem.assembly import Filler
from pdpetsc.problem.problem import Problem
from pdpetsc.problem.state import State
from pdpetsc.solvers.heat_steps import HeatSteps, HeatSystem
from pdpetsc.solvers.newton import ONE_STEP, StaticSolver
from pdpetsc.solvers.protocol import StepResult
from pdpetsc.terms.material_points import MaterialPoints

# The temperature counts where its residual is below this share of the largest of the step.
GOOD = 1e-10
# Names of both parts of the unknowns, in the options of PCFIELDSPLIT.
TEMPERATURE, DISPLACEMENT = "temperature", "displacement"


class MonolithicSolver(StaticSolver):
    """Newton's method for ``f_int(u, T) = f_ext(t)`` and ``A T = b`` together.

    The linear systems are

        [ A      0   ] [ dT ]       [ A T - b       ]
        [ K_uT   K   ] [ du ]  =  - [ f_int - f_ext ]

    with ``K_uT = G^T (W dP/dT)``, the exact derivative of internal forces by temperature, applied without a matrix. The
    upper right block is zero: neither flux, capacity nor sources depend on the displacement. PCFIELDSPLIT takes the
    temperature first, which is exact then but for the solvers of the parts.

    Parameters
    ----------
    problem, assembler, stop, steps
        As for ``StaticSolver``.

    Notes
    -----
    Construction and every method are collective. Call ``destroy`` before MPI ends.
    """

    def __init__(
        self, problem: Problem, assembler: Filler, stop: Callable[[], bool], steps: Steps | AdaptiveSteps = ONE_STEP
    ) -> None:
        (heat,) = problem.fields
        assert isinstance(heat, HeatSteps)
        assert isinstance(problem.material_term, MaterialPoints)
        self._heat, self._field, self._points = heat, heat.heat.field, problem.material_term
        cloud = problem.body.cloud
        self._n_u, self._n_T = problem.supports.fixed.size, cloud.n_owned
        # What temperatures and their residuals are divided by for PETSc; those of a step follow it.
        self._degree, self._power = 1.0, 1.0
        # The coupled matrix with what preconditions it, and all that is made for a step.
        self._mats: tuple[PETSc.Mat, PETSc.Mat] | None = None
        self._made: list[PETSc.Mat] = []
        self._coupling: Float | None = None
        self._first = 0.0
        super().__init__(problem, assembler, stop, steps)

    @classmethod
    def refuse(cls, problem: Problem) -> None:
        """Raise CaseError where temperature and displacement cannot be found together, on every rank."""
        if type(problem.material_term) is not MaterialPoints:
            raise CaseError(
                'HeatConduction with coupling="monolithic" takes bodies of deformation gradients whose bonds stay and '
                'that share no dilatation; take "staggered", which finds the same: no heat depends on the displacement.'
            )

    @property
    def tangent_at(self) -> Float | None:
        """Return None: a tangent is also of a temperature, which the next step begins with."""
        return None

    def solve(self, u: Float, t: float) -> tuple[Float, StepResult]:
        """Find equilibrium and temperature at step time ``t`` starting from ``u`` (n_rows, dim)."""
        system = self._system
        if self._all_prescribed:
            self._heat.solve()
            return super().solve(u, t)
        if self._heat.heat.declared.duration is None:
            # Refuse a piece that gains heat without end before functions of the temperature are evaluated.
            self._heat.solution()
        self._couple(system)
        attempt, result = super().solve(u, t)
        if result.converged:
            self._take(self._x)
        return attempt, result

    def destroy(self) -> None:
        """Free the PETSc objects, in order."""
        self.snes.destroy()
        self._free()
        super().destroy()

    def _free(self) -> None:
        """Free the matrices of a step."""
        for mat in self._made:
            mat.destroy()
        self._made.clear()

    @property
    def _system(self) -> HeatSystem:
        system = self._heat.system
        assert system is not None
        return system

    def _create(self) -> PETSc.Vec:
        """Return a vector of displacements and then temperatures of each rank."""
        return PETSc.Vec().createMPI((self._n_u + self._n_T, PETSc.DETERMINE), comm=self._comm)

    def _equip(self) -> None:
        """Tell PCFIELDSPLIT the parts, the temperature first."""
        first = self._x.getOwnershipRange()[0]
        parts = (
            PETSc.IS().createStride(self._n_u, first, 1, comm=self._comm),
            PETSc.IS().createStride(self._n_T, first + self._n_u, 1, comm=self._comm),
        )
        pc = self.snes.getKSP().getPC()
        if pc.getType() == "fieldsplit":
            pc.setFieldSplitIS((TEMPERATURE, parts[1]), (DISPLACEMENT, parts[0]))
        for part in parts:
            part.destroy()

    def _couple(self, system: HeatSystem) -> None:
        """Make the matrix of a step, whose part of the temperature changes with its length."""
        change = np.abs(system.start - self._field.before).max(initial=0.0)
        scale = system.matrix.scale
        sources = np.abs(system.matrix.residual(system.start, system.b, system.start)).max(initial=0.0) / scale
        self._degree = largest(self._comm, float(max(change, sources))) or 1.0
        self._power = self._degree * scale
        tangent = self._equilibrium.tangent
        self._free()
        # Where conduction takes no time a piece that nothing holds has no level: what preconditions it has.
        steady = self._heat.heat.declared.duration is None
        heat, near = system.matrix.mat.copy(), system.matrix.near.copy() if steady else None
        for mat in (heat, near):
            if mat is not None:
                mat.scale(self._degree / self._power)
                mat.setOption(PETSc.Mat.Option.SYMMETRIC, True)
                mat.setOption(PETSc.Mat.Option.SPD, mat is near or not steady)
        sizes = ((self._n_u, PETSc.DETERMINE), (self._n_T, PETSc.DETERMINE))
        coupling = PETSc.Mat().createPython(sizes, context=_Coupling(self._forces_of), comm=self._comm)
        coupling.setUp()
        rows = [[[tangent.preconditioner, coupling], [None, one]] for one in (heat, heat if near is None else near)]
        whole, part = (PETSc.Mat().createNest(blocks, comm=self._comm) for blocks in rows)
        self._mats = whole, part
        self._made = [whole, part, coupling, heat, *([] if near is None else [near])]
        self.snes.setJacobian(self._jacobian, whole, part)
        self._first = 0.0

    def _forces_of(self, change: Float) -> Float:
        """Return how internal forces change with the temperature, as PETSc sees both (n_u,)."""
        assert self._coupling is not None
        operator, body = self._points.operator, self.problem.body
        f = np.zeros((body.cloud.n_local, body.dim))
        operator.divergence(self._coupling * (change * self._degree)[operator.owner][:, None, None], f)
        return np.where(self._equilibrium.free, body.gather(f), 0.0).ravel() / self._scales.force

    def _displacement(self, x: PETSc.Vec) -> Float:
        """Return the displacements of a vector [length]."""
        return np.asarray(x.array_r[: self._n_u] * self._scales.length)

    def _temperature(self, x: PETSc.Vec) -> Float:
        """Return the temperatures of a vector; they are counted from those that the step begins with."""
        return np.asarray(self._system.start + x.array_r[self._n_u :] * self._degree)

    def _take(self, x: PETSc.Vec) -> None:
        self._field.take(self._temperature(x))

    def _run(self, start: Float) -> int:
        # Later runs go on with the temperature that has been found.
        change = (self._field.now - self._system.start) / self._degree
        return self._solve_from(np.concatenate([start.ravel() / self._scales.length, change]))

    def _linear_step(self, u: Float, state: State, b: Float) -> tuple[Float, int]:
        """Return the displacements of Newton's first step, which the temperature takes as well."""
        system, ksp, now = self._system, self.snes.getKSP(), self._field.now.copy()
        assert self._mats is not None
        self._coupling = self._points.stress_by_temperature(state)
        heat = system.matrix.residual(now, system.b, system.start)
        self._r.array = np.concatenate([b.ravel() / self._scales.force, -heat / self._power])
        ksp.setOperators(*self._mats)
        ksp.solve(self._r, self._x)
        change = self._x.array_r[self._n_u :] * self._degree
        if np.isfinite(total(self._comm, float(change.sum()))):
            self._field.take(now + change)
        return self._displacement(self._x).reshape(u.shape), ksp.getIterationNumber()

    def _residual(self, snes: PETSc.SNES, x: PETSc.Vec, r: PETSc.Vec) -> None:
        self._take(x)
        residual = self._equilibrium.residual(self._displacement(x))
        if residual is None:
            set_domain_error(snes)
            r.set(np.inf)
            return
        r.array = np.concatenate([residual.ravel() / self._scales.force, self._heat_residual(x) / self._power])

    def _heat_residual(self, x: PETSc.Vec) -> Float:
        system = self._system
        return system.matrix.residual(self._temperature(x), system.b, system.start)

    def _jacobian(self, snes: PETSc.SNES, x: PETSc.Vec, J: PETSc.Mat, P: PETSc.Mat) -> None:
        self._take(x)
        values = self._displacement(x)
        self._filled_at = self._equilibrium.at_prescribed(values)
        self._coupling = self._points.stress_by_temperature(self._equilibrium.state(values))
        self._equilibrium.assemble(values, effort(snes.getKSP()))
        for mat in (J, P):
            mat.assemble()

    def _shorten(self, x: PETSc.Vec, y: PETSc.Vec) -> None:
        """Halve a Newton step until the whole of it keeps det F > 0 at its temperature."""
        here, step = self._displacement(x), self._displacement(y)
        warm, change = self._temperature(x), y.array_r[self._n_u :] * self._degree

        def moved(part: float) -> Float:
            self._field.take(warm - part * change)
            return self._equilibrium.at_prescribed(here - part * step)

        part = self._equilibrium.admissible_part(moved)
        self._take(x)
        if part < 1.0:
            y.scale(part)

    def _judged(self, x: PETSc.Vec) -> bool:
        """Return whether forces balance and heat is conserved at a vector."""
        self._take(x)
        return self._equilibrium.judge(self._displacement(x), self._rtol) and self._conducts(x)

    def _conducts(self, x: PETSc.Vec) -> bool:
        """Return whether the residual of the temperature counts as zero."""
        norm = float(np.sqrt(total(self._comm, float((self._heat_residual(x) ** 2).sum()))))
        self._first = max(self._first, norm)
        floor = self._system.matrix.round_off(np.abs(self._temperature(x)) + self._degree)
        return np.isfinite(norm) and norm <= max(GOOD * self._first, floor)

    def _test(self, snes: PETSc.SNES, iteration: int, norms: tuple[float, float, float]) -> int | None:
        x, sought = snes.getSolution(), self._equilibrium
        if self.stop():
            return sought.interrupted()
        r = snes.getFunction()[0].array_r[: self._n_u] * self._scales.force
        norm = float(np.sqrt(total(self._comm, float((r**2).sum()))))
        warm = self._conducts(x)
        self._take(x)
        verdict = sought.verdict(self._displacement(x), iteration, norm, self._rtol)
        if verdict is not None and verdict > 0 and not warm:
            sought.reason = ""
            return None
        return self._unless_forced(verdict, snes, iteration)

    @property
    def _tangent_solver(self) -> PETSc.KSP | None:
        """Return the solver of the part of the displacement; that of the temperature has no negative pivots."""
        pc = self.snes.getKSP().getPC()
        return pc.getFieldSplitSubKSP()[1] if pc.getType() == "fieldsplit" else None


class _Coupling:
    """The derivative of internal forces by temperature as PETSc calls it."""

    def __init__(self, product: Callable[[Float], Float]) -> None:
        self._product = product

    def mult(self, mat: PETSc.Mat, x: PETSc.Vec, y: PETSc.Vec) -> None:
        """Write the product."""
        y.array = self._product(np.array(x.array_r))
