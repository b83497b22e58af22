"""Stages of a run, by which ``-log_view`` breaks down times, flops and messages."""

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
    """Count what happens in the body in a stage of its own (not collective)."""
    of = _stage(name)
    of.push()
    try:
        yield
    finally:
        of.pop()
