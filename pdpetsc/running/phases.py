"""Phases of a run, with their times."""

from __future__ import annotations

import time
from collections.abc import Iterator
from contextlib import contextmanager

from pdpetsc.petsc.stages import OUTPUT, SEARCH, SET_UP, stage

# Stages of PETSc's log for the phases.
STAGES = {
    **dict.fromkeys(("particles", "families"), SEARCH),
    **dict.fromkeys(("kernels", "model", "pattern", "allocation"), SET_UP),
    **dict.fromkeys(("output", "picture"), OUTPUT),
}


class Phases:
    """The current phase of a run, and the times of all phases.

    Attributes
    ----------
    now : str
        The current or last phase.
    timings : dict of str to float
        Time of every phase so far [s].
    """

    def __init__(self) -> None:
        self.now = "particles"
        self.timings: dict[str, float] = {}

    @contextmanager
    def timed(self, phase: str) -> Iterator[None]:
        """Run the body as a phase, and in its stage of PETSc's log; an error leaves it untimed."""
        self.now = phase
        before = time.perf_counter()
        with stage(STAGES[phase]):
            yield
        self.add(phase, time.perf_counter() - before)

    def add(self, phase: str, seconds: float) -> None:
        """Add to the time of a phase."""
        self.timings[phase] = self.timings.get(phase, 0.0) + seconds
