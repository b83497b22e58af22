"""What petsc4py does not reach: raw value arrays, the domain error flag, and which options were used.

The functions called here have had the same C signature since PETSc 3.18.
"""

from __future__ import annotations

import contextlib
import ctypes
import os
import re
import shlex
from collections.abc import Iterator, Mapping
from functools import lru_cache
from pathlib import Path
from typing import Any

import numpy as np
from petsc4py import PETSc

from pdpetsc.arrays import Float
from pdpetsc.discrete.communicator import Comm, agreed, is_root
from pdpetsc.errors import CaseError

# Option that keeps PETSc from reading .petscrc in the home folder and wherever one stands.
SKIP_FILES = "skip_petscrc"
READ_AT_THE_END = ("log_", "malloc", "memory_view", "objects_", "options_", "on_error", "debug", "start_in_debugger")


@lru_cache
def _library() -> ctypes.CDLL:
    return ctypes.CDLL(PETSc.__file__)


def _check(code: int) -> None:
    if code:
        raise PETSc.Error(code)


def seq_blocks(mat: PETSc.Mat) -> tuple[int, int | None]:
    """Return the handles of the sequential matrices of own and of other columns of an AIJ matrix."""
    if mat.getType() == "seqaij":
        return int(mat.handle), None
    diag, off = ctypes.c_void_p(), ctypes.c_void_p()
    _check(_library().MatMPIAIJGetSeqAIJ(ctypes.c_void_p(mat.handle), ctypes.byref(diag), ctypes.byref(off), None))
    assert diag.value is not None
    return diag.value, off.value


@contextlib.contextmanager
def values_of(handle: int | None, count: int) -> Iterator[Float]:
    """Give write access to the ``count`` values of a sequential AIJ matrix, without a copy."""
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
    """Tell SNES that the residual is not defined at the point it asked for."""
    _check(_library().SNESSetFunctionDomainError(ctypes.c_void_p(snes.handle)))


def forces_iteration(snes: PETSc.SNES) -> bool:
    """Return whether -snes_force_iteration asks for an iteration of every solve (not collective)."""
    forced = ctypes.c_int(0)
    _check(_library().SNESGetForceIteration(ctypes.c_void_p(snes.handle), ctypes.byref(forced)))
    return bool(forced.value)


@contextlib.contextmanager
def full_steps(snes: PETSc.SNES) -> Iterator[None]:
    """Let Newton take full steps in the body, whatever line search the options name."""
    search = _line_search(snes)
    _check(_library().SNESLineSearchSetType(search, b"basic"))
    try:
        yield
    finally:
        # A new type has its own numbers of iterations; all are back with the options.
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
    """Set up a linear solver; return whether its preconditioner could not be, as of a singular matrix (collective)."""
    ksp.setUp()
    failed = ctypes.c_int(0)
    _check(_library().PCGetFailedReason(ctypes.c_void_p(ksp.getPC().handle), ctypes.byref(failed)))
    return failed.value != 0


def negative_pivots(ksp: PETSc.KSP) -> int | None:
    """Return how many pivots of a factorised symmetric matrix are negative: as many as it has negative eigenvalues.

    None where there is no such factor, or its package does not count them (collective).
    """
    pc = ksp.getPC()
    if pc.getType() != "cholesky" or ksp.getConvergedReason() == 0:
        return None
    factor = pc.getFactorMatrix()
    if pc.getFactorSolverType() == "mumps":
        # PETSc's own question also wants to know the zero ones, for which MUMPS would have to look for null pivots.
        whole = factor.getComm().size == 1 or factor.getMumpsIcntl(13) == 1
        return int(factor.getMumpsInfog(12)) if whole else None
    try:
        negative, _, _ = factor.getInertia()
    except PETSc.Error:
        return None
    return int(negative)


def start_anew(ksp: PETSc.KSP) -> None:
    """Forget a factorisation that failed: after one PETSc's MUMPS does not even try the next matrix (collective).

    Others are made anew for every matrix; GAMG cannot be reset, it keeps the solvers of its levels with their sizes.
    """
    if ksp.getPC().getType() not in ("lu", "cholesky"):
        return
    mat, preconditioner = ksp.getOperators()
    ksp.getPC().reset()
    ksp.setOperators(mat, preconditioner)


def effort(ksp: PETSc.KSP) -> float | None:
    """Return the iterations per digit of the last linear solve, None without one or where it failed."""
    rtol = float(ksp.getTolerances()[0])
    if ksp.getConvergedReason() <= 0 or not 0.0 < rtol < 1.0:
        return None
    return float(ksp.getIterationNumber() / -np.log10(rtol))


