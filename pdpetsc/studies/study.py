"""Runs of one case with many parameter sets, with continuation of earlier studies."""

from __future__ import annotations

import contextlib
import dataclasses
import functools
import json
import math
import os
import time
from collections.abc import Generator, Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

from pdpetsc.declared import Count, Declared, Finite, fits, refuse_unknown
from pdpetsc.discrete.communicator import alone
from pdpetsc.errors import CaseError, SolveError
from pdpetsc.output.folder import holder_of, holding, set_aside
from pdpetsc.output.reading import read_summary
from pdpetsc.running.comparison import mebibytes, working_seconds
from pdpetsc.running.signals import held
from pdpetsc.studies import table
from pdpetsc.studies.jobs import LOOK, Job, command, end_all, launched
from pdpetsc.studies.refinement import NOISE, Convergence, converging
from pdpetsc.studies.run_identity import CaseFile, PlannedRun, differing
from pdpetsc.studies.run_store import LOG, RECORD, Outcome, claim_folder, folder_of, read_outcome, write_outcome
from pdpetsc.studies.sets import grid, text_of

# Time limit for the end of a run left by an earlier study [s].
PATIENCE = 60.0
# Relative error of a result over the tolerance of Newton's residual, and its lower bound [-].
AMPLIFIED, LEAST_NOISE = 100.0, 1e-8
# Environment variables that show that a launcher of MPI has started this process.
LAUNCHED = ("OMPI_COMM_WORLD_SIZE", "PMI_SIZE", "PMIX_RANK")


class Progress:
    """Receives the progress of a study; this base class ignores it."""

    def asked(self, count: int) -> None:
        """Receive the number of runs."""

    def again(self, run: PlannedRun, why: str) -> None:
        """Receive the repetition of an existing run, with the reason."""

    def started(self, run: PlannedRun) -> None:
        """Receive the start of a run."""

    def kept(self, outcome: Outcome) -> None:
        """Receive the outcome of a run of an earlier study."""

    def ended(self, outcome: Outcome) -> None:
        """Receive the outcome of a run of this study."""


