"""Observers of a run: each records or judges one subject of it."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any, TypeAlias

from pdpetsc.discrete.communicator import Comm
from pdpetsc.output.files import InCreationOrder
from pdpetsc.output.progress import Report
from pdpetsc.post.solution import Solution
from pdpetsc.problem.problem import Problem
from pdpetsc.solvers.protocol import Converged, Solver

# What ``summary.json`` says of each step of a run.
StepRecords: TypeAlias = Sequence[Mapping[str, Any]]


@dataclass(frozen=True)
class Origin:
    """The checkpoint from which a run continues.

    Attributes
    ----------
    start : Solution
        The state.
    path : Path
        The file.
    run : str
        Identifies the run that wrote it.
    steps : sequence of mapping
        The records of the steps up to it.
    tables : mapping of str to str
        The texts of ``history.csv`` and ``broken_bonds.csv`` by name, on rank 0; empty on the others.
    """

    start: Solution
    path: Path
    run: str = ""
    steps: StepRecords = ()
    tables: Mapping[str, str] = field(default_factory=dict)

    def inside(self, folder: Path) -> bool:
        """Return True if the checkpoint is in a folder."""
        return self.path.parent.resolve() == folder.resolve()


@dataclass
class Observed:
    """A run as its observers see it.

    Attributes
    ----------
    folder : Path
        Where files are written.
    run : str
        Identifies the run in its files.
    report : Report
        Takes lines and warnings.
    solver : Solver
        Finds the steps.
    order : InCreationOrder
        Of the particles in files.
    last : Solution
        The last converged state; at the beginning the state from which the run starts.
    origin : Origin or None
        The checkpoint from which it continues.
    steps : list of dict
        The records of all steps so far, with those before a restart.
    """

    folder: Path
    run: str
    report: Report
    solver: Solver
    order: InCreationOrder
    last: Solution
    origin: Origin | None
    steps: list[dict[str, Any]]

    @property
    def problem(self) -> Problem:
        """Return the problem that is solved."""
        return self.last.problem

    @property
    def comm(self) -> Comm:
        """Return the ranks of the run."""
        return self.last.cloud.comm

    @property
    def in_own_folder(self) -> bool:
        """Return True if the run continues in the folder of its checkpoint."""
        return self.origin is not None and self.origin.inside(self.folder)


class Observer:
    """Records or judges one subject of a run; a subclass overrides what it needs.

    Attributes
    ----------
    observed : Observed
        The run, from ``begin`` on.

    Notes
    -----
    All methods but ``summary`` and ``warnings`` are collective.
    """

    observed: Observed

    def rehearse(self, start: Solution, report: Report) -> None:
        """Evaluate once what the case asks for; nothing is written yet.

        Raises
        ------
        CaseError
            The case asks for something that cannot be recorded; the folder stays as it was.
        """

    def begin(self, observed: Observed) -> None:
        """Record the state from which the run starts; the folder belongs to the run."""
        self.observed = observed

    def step(self, solution: Solution, converged: Converged) -> Mapping[str, Any]:
        """Record a converged step; return what its record in ``summary.json`` says of it."""
        return {}

    def end(self) -> None:
        """Write what is left to write, when the run has converged or after an error; it may be called again."""

    def judge(self) -> None:
        """Judge the last state of a run that has converged, before the summary is written."""

    def summary(self, steps: StepRecords) -> Mapping[str, Any]:
        """Return the entries of ``summary.json``, from the records of all steps."""
        return {}

    def results(self) -> Mapping[str, float]:
        """Return named results besides those of the case (not collective)."""
        return {}

    def warnings(self, steps: StepRecords) -> Sequence[str]:
        """Return the sentences that a user should read at the end."""
        return ()

    def finish(self) -> None:
        """Do what is left after the summary of a run that has converged is written."""


class StepLines(Observer):
    """The line of the log for each step."""

    def begin(self, observed: Observed) -> None:
        super().begin(observed)
        observed.report.begin(observed.last.t, observed.last.step)

    def step(self, solution: Solution, converged: Converged) -> Mapping[str, Any]:
        """Print the line of the solver."""
        self.observed.report.step(converged.t, self.observed.solver.line(solution.step, converged))
        return {}
