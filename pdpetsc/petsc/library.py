"""Functions that petsc4py does not wrap: raw value arrays, domain errors, pivot counts, used options.

The functions called here have had the same C signature since PETSc 3.18.
"""

from __future__ import annotations

import contextlib
import ctypes
from collections.abc import Iterator
from functools import lru_cache

import numpy as np
from petsc4py import PETSc

from pdpetsc.arrays import Float

# Types of SNES that are Newton's method.
NEWTON = ("newtonls", "newtontr", "newtontrdc", "ksponly")
# Reasons of conjugate gradients for a matrix or a preconditioner that is not definite.
INDEFINITE = (
    PETSc.KSP.ConvergedReason.DIVERGED_INDEFINITE_MAT,
    PETSc.KSP.ConvergedReason.DIVERGED_INDEFINITE_PC,
)
# Largest number of vectors that GMRES stores for an indefinite matrix.
DIRECTIONS = 100
# PETSc's PC_SETUP_ERROR.
PC_FAILED = -1
# Parameters of mallopt in glibc, its default number of mappings, and the largest threshold that it accepts [bytes].
M_MMAP_THRESHOLD, M_MMAP_MAX, MAPPINGS, LARGE = -3, -4, 65536, 2**25


@lru_cache
def _library() -> ctypes.CDLL:
    return ctypes.CDLL(PETSc.__file__)


def _check(code: int) -> None:
    if code:
        raise PETSc.Error(code)


def seq_blocks(mat: PETSc.Mat) -> tuple[int, int | None]:
    """Return the handles of the sequential matrices of own and other columns of an AIJ matrix."""
    if mat.getType() == "seqaij":
        return int(mat.handle), None
    diag, off = ctypes.c_void_p(), ctypes.c_void_p()
    _check(_library().MatMPIAIJGetSeqAIJ(ctypes.c_void_p(mat.handle), ctypes.byref(diag), ctypes.byref(off), None))
    assert diag.value is not None
    return diag.value, off.value


@contextlib.contextmanager
def values_of(handle: int | None, count: int) -> Iterator[Float]:
    """Provide write access to the ``count`` values of a sequential AIJ matrix, without a copy."""
    if handle is None or count == 0:
        yield np.empty(0)
        return
    pointer = ctypes.POINTER(ctypes.c_double)()
    mat = ctypes.c_void_p(handle)
    _check(_library().MatSeqAIJGetArray(mat, ctypes.byref(pointer)))
    try:
        yield np.ctypeslib.as_array(pointer, shape=(count,))
    finally:
        _check(_library().MatSeqAIJRestoreArray(mat, ctypes.byref(pointer)))


def set_domain_error(snes: PETSc.SNES) -> None:
    """Report to SNES that the residual is undefined at the requested point."""
    _check(_library().SNESSetFunctionDomainError(ctypes.c_void_p(snes.handle)))


def forces_iteration(snes: PETSc.SNES) -> bool:
    """Return True if -snes_force_iteration requires an iteration in every solve (not collective)."""
    forced = ctypes.c_int(0)
    _check(_library().SNESGetForceIteration(ctypes.c_void_p(snes.handle), ctypes.byref(forced)))
    return bool(forced.value)


@contextlib.contextmanager
def full_steps(snes: PETSc.SNES) -> Iterator[None]:
    """Use full Newton steps in the ``with`` block, for any line search of the options."""
    search = _line_search(snes)
    _check(_library().SNESLineSearchSetType(search, b"basic"))
    try:
        yield
    finally:
        # A new type resets its numbers of iterations; the options restore them.
        _check(_library().SNESLineSearchSetFromOptions(search))


def line_search(snes: PETSc.SNES) -> str:
    """Return the type of line search."""
    name = ctypes.c_char_p()
    _check(_library().SNESLineSearchGetType(_line_search(snes), ctypes.byref(name)))
    return (name.value or b"").decode()


def _line_search(snes: PETSc.SNES) -> ctypes.c_void_p:
    search = ctypes.c_void_p()
    _check(_library().SNESGetLineSearch(ctypes.c_void_p(snes.handle), ctypes.byref(search)))
    return search


def set_up_failed(ksp: PETSc.KSP) -> bool:
    """Set up a linear solver; return True if its preconditioner failed, as for a singular matrix (collective)."""
    ksp.setUp()
    failed = ctypes.c_int(0)
    _check(_library().PCGetFailedReason(ctypes.c_void_p(ksp.getPC().handle), ctypes.byref(failed)))
    return failed.value != 0


