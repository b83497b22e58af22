"""Start of PETSc, with one message if it cannot be loaded."""

from __future__ import annotations

import contextlib
import os
import signal
from collections.abc import Sequence
from itertools import pairwise
from pathlib import Path
from typing import Any

from pdpetsc.bounds import whole_number
from pdpetsc.errors import CaseError, RunError
from pdpetsc.loading import cannot_load

# PETSc's arguments: its .petscrc files are not read (pdpetsc.petsc).
PETSC = ["pdpetsc", "-skip_petscrc"]

# Options of PETSc that name a file of options.
OPTIONS_FILES = ("options_file", "options_file_yaml")

# Environment variables of launchers with the number of processes.
LAUNCHED = ("OMPI_COMM_WORLD_SIZE", "PMI_SIZE", "PMIX_SIZE", "SLURM_STEP_NUM_TASKS")


def processes_started() -> int:
    """Return the number of processes started by a launcher; 1 without a launcher."""
    return max((whole_number(os.environ.get(name, "")) or 1 for name in LAUNCHED), default=1)


def start_petsc(words: Sequence[str] = ()) -> None:
    """Start PETSc with options from the command line.

    Raises
    ------
    CaseError
        A file of options cannot be read.
    RunError
        petsc4py is not installed, or cannot be loaded.
    """
    for option, value in pairwise([*words, *os.environ.get("PETSC_OPTIONS", "").split()]):
        if _names_file(option) and not any(map(os.path.isfile, _file_names(value))):
            raise CaseError(f"Cannot read the options of PETSc in {value}: no such file.")
    try:
        import petsc4py

        petsc4py.init([*PETSC, *words])
    except (ImportError, ValueError, AttributeError, OSError) as error:
        if getattr(error, "ierr", None) is not None:
            raise
        raise RunError(cannot_load("petsc4py", error)) from None


def handle_signals(handler: Any = None) -> None:
    """Set the handler of signals, by default KeyboardInterrupt, except for ignored ones, as under nohup."""
    with contextlib.suppress(ValueError):  # only the main thread may set handlers
        for number in (signal.SIGINT, signal.SIGTERM, signal.SIGHUP):
            if signal.getsignal(number) is not signal.SIG_IGN:
                signal.signal(number, handler or _interrupt)


def _interrupt(number: int, frame: Any) -> None:
    raise KeyboardInterrupt


def _names_file(option: str) -> bool:
    """Return True for an option of PETSc that names a file of options."""
    return option.lower().lstrip("-") in OPTIONS_FILES


def _file_names(value: str) -> set[str]:
    """Return the names that a value may mean: it may have a suffix for PETSc, "q.txt:yaml"."""
    return {value, value.rpartition(":")[0]} - {""}


def files_of_options(options: Sequence[str]) -> list[str]:
    """Return the files of options that PETSc reads, with the files that they name."""
    found: list[str] = []
    waiting = [*options, *os.environ.get("PETSC_OPTIONS", "").split()]
    while waiting:
        if not _names_file(waiting.pop(0)) or not waiting:
            continue
        for file in _file_names(waiting[0]).difference(found):
            found.append(file)
            with contextlib.suppress(OSError):
                lines = Path(file).read_text(errors="replace").splitlines()
                waiting += [word for line in lines for word in line.partition("#")[0].split()]
    return found
