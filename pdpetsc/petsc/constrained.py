"""Saddle-point preconditioner for a tangent with a stiff low-rank part B^T D B (near-incompressibility)."""

from __future__ import annotations

import numpy as np
from petsc4py import PETSc

from pdpetsc.arrays import Float, Mask
from pdpetsc.discrete.communicator import largest, total
from pdpetsc.gradient.products import ConstraintProduct
from pdpetsc.petsc.matrix_free import Preconditioning
from pdpetsc.petsc.schur import DIRECT, SchurComplement
from pdpetsc.petsc.shell import Shell
from pdpetsc.petsc.two_level import TwoLevel
from pdpetsc.problem.body import Body
from pdpetsc.problem.problem import Problem, Tangent
from pdpetsc.problem.state import State

# Tolerance of the saddle-point solve, over that of the outer solve and over the largest stiffness of a constraint,
# which multiplies its residual there; its smallest value; and the largest number of iterations.
CLOSER, LEAST, MOST = 1e-2, 1e-13, 1000
# Schur complement of the soft tangent, over the inverse of the soft stiffness of a constraint.
SPREAD = 1.0
# The diagonal is sufficient if no constraint is stiffer than this multiple of its soft stiffness.
LOW = 1.0


class Constrained(Preconditioning):
    """Precondition ``K = K_0 + B^T D B`` with stiff D by the system ``[K_0 B^T; B -D^-1]``.

    The condition number of the system does not depend on D. MINRES solves it, preconditioned by the two levels of the
    soft ``K_0`` and by the Schur complement ``D^-1 + B K_0^-1 B^T``. The latter is a ``SchurComplement``. Its diagonal
    is used if constraints are hardly stiff, too many to be factored, or MINRES fails. The second part of the diagonal
    is about the inverse of the stiffness of ``K_0`` against a constraint.

    Parameters
    ----------
    levels : TwoLevel
        The two levels.
    problem : Problem
        The problem.
    fixed : (n_rows, dim) bool
        Prescribed degrees of freedom.
    scale : float
        Unit of stiffness in the matrices [force / length].

    Attributes
    ----------
    iterations : int
        Total number of MINRES iterations.
    """

    def __init__(self, levels: TwoLevel, problem: Problem, fixed: Mask, scale: float) -> None:
        self._levels, self._problem, self._fixed, self._scale = levels, problem, fixed, scale
        self.mat, self.diagonal, self.bounded = levels.mat, levels.diagonal, False
        self._system: _System | None = None
        self._ksp: PETSc.KSP | None = None
        self.iterations = 0

    def fill(self, state: State) -> Tangent:
        """Update to a state; return the tangent there."""
        tangent = self._levels.fill(state)
        self.diagonal = self._levels.diagonal
        constraints = tangent.constraint()
        assert constraints is not None
        if self._system is None:
            self._system = _System(self._problem.body, self._fixed, self._scale)
        self._system.take(tangent.softened(), constraints, self.diagonal)
        return tangent

    def renewed(self) -> Preconditioning:
        """Build a new preconditioner for the current bonds."""
        levels = self._levels.renewed()
        assert isinstance(levels, TwoLevel)
        return Constrained(levels, self._problem, self._fixed, self._scale)

    def equip(self, tangent: PETSc.Mat, ksp: PETSc.KSP) -> None:
        """Use a saddle-point solve as preconditioner, unless options request another one."""
        self._outer = ksp
        pc = ksp.getPC()
        if pc.getType() == "python":
            pc.setPythonContext(Shell(self.solve))
        else:
            self._levels.equip(tangent, ksp)

    def solve(self, x: PETSc.Vec, y: PETSc.Vec) -> None:
        """Solve the system for forces x, and store the displacements in y."""
        assert self._system is not None
        if self._ksp is None:
            self._ksp = self._system.solver(self._levels, x.getComm(), x.getLocalSize())
        right, found = self._system.right, self._system.found
        n = x.getLocalSize()
        values = np.zeros(right.getLocalSize())
        values[:n] = x.array_r
        right.setArray(values)
        self._system.mat.stateIncrease()
        self._ksp.setTolerances(rtol=max(LEAST, CLOSER * self._outer.getTolerances()[0] / self._system.stiffest))
        self._ksp.solve(right, found)
        self.iterations += self._ksp.getIterationNumber()
        if self._ksp.getConvergedReason() < 0 and self._system.forget_schur():
            self._ksp.solve(right, found)
            self.iterations += self._ksp.getIterationNumber()
        y.setArray(found.array_r[:n])

    @property
    def bytes(self) -> int:
        """Return the memory of the entries of the two levels, over all ranks [bytes]."""
        return self._levels.bytes

    def destroy(self) -> None:
        if self._ksp is not None and self._system is not None:
            self._ksp.destroy()
            self._system.destroy()
        self._levels.destroy()