def set_failed(pc: PETSc.PC, failed: bool) -> None:
    """Set whether a preconditioner has failed, so that its linear solver fails, or reset it (collective)."""
    _check(_library().PCSetFailedReason(ctypes.c_void_p(pc.handle), PC_FAILED if failed else 0))


def refactors(snes: PETSc.SNES) -> bool:
    """Return True if SNES factors the tangent in every iteration (Newton's method without lagging)."""
    lag = ctypes.c_int(1)
    for ask in (_library().SNESGetLagJacobian, _library().SNESGetLagPreconditioner):
        _check(ask(ctypes.c_void_p(snes.handle), ctypes.byref(lag)))
        if lag.value != 1:
            return False
    return snes.getType() in NEWTON


def negative_pivots(ksp: PETSc.KSP, mat: PETSc.Mat) -> int | None:
    """Count the negative pivots of a factored symmetric matrix, which equal its negative eigenvalues.

    None if the linear solver has no factor of the symmetric ``mat`` itself, or if its package does not count pivots or
    has shifted them (collective).
    """
    pc = ksp.getPC()
    if pc.getType() != "cholesky" or ksp.getConvergedReason() <= 0 or pc.getOperators()[1].handle != mat.handle:
        return None
    reused, shift = ctypes.c_int(0), ctypes.c_int(0)
    _check(_library().PCGetReusePreconditioner(ctypes.c_void_p(pc.handle), ctypes.byref(reused)))
    if reused.value:
        return None
    factor = pc.getFactorMatrix()
    if pc.getFactorSolverType() == "mumps":
        # PETSc's function also requests the zero pivots, for which MUMPS would have to detect null pivots.
        whole = factor.getComm().size == 1 or factor.getMumpsIcntl(13) == 1
        return int(factor.getMumpsInfog(12)) if whole else None
    _check(_library().PCFactorGetShiftType(ctypes.c_void_p(pc.handle), ctypes.byref(shift)))
    if shift.value:
        return None
    try:
        negative, _, _ = factor.getInertia()
    except PETSc.Error:
        return None
    return int(negative)


def negative_pivots_of_symmetric_part(mat: PETSc.Mat) -> int | None:
    """Count the negative eigenvalues of ``(A + A^T) / 2`` by a Cholesky factor of MUMPS (collective)."""
    part = mat.transpose(PETSc.Mat())
    part.axpy(1.0, mat)
    part.setOption(PETSc.Mat.Option.SYMMETRIC, True)
    ksp = PETSc.KSP().create(comm=mat.comm)
    ksp.setOptionsPrefix("symmetric_part_")
    ksp.setType("preonly")
    pc = ksp.getPC()
    pc.setType("cholesky")
    pc.setFactorSolverType("mumps")
    ksp.setOperators(part)
    pc.setFactorSetUpSolverType()
    # Room for pivots, and the last dense block without ScaLAPACK, which does not count negative pivots.
    pc.getFactorMatrix().setMumpsIcntl(14, 50)
    pc.getFactorMatrix().setMumpsIcntl(13, 1)
    nothing, found = part.createVecs()
    ksp.solve(nothing, found)
    count = negative_pivots(ksp, part)
    for one in (nothing, found, ksp, part):
        one.destroy()
    return count


def null_pivots(ksp: PETSc.KSP) -> int:
    """Count the null pivots that MUMPS has replaced in its last factor; 0 for other solvers (collective)."""
    pc = ksp.getPC()
    if pc.getType() not in ("lu", "cholesky") or pc.getFactorSolverType() != "mumps":
        return 0
    return int(pc.getFactorMatrix().getMumpsInfog(28))


def use_absolute_diagonal(pc: PETSc.PC) -> None:
    """Let the preconditioner ``jacobi`` use the absolute values of the diagonal (not collective)."""
    _check(_library().PCJacobiSetUseAbs(ctypes.c_void_p(pc.handle), 1))


def put_irregular(b: PETSc.Vec) -> None:
    """Fill a vector with numbers between -1 and 1 without symmetry (not collective)."""
    first, last = b.getOwnershipRange()
    b.array = np.sin(1.0 + np.arange(first, last, dtype=np.float64) ** 2)


