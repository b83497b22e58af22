"""The tangent applied without a matrix, and when what preconditions it is made anew."""

from __future__ import annotations

from abc import ABC, abstractmethod

import numpy as np
from petsc4py import PETSc

from pdpetsc.arrays import Float, Mask
from pdpetsc.discrete.communicator import largest
from pdpetsc.petsc.matrix import TangentMatrix
from pdpetsc.petsc.stages import PRECONDITIONER, stage
from pdpetsc.petsc.tangent import PetscTangent
from pdpetsc.problem.nearest_neighbours import NearAssembler
from pdpetsc.problem.problem import Problem, Tangent
from pdpetsc.problem.state import State
from pdpetsc.problem.supports import Supports

# The preconditioner is made anew when a solve takes this many times the iterations per digit of the first one with it.
HARDER = 1.3
# A particle this many times as stiff as when the bounds of the smoother were estimated may lie outside of them.
STIFFER = 1.05


class Preconditioning(ABC):
    """What a preconditioner of a tangent without a matrix is made from.

    Attributes
    ----------
    mat : Mat
        The matrix that PETSc is given for it, over the scale of the tangent.
    diagonal : (n_rows * dim,) float64
        Diagonal of the tangent, or an estimate of it [force / length].
    bounded : bool
        Whether what smooths holds for the stiffness that it has seen only.

    Notes
    -----
    Every method is collective.
    """

    mat: PETSc.Mat
    diagonal: Float
    bounded: bool = True

    @abstractmethod
    def fill(self, state: State) -> Tangent:
        """Make it that of a state; return the tangent there."""

    @abstractmethod
    def renewed(self) -> Preconditioning:
        """Return another one for the bonds that there are now; this one is gone then."""

    def equip(self, tangent: PETSc.Mat, ksp: PETSc.KSP) -> None:  # noqa: B027
        """Give a linear solver of the tangent what options alone do not."""

    @property
    @abstractmethod
    def bytes(self) -> int:
        """Return the memory of the entries of its matrices, over all ranks [bytes]."""

    @abstractmethod
    def destroy(self) -> None:
        """Free the PETSc objects."""


class MatrixFreeTangent(PetscTangent):
    """A Mat of type python that applies ``K(u)`` family by family, and what preconditions it.

    Both are over a scale, and rows and columns of prescribed degrees of freedom hold only 1 on the diagonal.

    Parameters
    ----------
    problem : Problem
        Whose tangent it is.
    preconditioning : Preconditioning
        What the preconditioner is made from, over the same scale.
    fixed : (n_rows, dim) bool
        Prescribed degrees of freedom.
    scale : float
        The stiffness that is 1 in both [force / length].
    """

    def __init__(self, problem: Problem, preconditioning: Preconditioning, fixed: Mask, scale: float) -> None:
        self._problem = problem
        self._rebuilds = problem.rebuilds
        self._made_from = preconditioning
        self.preconditioner, self.diagonal = preconditioning.mat, preconditioning.diagonal
        self._product = _Product(problem.supports, scale)
        sizes = self.preconditioner.getSizes()
        self.mat = PETSc.Mat().createPython(sizes, context=self._product, comm=problem.body.cloud.comm)
        if problem.symmetric:
            self.mat.setOption(PETSc.Mat.Option.SYMMETRIC, True)
            self.mat.setOption(PETSc.Mat.Option.SYMMETRY_ETERNAL, True)
        self.mat.setUp()
        self._version = -1
        self._effort: float | None = None
        self._strength = np.empty(0)

    def update(self, state: State, effort: float | None = None) -> None:
        """Make it K at a state; what preconditions it stays as it is while linear solves do not get harder."""
        version = self._problem.version
        if self._problem.linear and self.holds():
            return
        keep = self._does_well(effort) and self._problem.bond_damage is None
        tangent = self._problem.linearised(state) if keep else None
        if tangent is None or self._stiffer(tangent):
            with stage(PRECONDITIONER):
                tangent = self._made_from.fill(state)
            self._effort = None
            self._strength = tangent.strength()
            self.diagonal = self._made_from.diagonal
        self._product.tangent = tangent
        self._version = version
        self.mat.stateIncrease()

    def _does_well(self, effort: float | None) -> bool:
        """Return whether the preconditioner does as well as when it was new; the first solve with it tells how well."""
        if effort is None or self._version < 0:
            return False
        if self._effort is None:
            self._effort = effort
        return effort <= HARDER * self._effort

    def _stiffer(self, tangent: Tangent) -> bool:
        """Return whether a particle is much stiffer than when the bounds of the smoother were estimated."""
        if not self._made_from.bounded:
            return False
        ratio = float(np.max(tangent.strength() / np.maximum(self._strength, np.finfo(float).tiny), initial=0.0))
        return largest(self._problem.body.cloud.comm, ratio) > STIFFER

    def renew(self) -> bool:
        """Choose anew what preconditions it where bonds have broken or mended."""
        if self._rebuilds == self._problem.rebuilds:
            return False
        self._rebuilds = self._problem.rebuilds
        self._made_from = self._made_from.renewed()
        self.preconditioner = self._made_from.mat
        self.forget()
        return True

    def equip(self, ksp: PETSc.KSP) -> None:
        """Give a linear solver, whose options are set, what options alone do not."""
        self._made_from.equip(self.mat, ksp)

    def holds(self) -> bool:
        """Return whether it is a tangent of the problem as it is, at whatever displacement (not collective)."""
        return self._rebuilds == self._problem.rebuilds and self._version == self._problem.version

    def forget(self) -> None:
        """Let the next ``update`` make it anew (not collective)."""
        self._version = -1

    @property
    def bytes(self) -> int:
        """Return the memory of the entries of the matrices that precondition it, over all ranks [bytes]."""
        return self._made_from.bytes

    def destroy(self) -> None:
        """Free the PETSc objects."""
        self.mat.destroy()
        self._made_from.destroy()


class NearMatrix(Preconditioning):
    """A matrix of nearest neighbours, of which any of PETSc's preconditioners can be made.

    Parameters
    ----------
    near : NearAssembler
        Fills it.
    fixed : (n_rows, dim) bool
        Prescribed degrees of freedom.
    scale : float
        The stiffness that is 1 in it [force / length].
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
        """Return that of the nearest neighbours that hold now."""
        self.destroy()
        return NearMatrix(NearAssembler(self._near.problem), self._fixed, self._scale)

    @property
    def bytes(self) -> int:
        """Return the memory of its entries, over all ranks [bytes]."""
        return self._matrix.bytes

    def destroy(self) -> None:
        """Free the PETSc object."""
        self._matrix.destroy()


class _Product:
    """``C^T K C`` times a vector, with the rows of prescribed and tied degrees of freedom."""

    def __init__(self, supports: Supports, scale: float) -> None:
        self._supports, self._fixed, self._free = supports, supports.fixed, ~supports.fixed
        self._weight = self._free / scale
        self._masked = np.zeros(self._fixed.shape)
        self.tangent: Tangent | None = None

    def mult(self, mat: PETSc.Mat, x: PETSc.Vec, y: PETSc.Vec) -> None:
        """Multiply; PETSc calls it."""
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