class _System:
    """Represent ``[K_0 B^T; B -D^-1]`` over the scale of the tangent, and its preconditioner, for PETSc."""

    def __init__(self, body: Body, fixed: Mask, scale: float) -> None:
        self._body, self._free, self._scale = body, ~fixed, scale
        self._masked = np.zeros(fixed.shape)
        self._schur: SchurComplement | None = None

    def take(self, soft: Tangent, constraints: ConstraintProduct, diagonal: Float) -> None:
        """Bind a tangent whose soft part has a diagonal (n_rows * dim,) [force / length] (collective)."""
        self._soft, self._of = soft, constraints
        sizes = np.diff(constraints.ptr)
        self._condition_of = np.repeat(np.arange(len(sizes)), sizes)
        with np.errstate(divide="ignore"):
            self._compliance = self._scale / np.maximum(constraints.D, 1e-12 * constraints.soft)
        stiffest = float(np.max(constraints.D / constraints.soft, initial=1.0))
        self.stiffest = largest(self._body.cloud.comm, stiffest)
        self._soften = SPREAD * self._scale / constraints.soft
        body, n = self._body, self._body.cloud.n_owned
        self.forget_schur()
        if self.stiffest > LOW and total(body.cloud.comm, len(sizes)) <= DIRECT[body.dim]:
            of_soft = diagonal.reshape(self._free.shape)[:n] / self._scale
            data = self._compliance, self._soften, of_soft, self._free[:n]
            self._schur = SchurComplement(body, constraints, *data)

    def forget_schur(self) -> bool:
        """Replace the Schur complement by its diagonal; return False if it was the diagonal before."""
        other, self._schur = self._schur, None
        if other is not None:
            other.destroy()
        return other is not None

    def solver(self, levels: TwoLevel, comm: PETSc.Comm, n: int) -> PETSc.KSP:
        """Build MINRES with the two levels as preconditioner (collective)."""
        size = n + len(self._compliance)
        self.mat = PETSc.Mat().createPython(((size, None), (size, None)), context=Shell(self.times), comm=comm)
        self.mat.setUp()
        self.right, self.found = self.mat.createVecs()
        self._soft_mat = PETSc.Mat().createPython(levels.mat.getSizes(), context=Shell(self._soft_product), comm=comm)
        self._soft_mat.setUp()
        self._inner = PETSc.KSP().create(comm=comm)
        self._inner.setOperators(self._soft_mat, levels.mat)
        self._inner.setOptionsPrefix("soft_")
        self._inner.setType("preonly")
        self._inner.getPC().setType("mg")
        levels.equip(self._soft_mat, self._inner)
        self._x, self._y = levels.mat.createVecs()
        ksp = PETSc.KSP().create(comm=comm)
        ksp.setOptionsPrefix("conditions_")
        ksp.setOperators(self.mat, self.mat)
        ksp.setType("minres")
        ksp.setTolerances(atol=0.0, max_it=MOST)
        ksp.getPC().setType("python")
        ksp.getPC().setPythonContext(Shell(self.precondition))
        ksp.setFromOptions()
        return ksp

    def times(self, x: PETSc.Vec, y: PETSc.Vec) -> None:
        """Compute the product of the system with x."""
        n, of, body = self._free.size, self._of, self._body
        values = x.array_r
        u, q = values[:n].reshape(self._free.shape), values[n:]
        np.multiply(u, self._free, out=self._masked)
        f = np.zeros((body.cloud.n_local, body.dim))
        np.add.at(f, of.members, q[self._condition_of][:, None] * of.b)
        result = body.gather(f) + self._soft(self._masked) / self._scale
        local = body.with_ghosts(self._masked)
        strain = np.bincount(self._condition_of, np.einsum("ei,ei->e", of.b, local[of.members]), len(q))
        whole = y.array_w
        whole[:n] = np.where(self._free, result, u).ravel()
        whole[n:] = strain - self._compliance * q

    def precondition(self, x: PETSc.Vec, y: PETSc.Vec) -> None:
        """Apply the two levels and the Schur complement to x."""
        n = self._free.size
        self._x.setArray(x.array_r[:n])
        self._inner.solve(self._x, self._y)
        whole = y.array_w
        whole[:n] = self._y.array_r
        right = x.array_r[n:]
        whole[n:] = right / (self._compliance + self._soften) if self._schur is None else self._schur.solve(right)

    def soft_times(self, x: Float) -> Float:
        """Compute the soft tangent over the scale times unknowns (n_rows * dim,)."""
        u = x.reshape(self._free.shape)
        np.multiply(u, self._free, out=self._masked)
        return np.where(self._free, self._soft(self._masked) / self._scale, u).ravel()

    def _soft_product(self, x: PETSc.Vec, y: PETSc.Vec) -> None:
        y.setArray(self.soft_times(x.array_r))

    def destroy(self) -> None:
        """Free the PETSc objects."""
        self.forget_schur()
        for one in (self._inner, self._soft_mat, self.mat, self.right, self.found, self._x, self._y):
            one.destroy()
