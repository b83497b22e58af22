"""Monolithic coupling: equilibrium and heat conduction of a load step in one Newton iteration."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
from petsc4py import PETSc

from pdpetsc.arrays import Float
from pdpetsc.declare.steps import AdaptiveSteps, Steps
from pdpetsc.discrete.communicator import largest, norm, total
from pdpetsc.petsc.shell import Shell
from pdpetsc.problem.assembly import Filler
from pdpetsc.problem.problem import Problem
from pdpetsc.problem.state import State
from pdpetsc.solvers.heat_steps import HeatSteps, HeatSystem
from pdpetsc.solvers.newton import ONE_STEP, StaticSolver
from pdpetsc.solvers.protocol import StepResult

# Relative step of the differences by temperature, over the temperature and its change in a load step.
DIFFERENCE = 1e-5
# The temperature is accepted if its residual is below this share of the largest one in the step.
GOOD = 1e-10
# Names of the two blocks in the options of PCFIELDSPLIT.
TEMPERATURE, DISPLACEMENT = "temperature", "displacement"


class MonolithicSolver(StaticSolver):
    """Solve ``f_int(u, T) = f_ext(t)`` and ``A T = b`` together by Newton's method.

    The linear systems are

        [ A      0   ] [ dT ]       [ A T - b       ]
        [ K_uT   K   ] [ du ]  =  - [ f_int - f_ext ]

    ``K_uT`` is the derivative of internal forces by temperature. It is applied without a matrix, by central differences
    of the forces of all terms along the change of the temperature. The upper right block is zero: flux, capacity and
    sources do not depend on the displacement. PCFIELDSPLIT solves the temperature first, which is exact up to the
    solvers of the blocks.

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
        self._heat, self._field = heat, heat.heat.field
        self._n_T = problem.body.cloud.n_owned
        # Scales of temperatures and their residuals for PETSc, set in each step.
        self._degree, self._power = 1.0, 1.0
        # Matrices of a step, first the coupled one and its preconditioning matrix.
        self._made: list[PETSc.Mat] = []
        # Displacements of the current derivative by temperature.
        self._coupled_at = np.zeros(problem.supports.fixed.shape)
        self._first = 0.0
        super().__init__(problem, assembler, stop, steps)

    # The tangent also depends on the temperature at the start of the next step.
    tangent_at = None

    def solve(self, u: Float, t: float) -> tuple[Float, StepResult]:
        """Find equilibrium and temperature at load parameter ``t`` starting from ``u`` (n_rows, dim)."""
        if self._all_prescribed:
            self._heat.solve()
            return super().solve(u, t)
        if self._heat.heat.declared.duration is None:
            # Refuse a piece with unlimited heat input before functions of the temperature are evaluated.
            self._heat.solution()
        self._couple(self._heat.system)
        attempt, result = super().solve(u, t)
        if result.converged:
            self._read(self._x)
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

    def _create(self) -> PETSc.Vec:
        """Create a vector of displacements followed by temperatures on each rank."""
        return PETSc.Vec().createMPI((self._n_u + self._n_T, PETSc.DETERMINE), comm=self._comm)

    def _equip(self) -> None:
        """Set the blocks of PCFIELDSPLIT, the temperature first."""
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
        """Build the matrix of a step, whose temperature block depends on the length of the step."""
        scale = system.matrix.scale
        sources = system.matrix.residual(system.start, system.b, system.start) / scale
        both = np.abs([system.start - self._field.before, sources])
        self._degree = largest(self._comm, both, initial=0.0) or 1.0
        self._power = self._degree * scale
        tangent = self._equilibrium.tangent
        self._free()
        # In steady conduction the mean value of an unsupported piece is undetermined; the preconditioning matrix is
        # regular.
        steady = self._heat.heat.declared.duration is None
        heat, near = system.matrix.mat.copy(), system.matrix.near.copy() if steady else None
        for mat in (heat, near):
            if mat is not None:
                mat.scale(self._degree / self._power)
                mat.setOption(PETSc.Mat.Option.SYMMETRIC, True)
                mat.setOption(PETSc.Mat.Option.SPD, mat is near or not steady)
        sizes = ((self._n_u, PETSc.DETERMINE), (self._n_T, PETSc.DETERMINE))
        coupling = PETSc.Mat().createPython(sizes, context=Shell(self._coupling), comm=self._comm)
        coupling.setUp()
        rows = [[[tangent.preconditioner, coupling], [None, one]] for one in (heat, heat if near is None else near)]
        whole, part = (PETSc.Mat().createNest(blocks, comm=self._comm) for blocks in rows)
        self._made = [whole, part, coupling, heat, *([] if near is None else [near])]
        self.snes.setJacobian(self._jacobian, whole, part)
        self._first = 0.0

    def _coupling(self, x: PETSc.Vec, y: PETSc.Vec) -> None:
        """Write the change of internal forces with a change of the temperature, both in PETSc's scale."""
        change = np.array(x.array_r)
        now, comm, supports = self._field.now.copy(), self._comm, self.problem.supports
        size = largest(comm, np.abs(change), initial=0.0)
        y.set(0.0)
        if not size > 0.0:
            return
        step = DIFFERENCE * max(self._degree, largest(comm, np.abs(now), initial=0.0)) / size
        forces = []
        for by in (step, -step):
            self._field.take(now + by * change)
            forces.append(self.problem.internal_force(self.problem.state(self._coupled_at, self.t)))
        self._field.take(now)
        up, down = forces
        if up is not None and down is not None:  # Newton's method converges without it as well
            y.array = supports.reduced(up - down).ravel() * (self._degree / (2.0 * step * self._scales.force))

    def _read(self, x: PETSc.Vec) -> Float:
        self._field.take(self._temperature(x))
        return self._displacement(x)

    def _temperature(self, x: PETSc.Vec) -> Float:
        """Return the temperatures of a vector, which stores the difference to those at the start of the step."""
        return np.asarray(self._heat.system.start + x.array_r[self._n_u :] * self._degree)

    def _run(self, start: Float) -> int:
        # Later runs continue with the current temperature.
        change = (self._field.now - self._heat.system.start) / self._degree
        return self._solve_from(np.concatenate([start.ravel() / self._scales.length, change]))

    def _linear_step(self, u: Float, state: State, b: Float) -> tuple[Float, int]:
        """Return the displacements of the first Newton step, and apply its change of the temperature."""
        system, ksp, now = self._heat.system, self.snes.getKSP(), self._field.now.copy()
        self._coupled_at = u
        heat = system.matrix.residual(now, system.b, system.start)
        self._r.array = np.concatenate([b.ravel() / self._scales.force, -heat / self._power])
        ksp.setOperators(*self._made[:2])
        ksp.solve(self._r, self._x)
        change = self._x.array_r[self._n_u :] * self._degree
        if np.isfinite(total(self._comm, float(change.sum()))):
            self._field.take(now + change)
        return self._displacement(self._x).reshape(u.shape), ksp.getIterationNumber()

    def _other_residuals(self, x: PETSc.Vec) -> Float:
        return self._heat_residual(x) / self._power

    def _heat_residual(self, x: PETSc.Vec) -> Float:
        system = self._heat.system
        return system.matrix.residual(self._temperature(x), system.b, system.start)

    def _jacobian(self, snes: PETSc.SNES, x: PETSc.Vec, J: PETSc.Mat, P: PETSc.Mat) -> None:
        self._coupled_at = self._equilibrium.at_prescribed(self._read(x))
        super()._jacobian(snes, x, J, P)
        for mat in (J, P):
            mat.assemble()

    def _norm(self, of_all: float) -> float:
        """Return the norm of the displacement residual [force]."""
        return norm(self._comm, self.snes.getFunction()[0].array_r[: self._n_u] * self._scales.force)

    def _others_converged(self, x: PETSc.Vec) -> bool:
        """Return True if the residual of the temperature is within the tolerance."""
        off = norm(self._comm, self._heat_residual(x))
        self._first = max(self._first, off)
        floor = self._heat.system.matrix.round_off(np.abs(self._temperature(x)) + self._degree)
        return np.isfinite(off) and off <= max(GOOD * self._first, floor)

    @property
    def _tangent_solver(self) -> PETSc.KSP | None:
        """Return the solver of the displacement block; the temperature block has no negative pivots."""
        pc = self.snes.getKSP().getPC()
        return pc.getFieldSplitSubKSP()[1] if pc.getType() == "fieldsplit" else None