@dataclass(frozen=True)
class Runs(Declared):
    """The runs of a case in one folder.

    Parameters
    ----------
    case : Path
        The case file.
    folder : Path
        Folder of the study.
    writes : tuple of str
        Names of files that the study writes to the folder besides its runs.
    ranks, jobs : int
        Ranks of each run, and number of parallel runs.
    options : sequence of str
        Words for the command line of every run: PETSc's options, ``--solver NAME``.
    retry : bool
        Repeat failed runs.
    launcher : str, optional
        Launcher of ranks; by default ``mpirun -n {ranks}``.

    Raises
    ------
    CaseError
        A number is not positive, the launcher does not contain the number of ranks, or MPI has started this process.
    """

    case: Path
    folder: Path
    writes: tuple[str, ...]
    ranks: Count = 1
    jobs: Count = 1
    options: Sequence[str] = ()
    retry: bool = False
    launcher: str | None = None

    def __post_init__(self) -> None:
        super().__post_init__()
        if any(name in os.environ for name in LAUNCHED):
            raise CaseError("A study starts its runs itself: call it without mpirun and give --ranks N.")
        launched((), self.ranks, self.launcher)

    @functools.cached_property
    def file(self) -> CaseFile:
        """Return the case file with the options and ranks of the runs."""
        return CaseFile(self.case, self.options, self.ranks)

    @contextlib.contextmanager
    def in_folder(self) -> Iterator[None]:
        """Lock the folder for this study while the body runs; nothing is written before.

        Tables and pictures of an earlier study in the folder are removed.

        Raises
        ------
        CaseError
            The folder belongs to another study, has other files with the names of this one, or cannot be written to.
        """
        with holding(alone(), self.folder):
            claim_folder(self.folder, self.writes)
            for name in self.writes:
                (self.folder / name).unlink(missing_ok=True)
            yield

    def outcomes(
        self, planned: Sequence[PlannedRun], progress: Progress | None = None
    ) -> Generator[list[Outcome], None, None]:
        """Execute the runs that have not finished earlier; close the iterator to end active ones.

        Parameters
        ----------
        planned : sequence of PlannedRun
            The runs, at least one.
        progress : Progress, optional
            Receives the progress of runs.

        Yields
        ------
        list of Outcome
            The outcomes so far, in the order of the planned runs: first of earlier runs, then after the end of each
            run. The last list is complete.

        Raises
        ------
        CaseError
            The folder of a run was not created by a study, has other files, or is in use by another run.
        OutputError
            An outcome cannot be written.
        """
        tell = progress or Progress()
        ended: dict[int, Outcome] = {}
        waiting: list[int] = []
        for run in planned:
            if not run.refused:
                claim_folder(self._folder(run))
        tell.asked(len(planned))
        for number, run in enumerate(planned):
            earlier, why = (None, "") if run.refused else read_outcome(self._folder(run), run.identity)
            if run.refused:
                ended[number] = self._failed(run, CaseError.exit_status, run.refused)
                tell.ended(ended[number])
            elif earlier is not None and (earlier.finished or not self.retry):
                ended[number] = dataclasses.replace(earlier, parameters=run.parameters)
                tell.kept(ended[number])
            else:
                waiting.append(number)
                if why:
                    tell.again(run, why)
        running: dict[int, Job] = {}
        try:
            yield [ended[number] for number in sorted(ended)]
            while waiting or running:
                for number, outcome in self._next(planned, waiting, running, tell):
                    ended[number] = outcome
                    tell.ended(outcome)
                    yield [ended[number] for number in sorted(ended)]
                time.sleep(LOOK)
        except BaseException:
            end_all(list(running.values()))
            raise

    def _next(
        self, planned: Sequence[PlannedRun], waiting: list[int], running: dict[int, Job], tell: Progress
    ) -> Iterator[tuple[int, Outcome]]:
        """Start waiting runs, and yield the number and outcome of those that have ended."""
        while waiting and len(running) < self.jobs:
            number = waiting.pop(0)
            run = planned[number]
            if changed := differing(run.files, self.case.parent):
                yield number, self._changed(run, changed)
                continue
            line, log = self._prepared(run)
            with held():
                running[number] = Job(line, log)
            tell.started(run)
        for number, job in list(running.items()):
            if (status := job.ended) is not None:
                outcome = self._judged(planned[number], job, status)
                del running[number]
                yield number, outcome

    def _folder(self, run: PlannedRun) -> Path:
        return folder_of(self.folder, run.parameters)

    def _failed(self, run: PlannedRun, exit_status: int, said: str) -> Outcome:
        return Outcome(run.parameters, self._folder(run), "failed", exit_status, said)

    def _changed(self, run: PlannedRun, names: Sequence[str], exit_status: int = 0) -> Outcome:
        """Return the outcome of a run whose input files have changed since planning; it is not stored."""
        said = f"the case or its files changed while the study ran: {', '.join(names)}."
        failed = self._failed(run, exit_status or SolveError.exit_status, said)
        return dataclasses.replace(failed, changed=True)

    def _prepared(self, run: PlannedRun) -> tuple[list[str], Path]:
        """Prepare the folder of a run; return its command and the file of its output."""
        folder = self._folder(run)
        _wait_for_others(folder)
        # Remove files of an earlier run, so that they cannot be mistaken for results of this run.
        (folder / RECORD).unlink(missing_ok=True)
        set_aside(alone(), folder)
        given = [f"{name}={value}" for name, value in run.parameters.items()]
        return launched(command(self.case, given, folder, self.options), self.ranks, self.launcher), folder / LOG

    def _judged(self, run: PlannedRun, job: Job, status: int) -> Outcome:
        """Return and store the outcome of a run, by its exit status and summary."""
        if changed := differing(run.files, self.case.parent):
            return self._changed(run, changed, status)
        folder = self._folder(run)
        try:
            summary = read_summary(folder)
        except CaseError:
            summary = {}
        results = summary.get("results") or {}
        # A summary with other parameters does not belong to this run.
        own = run.parameters.keys() <= (summary.get("parameters") or {}).keys()
        finished = status == 0 and summary.get("status") == "converged" and own and fits(results, Mapping[str, Finite])
        outcome = Outcome(
            run.parameters, folder, "finished" if finished else "failed", status,
            "" if finished else job.said if status else f"exit status 0 without a finished run: {job.said}",
            {name: float(value) for name, value in results.items()} if finished else {},
            working_seconds(summary), mebibytes(summary),
            sum(bool(step.get("negative_pivots")) for step in summary.get("steps") or []),
            job.messages if finished else (), _noise(summary),
        )  # fmt: skip
        # A stopped run has not failed; it is run again.
        if summary.get("error") != "Interrupted":
            write_outcome(outcome, run.identity)
        return outcome


