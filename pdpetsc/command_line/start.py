"""Starting PETSc, and one sentence where it cannot be loaded."""

from __future__ import annotations

import os
from collections.abc import Sequence

from pdpetsc.errors import RunError
from pdpetsc.loading import cannot_load

# PETSc's arguments: its .petscrc files are not read (pdpetsc.petsc).
PETSC = ["pdpetsc", "-skip_petscrc"]

# What tells that a launcher has started several processes.
LAUNCHED = ("OMPI_COMM_WORLD_SIZE", "PMI_SIZE", "PMIX_SIZE", "SLURM_STEP_NUM_TASKS")


def processes_started() -> int:
    """Return how many processes a launcher says that it has started; 1 where there is none."""
    return max((int(os.environ[name]) for name in LAUNCHED if os.environ.get(name, "").isdigit()), default=1)


def start_petsc(words: Sequence[str] = ()) -> None:
    """Start PETSc with options from the command line.

    Raises
    ------
    RunError
        petsc4py is not there, or cannot be loaded.
    """
    try:
        import petsc4py

        petsc4py.init([*PETSC, *words])
    except (ImportError, ValueError, AttributeError, OSError) as error:
        if getattr(error, "ierr", None) is not None:
            raise
        raise RunError(cannot_load("petsc4py", error)) from None
