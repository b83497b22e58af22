"""Errors a user can meet, and the exit status each ends a run with."""

from __future__ import annotations

from typing import Any


class PdpetscError(Exception):
    """Base of the errors that end a run with one sentence instead of a traceback."""

    exit_status = 1


class CaseError(PdpetscError, ValueError):
    """The case or the command line is wrong; nothing was run."""

    exit_status = 2


class FlatFamilies(CaseError):
    """Families are too small or too flat for a gradient; ``gid`` names this rank's."""

    def __init__(self, message: str, gid: Any) -> None:
        super().__init__(message)
        self.gid = gid


class SolveError(PdpetscError, RuntimeError):
    """A load step did not converge; everything up to the last converged step is on disk."""


class OutputError(PdpetscError, OSError):
    """A result could not be written; the files hold the last step that could."""


class Interrupted(PdpetscError):
    """The run was asked to stop by a signal; the last converged step is on disk."""
