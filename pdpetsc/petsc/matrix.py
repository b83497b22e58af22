"""Tangent matrix in PETSc: allocation, values in place, prescribed degrees of freedom."""

from __future__ import annotations

import numpy as np
from petsc4py import PETSc

from pdpetsc.arrays import GlobalIndex, Mask, row_of_entries
from pdpetsc.discrete.communicator import total
from pdpetsc.discrete.components import rigid_modes
from pdpetsc.discrete.sparsity import Sparsity, positions_of_own_blocks
from pdpetsc.kernels.sparsity import scalar_rows
from pdpetsc.petsc.combination import combination_matrix
from pdpetsc.petsc.library import seq_blocks, values_of
from pdpetsc.petsc.sparse import PER_ENTRY, allocated_bytes, block_matrix, set_rigid_modes, set_symmetry, size_of
from pdpetsc.petsc.tangent import PetscTangent
from pdpetsc.problem.assembly import Assembler
from pdpetsc.problem.problem import Problem
from pdpetsc.problem.state import State


def predicted_bytes(sparsity: Sparsity, dim: int) -> int:
    """Estimate the memory of the matrix over all ranks from its sparsity: values, columns and rows [bytes].

    Notes
    -----
    Collective.
    """
    index = np.dtype(PETSc.IntType).itemsize
    per_rank = sparsity.n_blocks * dim * dim * PER_ENTRY + sparsity.cloud.n_rows * dim * 6 * index
    return int(total(sparsity.cloud.comm, per_rank))


class TangentMatrix(PetscTangent):
    """Store the tangent in an AIJ matrix of block size ``dim`` that an assembler fills in place.

    The matrix is ``C^T K C / scale`` with the constraints ``u = C q + g``. Rows and columns of prescribed and tied
    degrees of freedom contain only 1 on the diagonal, so that the matrix stays symmetric.

    Parameters
    ----------
    assembler : Assembler
        Fills the matrix of a body.
    fixed : (n_rows, dim) bool
        Prescribed degrees of freedom.
    scale : float
        Unit of stiffness in the matrix [force / length].

    Notes
    -----
    Construction and every method are collective. Call ``destroy`` before MPI ends.
    """

    def __init__(self, assembler: Assembler, fixed: Mask, scale: float) -> None:
        self._scale = scale
        self._fixed = fixed.ravel()
        self._build(assembler)

    def _build(self, assembler: Assembler) -> None:
        """Allocate the matrix of an assembler."""
        self._assembler, self._pattern = assembler, assembler.problem.pattern
        problem, sparsity = assembler.problem, assembler.pattern
        fixed = self._fixed.reshape(-1, problem.dim)
        dim, n = problem.dim, problem.body.cloud.n_rows
        self._whole = _allocate(problem, sparsity)
        self._tied = None if problem.supports.ties is None else combination_matrix(problem.supports)
        self.mat = self._whole if self._tied is None else self._combined(None)
        self.preconditioner = self.mat
        rows = sparsity.rows
        self._n_diag = int(rows.diag_ptr[-1]) * dim * dim
        self._n_off = int(rows.off_ptr[-1]) * dim * dim
        other = sparsity.of_other_columns(fixed.astype(np.int8)).astype(bool)
        is_diag, axis = rows.columns < n, np.arange(dim)
        self._zero_diag = _constrained(rows.diag_ptr, rows.columns[is_diag], fixed, fixed)
        self._zero_off = _constrained(rows.off_ptr, rows.columns[~is_diag] - n, fixed, other)
        self._diagonal = positions_of_own_blocks(rows, n, dim)[:, axis, axis].ravel()
        self._handles = seq_blocks(self._whole)
        self._filled = -1
        self.diagonal = np.zeros(n * dim)

    def update(self, state: State, effort: tuple[int, float] | None = None) -> None:
        """Fill the matrix with K. The matrix of a linear problem is filled only if the problem has changed."""
        version = self._assembler.problem.version
        if self._filled == version and self._assembler.problem.linear:
            return
        with values_of(self._handles[0], self._n_diag) as diag, values_of(self._handles[1], self._n_off) as off:
            self._assembler.assemble(state, diag, off)
            self.diagonal = diag[self._diagonal]
            diag *= 1.0 / self._scale
            off *= 1.0 / self._scale
            if self._tied is None:
                diag[self._zero_diag] = 0.0
                off[self._zero_off] = 0.0
                diag[self._diagonal[self._fixed]] = 1.0
        self._whole.assemble()
        if self._tied is not None:
            self._combined(self.mat)
        self.mat.stateIncrease()
        self._filled = version

    def _combined(self, mat: PETSc.Mat | None) -> PETSc.Mat:
        """Compute ``C^T K C`` with 1 on the diagonal of prescribed and tied degrees of freedom, in ``mat`` if given."""
        if mat is None:
            self._whole.assemble()
        found = self._whole.ptap(self._tied, result=mat)
        diagonal = found.getDiagonal()
        diagonal.setArray(np.where(self._fixed, 1.0, diagonal.array_r))
        found.setDiagonal(diagonal)
        diagonal.destroy()
        if mat is None:
            _describe(found, self._assembler.problem)
        return found

    def renew(self) -> bool:
        """Allocate a new matrix if terms couple other particles than before; return True then.

        Bonds that break leave the sparsity as it is.
        """
        problem = self._assembler.problem
        if self._pattern == problem.pattern:
            return False
        self.destroy()
        self._build(type(self._assembler)(problem))
        return True

    def holds(self) -> bool:
        """Return True if the problem has not changed since the last fill, at any displacement (not collective)."""
        return self._filled == self._assembler.problem.version

    def forget(self) -> None:
        """Force the next ``update`` to fill the matrix, since its displacement was rejected (not collective)."""
        self._filled = -1

    @property
    def bytes(self) -> int:
        """Return the memory of the entries that PETSc allocated, over all ranks [bytes]."""
        return allocated_bytes(self.mat)

    def destroy(self) -> None:
        self.mat.destroy()
        if self._tied is not None:
            self._whole.destroy()
            self._tied.destroy()


