"""Negative eigenvalues of symmetric matrices without a factorisation."""

from __future__ import annotations

from petsc4py import PETSc

from pdpetsc.petsc.library import put_irregular, use_absolute_diagonal

# Tolerance of the solve, and largest number of iterations.
EXACT, ITERATIONS = 1e-6, 100_000


def has_negative_eigenvalue(ksp: PETSc.KSP, free: PETSc.Vec) -> bool | None:
    """Return True if the symmetric matrix of a linear solver has a negative eigenvalue; None if that is unknown.

    Conjugate gradients solve ``A x = b`` for an irregular ``b``, with a positive definite preconditioner M. If all Ritz
    values ``theta_k`` so far are positive, the residual along an eigenvector of ``M^-1 A`` with the eigenvalue ``lambda
    < 0`` is that of ``b`` times ``prod(1 + |lambda| / theta_k) > 1``. The solve therefore converges only if there is no
    such eigenvector, and otherwise meets a direction ``p . A p < 0``.

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
    ksp.setTolerances(rtol=EXACT, atol=0.0, max_it=ITERATIONS)
    ksp.solve(b, x)
    reason = ksp.getConvergedReason()
    ksp.destroy()
    x.destroy()
    if reason > 0:
        return False
    return True if reason == PETSc.KSP.ConvergedReason.DIVERGED_INDEFINITE_MAT else None
