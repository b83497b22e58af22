"""Starting PETSc, and one sentence where it cannot be loaded."""

from __future__ import annotations

from collections.abc import Sequence

from pdpetsc.errors import RunError
from pdpetsc.loading import cannot_load

# PETSc's arguments: its .petscrc files are not read (pdpetsc.petsc).
PETSC = ["pdpetsc", "-skip_petscrc"]


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