def _wait_for_others(folder: Path) -> None:
    """Wait for a run left by a killed study; raise CaseError if it continues."""
    until = time.monotonic() + PATIENCE
    while (holder := holder_of(folder)) is not None and not holder.gone:
        if time.monotonic() > until:
            raise CaseError(f"Process {holder.pid} on {holder.host} runs in {folder}; wait for it, or end it.")
        time.sleep(0.1)


def _noise(summary: Mapping[str, Any]) -> float:
    """Return the relative error of a result by the tolerance of the solver, with its amplification."""
    if not str(summary.get("solver")).startswith("snes"):
        return NOISE
    try:
        tolerance = float(summary["options"]["snes_rtol"]["value"])
    except (KeyError, TypeError, ValueError):
        return NOISE
    return max(LEAST_NOISE, AMPLIFIED * tolerance) if math.isfinite(tolerance) else NOISE


@dataclass(frozen=True)
class Study:
    """The results of a study.

    Attributes
    ----------
    folder : Path
        Folder with ``study.csv``, ``study.json`` and a folder for each run.
    outcomes : list of Outcome
        One outcome per parameter set, in their order; failed runs are included, without results.
    convergence : list of Convergence
        Convergence of each result, if ``refine`` is given.
    """

    folder: Path
    outcomes: list[Outcome]
    convergence: list[Convergence] = field(default_factory=list)

    @property
    def failed(self) -> list[Outcome]:
        """Return the runs that failed."""
        return [outcome for outcome in self.outcomes if not outcome.finished]

    def values(self, name: str) -> dict[str, float]:
        """Return a result of each finished run, by the name of the run."""
        return {one.name: one.results[name] for one in self.outcomes if name in one.results}


@dataclass(frozen=True)
class Refinement:
    """The parameter of refinement of a study.

    ``study`` fits ``f_0 + C h^p`` to each result, with ``h`` this parameter or its inverse, for each set of the other
    parameters.

    Parameters
    ----------
    of : str
        ``"dx"`` for a size, ``"1/n"`` for a number of particles or cells.
    exact : mapping of str to float
        Exact values of results for the errors, from another source.
    expected : bool
        Use the expected results of the case if ``exact`` has no value.

    Examples
    --------
    >>> import pdpetsc as pd
    >>> by_number = pd.Refinement("1/n", exact={"tip": 7.4})
    >>> by_number.name
    'n'
    """

    of: str
    exact: Mapping[str, float] = field(default_factory=dict)
    expected: bool = False

    @property
    def name(self) -> str:
        """Return the parameter."""
        return self.of.removeprefix("1/")

    def check(self, kinds: Mapping[str, str], sets: Iterable[Mapping[str, str]]) -> None:
        """Raise CaseError if the case does not have the parameter, or if it is a number of something and no size."""
        refuse_unknown([self.name], kinds, "The case has no parameter")
        if kinds[self.name] not in ("int", "float"):
            raise CaseError(f"Parameter {self.name} is no number, so it is no size.")
        if kinds[self.name] == "int" and not self.of.startswith("1/"):
            raise CaseError(f"Parameter {self.name} is a whole number, so it counts; the size is then 1/{self.name}.")
        if any(self.name not in one for one in sets):
            raise CaseError(f"Every parameter set needs a value of {self.name}, which is to be refined.")

    def found(self, outcomes: Sequence[Outcome], planned: Sequence[PlannedRun]) -> list[Convergence]:
        """Return the convergence of each result, for each set of the other parameters.

        Raises
        ------
        CaseError
            An exact value does not belong to a result of the runs.
        """
        groups: dict[str, list[tuple[Outcome, PlannedRun]]] = {}
        for outcome, run in zip(outcomes, planned, strict=True):
            rest = {name: value for name, value in outcome.parameters.items() if name != self.name}
            groups.setdefault(json.dumps(sorted(rest.items())), []).append((outcome, run))
        names = list(dict.fromkeys(name for outcome in outcomes for name in outcome.results))
        if names:
            refuse_unknown(self.exact, names, "The case has no result")
        found = [self._one(name, members) for members in groups.values() for name in names]
        # A constant, such as an exact value among the results, has no order.
        return [one for one in found if one.exact is not None or len(one.values) < 2 or len(set(one.values)) > 1]

    def _one(self, name: str, members: Sequence[tuple[Outcome, PlannedRun]]) -> Convergence:
        have = [(outcome, run) for outcome, run in members if name in outcome.results]
        sizes = [float(outcome.parameters[self.name]) for outcome, _ in have]
        sizes = [1.0 / size if size else 0.0 for size in sizes] if self.of.startswith("1/") else sizes
        rest = {key: value for key, value in members[0][0].parameters.items() if key != self.name}
        exact, notes = self.exact.get(name), []
        if exact is None and self.expected:
            wanted = {run.expected.get(name) for _, run in have}
            if len(wanted) == 1:
                exact = wanted.pop()
            elif wanted:
                notes.append("what the case expects differs between the sizes, so the order is not against it")
        noise = max((outcome.noise for outcome, _ in have), default=NOISE)
        found = converging(name, sizes, [outcome.results[name] for outcome, _ in have], exact, rest, noise)
        if lost := len(members) - len(have):
            notes.append(f"{lost} of {len(members)} runs failed and are left out")
        return dataclasses.replace(found, note="; ".join(filter(None, [found.note, *notes])))


