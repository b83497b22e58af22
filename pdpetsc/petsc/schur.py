"""Schur complement of constraints on a displacement, by two solves with a matrix of the constraints only."""

from __future__ import annotations

import numpy as np
import scipy
from petsc4py import PETSc

from pdpetsc.arrays import Float, GlobalIndex, Mask, row_of_entries
from pdpetsc.discrete.communicator import largest
from pdpetsc.gradient.products import ConstraintProduct
from pdpetsc.kernels.near import reach_kernel
from pdpetsc.problem.body import Body

# Largest number of constraints on all ranks whose matrix is factored, by dimension; otherwise the diagonal is used.
DIRECT = {1: 10**6, 2: 250_000, 3: 40_000}
# Bonds up to this multiple of the length of the 2 dim-th shortest bond represent the whole family.
NEAR = 1.6
# A constraint whose compliance is this share of the soft compliance hardly matters.
STIFF = 0.1
# Shift of the diagonal of the matrix of constraints, as a share of the diagonal and of its largest entry.
LIFTED, LEAST = 1e-3, 1e-14


class SchurComplement:
    """Approximate ``S = C + B K_0^-1 B^T`` by least squares: ``S^-1 = t L^-1 H L^-1 t + (C + q)^-1``.

    With the inverse D of the diagonal of ``K_0``, 0 for prescribed unknowns::

        L = B D B^T,   H = B D K D B^T,   t^2 = 1 / (1 + 10 C / q)

    K has the diagonal of ``K_0`` and couples each particle with its nearest neighbours only. q is the compliance of the
    soft resistance to a constraint. Pressures that change from patch to patch cause small forces; uniform ones meet
    little resistance. L and H represent both effects, a diagonal does not. The last part is for constraints that cause
    no force, and for constraints with a compliance.

    Parameters
    ----------
    body : Body
        Particles and bonds.
    constraints : ConstraintProduct
        The constraints.
    compliance, soft : (n_conditions,) float64
        C and q.
    diagonal : (n_owned, dim) float64
        Diagonal of ``K_0``.
    free : (n_owned, dim) bool
        Unknowns that are not prescribed.

    Notes
    -----
    Construction and every method are collective. Call ``destroy`` before MPI ends.

    References
    ----------
    Elman2006 approximate the Schur complement of the Navier-Stokes equations in this way.
    """

    def __init__(
        self, body: Body, constraints: ConstraintProduct, compliance: Float, soft: Float, diagonal: Float, free: Mask
    ) -> None:
        cloud, dim = body.cloud, body.dim
        n, comm = cloud.n_owned, cloud.comm
        self._diagonal = compliance + soft
        self._turn = np.sqrt(1.0 / (1.0 + compliance / (STIFF * soft)))
        here = np.zeros((cloud.n_local, 2 * dim))
        here[:n, dim:] = np.where(free, np.maximum(diagonal, 0.0), 0.0)
        np.divide(1.0, here[:n, dim:], out=here[:n, :dim], where=here[:n, dim:] > 0.0)
        cloud.halo.forward(here)
        inverse, held = here[:, :dim], here[:, dim:]
        columns = _rows_of(body)
        turned = constraints.b.copy()
        if len(cloud.sign):
            images = constraints.members >= n
            turned[images] *= cloud.sign[constraints.members[images] - n]
        of = row_of_entries(constraints.ptr)
        values = turned * inverse[constraints.members]
        roots = turned * np.sqrt(inverse[constraints.members])
        where = of, columns[constraints.members]
        size, width = len(compliance), (n * dim, cloud.n_global * dim)
        matrices = [_matrix(comm, size, width, dim, *where, each) for each in (roots, values)]
        root, spread = (mat.transpose() for mat in matrices)
        self._L = root.transposeMatMult(root)
        near = _near(body, columns, held, width)
        self._H = near.ptap(spread)
        for mat in (*matrices, near):
            mat.destroy()
        self._x, self._y = self._L.createVecs()
        self._L.getDiagonal(self._x)
        most = largest(comm, self._x.array_r, initial=0.0)
        self._x.scale(LIFTED)
        self._x.shift(LEAST * most if most > 0.0 else 1.0)
        self._L.setDiagonal(self._x, PETSc.InsertMode.ADD_VALUES)
        self._L.setOption(PETSc.Mat.Option.SYMMETRIC, True)
        self._ksp = PETSc.KSP().create(comm=comm)
        self._ksp.setOptionsPrefix("patches_")
        self._ksp.setOperators(self._L)
        self._ksp.setType("preonly")
        self._ksp.getPC().setType("cholesky")
        self._ksp.getPC().setFactorSolverType("mumps")
        self._ksp.setFromOptions()

    def solve(self, values: Float) -> Float:
        """Compute ``S^-1`` times values of the own constraints (n_conditions,)."""
        x, y = self._x, self._y
        x.setArray(self._turn * values)
        self._ksp.solve(x, y)
        self._H.mult(y, x)
        self._ksp.solve(x, y)
        return np.asarray(self._turn * y.array_r + values / self._diagonal)

    def destroy(self) -> None:
        """Free the PETSc objects."""
        for one in (self._ksp, self._L, self._H, self._x, self._y):
            one.destroy()


