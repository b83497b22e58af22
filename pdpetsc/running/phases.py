"""Phases of a run: which one it is in, and how long each has taken."""

from __future__ import annotations

import time
from collections.abc import Iterator
from contextlib import contextmanager

from pdpetsc.petsc.stages import OUTPUT, SEARCH, SET_UP, stage

# Stages of PETSc's log that phases belong to.
STAGES = {
    **dict.fromkeys(("particles", "families"), SEARCH),
    **dict.fromkeys(("kernels", "model", "pattern", "allocation"), SET_UP),
    **dict.fromkeys(("output", "picture"), OUTPUT),
}


class Phases:
    """What a run is doing.

    Attributes
    ----------
    now : str
        The phase that it is in, or was in last.
    timings : dict of str to float
        What every phase has taken so far [s].
    """

    def __init__(self) -> None:
        self.now = "particles"
        self.timings: dict[str, float] = {}

    @contextmanager
    def timed(self, phase: str) -> Iterator[None]:
        """Be in a phase, and in its stage of PETSc's log, while the body runs; an error ends it untimed."""
        self.now = phase
        before = time.perf_counter()
        with stage(STAGES[phase]):
            yield
        self.add(phase, time.perf_counter() - before)

    def add(self, phase: str, seconds: float) -> None:
        """Add to what a phase has taken."""
        self.timings[phase] = self.timings.get(phase, 0.0) + seconds
