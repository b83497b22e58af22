"""Properties of matrices: symmetry, near-null space and memory."""

from __future__ import annotations

import numpy as np
from petsc4py import PETSc

from pdpetsc.arrays import Float
from pdpetsc.problem.problem import Problem

# Memory of an entry of a sparse matrix, a value and its column [bytes].
PER_ENTRY = 8 + np.dtype(PETSc.IntType).itemsize


def allocated_bytes(*mats: PETSc.Mat) -> int:
    """Return the memory of the entries that PETSc allocated, over all ranks [bytes] (collective)."""
    return int(sum(mat.getInfo(PETSc.Mat.InfoType.GLOBAL_SUM)["nz_allocated"] for mat in mats)) * PER_ENTRY


def set_symmetry(mat: PETSc.Mat, problem: Problem) -> None:
    """Tell PETSc that a matrix is symmetric, now and later, if the tangent of the problem is."""
    if problem.symmetric:
        mat.setOption(PETSc.Mat.Option.SYMMETRIC, True)
        mat.setOption(PETSc.Mat.Option.SYMMETRY_ETERNAL, True)


def set_rigid_modes(mat: PETSc.Mat, modes: Float) -> None:
    """Set the near-null space of a matrix, for coarsening by algebraic multigrid (collective).

    ``modes`` (n, dim, modes) are the rigid motions at the unknowns of its rows.
    """
    basis: list[PETSc.Vec] = []
    for m in range(modes.shape[2]):
        vec = mat.createVecLeft()
        vec.setArray(modes[:, :, m].ravel())
        for earlier in basis:
            vec.axpy(-vec.dot(earlier), earlier)
        if vec.norm() > 0.0:
            vec.normalize()
            basis.append(vec)
        else:
            vec.destroy()
    space = PETSc.NullSpace().create(vectors=basis, comm=mat.getComm())
    mat.setNearNullSpace(space)
    space.destroy()
    for vec in basis:
        vec.destroy()
