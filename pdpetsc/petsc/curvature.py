"""Negative eigenvalues of symmetric matrices without a factorisation."""

from __future__ import annotations

from petsc4py import PETSc

from pdpetsc.petsc.library import put_irregular, use_absolute_diagonal

# Tolerance of the solve, and largest number of iterations.
EXACT, ITERATIONS = 1e-6, 100_000


def has_negative_eigenvalue(ksp: PETSc.KSP, free: PETSc.Vec) -> bool | None:
    """Return True if the symmetric matrix of a linear solver has a negative eigenvalue; None if that is unknown.

    Conjugate gradients solve ``A x = b`` for an irregular ``b``, with a positive definite preconditioner M. Let
    ``lambda < 0`` be an eigenvalue of ``M^-1 A``, and let all Ritz values ``theta_k`` so far be positive. The part of
    the residual in its eigenvector is that of ``b`` times ``prod(1 + |lambda| / theta_k) > 1``. The solve therefore
    converges only if there is no such eigenvector. Otherwise it meets a direction ``p . A p < 0``.

    M is the preconditioner of the solver if that has two levels with a positive definite coarse matrix. Otherwise it is
    the diagonal.

    Parameters
    ----------
    ksp : KSP
        Solver with the matrix and its preconditioner.
    free : Vec
        1 for the unknowns, 0 for prescribed ones [-].

    Notes
    -----
    Collective.
    """
    mat, near = ksp.getOperators()
    pc, b = ksp.getPC(), free.duplicate()
    put_irregular(b)
    b.pointwiseMult(b, free)
    levels = pc if pc.getType() == "mg" and _is_definite(pc.getMGCoarseSolve().getOperators()[0]) else None
    found = _meets_negative_curvature(mat, near, b, levels)
    b.destroy()
    return found


def _is_definite(mat: PETSc.Mat) -> bool:
    """Return True if a symmetric matrix is known to be positive definite."""
    b = mat.createVecRight()
    put_irregular(b)
    found = _meets_negative_curvature(mat, mat, b)
    b.destroy()
    return found is False


def _meets_negative_curvature(
    mat: PETSc.Mat, near: PETSc.Mat, b: PETSc.Vec, preconditioner: PETSc.PC | None = None
) -> bool | None:
    """Return True if conjugate gradients meet negative curvature, False if they converge, None if they fail."""
    ksp, x = PETSc.KSP().create(comm=mat.comm), b.duplicate()
    ksp.setOptionsPrefix("curvature_")
    ksp.setType("cg")
    if preconditioner is None:
        ksp.getPC().setType("jacobi")
        use_absolute_diagonal(ksp.getPC())
    else:
        ksp.setPC(preconditioner)
    ksp.setOperators(mat, near)
    # The residual grows until negative curvature is met.
    ksp.setTolerances(rtol=EXACT, atol=0.0, divtol=1e300, max_it=ITERATIONS)
    ksp.solve(b, x)
    # PETSc reports changes of sign only: a negative definite matrix has none.
    reason, negative = ksp.getConvergedReason(), bool(x.dot(b) < 0.0)
    ksp.destroy()
    x.destroy()
    if reason > 0:
        return negative
    return True if reason == PETSc.KSP.ConvergedReason.DIVERGED_INDEFINITE_MAT else None