def _allocate(problem: Problem, sparsity: Sparsity) -> PETSc.Mat:
    dim, cloud = problem.dim, problem.body.cloud
    columns = _global_columns(sparsity)
    rows = sparsity.rows
    block_ptr = rows.diag_ptr + rows.off_ptr
    row_ptr = np.empty(cloud.n_rows * dim + 1, dtype=PETSc.IntType)
    scalar = np.empty(len(columns) * dim * dim, dtype=PETSc.IntType)
    scalar_rows(block_ptr, columns, dim, row_ptr, scalar)
    mat = block_matrix(cloud.comm, size_of(cloud), dim)
    mat.setPreallocationCSR((row_ptr, scalar))
    _describe(mat, problem)
    return mat


def _describe(mat: PETSc.Mat, problem: Problem) -> None:
    """Set the symmetry and the near-null space of the matrix."""
    set_symmetry(mat, problem)
    modes = rigid_modes(problem.body.cloud)
    of_virtual = np.zeros((problem.body.cloud.n_virtual, *modes.shape[1:]))
    set_rigid_modes(mat, np.concatenate([modes, of_virtual]))


def _global_columns(sparsity: Sparsity) -> GlobalIndex:
    """Return the global row of the column of every block, in the order of the rows of a distributed matrix."""
    n, first = sparsity.n_own_columns, sparsity.cloud.first
    columns = sparsity.rows.columns
    other = np.concatenate([sparsity.other_columns, [0]])
    return np.where(columns < n, columns + first, other[np.maximum(columns - n, 0)])


def _constrained(ptr: GlobalIndex, columns: GlobalIndex, fixed_rows: Mask, fixed_columns: Mask) -> GlobalIndex:
    """Return the positions of values in rows or columns of prescribed degrees of freedom."""
    dim = fixed_rows.shape[1]
    row = row_of_entries(ptr)
    touched = fixed_rows.any(axis=1)[row] | fixed_columns.any(axis=1)[columns]
    block = np.flatnonzero(touched)
    row, column = row[block], columns[block]
    width = np.diff(ptr)[row]
    i, k = np.arange(dim)[:, None], np.arange(dim)[None, :]
    start = dim * dim * ptr[row] + dim * (block - ptr[row])
    position = start[:, None, None] + (dim * width)[:, None, None] * i + k
    hit = fixed_rows[row][:, :, None] | fixed_columns[column][:, None, :]
    return np.asarray(position[hit])
