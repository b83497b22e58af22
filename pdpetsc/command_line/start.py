"""Starting PETSc, and one sentence where it cannot be loaded."""

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

# What tells that a launcher has started several processes.
LAUNCHED = ("OMPI_COMM_WORLD_SIZE", "PMI_SIZE", "PMIX_SIZE", "SLURM_STEP_NUM_TASKS")


def processes_started() -> int:
    """Return how many processes a launcher says that it has started; 1 where there is none."""
    return max((whole_number(os.environ.get(name, "")) or 1 for name in LAUNCHED), default=1)


def start_petsc(words: Sequence[str] = ()) -> None:
    """Start PETSc with options from the command line.

    Raises
    ------
    CaseError
        A file of options cannot be read, which PETSc says in many lines.
    RunError
        petsc4py is not there, or cannot be loaded.
    """
    for option, value in pairwise([*words, *os.environ.get("PETSC_OPTIONS", "").split()]):
        # A file may be followed by a word on what PETSc does with it: "q.txt:yaml".
        files = {value, value.rpartition(":")[0]} - {""}
        if option.lower().lstrip("-") in OPTIONS_FILES and not any(map(os.path.isfile, files)):
            raise CaseError(f"Cannot read the options of PETSc in {value}: no such file.")
    try:
        import petsc4py

        petsc4py.init([*PETSC, *words])
    except (ImportError, ValueError, AttributeError, OSError) as error:
        if getattr(error, "ierr", None) is not None:
            raise
        raise RunError(cannot_load("petsc4py", error)) from None


def take_signals(handler: Any = None) -> None:
    """Let signals raise KeyboardInterrupt or do something else, except those that are ignored, as under nohup."""
    with contextlib.suppress(ValueError):  # they are the main thread's
        for number in (signal.SIGINT, signal.SIGTERM, signal.SIGHUP):
            if signal.getsignal(number) is not signal.SIG_IGN:
                signal.signal(number, handler or _interrupt)


def _interrupt(number: int, frame: Any) -> None:
    raise KeyboardInterrupt


def files_of_options(options: Sequence[str]) -> list[str]:
    """Return the files that PETSc reads options from, with the files that they name."""
    found: list[str] = []
    waiting = [*options, *os.environ.get("PETSC_OPTIONS", "").split()]
    while waiting:
        word = waiting.pop(0)
        if word.lower().lstrip("-") not in OPTIONS_FILES or not waiting:
            continue
        # A file may be followed by a word on what PETSc does with it: "q.txt:yaml".
        for file in {waiting[0], waiting[0].rpartition(":")[0]} - {"", *found}:
            found.append(file)
            with contextlib.suppress(OSError):
                lines = Path(file).read_text(errors="replace").splitlines()
                waiting += [word for line in lines for word in line.partition("#")[0].split()]
    return found