def study(
    case: str | Path,
    sets: Mapping[str, Sequence[Any]] | Sequence[Mapping[str, Any]],
    folder: str | Path | None = None,
    *,
    ranks: int = 1,
    jobs: int = 1,
    options: Sequence[str] = (),
    retry: bool = False,
    launcher: str | None = None,
    refine: Refinement | str | None = None,
    progress: Progress | None = None,
    name: str = "study",
) -> Study:
    """Run a case with many parameter sets, each in a separate process, and write one table.

    Runs in the folder are not repeated if the case file with its imports and declarations, parameters, options, ranks
    and pdpetsc are unchanged, and the files of the run too. Failed runs are repeated only with ``retry``. Call a
    stopped or killed study again to continue.

    Parameters
    ----------
    case : str or Path
        The case file.
    sets : mapping of str to sequence, or sequence of mappings
        Values of each parameter, for all combinations; or the parameter sets themselves.
    folder : str or Path, optional
        Folder of the table and of the runs; by default ``out/study_CASE``.
    ranks, jobs : int
        Ranks of each run, and number of parallel runs.
    options : sequence of str
        Words for the command line of each run, such as ``["-pc_type", "lu"]``.
    retry : bool
        Repeat failed runs.
    launcher : str, optional
        Launcher of ranks; by default ``"mpirun -n {ranks}"``, and none for one rank.
    refine : Refinement or str, optional
        The parameter of refinement, for orders of convergence.
    progress : Progress, optional
        Receives the progress of runs.
    name : str
        Name of the tables.

    Returns
    -------
    Study
        Outcomes of all runs; failed runs have no results.

    Raises
    ------
    CaseError
        The case file cannot be read, a parameter or its value does not fit the case, every set is refused by the case,
        or the folder is in use or not of a study. Nothing was run.
    OutputError
        A table cannot be written.

    Notes
    -----
    Not collective: call it from one process, without mpirun.

    Examples
    --------
    >>> import pdpetsc as pd
    >>> done = pd.study("bar.py", {"dx": [1.0, 0.5, 0.25]}, "out/bars", jobs=2, refine="dx")  # doctest: +SKIP
    >>> done.values("u_end"), done.convergence[0].order                                       # doctest: +SKIP
    """
    path = Path(case)
    place = Path(folder) if folder is not None else Path("out") / f"{name}_{path.stem}"
    if isinstance(sets, Mapping):
        listed = grid(sets)
    else:
        listed = [{parameter: text_of(value) for parameter, value in one.items()} for one in sets]
    along = Refinement(refine) if isinstance(refine, str) else refine
    runs = Runs(path, place, table.names(name), ranks, jobs, options, retry, launcher)
    if not listed:
        raise CaseError("A study needs a parameter set.")
    planned = runs.file.plan(listed)
    if along is not None:
        along.check(runs.file.kinds, [run.parameters for run in planned])
    if all(run.refused for run in planned):
        raise CaseError(planned[0].refused)
    outcomes: list[Outcome] = []
    with runs.in_folder(), contextlib.closing(runs.outcomes(planned, progress)) as so_far:
        for outcomes in so_far:
            table.write(place, name, outcomes, [])
        convergence = along.found(outcomes, planned) if along is not None else []
        table.write(place, name, outcomes, convergence)
    return Study(place, outcomes, convergence)