@contextlib.contextmanager
def with_tolerance(ksp: PETSc.KSP, rtol: float) -> Iterator[None]:
    """Set the relative tolerance of a linear solver in the ``with`` block."""
    before = ksp.getTolerances()[0]
    ksp.setTolerances(rtol=rtol)
    try:
        yield
    finally:
        ksp.setTolerances(rtol=before)


@contextlib.contextmanager
def with_solves_to(snes: PETSc.SNES, rtol: float) -> Iterator[None]:
    """Let solves with the linear solver of SNES end at a relative tolerance in the ``with`` block.

    With ``-snes_ksp_ew`` PETSc would give each of them the tolerance of a Newton iteration, also outside of ``solve``.
    """
    forcing = snes.getUseEW()
    snes.setUseEW(False)
    try:
        with with_tolerance(snes.getKSP(), rtol):
            yield
    finally:
        snes.setUseEW(forcing)


@contextlib.contextmanager
def with_indefinite(ksp: PETSc.KSP) -> Iterator[None]:
    """Replace conjugate gradients by GMRES, which solves indefinite systems, in the ``with`` block."""
    kind, side, norm = ksp.getType(), ksp.getPCSide(), ksp.getNormType()
    ksp.setType("gmres")
    ksp.setGMRESRestart(DIRECTIONS)
    ksp.setPCSide(PETSc.PC.Side.RIGHT)
    ksp.setNormType(PETSc.KSP.NormType.UNPRECONDITIONED)
    try:
        yield
    finally:
        ksp.setType(kind)
        ksp.setPCSide(side)
        ksp.setNormType(norm)


def met_indefinite(ksp: PETSc.KSP) -> bool:
    """Return True if the last solve by conjugate gradients failed since a matrix is not definite (not collective)."""
    return ksp.getType() == "cg" and ksp.getConvergedReason() in INDEFINITE


def start_anew(ksp: PETSc.KSP) -> None:
    """Reset a factorisation that failed, since PETSc's MUMPS would not try the next matrix (collective).

    Other preconditioners are rebuilt for every matrix. GAMG cannot be reset: it keeps the solvers of its levels with
    their sizes.
    """
    if ksp.getPC().getType() == "mg":
        start_anew(ksp.getPC().getMGCoarseSolve())
    if ksp.getPC().getType() not in ("lu", "cholesky"):
        return
    mat, preconditioner = ksp.getOperators()
    ksp.getPC().reset()
    ksp.setOperators(mat, preconditioner)


def effort(ksp: PETSc.KSP) -> tuple[int, float] | None:
    """Return the iterations of the last linear solve and its digits, or None without a solve that converged."""
    rtol, iterations = float(ksp.getTolerances()[0]), ksp.getIterationNumber()
    # Setting up the solver for the next solve clears the reason, but not the iterations.
    if ksp.getConvergedReason() < 0 or iterations == 0 or not 0.0 < rtol < 1.0:
        return None
    return int(iterations), float(-np.log10(rtol))


def linear_solver(ksp: PETSc.KSP) -> str:
    """Return a short description of a linear solver."""
    pc = ksp.getPC()
    package = pc.getFactorSolverType() if pc.getType() in ("lu", "cholesky", "ilu", "icc") else None
    return f"ksp {ksp.getType()}, pc {f'{pc.getType()} ({package})' if package else pc.getType()}"


def petsc_version() -> str:
    """Return PETSc's version."""
    return ".".join(str(part) for part in PETSc.Sys.getVersion())


def option_used(name: str) -> bool:
    """Return True if a PETSc object has looked up an option, named without its dash."""
    used = ctypes.c_int(0)
    _check(_library().PetscOptionsUsed(None, name.encode(), ctypes.byref(used)))
    return bool(used.value)


def return_freed_memory(returns: bool) -> None:
    """Let the C library return freed blocks of at least ``LARGE`` bytes to the system, or keep them for later arrays.

    Set-up needs its large arrays once. The arrays of a march are those of the step before, and their pages would be
    mapped again each time. SuperLU_DIST, which PETSc may load, lets the C library keep all blocks.
    """
    mallopt = getattr(ctypes.CDLL(None), "mallopt", None)  # of glibc only
    if mallopt is not None:
        mallopt(M_MMAP_MAX, MAPPINGS if returns else 0)
        mallopt(M_MMAP_THRESHOLD, LARGE)


return_freed_memory(True)
