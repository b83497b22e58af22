"""Stages of a run, by which ``-log_view`` groups times, flops and messages."""

from __future__ import annotations

import contextlib
from collections.abc import Iterator
from functools import lru_cache

from petsc4py import PETSc

SEARCH, SET_UP, RESIDUAL, TANGENT, PRECONDITIONER, OUTPUT = (
    "search", "set-up", "residual", "tangent", "preconditioner", "output",
)  # fmt: skip


@lru_cache
def _stage(name: str) -> PETSc.LogStage:
    return PETSc.Log.Stage(name)


@contextlib.contextmanager
def stage(name: str) -> Iterator[None]:
    """Count the events of the ``with`` block in a separate stage (not collective)."""
    of = _stage(name)
    of.push()
    try:
        yield
    finally:
        of.pop()
