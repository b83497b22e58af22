"""Solution of the system of conforming weights."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from contextlib import contextmanager

import numpy as np
from petsc4py import PETSc

from pdpetsc.arrays import Float
from pdpetsc.discrete.communicator import Comm, total
from pdpetsc.gradient.conforming_system import ConformingSystem
from pdpetsc.gradient.near_inverse import NearInverse
from pdpetsc.petsc.options import Options
from pdpetsc.petsc.shell import Shell
from pdpetsc.petsc.sparse import assembled, orthonormal

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
# Mean number of entries of a row below which aggregates of multigrid are small: half the iterations. With longer rows
# they take seven times as long to set up.
SHORT = 50
FACTOR = {"weights_pc_type": "cholesky", "weights_pc_factor_mat_solver_type": "mumps"}


class _Preconditioner:
    """Apply an approximate inverse, with a factor or a multigrid cycle of its matrices (construction is collective)."""

    def __init__(self, near: NearInverse, comm: Comm, options: Options) -> None:
        self._near, n = near, len(near.x)
        self._inner: list[PETSc.PC] = []
        count = int(total(comm, n))
        direct = count <= near.direct[near.x.shape[1]]
        options.suggest(FACTOR if direct else MULTIGRID)
        vectors = orthonormal(comm, [np.ones(n), *near.x.T])
        linear = PETSc.NullSpace().create(vectors=vectors, comm=comm)
        for triplets in near.matrices:
            matrix = assembled(comm, (n, count), triplets, LIFTED)
            if not direct:
                short = matrix.getInfo(PETSc.Mat.InfoType.GLOBAL_SUM)["nz_used"] < SHORT * count
                options.suggest({"weights_pc_gamg_aggressive_coarsening": 0 if short else 1})
            matrix.setNearNullSpace(linear)
            pc = PETSc.PC().create(comm=comm)
            pc.setOptionsPrefix(PREFIX)
            pc.setOperators(matrix)
            self._inner.append(pc)
            with options.active():
                pc.setFromOptions()
                pc.setUp()
            matrix.destroy()
        self._b, self._x = (PETSc.Vec().createMPI((n, count), comm=comm) for _ in range(2))
        for thing in (linear, *vectors):
            thing.destroy()

    def apply(self, pc: PETSc.PC, x: PETSc.Vec, y: PETSc.Vec) -> None:
        """Apply the approximate inverse."""
        near, dim = self._near, self._near.x.shape[1]
        r = x.array_r.reshape(-1, dim)
        values = near.restrict(r)
        solved = np.empty_like(values)
        for component in range(dim):
            self._b.setArray(values[:, component])
            self._inner[component % len(self._inner)].apply(self._b, self._x)
            solved[:, component] = self._x.array_r
        y.setArray((r * near.inverse_diagonal + near.interpolate(solved)).ravel())

    def destroy(self, pc: PETSc.PC) -> None:
        """Free the PETSc objects; called by PETSc with the last use of the preconditioner."""
        for thing in (*self._inner, self._b, self._x):
            thing.destroy()


def _without_null_functions(null_space: PETSc.NullSpace, x: PETSc.Vec, system: ConformingSystem) -> None:
    """Remove the null functions of the system from a vector; called by PETSc."""
    values = x.array_r.reshape(-1, system.cloud.dim)
    x.setArray(system.without_null_functions(values).ravel())


@contextmanager
def solve_conforming(
    system: ConformingSystem, near: NearInverse, options: Options | None = None
) -> Iterator[Callable[[Float, float], tuple[Float, int]]]:
    """Provide a function that solves the system of conforming weights for all components.

    It takes a right-hand side (n_owned, dim) and the relative tolerance of its residual, and returns the multipliers
    and the number of iterations.

    Parameters
    ----------
    near : NearInverse
        Approximate inverse.
    options : Options, optional
        Options of the run, which may change the preconditioner; by default only those of the command line.

    Notes
    -----
    Collective. The caller must check the quality of the solution.
    """
    cloud = system.cloud
    sizes = (cloud.n_owned * cloud.dim, cloud.n_global * cloud.dim)

    def product(x: PETSc.Vec, y: PETSc.Vec) -> None:
        y.setArray(system.product(x.array_r.reshape(-1, cloud.dim)).ravel())

    operator = PETSc.Mat().createPython((sizes, sizes), context=Shell(product), comm=cloud.comm)
    operator.setOption(PETSc.Mat.Option.SYMMETRIC, True)
    operator.setUp()
    null_space = PETSc.NullSpace().create(comm=cloud.comm)
    null_space.setFunction(_without_null_functions, (system,))
    operator.setNullSpace(null_space)
    ksp = PETSc.KSP().create(comm=cloud.comm)
    b, x = operator.createVecs()

    def solve(rhs: Float, rtol: float) -> tuple[Float, int]:
        ksp.setTolerances(rtol=rtol, atol=0.0, max_it=near.most)
        ksp.setConvergenceHistory(near.most + 1, reset=True)
        b.setArray(rhs.ravel())
        ksp.solve(b, x)
        iterations = ksp.getIterationNumber()
        if ksp.getConvergedReason() < 0 and iterations < near.most:
            # Near round-off the singular system ceases to be positive, after an iterate that may be worse than before.
            best = int(np.argmin(ksp.getConvergenceHistory()))
            ksp.setTolerances(max_it=max(best, 1))
            ksp.solve(b, x)
            iterations += ksp.getIterationNumber()
        return np.array(x.array_r).reshape(rhs.shape), iterations

    try:
        ksp.setType("cg")
        ksp.setNormType(PETSc.KSP.NormType.UNPRECONDITIONED)
        ksp.setOperators(operator)
        ksp.getPC().setType("python")
        ksp.getPC().setPythonContext(_Preconditioner(near, cloud.comm, Options({}) if options is None else options))
        yield solve
    finally:
        for thing in (ksp, b, x, operator, null_space):
            thing.destroy()
