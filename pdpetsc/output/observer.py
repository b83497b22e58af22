"""Observers of a run: each records or checks one aspect of it."""

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

# Records of the steps of a run in ``summary.json``.
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
        Identifier of the run that wrote it.
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
    """The data of a run for its observers.

    Attributes
    ----------
    folder : Path
        Folder of the output files.
    run : str
        Identifier of the run in its files.
    report : Report
        Prints lines and warnings.
    solver : Solver
        Solver of the steps.
    order : InCreationOrder
        Order of the particles in files.
    last : Solution
        The last converged state; at the beginning the state from which the run starts.
    origin : Origin or None
        The checkpoint from which it continues.
    steps : list of dict
        The records of all steps so far, including those before a restart.
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
    """Record or check one aspect of a run; subclasses override the methods that they need.

    Attributes
    ----------
    observed : Observed
        The run, from ``begin`` on.

    Notes
    -----
    All methods except ``summary``, ``results`` and ``warnings`` are collective.
    """

    observed: Observed

    def rehearse(self, start: Solution, report: Report) -> None:
        """Evaluate the requested output once; nothing is written yet.

        Raises
        ------
        CaseError
            The case requests output that cannot be recorded; the folder stays unchanged.
        """

    def begin(self, observed: Observed) -> None:
        """Record the initial state; the folder is locked for the run."""
        self.observed = observed

    def step(self, solution: Solution, converged: Converged) -> Mapping[str, Any]:
        """Record a converged step; return entries for its record in ``summary.json``."""
        return {}

    def end(self) -> None:
        """Write remaining output, after convergence or an error; may be called more than once."""

    def judge(self) -> None:
        """Check the last state of a converged run, before the summary is written."""

    def summary(self, steps: StepRecords) -> Mapping[str, Any]:
        """Return the entries of ``summary.json``, from the records of all steps."""
        return {}

    def results(self) -> Mapping[str, float]:
        """Return named results in addition to those of the case (not collective)."""
        return {}

    def warnings(self, steps: StepRecords) -> Sequence[str]:
        """Return the warnings that are printed at the end."""
        return ()

    def finish(self) -> None:
        """Finish a converged run, after the summary is written."""


class StepLines(Observer):
    """Print a line for each step."""

    def begin(self, observed: Observed) -> None:
        super().begin(observed)
        observed.report.begin(observed.last.t, observed.last.step)

    def step(self, solution: Solution, converged: Converged) -> Mapping[str, Any]:
        """Print the line of a converged step."""
        self.observed.report.step(converged.t, self.observed.solver.line(solution.step, converged))
        return {}
