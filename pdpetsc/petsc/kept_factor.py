"""Tangent whose factor is kept while it is not needed to count pivots."""

from __future__ import annotations

from petsc4py import PETSc

from pdpetsc.petsc.matrix import TangentMatrix
from pdpetsc.petsc.matrix_free import Product
from pdpetsc.petsc.tangent import PetscTangent
from pdpetsc.problem.problem import Problem
from pdpetsc.problem.state import State

# Products with K for which a factor is kept, by dimension. With the solutions by the factor that belong to them, they
# take about as long as filling and factoring the matrix.
PRODUCTS = {1: 30, 2: 30, 3: 60}


class KeptFactor(PetscTangent):
    """Keep the factor of K as preconditioner, and apply the current K without a matrix.

    A sweep changes the stiffness of few bonds, and each sweep changes it less. A Krylov solver with the factor of an
    earlier sweep then takes less time than filling and factoring the matrix. If damage of a symmetric problem follows
    the displacement, every update fills the matrix, so that its factor has the pivots of K. The first update of a load
    step does too, so that a run from a checkpoint solves with the same factors.

    Parameters
    ----------
    matrix : TangentMatrix
        Matrix of K.
    problem : Problem
        A problem with damage.
    scale : float
        Unit of stiffness in the matrix [force / length].
    """

    def __init__(self, matrix: TangentMatrix, problem: Problem, scale: float) -> None:
        self._problem, self._matrix = problem, matrix
        self._operator = _Operator(Product(problem.supports, scale), matrix)
        self._version, self._step = -1, 0.0
        self._ksp: PETSc.KSP | None = None
        self._create()

    def _create(self) -> None:
        """Create the matrix of type python for the current matrix."""
        self.preconditioner, self.diagonal, self.exact = self._matrix.mat, self._matrix.diagonal, True
        self._operator.product.tangent = None
        comm = self._problem.body.cloud.comm
        self.mat = PETSc.Mat().createPython(self.preconditioner.getSizes(), context=self._operator, comm=comm)
        self.mat.setUp()

    def update(self, state: State, effort: float | None = None) -> None:
        """Update to K at a state; without pivots to count, the factor is kept for some products."""
        problem, damage = self._problem, self._problem.damage
        counts_pivots = problem.symmetric and not (damage is not None and damage.frozen)
        before = self._version >= 0 and self._step == problem.converged
        few = self._operator.count <= PRODUCTS[problem.dim]
        self.exact = counts_pivots or not (before and few and self._preconditions())
        self._step = problem.converged
        if self.exact:
            self._operator.count = 0
            self._matrix.forget()
            self._matrix.update(state)
            self.diagonal = self._matrix.diagonal
        self._operator.product.tangent = None if self.exact else self._problem.linearised(state)
        self._version = self._problem.version
        self.mat.stateIncrease()

    def _preconditions(self) -> bool:
        """Return True if the linear solver iterates with a factor, and its last solve has not failed."""
        ksp = self._ksp
        if ksp is None or ksp.getType() == "preonly" or ksp.getPC().getType() not in ("lu", "cholesky"):
            return False
        return bool(ksp.getConvergedReason() >= 0)

    def equip(self, ksp: PETSc.KSP) -> None:
        """Find out from the linear solver whether a factor can be kept."""
        self._ksp = ksp

    def renew(self) -> bool:
        """Allocate a new matrix if terms couple other particles than before; return True then."""
        if not self._matrix.renew():
            return False
        self.mat.destroy()
        self.forget()
        self._create()
        return True

    def holds(self) -> bool:
        """Return True if the tangent is that of the current problem, at any displacement (not collective)."""
        return self._version == self._problem.version

    def forget(self) -> None:
        """Force the next ``update`` to fill the matrix (not collective)."""
        self._version = -1

    @property
    def bytes(self) -> int:
        """Return the memory of the entries that PETSc allocated, over all ranks [bytes]."""
        return self._matrix.bytes

    def destroy(self) -> None:
        self.mat.destroy()
        self._matrix.destroy()


class _Operator:
    """Apply K by its matrix, or without if a tangent is given, and count the products."""

    def __init__(self, product: Product, matrix: TangentMatrix) -> None:
        self.product, self.count = product, 0
        self._matrix = matrix

    def mult(self, mat: PETSc.Mat, x: PETSc.Vec, y: PETSc.Vec) -> None:
        """Compute the product; called by PETSc."""
        self.count += 1
        if self.product.tangent is None:
            self._matrix.mat.mult(x, y)
        else:
            self.product.mult(mat, x, y)
