"""Symmetric systems with one number per particle, preconditioned by a sparse matrix that resembles them."""

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

# What is added to the diagonal of the preconditioner, as a share of it: its null space has none of its own.
LIFTED = 1e-8
PREFIX = "weights_"
MULTIGRID = {
    "weights_pc_type": "gamg",
    # Without it weak couplings along the diagonals of families cost three times as many iterations.
    "weights_pc_gamg_threshold": 0.02,
    "weights_mg_levels_ksp_max_it": 3,
    "weights_mg_coarse_pc_type": "svd",
}
FACTOR = {"weights_pc_type": "cholesky", "weights_pc_factor_mat_solver_type": "mumps"}
# Largest number of particles for which the near matrix is factored, by dimension.
DIRECT = {1: 10**7, 2: 250_000, 3: 6_000}
# Iterations at most; a system that takes more has hardly anything to solve for.
MOST = 2000


class ScalarSystem(Protocol):
    """A symmetric positive semidefinite system on the particles of a cloud."""

    cloud: Cloud

    @property
    def null_functions(self) -> Sequence[Float]:
        """Return the functions on the own particles (n_owned,) that span its null space (collective)."""
        ...

    def product(self, values: Float) -> Float:
        """Return the product with numbers of the own particles (n_owned, columns) (collective)."""
        ...


class _Product:
    """The system as PETSc calls it."""

    def __init__(self, system: ScalarSystem) -> None:
        self._system = system

    def mult(self, mat: PETSc.Mat, x: PETSc.Vec, y: PETSc.Vec) -> None:
        """Write the product."""
        with y as values:
            values[:] = self._system.product(x.getArray(readonly=True)[:, None])[:, 0]


class _Preconditioner:
    """The cycle of the near matrix alone: PETSc's own would smooth with the system on its finest level."""

    def __init__(self, inner: PETSc.PC) -> None:
        self._inner = inner

    def apply(self, pc: PETSc.PC, x: PETSc.Vec, y: PETSc.Vec) -> None:
        """Write the cycle's correction."""
        self._inner.apply(x, y)


def solve_scalar(
    system: ScalarSystem, near: scipy.sparse.csr_matrix, rhs: Float, rtol: float, options: Options | None = None
) -> tuple[Float, int]:
    """Return the solutions of a system whose null space are linear functions, and the iterations of all of them.

    Parameters
    ----------
    near : (n_local, n_local) sparse
        What the rank adds to the matrix that preconditions it, over its particles with ghosts.
    rhs : (n_owned, n) float64
        Right-hand sides, of which every one is solved for.
    rtol : float
        Relative tolerance of the residual.
    options : Options, optional
        Those of the run, which may change the solver; none but the command line's by default.

    Notes
    -----
    Collective. Whether the solution is good is for the caller to judge.
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
    """Return the sum over ranks of what each adds, its diagonal lifted by a share of it (collective)."""
    sizes = (cloud.n_owned, cloud.n_global)
    entries = near.tocoo()
    # Rows of a cloud count its particles first, in the order of ranks.
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
    """Return an orthonormal basis of functions on the own particles (n_owned,).

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
