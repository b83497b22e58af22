"""Sparse matrices: their assembly from entries of all ranks, symmetry, near-null space and memory."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
import scipy
from petsc4py import PETSc

from pdpetsc.arrays import Float
from pdpetsc.discrete.cloud import Cloud
from pdpetsc.discrete.communicator import Comm, exchange, offset, owners
from pdpetsc.gradient.near_inverse import Triplets
from pdpetsc.problem.problem import Problem

# Memory of an entry of a sparse matrix, a value and its column [bytes].
PER_ENTRY = 8 + np.dtype(PETSc.IntType).itemsize


def size_of(cloud: Cloud) -> tuple[int, int]:
    """Return the number of own unknowns, and of those of all ranks."""
    return cloud.n_rows * cloud.dim, (cloud.n_global + cloud.n_virtual_global) * cloud.dim


def block_matrix(comm: Comm, size: tuple[int, int], dim: int) -> PETSc.Mat:
    """Return an AIJ matrix in blocks of ``dim`` without entries, of this number of own and of all rows (collective)."""
    mat = PETSc.Mat().create(comm=comm)
    mat.setSizes((size, size), bsize=dim)
    mat.setType("aij")
    return mat


def assembled(comm: Comm, sizes: tuple[int, int], triplets: Triplets, lifted: float) -> PETSc.Mat:
    """Assemble the sum of the triplets of all ranks, with a diagonal shifted by ``lifted`` (collective).

    ``sizes`` are the number of own rows and that of all rows.
    """
    first = offset(comm, sizes[0])
    owner, _ = owners(comm, first, triplets.rows)
    (rows, columns, values), _ = exchange(comm, owner, list(triplets))
    own = scipy.sparse.csr_matrix((values, (rows - first, columns)), shape=sizes)
    own.sum_duplicates()
    csr = own.indptr.astype(PETSc.IntType), own.indices.astype(PETSc.IntType), own.data
    mat = PETSc.Mat().createAIJ((sizes, sizes), csr=csr, comm=comm)
    if not lifted:
        return mat
    diagonal = mat.getDiagonal()
    diagonal.scale(lifted)
    diagonal.shift(float(diagonal.max()[1]) * lifted)
    mat.setOption(PETSc.Mat.Option.NEW_NONZERO_ALLOCATION_ERR, False)
    mat.setDiagonal(diagonal, addv=True)
    mat.assemble()
    mat.setOption(PETSc.Mat.Option.SPD, True)
    diagonal.destroy()
    return mat


def allocated_bytes(*mats: PETSc.Mat) -> int:
    """Return the memory of the entries that PETSc allocated, over all ranks [bytes] (collective)."""
    return int(sum(mat.getInfo(PETSc.Mat.InfoType.GLOBAL_SUM)["nz_allocated"] for mat in mats)) * PER_ENTRY


def set_symmetry(mat: PETSc.Mat, problem: Problem) -> None:
    """Tell PETSc that a matrix is symmetric, now and later, if the tangent of the problem is."""
    if problem.symmetric:
        mat.setOption(PETSc.Mat.Option.SYMMETRIC, True)
        mat.setOption(PETSc.Mat.Option.SYMMETRY_ETERNAL, True)


def orthonormal(comm: PETSc.Comm | Comm, functions: Sequence[Float]) -> list[PETSc.Vec]:
    """Compute an orthonormal basis of functions on own unknowns (n,), which the caller destroys (collective)."""
    basis: list[PETSc.Vec] = []
    for values in functions:
        vector = PETSc.Vec().createMPI((len(values), PETSc.DECIDE), comm=comm)
        vector.setArray(values)
        for _ in range(2):
            for earlier in basis:
                vector.axpy(-vector.dot(earlier), earlier)
        if vector.norm() > 0.0:
            vector.normalize()
            basis.append(vector)
        else:
            vector.destroy()
    return basis


def set_rigid_modes(mat: PETSc.Mat, modes: Float) -> None:
    """Set the near-null space of a matrix, for coarsening by algebraic multigrid (collective).

    ``modes`` (n, dim, modes) are the rigid motions at the unknowns of its rows.
    """
    basis = orthonormal(mat.getComm(), [modes[:, :, m].ravel() for m in range(modes.shape[2])])
    space = PETSc.NullSpace().create(vectors=basis, comm=mat.getComm())
    mat.setNearNullSpace(space)
    space.destroy()
    for vec in basis:
        vec.destroy()
