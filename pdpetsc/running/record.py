"""The record of a run: its observers, and ``summary.json``."""

from __future__ import annotations

import resource
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

from pdpetsc.discrete.communicator import Comm, alone
from pdpetsc.output.observer import Observed, Observer
from pdpetsc.output.records import plain, write_summary
from pdpetsc.post.solution import Solution
from pdpetsc.running.phases import Phases
from pdpetsc.solvers.protocol import Converged, StepResult


class RunRecord:
    """All records of a run.

    Parameters
    ----------
    comm : Comm
        The ranks.
    folder : Path
        Output folder.
    entries : mapping
        The first entries of the summary.

    Attributes
    ----------
    phases : Phases
        Phases of the run.
    summary : dict
        Entries of ``summary.json`` besides those of the steps.
    steps : list of dict
        The records of the steps, with those before a restart.
    solved : int
        Number of steps of this run.
    failed : list of StepResult
        Failed attempts since the last step.
    unit : str
        Name of the iterations of the solver.
    observers : sequence of Observer
        Observers, in recording order.
    observed : Observed or None
        Data for the observers, from ``begin`` on.
    taken : bool
        True if the folder has files of this run.
    """

    def __init__(self, comm: Comm, folder: Path, entries: Mapping[str, Any]) -> None:
        self.comm = comm
        self.folder = folder
        self.phases = Phases()
        self.summary = dict(entries)
        self.steps: list[dict[str, Any]] = []
        self.solved = 0
        self.failed: list[StepResult] = []
        self.unit = "Newton"
        self.observers: Sequence[Observer] = ()
        self.observed: Observed | None = None
        self.taken = False

    def begin(self, observed: Observed) -> None:
        """Record the initial state of the run (collective)."""
        # The work of the next step requires these forces, before bonds fail and multipliers of contact change.
        observed.last.hold_forces()
        for observer in self.observers:
            observer.begin(observed)
        self.observed = observed
        observed.last.forget()

    def step(self, converged: Converged) -> None:
        """Record a converged step (collective)."""
        assert self.observed is not None
        observed, last = self.observed, self.observed.last
        self.solved += 1
        self.steps.append(_of_step(last.step + 1, converged, self.unit))
        self.failed.clear()
        u, t, resume = converged.u, converged.t, converged.resume
        tangent_at = observed.solver.tangent_at
        solution = Solution(last.problem, u, t, last.step + 1, resume=resume, tangent_at=tangent_at)
        solution.follow(last, converged.work)
        # The body is in this state from here on, even if recording fails.
        observed.last = solution
        for observer in self.observers:
            self.steps[-1] |= observer.step(solution, converged)
        solution.forget()

    def end(self) -> None:
        """Let the observers write remaining data (collective)."""
        if self.observed is not None:
            for observer in self.observers:
                observer.end()

    def judge(self) -> None:
        """Let the observers check the last state of a converged run (collective)."""
        for observer in self.observers:
            observer.judge()

    def write(self, status: str, results: Mapping[str, float] | None = None) -> dict[str, Any]:
        """Write the summary, and return the contents of the file (collective)."""
        memory = self.comm.allgather(_peak_memory())
        summary = self._summary(status, results or {}, memory)
        write_summary(self.comm, self.folder, summary)
        return dict(plain(summary))

    def write_alone(self, status: str) -> None:
        """Write the summary on this rank only (not collective)."""
        write_summary(alone(), self.folder, self._summary(status, {}, [_peak_memory()]))

    def _summary(self, status: str, results: Mapping[str, float], memory: list[int]) -> dict[str, Any]:
        summary = self.summary | {
            "status": status,
            "results": dict(results),
            "steps": self.steps,
            "failed_attempts": [_of_attempt(result, self.unit) for result in self.failed],
            "timings": self.phases.timings,
            "peak_memory_bytes": memory,
        }
        for observer in self.observers:
            summary |= observer.summary(self.steps)
        return summary | {"warnings": self.warnings()}

    def warnings(self) -> list[str]:
        """Return the warnings of the observers (not collective)."""
        return [warning for observer in self.observers for warning in observer.warnings(self.steps)]


def _peak_memory() -> int:
    return resource.getrusage(resource.RUSAGE_SELF).ru_maxrss * 1024


def _of_step(step: int, converged: Converged, unit: str) -> dict[str, Any]:
    cut_backs = [_of_attempt(failure, unit) for failure in converged.failures]
    result = converged.result
    damage = {"broken_bonds": result.broken, "sweeps": result.sweeps} if result.broken or result.sweeps else {}
    return {"step": step, "t": converged.t, **_of_attempt(result, unit), **damage, "cut_backs": cut_backs}


def _of_attempt(result: StepResult, unit: str) -> dict[str, Any]:
    return {
        "reason": result.reason,
        "norms": result.norms,
        "reference": result.reference,
        "negative_pivots": result.negative_pivots,
        **({"growth": result.growth} if result.growth else {}),
        **({"crossed": True} if result.crossed else {}),
        **({"moved": result.moved} if result.moved else {}),
        **({"switched": result.switched} if result.switched else {}),
        f"{unit.lower()}_iterations": result.iterations,
        "linear_iterations": result.linear_iterations,
    }
