"""Matrix ``C`` of tied displacements in PETSc."""

from __future__ import annotations

import numpy as np
import scipy
from petsc4py import PETSc

from pdpetsc.petsc.sparse import size_of
from pdpetsc.problem.supports import Supports


def combination_matrix(supports: Supports) -> PETSc.Mat:
    """Build ``C`` of ``u = C q + g`` over the components of all unknowns (collective).

    Columns of prescribed and tied components contain only a zero on the diagonal, so that ``C^T K C`` has an entry
    there.
    """
    ties, cloud = supports.ties, supports.body.cloud
    assert ties is not None
    dim, size, tied = cloud.dim, size_of(cloud), ties.all
    on_terms = np.repeat(tied.particle.astype(np.int64) * dim + tied.axis, np.diff(tied.ptr))
    depends = tied.row * dim + tied.of_axis
    # Prescribed components are part of g.
    coefficient = np.where(ties.of_terms(supports.fixed.astype(float)) > 0.0, 0.0, tied.coefficient)
    own = np.arange(supports.fixed.size)
    rows = np.concatenate([own, on_terms])
    columns = np.concatenate([own + cloud.first * dim, depends])
    values = np.concatenate([np.where(supports.fixed.ravel(), 0.0, 1.0), coefficient])
    csr = scipy.sparse.coo_array((values, (rows, columns)), shape=size).tocsr()
    arrays = csr.indptr.astype(PETSc.IntType), csr.indices.astype(PETSc.IntType), csr.data
    return PETSc.Mat().createAIJ((size, size), bsize=dim, csr=arrays, comm=cloud.comm)