def _rows_of(body: Body) -> GlobalIndex:
    """Return the global number of each local particle, in the order of ranks (n_local,) (collective)."""
    cloud = body.cloud
    return cloud.halo.with_ghosts(cloud.first + np.arange(cloud.n_owned, dtype=np.int64))


def _matrix(
    comm: PETSc.Comm, n_rows: int, width: tuple[int, int], dim: int, rows: GlobalIndex, columns: GlobalIndex,
    values: Float,
) -> PETSc.Mat:  # fmt: skip
    """Build a matrix with ``values`` (n_entries, dim) at own rows and the unknowns of columns (collective)."""
    at = (columns[:, None] * dim + np.arange(dim)).ravel()
    found = scipy.sparse.csr_array(
        scipy.sparse.coo_array((values.ravel(), (np.repeat(rows, dim), at)), shape=(n_rows, width[1]))
    )
    return _of_rows(comm, found, (n_rows, None), width)


def _of_rows(
    comm: PETSc.Comm, rows: scipy.sparse.csr_array, size: tuple[int, int | None], width: tuple[int, int]
) -> PETSc.Mat:
    """Build a matrix from the rows of each rank (collective)."""
    rows.sum_duplicates()
    rows.sort_indices()
    csr = rows.indptr.astype(PETSc.IntType), rows.indices.astype(PETSc.IntType), rows.data
    return PETSc.Mat().createAIJ((size, width), csr=csr, comm=comm)


def _near(body: Body, columns: GlobalIndex, held: Float, width: tuple[int, int]) -> PETSc.Mat:
    """Build K from springs between nearest neighbours, equal along all axes, with the given diagonal (collective)."""
    cloud, families, dim = body.cloud, body.families, body.dim
    n = cloud.n_owned
    reach, every = np.zeros(n), np.ones(len(families.neighbours), dtype=bool)
    reach_kernel(dim, 2 * dim)(families.indptr, families.neighbours, every, cloud.x, reach)
    length = families.lengths(cloud.x)
    # Both ends of a bond must count it as short.
    far = cloud.halo.with_ghosts(NEAR * reach)
    i, j = families.centres, families.neighbours
    kept = length <= np.minimum(far[i], far[j])
    i, j = i[kept], j[kept]
    count = cloud.halo.with_ghosts(np.maximum(np.bincount(i, minlength=n), 1))
    each = held / count[:, None]
    stiffness = np.where((held[i] > 0.0) & (held[j] > 0.0), 0.5 * (each[i] + each[j]), 0.0)
    wall = np.where(held[j] > 0.0, 0.0, 0.5 * each[i])
    diagonal = np.stack([np.bincount(i, (stiffness + wall)[:, axis], n) for axis in range(dim)], axis=1)
    at = (columns[j][:, None] * dim + np.arange(dim)).ravel()
    row = (i[:, None].astype(np.int64) * dim + np.arange(dim)).ravel()
    own = np.arange(n * dim)
    entries = np.concatenate([-stiffness.ravel(), diagonal.ravel()])
    rows, at = np.concatenate([row, own]), np.concatenate([at, cloud.first * dim + own])
    found = scipy.sparse.csr_array(scipy.sparse.coo_array((entries, (rows, at)), shape=(n * dim, width[1])))
    return _of_rows(cloud.comm, found, width, width)
