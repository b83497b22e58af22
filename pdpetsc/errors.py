"""Errors for users with their exit statuses, and conversion of other exceptions to them."""

from __future__ import annotations

import sysconfig
import traceback
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

PACKAGE = Path(__file__).parent
# PETSc's error codes for a rejected option or value: support, order, sizes, arguments, types, packages.
WRONG_OPTION = (55, 56, 58, 60, 61, 62, 63, 64, 71, 73, 74, 75, 77, 80, 83, 86, 92, 94, 99)
# Meaning of errors of PETSc that have a number only, before its error handler is set.
CODES = {
    55: "out of memory", 56: "not supported", 60: "a wrong size", 62: "a wrong argument", 63: "out of range",
    65: "a file cannot be opened", 66: "a file cannot be read", 67: "a file cannot be written",
    83: "an option or a file it names is wrong", 86: "unknown type", 92: "a package is missing",
}  # fmt: skip
# Largest number of characters of a message that is sent to other ranks.
LONGEST = 2000


class PdpetscError(Exception):
    """Base class of the errors that end a run with one message instead of a traceback.

    Attributes
    ----------
    exit_status : int
        Exit status of the command line.
    agreed : int
        Number of ranks that are known to have raised it at the same place. The ranks of a communicator of this size may
        still communicate.
    petsc : bool
        True if it came from an error of PETSc on another rank.
    phase : str
        Phase of the run, if known.
    rank : int, optional
        Rank that raised it, if not all did.
    what : str
        Text of the original error.
    of_user, of_option, bug : bool
        As for ``RunError``, which sets them.
    """

    exit_status = 1
    agreed = 0
    petsc = False
    phase = ""
    rank: int | None = None
    what = ""
    of_user = False
    of_option = False
    bug = False

    def of_one_rank(self, phase: str, rank: int) -> PdpetscError:
        """Return the error of a single rank, with its number."""
        return RunError(str(self), users_line(self), phase, rank)


class CaseError(PdpetscError, ValueError):
    """The case or the command line is wrong; nothing was run."""

    exit_status = 2


class FlatFamilies(CaseError):
    """Families are too small or too flat for a gradient; ``gid`` identifies those of this rank."""

    def __init__(self, message: str, gid: Any = None) -> None:
        super().__init__(message)
        self.gid = gid


class NoConformingWeights(CaseError):
    """Families are too small for weights that satisfy the divergence theorem."""


class UnknownSurface(CaseError):
    """The particles have no cells whose faces are known."""


class SolveError(PdpetscError, RuntimeError):
    """A load step did not converge; everything up to the last converged step is on disk."""


@contextmanager
def case_errors() -> Iterator[None]:
    """Turn a SolveError in the ``with`` block into a CaseError: a function of the case fails before the run begins."""
    try:
        yield
    except SolveError as error:
        raise CaseError(str(error)) from error


class CheckError(PdpetscError, AssertionError):
    """The results of a finished run differ from those that its case expects; they are on disk."""


class OutputError(PdpetscError, OSError):
    """A result could not be written; the files hold the last step that was written."""


class Interrupted(PdpetscError):
    """The run was asked to stop by a signal; the last converged step is on disk."""

    def of_one_rank(self, phase: str, rank: int) -> PdpetscError:
        """Return the error itself, because a signal belongs to no rank."""
        return self


class RunError(PdpetscError, RuntimeError):
    """A function of the case, PETSc, the memory or pdpetsc itself failed during a run.

    Attributes
    ----------
    what : str
        Type and message of the exception, or PETSc's reason.
    place : str
        File and line.
    phase : str
        Phase of the run.
    rank : int, optional
        Rank that raised it, if not all did.
    of_user : bool
        True if code outside pdpetsc raised it.
    of_option : bool
        True if PETSc rejected an option or its value.
    bug : bool
        True if it is a defect of pdpetsc.
    """

    def __init__(
        self, what: str, place: str = "", phase: str = "", rank: int | None = None, of_user: bool = False,
        of_option: bool = False, bug: bool = False,
    ) -> None:  # fmt: skip
        super().__init__(what)
        self.what = what
        self.place = place
        self.phase = phase
        self.rank = rank
        self.of_user = of_user
        self.of_option = of_option
        self.bug = bug

    def of_one_rank(self, phase: str, rank: int) -> PdpetscError:
        """Return the error itself."""
        return self

    def __str__(self) -> str:
        words = ["Failed" if self.rank is None else f"Rank {self.rank} failed"]
        words += [f"in phase {self.phase}"] if self.phase else []
        words += [f"at {self.place}"] if self.place else []
        note = "; this is a defect of pdpetsc, please report its traceback" if self.bug else ""
        return f"{' '.join(words)}: {self.what.rstrip('.')}{note}."


# Error classes that every rank can rebuild; classes defined in a case file are unknown on other ranks.
KINDS: dict[str, type[PdpetscError]] = {
    kind.__name__: kind
    for kind in (
        PdpetscError, CaseError, FlatFamilies, UnknownSurface, SolveError, CheckError, OutputError, Interrupted,
        RunError,
    )
}  # fmt: skip


