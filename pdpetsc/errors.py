"""Errors a user can meet, the exit status each ends a run with, and the sentence for every other exception."""

from __future__ import annotations

import sysconfig
import traceback
from pathlib import Path
from typing import Any

PACKAGE = Path(__file__).parent
# PETSc's error codes of an option or a value that it does not take: support, order, sizes, arguments, types, packages.
WRONG_OPTION = (55, 56, 58, 60, 61, 62, 63, 64, 71, 73, 74, 75, 77, 80, 83, 86, 92, 94, 99)
# What PETSc says by its number alone, before its handler of errors is there.
CODES = {
    55: "out of memory", 56: "not supported", 60: "a wrong size", 62: "a wrong argument", 63: "out of range",
    65: "a file cannot be opened", 66: "a file cannot be read", 67: "a file cannot be written",
    83: "an option or a file it names is wrong", 86: "unknown type", 92: "a package is missing",
}  # fmt: skip
# Characters of a sentence that travel to other ranks.
LONGEST = 2000


class PdpetscError(Exception):
    """Base of the errors that end a run with one sentence instead of a traceback.

    Attributes
    ----------
    exit_status : int
        What the command line ends with.
    agreed : int
        How many ranks are known to have raised it at the same place: those of a communicator with so many may go on to
        communicate.
    petsc : bool
        Whether it came from an error of PETSc on another rank.
    phase : str
        What the run was at, if known.
    rank : int, optional
        Where it was raised, if not everywhere.
    what : str
        What was raised.
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
        """Return the error as one of a single rank, which it names."""
        return RunError(str(self), users_line(self), phase, rank)


class CaseError(PdpetscError, ValueError):
    """The case or the command line is wrong; nothing was run."""

    exit_status = 2


class FlatFamilies(CaseError):
    """Families are too small or too flat for a gradient; ``gid`` names this rank's."""

    def __init__(self, message: str, gid: Any = None) -> None:
        super().__init__(message)
        self.gid = gid


class NoConformingWeights(CaseError):
    """Families are too small to be changed so that they satisfy the divergence theorem."""


class SolveError(PdpetscError, RuntimeError):
    """A load step did not converge; everything up to the last converged step is on disk."""


class CheckError(PdpetscError, AssertionError):
    """A run has ended and its results are on disk, but they are not what its case expects."""


class OutputError(PdpetscError, OSError):
    """A result could not be written; the files hold the last step that could."""


class Interrupted(PdpetscError):
    """The run was asked to stop by a signal; the last converged step is on disk."""

    def of_one_rank(self, phase: str, rank: int) -> PdpetscError:
        """Return the error itself: a signal is of no rank."""
        return self


class RunError(PdpetscError, RuntimeError):
    """A function of the case, PETSc, the memory or pdpetsc itself failed in the course of a run.

    Attributes
    ----------
    what : str
        What was raised, or PETSc's reason.
    place : str
        File and line.
    phase : str
        What the run was at.
    rank : int, optional
        Where it was raised, if not everywhere.
    of_user : bool
        Whether code outside pdpetsc raised it.
    of_option : bool
        Whether PETSc found an option or its value wrong.
    bug : bool
        Whether it is a defect of pdpetsc.
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
        """Return the error itself, which knows its rank."""
        return self

    def __str__(self) -> str:
        words = ["Failed" if self.rank is None else f"Rank {self.rank} failed"]
        words += [f"in phase {self.phase}"] if self.phase else []
        words += [f"at {self.place}"] if self.place else []
        note = "; this is a defect of pdpetsc, please report its traceback" if self.bug else ""
        return f"{' '.join(words)}: {self.what.rstrip('.')}{note}."


# What every rank can make anew from a few words; an error class of a case file is not known on other ranks.
KINDS: dict[str, type[PdpetscError]] = {
    kind.__name__: kind
    for kind in (PdpetscError, CaseError, FlatFamilies, SolveError, CheckError, OutputError, Interrupted, RunError)
}


def notice(error: PdpetscError) -> dict[str, Any]:
    """Return what other ranks need to raise an error: its kind, exit status and text, all of plain types."""
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
    """Return the error that a ``notice`` tells of."""
    error = KINDS[told["kind"]](told["text"], **told.get("more", {}))
    error.exit_status, error.petsc = told["status"], told["petsc"]
    return error


def described(error: BaseException) -> PdpetscError:
    """Return an exception as an error of one sentence: itself where it is one.

    What passes through code outside pdpetsc and its libraries is that code's, with its line; PETSc's errors have
    PETSc's own reason; what is left is a defect of pdpetsc.
    """
    if isinstance(error, PdpetscError):
        return error
    if isinstance(error, KeyboardInterrupt):
        return Interrupted("Stopped by a signal.")
    place = users_line(error)
    code = getattr(error, "ierr", None)
    if code is not None and type(error).__module__.startswith("petsc4py"):
        # What a user's function raises below PETSc comes back as what it was.
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
        # What a case declares is looked at there, also what its functions return.
        return RunError(f"{what}; a number or an array that the case gives is none, or too large", own, of_user=True)
    if isinstance(error, OSError):
        return RunError(f"{error.strerror or error}{f': {error.filename}' if error.filename else ''}")
    return RunError(what, own, bug=True)


def petsc_reason(error: BaseException) -> str:
    """Return what PETSc says is wrong, without its traceback and hints."""
    lines = [line.split("] ", 1)[-1].strip() for line in str(error).splitlines() if line.strip()]
    # A frame is "SNESSolve() at /path/snes.c:4692"; the words after the last one are the reason.
    kept = [line for line in lines if not line.startswith("error code") and "() at " not in line]
    kept = [line.split(". Check for miss-spelling", 1)[0] for line in kept if not line.startswith(("See ", "* "))]
    if kept:
        return ": ".join(line.rstrip(". ") for line in kept)
    code = getattr(error, "ierr", 0)
    return f"PETSc's error {code}{f', {CODES[code]}' if code in CODES else ''}"


def of_petsc(error: BaseException | None) -> bool:
    """Return whether PETSc raised an error, or what it came from; PETSc's objects are then in no order."""
    # An error that is raised anew while another one of its causes is handled closes a ring.
    seen: set[int] = set()
    while error is not None and id(error) not in seen:
        # Of an error that another rank has told of only this is known.
        if getattr(error, "petsc", False) or (hasattr(error, "ierr") and type(error).__module__.startswith("petsc4py")):
            return True
        seen.add(id(error))
        error = error.__cause__ or error.__context__
    return False


def users_line(error: BaseException) -> str:
    """Return file and line of the innermost frame outside pdpetsc and what is installed, empty where there is none."""
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
    """Return the lines of pdpetsc that an exception passed through: the same on ranks that failed together."""
    frames = traceback.extract_tb(error.__traceback__)
    return tuple(f"{Path(f.filename).name}:{f.lineno}" for f in frames if PACKAGE in Path(f.filename).resolve().parents)
