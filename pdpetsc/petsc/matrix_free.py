"""Matrix-free tangent, and the rules for rebuilding its preconditioner."""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Callable

import numpy as np
from petsc4py import PETSc

from pdpetsc.arrays import Float, Mask
from pdpetsc.discrete.communicator import anywhere, largest
from pdpetsc.petsc.matrix import TangentMatrix
from pdpetsc.petsc.slow_modes import SlowModes
from pdpetsc.petsc.sparse import set_symmetry
from pdpetsc.petsc.stages import PRECONDITIONER, stage
from pdpetsc.petsc.tangent import PetscTangent
from pdpetsc.problem.nearest_neighbours import NearAssembler
from pdpetsc.problem.problem import Problem, Tangent
from pdpetsc.problem.state import State
from pdpetsc.problem.supports import Supports

# The preconditioner is rebuilt if the solves with it have needed this many iterations more than the first ones did.
# A rebuild costs about as much.
REBUILD = 15.0
# Solves with a preconditioner that determine its iterations per digit. The first digits of a smooth load come easily.
FIRST = 2
# Estimated bounds of the smoother may be invalid if a particle has become stiffer by this factor.
STIFFER = 1.05


class Preconditioning(ABC):
    """Provide the matrix for the preconditioner of a matrix-free tangent.

    Attributes
    ----------
    mat : Mat
        Preconditioning matrix for PETSc, over the scale of the tangent.
    diagonal : (n_rows * dim,) float64
        Diagonal of the tangent, or an estimate of it [force / length].
    bounded : bool
        Whether the smoother is valid only up to the stiffness at which it was set up.
    slow : SlowModes or None
        Modes that it learns from the solves.

    Notes
    -----
    Every method is collective.
    """

    mat: PETSc.Mat
    diagonal: Float
    bounded: bool = True
    slow: SlowModes | None = None

    @abstractmethod
    def fill(self, state: State) -> Tangent:
        """Update to a state; return the tangent there."""

    @abstractmethod
    def renewed(self) -> Preconditioning:
        """Build a new object for the current bonds, and free this one."""

    def equip(self, tangent: PETSc.Mat, ksp: PETSc.KSP) -> None:  # noqa: B027
        """Set properties of a linear solver of the tangent that options cannot set."""

    @property
    @abstractmethod
    def bytes(self) -> int:
        """Return the memory of the matrix entries over all ranks [bytes]."""

    @abstractmethod
    def destroy(self) -> None:
        """Free the PETSc objects."""