def notice(error: PdpetscError) -> dict[str, Any]:
    """Return the data from which other ranks rebuild an error, in plain types: kind, exit status and text."""
    kind = next(kind.__name__ for kind in type(error).__mro__ if kind.__name__ in KINDS)
    told: dict[str, Any] = {"kind": kind, "status": int(error.exit_status), "text": str(error)[:LONGEST]}
    told["petsc"] = of_petsc(error)
    if isinstance(error, RunError):
        told["more"] = {
            "place": error.place, "phase": error.phase, "rank": error.rank, "of_user": error.of_user,
            "of_option": error.of_option, "bug": error.bug,
        }  # fmt: skip
        told["text"] = error.what[:LONGEST]
    return told


def rebuilt(told: dict[str, Any]) -> PdpetscError:
    """Return the error that a ``notice`` describes."""
    error = KINDS[told["kind"]](told["text"], **told.get("more", {}))
    error.exit_status, error.petsc = told["status"], told["petsc"]
    return error


def described(error: BaseException) -> PdpetscError:
    """Return an exception as an error with one message; return it unchanged if it is one already.

    An exception that passed through code outside pdpetsc and its libraries is attributed to that code, with the line.
    Errors of PETSc have the reason that PETSc reports. Errors of memory, imports and files keep their message. All
    others are defects of pdpetsc.
    """
    if isinstance(error, PdpetscError):
        return error
    if isinstance(error, KeyboardInterrupt):
        return Interrupted("Stopped by a signal.")
    place = users_line(error)
    code = getattr(error, "ierr", None)
    if code is not None and type(error).__module__.startswith("petsc4py"):
        # An exception of a user's function that PETSc called comes back with its own type, not here.
        return RunError(petsc_reason(error), place, of_user=bool(place), of_option=code in WRONG_OPTION and not place)
    what = f"{type(error).__name__}: {' '.join(str(error).split())}" if str(error) else type(error).__name__
    if isinstance(error, SystemExit):
        what = "sys.exit was called; raise an error instead"
    if isinstance(error, MemoryError):
        what = f"out of memory{f' ({error})' if str(error) else ''}; take fewer particles, more ranks or more nodes"
    if place:
        return RunError(what, place, of_user=True)
    if isinstance(error, MemoryError | ImportError | SystemExit):
        return RunError(what)
    own = _own_line(error)
    if own.startswith("pdpetsc/declare/") and isinstance(error, TypeError | ValueError | ArithmeticError):
        # Declared values, and values that functions of the case return, are checked there.
        return RunError(f"{what}; a number or an array that the case gives is none, or too large", own, of_user=True)
    if isinstance(error, OSError):
        return RunError(f"{error.strerror or error}{f': {error.filename}' if error.filename else ''}")
    return RunError(what, own, bug=True)


def petsc_reason(error: BaseException) -> str:
    """Return the reason that PETSc reports, without its traceback and hints."""
    lines = [line.split("] ", 1)[-1].strip() for line in str(error).splitlines() if line.strip()]
    # A frame is "SNESSolve() at /path/snes.c:4692"; the words after the last one are the reason.
    kept = [line for line in lines if not line.startswith("error code") and "() at " not in line]
    kept = [line.split(". Check for miss-spelling", 1)[0] for line in kept if not line.startswith(("See ", "* "))]
    if kept:
        return ": ".join(line.rstrip(". ") for line in kept)
    code = getattr(error, "ierr", 0)
    return f"PETSc's error {code}{f', {CODES[code]}' if code in CODES else ''}"


def of_petsc(error: BaseException | None) -> bool:
    """Return True if PETSc raised an error or one of its causes; objects of PETSc may then be inconsistent."""
    # The chain of causes is a ring if an error is raised again while one of its causes is handled.
    seen: set[int] = set()
    while error is not None and id(error) not in seen:
        # Only this attribute is known of an error of another rank.
        if getattr(error, "petsc", False) or (hasattr(error, "ierr") and type(error).__module__.startswith("petsc4py")):
            return True
        seen.add(id(error))
        error = error.__cause__ or error.__context__
    return False


def users_line(error: BaseException) -> str:
    """Return file and line of the innermost frame outside pdpetsc and installed packages, or an empty string."""
    paths = sysconfig.get_paths()
    installed = [str(Path(paths[name]).resolve()) for name in ("stdlib", "platstdlib", "purelib", "platlib")]
    for frame in reversed(traceback.extract_tb(error.__traceback__)):
        path = Path(frame.filename).resolve() if not frame.filename.startswith("<") else None
        if path is None or PACKAGE in path.parents or "dist-packages" in path.parts or "site-packages" in path.parts:
            continue
        if path.suffix == ".py" and not any(str(path).startswith(f"{folder}/") for folder in installed):
            return f"{path}:{frame.lineno}" + (f" ({frame.name})" if frame.name != "<module>" else "")
    return ""


def _own_line(error: BaseException) -> str:
    frames = [f for f in traceback.extract_tb(error.__traceback__) if PACKAGE in Path(f.filename).resolve().parents]
    return f"pdpetsc/{Path(frames[-1].filename).resolve().relative_to(PACKAGE)}:{frames[-1].lineno}" if frames else ""


def places(error: BaseException) -> tuple[str, ...]:
    """Return the lines of pdpetsc that an exception passed through, equal on ranks that failed together."""
    frames = traceback.extract_tb(error.__traceback__)
    return tuple(f"{Path(f.filename).name}:{f.lineno}" for f in frames if PACKAGE in Path(f.filename).resolve().parents)
