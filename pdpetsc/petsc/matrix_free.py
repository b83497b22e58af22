"""The tangent applied without a matrix, preconditioned by a matrix of nearest neighbours."""

from __future__ import annotations

import numpy as np
from petsc4py import PETSc

from pdpetsc.arrays import Mask
from pdpetsc.discrete.communicator import largest
from pdpetsc.petsc.matrix import TangentMatrix
from pdpetsc.petsc.stages import PRECONDITIONER, stage
from pdpetsc.petsc.tangent import PetscTangent
from pdpetsc.problem.nearest_neighbours import NearAssembler
from pdpetsc.problem.problem import Problem, Tangent
from pdpetsc.problem.state import State

# The preconditioner is made anew when a solve takes this many times the iterations per digit of the first one with it.
HARDER = 1.3
# A particle this many times as stiff as when the bounds of the smoother were estimated may lie outside of them.
STIFFER = 1.05


class MatrixFreeTangent(PetscTangent):
    """A Mat of type python that applies ``K(u)`` family by family, and an AIJ matrix of nearest neighbours.

    Both are over ``scale``, and rows and columns of prescribed degrees of freedom hold only 1 on the diagonal.

    Parameters
    ----------
    near : NearAssembler
        Fills the matrix of nearest neighbours.
    fixed : (n_rows, dim) bool
        Prescribed degrees of freedom.
    scale : float
        The stiffness that is 1 in both [force / length].
    """

    def __init__(self, near: NearAssembler, fixed: Mask, scale: float) -> None:
        self._near = near
        self._fixed, self._scale = fixed, scale
        self._problem: Problem = near.problem
        self._rebuilds = self._problem.rebuilds
        self._matrix = TangentMatrix(near, fixed, scale)
        self.preconditioner, self.diagonal = self._matrix.mat, self._matrix.diagonal
        self._product = _Product(fixed, scale)
        sizes = self._matrix.mat.getSizes()
        self.mat = PETSc.Mat().createPython(sizes, context=self._product, comm=self._problem.body.cloud.comm)
        if self._problem.symmetric:
            self.mat.setOption(PETSc.Mat.Option.SYMMETRIC, True)
            self.mat.setOption(PETSc.Mat.Option.SYMMETRY_ETERNAL, True)
        self.mat.setUp()
        self._version = -1
        self._effort: float | None = None
        self._strength = np.empty(0)

    def update(self, state: State, effort: float | None = None) -> None:
        """Make it K at a state; the nearest neighbours stay as they are while linear solves do not get harder."""
        version = self._problem.version
        if self._problem.linear and self.holds():
            return
        keep = self._does_well(effort) and self._problem.damage is None
        tangent = self._problem.linearised(state) if keep else None
        if tangent is None or self._stiffer(tangent):
            self._matrix.forget()
            with stage(PRECONDITIONER):
                self._matrix.update(state)
            tangent, self._effort = self._near.tangent, None
            self._strength = tangent.strength()
            self.diagonal = self._matrix.diagonal
        # The assembler does not keep the moduli of another displacement.
        self._near.tangent = self._product.tangent = tangent
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
        ratio = float(np.max(tangent.strength() / np.maximum(self._strength, np.finfo(float).tiny), initial=0.0))
        return largest(self._problem.body.cloud.comm, ratio) > STIFFER

    def renew(self) -> bool:
        """Choose nearest neighbours anew where bonds have broken or mended."""
        if self._rebuilds == self._problem.rebuilds:
            return False
        self._rebuilds = self._problem.rebuilds
        self._matrix.destroy()
        self._near = NearAssembler(self._problem)
        self._matrix = TangentMatrix(self._near, self._fixed, self._scale)
        self.preconditioner = self._matrix.mat
        self.forget()
        return True

    def holds(self) -> bool:
        """Return whether it is a tangent of the problem as it is, at whatever displacement (not collective)."""
        return self._rebuilds == self._problem.rebuilds and self._version == self._problem.version

    def forget(self) -> None:
        """Let the next ``update`` make it anew (not collective)."""
        self._version = -1

    @property
    def bytes(self) -> int:
        """Return the memory of the entries of the matrix of nearest neighbours, over all ranks [bytes]."""
        return self._matrix.bytes

    def destroy(self) -> None:
        """Free the PETSc objects."""
        self.mat.destroy()
        self._matrix.destroy()


class _Product:
    """The tangent times a vector, with the rows of prescribed degrees of freedom."""

    def __init__(self, fixed: Mask, scale: float) -> None:
        self._fixed, self._free = fixed, ~fixed
        self._weight = self._free / scale
        self._masked = np.zeros(fixed.shape)
        self.tangent: Tangent | None = None

    def mult(self, mat: PETSc.Mat, x: PETSc.Vec, y: PETSc.Vec) -> None:
        """Multiply; PETSc calls it."""
        assert self.tangent is not None
        values = x.array_r.reshape(self._free.shape)
        np.multiply(values, self._free, out=self._masked)
        product = self.tangent(self._masked)
        result = y.array_w.reshape(self._free.shape)
        np.multiply(product, self._weight, out=result)
        np.copyto(result, values, where=self._fixed)
