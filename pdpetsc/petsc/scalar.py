"""Symmetric systems with one unknown per particle, preconditioned by a similar sparse matrix."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Protocol

import numpy as np
import scipy
from petsc4py import PETSc

from pdpetsc.arrays import Float
from pdpetsc.discrete.cloud import Cloud
from pdpetsc.discrete.communicator import exchange
from pdpetsc.petsc.options import Options

# Shift of the diagonal of the preconditioner, as a share of it. It removes the null space of the preconditioner.
LIFTED = 1e-8
PREFIX = "weights_"
MULTIGRID = {
    "weights_pc_type": "gamg",
    # Without the threshold, weak couplings along the diagonals of families cost three times as many iterations.
    "weights_pc_gamg_threshold": 0.02,
    "weights_mg_levels_ksp_max_it": 3,
    "weights_mg_coarse_pc_type": "svd",
}
FACTOR = {"weights_pc_type": "cholesky", "weights_pc_factor_mat_solver_type": "mumps"}
# Largest number of particles for which the near matrix is factored, by dimension.
DIRECT = {1: 10**7, 2: 250_000, 3: 6_000}
# Largest number of iterations. A system that needs more has almost nothing to solve.
MOST = 2000


class ScalarSystem(Protocol):
    """Define a symmetric positive semidefinite system on the particles of a cloud."""

    cloud: Cloud

    @property
    def null_functions(self) -> Sequence[Float]:
        """Return the functions on the own particles (n_owned,) that span the null space (collective)."""
        ...

    def product(self, values: Float) -> Float:
        """Compute the product with values of the own particles (n_owned, columns) (collective)."""
        ...


class _Product:
    """Provide the system as a PETSc shell matrix."""

    def __init__(self, system: ScalarSystem) -> None:
        self._system = system

    def mult(self, mat: PETSc.Mat, x: PETSc.Vec, y: PETSc.Vec) -> None:
        """Compute the product."""
        with y as values:
            values[:] = self._system.product(x.getArray(readonly=True)[:, None])[:, 0]


class _Preconditioner:
    """Apply the multigrid cycle of the near matrix only. PETSc would smooth with the system on the finest level."""

    def __init__(self, inner: PETSc.PC) -> None:
        self._inner = inner

    def apply(self, pc: PETSc.PC, x: PETSc.Vec, y: PETSc.Vec) -> None:
        """Apply one cycle."""
        self._inner.apply(x, y)


def solve_scalar(
    system: ScalarSystem, near: scipy.sparse.csr_matrix, rhs: Float, rtol: float, options: Options | None = None
) -> tuple[Float, int]:
    """Solve a system whose null space consists of linear functions; return solutions and total iterations.

    Parameters
    ----------
    near : (n_local, n_local) sparse
        Contribution of this rank to the preconditioning matrix, over its particles with ghosts.
    rhs : (n_owned, n) float64
        Right-hand sides; each one is solved.
    rtol : float
        Relative tolerance of the residual.
    options : Options, optional
        Options of the run, which may change the solver; by default only those of the command line.

    Notes
    -----
    Collective. The caller must check the quality of the solution.
    """
    cloud = system.cloud
    sizes = (cloud.n_owned, cloud.n_global)
    found = np.zeros_like(rhs)
    options = Options({}) if options is None else options
    options.suggest(FACTOR if cloud.n_global <= DIRECT[cloud.dim] else MULTIGRID)
    operator = PETSc.Mat().createPython((sizes, sizes), context=_Product(system), comm=cloud.comm)
    operator.setOption(PETSc.Mat.Option.SYMMETRIC, True)
    operator.setUp()
    x = cloud.x[: cloud.n_owned]
    matrix, vectors = assembled(cloud, near), _orthonormal(cloud, [np.ones(len(x)), *x.T])
    near_null_space = PETSc.NullSpace().create(vectors=vectors, comm=cloud.comm)
    matrix.setNearNullSpace(near_null_space)
    exact = _orthonormal(cloud, system.null_functions)
    null_space = PETSc.NullSpace().create(vectors=exact, comm=cloud.comm)
    operator.setNullSpace(null_space)
    ksp = PETSc.KSP().create(comm=cloud.comm)
    ksp.setType("cg")
    ksp.setNormType(PETSc.KSP.NormType.UNPRECONDITIONED)
    ksp.setOperators(operator)
    inner = PETSc.PC().create(comm=cloud.comm)
    inner.setOptionsPrefix(PREFIX)
    inner.setOperators(matrix)
    ksp.getPC().setType("python")
    ksp.getPC().setPythonContext(_Preconditioner(inner))
    ksp.setTolerances(rtol=rtol, atol=0.0, max_it=MOST)
    b, x = matrix.createVecs()
    iterations = 0
    try:
        with options.active():
            inner.setFromOptions()
            inner.setUp()
            for column in range(rhs.shape[1]):
                b.setArray(rhs[:, column])
                x.set(0.0)
                ksp.solve(b, x)
                iterations += ksp.getIterationNumber()
                found[:, column] = x.getArray(readonly=True)
    finally:
        for thing in (ksp, inner, b, x, operator, matrix, near_null_space, null_space, *vectors, *exact):
            thing.destroy()
    return found, iterations


def assembled(cloud: Cloud, near: scipy.sparse.csr_matrix, lifted: float = LIFTED) -> PETSc.Mat:
    """Assemble the sum of the contributions of all ranks, with a diagonal shifted by ``lifted`` (collective)."""
    sizes = (cloud.n_owned, cloud.n_global)
    entries = near.tocoo()
    # Rows of a cloud number its particles first, in the order of ranks.
    rows, columns = cloud.row[entries.row], cloud.row[entries.col]
    firsts = np.array(cloud.comm.allgather(cloud.first))
    owner = np.searchsorted(firsts, rows, side="right") - 1
    (rows, columns, values), _ = exchange(cloud.comm, owner, [rows, columns, entries.data])
    own = scipy.sparse.csr_matrix((values, (rows - cloud.first, columns)), shape=sizes)
    own.sum_duplicates()
    csr = own.indptr.astype(PETSc.IntType), own.indices.astype(PETSc.IntType), own.data
    mat = PETSc.Mat().createAIJ((sizes, sizes), csr=csr, comm=cloud.comm)
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


def _orthonormal(cloud: Cloud, functions: Sequence[Float]) -> list[PETSc.Vec]:
    """Compute an orthonormal basis of functions on the own particles (n_owned,).

    Notes
    -----
    Collective.
    """
    n = cloud.n_owned
    made: list[PETSc.Vec] = []
    for values in functions:
        vector = PETSc.Vec().createMPI((n, cloud.n_global), comm=cloud.comm)
        vector.setArray(values)
        for _ in range(2):
            for other in made:
                vector.axpy(-vector.dot(other), other)
        if vector.norm() > 0.0:
            vector.normalize()
            made.append(vector)
    return made