class MatrixFreeTangent(PetscTangent):
    """Apply ``K(u)`` family by family in a Mat of type python, and manage its preconditioner.

    Both are divided by a scale. Rows and columns of prescribed degrees of freedom contain only 1 on the diagonal.

    Parameters
    ----------
    problem : Problem
        The problem.
    preconditioning : Preconditioning
        Preconditioning matrix, over the same scale.
    fixed : (n_rows, dim) bool
        Prescribed degrees of freedom.
    scale : float
        Unit of stiffness in both [force / length].
    """

    def __init__(self, problem: Problem, preconditioning: Preconditioning, fixed: Mask, scale: float) -> None:
        self._problem = problem
        self._rebuilds = problem.rebuilds
        self._made_from = preconditioning
        self.preconditioner, self.diagonal = preconditioning.mat, preconditioning.diagonal
        self._product = _Product(problem.supports, scale)
        sizes = self.preconditioner.getSizes()
        self.mat = PETSc.Mat().createPython(sizes, context=self._product, comm=problem.body.cloud.comm)
        set_symmetry(self.mat, problem)
        self.mat.setUp()
        self._version = -1
        # Whether slow modes are those of the current tangent.
        self._renewed = False
        self._usual, self._solves, self._lost = 0.0, 0, 0.0
        self._strength, self._n_stiff = np.empty(0), 0

    def update(self, state: State, effort: tuple[int, float] | None = None) -> None:
        """Update to K at a state. The preconditioner is kept until it has cost as much as a rebuild."""
        version = self._problem.version
        if self._problem.linear and self.holds():
            return
        keep = self._does_well(effort) and self._problem.bond_damage is None
        tangent = self._problem.linearised(state) if keep else None
        if tangent is None or self._stiffer(tangent):
            with stage(PRECONDITIONER):
                tangent = self._made_from.fill(state)
            self._usual, self._solves, self._lost = 0.0, 0, 0.0
            self._strength, self._n_stiff = tangent.strength(), tangent.n_stiff
            self.diagonal = self._made_from.diagonal
        self._product.tangent = tangent
        self._renewed = False
        self._version = version
        self.mat.stateIncrease()

    def _does_well(self, effort: tuple[int, float] | None) -> bool:
        """Return True if the preconditioner has cost fewer iterations than it would cost to rebuild it."""
        if effort is None or self._version < 0:
            return False
        iterations, digits = effort
        self._solves += 1
        if self._solves <= FIRST:
            self._usual = max(self._usual, iterations / digits)
        self._lost += max(0.0, iterations - self._usual * digits)
        return self._lost <= REBUILD

    def _stiffer(self, tangent: Tangent) -> bool:
        """Return True if a particle is much stiffer than at the estimate of the bounds of the smoother.

        So are particles of facets that have come into contact.
        """
        if not self._made_from.bounded:
            return False
        comm = self._problem.body.cloud.comm
        if self._problem.stiff and anywhere(comm, tangent.n_stiff != self._n_stiff):
            return True
        ratio = float(np.max(tangent.strength() / np.maximum(self._strength, np.finfo(float).tiny), initial=0.0))
        return largest(comm, ratio) > STIFFER

    def renew(self) -> bool:
        """Rebuild the preconditioner if bonds have broken or mended; return True if it was rebuilt."""
        if self._rebuilds == self._problem.rebuilds:
            return False
        self._rebuilds = self._problem.rebuilds
        self._made_from = self._made_from.renewed()
        self.preconditioner = self._made_from.mat
        self.forget()
        return True

    def equip(self, ksp: PETSc.KSP) -> None:
        """Set properties of a linear solver that options cannot set; its options must be set before."""
        self._made_from.equip(self.mat, ksp)

    def solve(self, ksp: PETSc.KSP, b: PETSc.Vec, x: PETSc.Vec) -> None:
        """Solve ``K x = b``. The preconditioner learns the slow modes of this solve for the next one."""
        slow = self._made_from.slow
        if slow is None:
            ksp.solve(b, x)
            return
        if not self._renewed:
            ksp.setUp()
            slow.renew(self.mat, ksp.getPC())
            self._renewed = True
        self._product.watch = slow.watch
        ksp.solve(b, x)
        self._product.watch = None
        slow.keep()

    def holds(self) -> bool:
        """Return True if the tangent is that of the current problem, at any displacement (not collective)."""
        return self._rebuilds == self._problem.rebuilds and self._version == self._problem.version

    def forget(self) -> None:
        """Force the next ``update`` to rebuild the tangent (not collective)."""
        self._version = -1

    @property
    def bytes(self) -> int:
        """Return the memory of the entries of the preconditioning matrices over all ranks [bytes]."""
        return self._made_from.bytes

    def destroy(self) -> None:
        self.mat.destroy()
        self._made_from.destroy()


class NearMatrix(Preconditioning):
    """Store the matrix of nearest neighbours, for any of PETSc's preconditioners.

    Parameters
    ----------
    near : NearAssembler
        Assembler of the matrix.
    fixed : (n_rows, dim) bool
        Prescribed degrees of freedom.
    scale : float
        Unit of stiffness in the matrix [force / length].
    """

    def __init__(self, near: NearAssembler, fixed: Mask, scale: float) -> None:
        self._near, self._fixed, self._scale = near, fixed, scale
        self._matrix = TangentMatrix(near, fixed, scale)
        self.mat, self.diagonal = self._matrix.mat, self._matrix.diagonal

    def fill(self, state: State) -> Tangent:
        """Fill the matrix; return the tangent of the whole body."""
        self._matrix.forget()
        self._matrix.update(state)
        self.diagonal = self._matrix.diagonal
        return self._near.take_tangent()

    def renewed(self) -> Preconditioning:
        """Build a new matrix for the nearest neighbours that are still bonded."""
        self.destroy()
        return NearMatrix(NearAssembler(self._near.problem), self._fixed, self._scale)

    @property
    def bytes(self) -> int:
        """Return the memory of the matrix entries over all ranks [bytes]."""
        return self._matrix.bytes

    def destroy(self) -> None:
        self._matrix.destroy()


class _Product:
    """Apply ``C^T K C`` to a vector, with the rows of prescribed and tied degrees of freedom."""

    def __init__(self, supports: Supports, scale: float) -> None:
        self._supports, self._fixed, self._free = supports, supports.fixed, ~supports.fixed
        self._weight = self._free / scale
        self._masked = np.zeros(self._fixed.shape)
        self.tangent: Tangent | None = None
        self.watch: Callable[[Float, Float], None] | None = None

    def mult(self, mat: PETSc.Mat, x: PETSc.Vec, y: PETSc.Vec) -> None:
        """Compute the product; called by PETSc."""
        assert self.tangent is not None
        values = x.array_r.reshape(self._free.shape)
        if self._supports.ties is None:
            np.multiply(values, self._free, out=self._masked)
            product = self.tangent(self._masked)
        else:
            product = self._supports.reduced(self.tangent(self._supports.completed(values)))
        result = y.array_w.reshape(self._free.shape)
        np.multiply(product, self._weight, out=result)
        np.copyto(result, values, where=self._fixed)
        if self.watch is not None:
            self.watch(values.ravel(), result.ravel())
