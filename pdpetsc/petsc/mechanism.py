"""Mechanisms: displacements that a tangent does not resist."""

from __future__ import annotations

import numpy as np
from petsc4py import PETSc

from pdpetsc.arrays import Float, Mask
from pdpetsc.discrete.communicator import largest, total
from pdpetsc.petsc.library import null_pivots, put_irregular, set_up_failed
from pdpetsc.petsc.tangent import PetscTangent

# Smallest energy of a displacement, over the sum of the energies of its components alone, that is not round-off.
# Connected bodies are above 1e-9, fragments on soft springs above 1e-11; mechanisms are below 1e-27.
ROUND_OFF = 100.0 * float(np.finfo(float).eps)
# Tolerance of the linear solve. With a mechanism the residual stays above about the inverse root of the number of
# unknowns.
RTOL = 1e-4
# Largest number of iterations, with and without the preconditioner of the run.
MOST, MOST_ALONE = 500, 10_000


def mechanism(tangent: PetscTangent, ksp: PETSc.KSP, free: Mask, scale: float) -> Float | None:
    """Find a displacement (n_rows, dim) that a tangent K does not resist, at most 1; None if there is none.

    The search is an inverse iteration, ``K x = D b``, with the diagonal D of K and a vector b without symmetry. Along a
    null vector of K the solution x grows until ``x . K x / (x . D x)`` is round-off. For a regular K that ratio is at
    least its smallest eigenvalue.

    A factor with a vanishing pivot gives no such solution. Conjugate gradients without that factor then repeat the
    search. They also replace every other iterative solver: GMRES, which minimises the residual, does not let x grow.
    Tangents of intact bodies are symmetric.

    Parameters
    ----------
    tangent : PetscTangent
        K, up to date.
    ksp : KSP
        Linear solver of the run for K. Only its preconditioner is used.
    free : (n_rows, dim) bool
        Degrees of freedom that are not prescribed.
    scale : float
        Unit of stiffness in the matrix [force / length].

    Notes
    -----
    Collective. Equilibrium under loads that do not move the mechanism can be found even if there is a mechanism.
    """
    ksp.setOperators(tangent.mat, tangent.preconditioner)
    if not set_up_failed(ksp):
        found = _unresisted(tangent, free, scale, "preonly" if ksp.getType() == "preonly" else "fcg", ksp.getPC(), MOST)
        if found is not None or not null_pivots(ksp):
            return found
    return _unresisted(tangent, free, scale, "cg", None, MOST_ALONE)


def _unresisted(
    tangent: PetscTangent, free: Mask, scale: float, kind: str, pc: PETSc.PC | None, most: int
) -> Float | None:
    """Return the solution of one inverse iteration if nothing resists it."""
    mat = tangent.mat
    comm = mat.getComm().tompi4py()
    D = np.where(free.ravel(), np.abs(tangent.diagonal), 0.0) / scale
    least = float(np.finfo(float).eps) * largest(comm, D, initial=0.0)
    D = np.where(free.ravel(), np.maximum(D, least), 0.0)
    x, b = tangent.preconditioner.createVecs()
    put_irregular(b)
    b.array *= D
    solver = PETSc.KSP().create(comm=mat.getComm())
    solver.setType(kind)
    if pc is None:
        solver.getPC().setType("jacobi")
    else:
        solver.setPC(pc)
    solver.setOperators(mat, tangent.preconditioner)
    solver.setTolerances(rtol=RTOL, atol=0.0, divtol=1e300, max_it=most)
    solver.solve(b, x)
    solver.destroy()
    size = x.norm(PETSc.NormType.INFINITY)
    if np.isfinite(size) and size > 0.0:
        x.scale(1.0 / size)
    mat.mult(x, b)
    values = x.array.copy()
    work, alone = total(comm, [float(values @ b.array_r), float(values @ (D * values))])
    x.destroy()
    b.destroy()
    return values.reshape(free.shape) if abs(work) < ROUND_OFF * alone else None