def linear_solver(ksp: PETSc.KSP) -> str:
    """Return a linear solver in a few words."""
    pc = ksp.getPC()
    package = pc.getFactorSolverType() if pc.getType() in ("lu", "cholesky", "ilu", "icc") else None
    return f"ksp {ksp.getType()}, pc {f'{pc.getType()} ({package})' if package else pc.getType()}"


def petsc_version() -> str:
    """Return PETSc's version."""
    return ".".join(str(part) for part in PETSc.Sys.getVersion())


def option_used(name: str) -> bool:
    """Return whether any PETSc object looked up an option, given without its dash."""
    used = ctypes.c_int(0)
    _check(_library().PetscOptionsUsed(None, name.encode(), ctypes.byref(used)))
    return bool(used.value)


def refuse_names(chosen: Mapping[str, Any]) -> None:
    """Raise CaseError for a name that cannot be an option's (not collective; the same on all ranks)."""
    for name in chosen:
        if not isinstance(name, str) or not re.fullmatch(r"[A-Za-z]\w*([-.:]\w+)*", name):
            raise CaseError(f"A PETSc option is named without its dash, like 'snes_rtol', not {name!r}.")


def refuse_files(comm: Comm, in_force: Mapping[str, Mapping[str, Any]]) -> None:
    """Raise CaseError for a file of a viewer or monitor that cannot be made (collective).

    PETSc opens that of -log_view as it ends, on rank 0, and the others would wait for it.
    """
    of_files = {}
    for name, option in in_force.items():
        words = str(option["value"] or "").split(":")
        if re.search(r"view|monitor|log_|history", name) and len(words) > 1 and words[1]:
            of_files[name] = Path(words[1])
    try:
        with agreed(comm):
            for name, path in of_files.items() if is_root(comm) else ():
                if path.is_dir() or not os.access(path if path.exists() else path.parent, os.W_OK):
                    raise CaseError(f"The option -{name} writes to {path}, which cannot be written.")
    except CaseError:
        for name in of_files:
            PETSc.Options().delValue(name)
        raise


@contextlib.contextmanager
def options(chosen: Mapping[str, Any], defaults: Mapping[str, Any]) -> Iterator[None]:
    """Put options into PETSc's database for the time of a run.

    What is already there, from the command line or the environment, wins over ``chosen``, which wins over ``defaults``.
    A value of None stands for an option without value.
    """
    database = PETSc.Options()
    # Asking for a name would count as its use.
    there = {name.lower() for name in database.getAll()}
    inserted = []
    for name, value in [*chosen.items(), *defaults.items()]:
        if name.lower() not in there:
            database.setValue(name, _text(value))
            there.add(name.lower())
            inserted.append(name)
    try:
        yield
    finally:
        for name in inserted:
            database.delValue(name)


def options_in_force(chosen: Mapping[str, Any], defaults: Mapping[str, Any]) -> dict[str, dict[str, Any]]:
    """Return value and source of every option in PETSc's database, in the body of ``options`` (not collective)."""
    sources = {"case": chosen, "environment": _environment(), "pdpetsc": defaults}
    found: dict[str, dict[str, Any]] = {}
    for name, value in sorted(PETSc.Options().getAll().items()):
        if name != SKIP_FILES:
            same = (of for of, known in sources.items() if name in known and _text(known[name]) == _text(value))
            found[name] = {"value": value, "from": next(same, "command line")}
    return found


def unused(in_force: Mapping[str, Mapping[str, Any]]) -> list[str]:
    """Return the options in force that nothing has looked up, in the body of ``options`` (not collective).

    Those that pdpetsc suggests are not among them, nor those that PETSc reads when it ends.
    """
    return [
        name
        for name, option in in_force.items()
        if option["from"] != "pdpetsc" and not name.startswith(READ_AT_THE_END) and not option_used(name)
    ]


def _environment() -> dict[str, str]:
    """Return the options of PETSC_OPTIONS."""
    found: dict[str, str] = {}
    name = ""
    with contextlib.suppress(ValueError):
        for word in shlex.split(os.environ.get("PETSC_OPTIONS", "")):
            if re.match(r"-{1,2}[A-Za-z]", word):
                name = word[1:]
                found[name] = ""
            elif name:
                found[name], name = word, ""
    return found


def _text(value: Any) -> str:
    return "" if value is None else str(value)
