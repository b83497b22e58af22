"""Assembled symmetric systems with one unknown per particle and prescribed values."""

from __future__ import annotations

import numpy as np
import scipy
from petsc4py import PETSc

from pdpetsc.arrays import Float, Mask
from pdpetsc.discrete.cloud import Cloud
from pdpetsc.discrete.communicator import norm, total
from pdpetsc.gradient.near_inverse import Triplets
from pdpetsc.petsc.options import Options
from pdpetsc.petsc.sparse import assembled

PREFIX = "heat_"
RTOL = 1e-13
# A solution is accepted if its residual is below this share of the right-hand side,
GOOD = 1e-10
# or below this multiple of the round-off of the diagonal times the values.
FLOOR = 20.0
MOST = 2000
# Largest number of particles for which the matrix is factored, by dimension.
DIRECT = {1: 10**7, 2: 250_000, 3: 6_000}
# Shift of the diagonal of the preconditioner, as a share of the largest entry. The inverse of the shift multiplies the
# round-off of the mean value of unsupported pieces.
LIFTED = 1e-6
MULTIGRID = {"heat_pc_type": "gamg", "heat_pc_gamg_threshold": 0.02, "heat_mg_coarse_pc_type": "svd"}
FACTOR = {"heat_pc_type": "cholesky", "heat_pc_factor_mat_solver_type": "mumps"}


class ScalarMatrix:
    """Solve ``A x = b`` with prescribed x at some particles.

    Parameters
    ----------
    cloud : Cloud
        The particles.
    of_rank : (n_local, n_local) sparse
        Contribution of this rank to A, over its particles with ghosts.
    held : (n_owned,) bool
        Particles with prescribed x.
    options : Options
        Options of the run.

    Attributes
    ----------
    mat : PETSc.Mat
        A, with rows and columns of prescribed values and isolated particles replaced by a diagonal.
    near : PETSc.Mat
        ``mat`` with a shifted diagonal, which is regular for unsupported pieces.
    scale : float
        The largest entry of the diagonal, 1 if A is zero.

    Notes
    -----
    Construction and every method are collective. Call ``destroy`` before MPI ends.
    """

    def __init__(self, cloud: Cloud, of_rank: scipy.sparse.csr_matrix, held: Mask, options: Options) -> None:
        self._cloud = cloud
        self._held = held
        self._diagonal = np.zeros(cloud.n_owned)
        entries = of_rank.tocoo()
        rows, columns = cloud.row[entries.row], cloud.row[entries.col]
        sizes = (cloud.n_owned, cloud.n_global)
        self._whole = assembled(cloud.comm, sizes, Triplets(rows, columns, entries.data), 0.0)
        rows = (cloud.first + np.flatnonzero(held)).astype(PETSc.IntType)
        self.mat = self._whole.copy()
        # Isolated particles keep their value.
        self.mat.setOption(PETSc.Mat.Option.NEW_NONZERO_ALLOCATION_ERR, False)
        diagonal = self.mat.getDiagonal()
        self._diagonal[:] = diagonal.getArray(readonly=True)
        scale = float(diagonal.max()[1])
        lonely = diagonal.getArray(readonly=True) <= 0.0
        self.scale = scale if scale > 0.0 else 1.0
        diagonal.setArray(np.where(lonely, self.scale, diagonal.getArray(readonly=True)))
        self.mat.setDiagonal(diagonal)
        self.mat.assemble()
        self.mat.zeroRowsColumns(rows, diag=self.scale)
        self._lonely = lonely
        # The system does not determine the mean value of an unsupported piece; the preconditioning matrix does.
        self.near = self.mat.copy()
        diagonal.setArray(np.full(cloud.n_owned, LIFTED * self.scale))
        self.near.setDiagonal(diagonal, addv=True)
        self.near.assemble()
        diagonal.destroy()
        for mat in (self.mat, self.near):
            mat.setOption(PETSc.Mat.Option.SYMMETRIC, True)
        self.near.setOption(PETSc.Mat.Option.SPD, True)
        self._ksp = PETSc.KSP().create(comm=cloud.comm)
        self._ksp.setOptionsPrefix(PREFIX)
        self._ksp.setType("cg")
        self._ksp.setNormType(PETSc.KSP.NormType.UNPRECONDITIONED)
        self._ksp.setOperators(self.mat, self.near)
        self._ksp.setInitialGuessNonzero(True)
        options.suggest(FACTOR if cloud.n_global <= DIRECT[cloud.dim] else MULTIGRID)
        with options.active():
            self._ksp.setFromOptions()
            self._ksp.setUp()

    def residual(self, values: Float, b: Float, given: Float) -> Float:
        """Compute ``A v - b`` (n_owned,); for prescribed and isolated particles, the scale times the deviation."""
        found = self.product(np.where(self._held | self._lonely, given, values)) - b
        return np.where(self._held | self._lonely, self.scale * (values - given), found)

    def round_off(self, values: Float) -> float:
        """Compute the norm of the round-off of ``A v`` in a residual (collective)."""
        return FLOOR * float(np.finfo(float).eps) * norm(self._cloud.comm, self._diagonal * values)

    def product(self, values: Float) -> Float:
        """Compute ``A v`` (n_owned,), including the rows of prescribed values."""
        x, y = self._whole.createVecs()
        x.setArray(values)
        self._whole.mult(x, y)
        found: Float = np.array(y.getArray(readonly=True))
        x.destroy(), y.destroy()
        return found

    def solve(self, b: Float, start: Float) -> tuple[Float, bool]:
        """Return x with its prescribed values from ``start`` (n_owned,), and True if it is a solution.

        The mean value of an unsupported piece is that of ``start``.
        """
        # Solve for the difference to the start, which is zero for prescribed values.
        residual = b - self.product(start)
        # Isolated particles keep their value if no heat enters them.
        stuck = np.where(self._lonely & ~self._held, np.abs(residual), 0.0)
        residual[self._held | self._lonely] = 0.0
        x, r = self.mat.createVecs()
        r.setArray(residual)
        size = r.norm()
        found, good = start.copy(), True
        if size > 0.0:
            x.set(0.0)
            floor = self.round_off(start)
            self._ksp.setTolerances(rtol=RTOL, atol=floor, max_it=MOST)
            self._ksp.solve(r, x)
            found += x.getArray(readonly=True)
            self.mat.multAdd(-1.0 * x, r, r)
            floor = max(floor, 2.0 * self.round_off(found))
            good = bool(np.isfinite(r.norm()) and r.norm() <= max(GOOD * size, floor))
        x.destroy(), r.destroy()
        lost, whole = total(self._cloud.comm, [float((stuck**2).sum()), float((b**2).sum())])
        return found, good and bool(lost <= GOOD**2 * whole)

    def destroy(self) -> None:
        """Free the PETSc objects."""
        for thing in (self._ksp, self.near, self.mat, self._whole):
            thing.destroy()
