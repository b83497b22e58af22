"""Running one case with many parameter sets, and going on with what is there."""

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
from pdpetsc.studies.run_store import LOG, RECORD, Outcome, folder_of, keep, kept, take
from pdpetsc.studies.sets import grid, text_of

# How long a run that an earlier study left behind may take to end [s].
PATIENCE = 60.0
# Share of a result that is open, over the tolerance of Newton's residual, and the least that there is [-].
AMPLIFIED, LEAST_NOISE = 100.0, 1e-8
# What tells that a launcher of MPI has started this process.
LAUNCHED = ("OMPI_COMM_WORLD_SIZE", "PMI_SIZE", "PMIX_RANK")


class Progress:
    """Is told how a study goes on; this one keeps it to itself."""

    def asked(self, count: int) -> None:
        """Take how many runs there are."""

    def again(self, run: PlannedRun, why: str) -> None:
        """Take that a run is run again though there is one."""

    def started(self, run: PlannedRun) -> None:
        """Take that a run has been started."""

    def kept(self, outcome: Outcome) -> None:
        """Take how a run ended in an earlier study."""

    def ended(self, outcome: Outcome) -> None:
        """Take how a run ended in this study."""


@dataclass(frozen=True)
class Runs(Declared):
    """The runs of a case in one folder.

    Parameters
    ----------
    case : Path
        The case file.
    folder : Path
        Of the study.
    writes : tuple of str
        Names of the files that the study writes into the folder beside those of its runs.
    ranks, jobs : int
        Ranks of each run, and runs side by side.
    options : sequence of str
        Words for the command line of every run: PETSc's options, ``--solver NAME``.
    retry : bool
        Run again what has failed.
    launcher : str, optional
        What starts ranks, ``mpirun -n {ranks}`` by default.

    Raises
    ------
    CaseError
        A number is not positive, the launcher does not say where the number of ranks goes, or MPI has started this
        process.
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
        """Keep the folder for this study while the body runs; nothing is written before.

        Raises
        ------
        CaseError
            The folder is another study's, holds other files under names of this one, or cannot be written to.
        """
        with holding(alone(), self.folder):
            take(self.folder, self.writes)
            yield

    def outcomes(
        self, planned: Sequence[PlannedRun], progress: Progress | None = None
    ) -> Generator[list[Outcome], None, None]:
        """Carry out the runs that have not finished earlier; close the iterator to end those that go on.

        Parameters
        ----------
        planned : sequence of PlannedRun
            The runs, at least one.
        progress : Progress, optional
            Is told of every run.

        Yields
        ------
        list of Outcome
            How the runs that have ended so far ended, in the order of the planned runs: first the earlier ones, then
            whenever a run has ended. The last list is complete.

        Raises
        ------
        CaseError
            The folder of a run is none that a study has made, holds files of others, or something else runs in it.
        OutputError
            How a run ended cannot be written.
        """
        tell = progress or Progress()
        ended: dict[int, Outcome] = {}
        waiting: list[int] = []
        for run in planned:
            if not run.refused:
                take(self._folder(run))
        tell.asked(len(planned))
        for number, run in enumerate(planned):
            earlier, why = (None, "") if run.refused else kept(self._folder(run), run.identity)
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
        """Start runs that wait, and yield the number and outcome of those that have ended."""
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
        """Return the outcome of a run whose input files are not those it was planned with; it is not kept."""
        said = f"the case or its files changed while the study ran: {', '.join(names)}."
        failed = self._failed(run, exit_status or SolveError.exit_status, said)
        return dataclasses.replace(failed, changed=True)

    def _prepared(self, run: PlannedRun) -> tuple[list[str], Path]:
        """Make the folder of a run ready; return its command and where its output goes."""
        folder = self._folder(run)
        _wait_for_others(folder)
        # Nothing of an earlier run is left to be taken for what this one gives.
        (folder / RECORD).unlink(missing_ok=True)
        set_aside(alone(), folder)
        given = [f"{name}={value}" for name, value in run.parameters.items()]
        return launched(command(self.case, given, folder, self.options), self.ranks, self.launcher), folder / LOG

    def _judged(self, run: PlannedRun, job: Job, status: int) -> Outcome:
        """Return how a run ended, by its exit status and its own summary, and keep that."""
        if changed := differing(run.files, self.case.parent):
            return self._changed(run, changed, status)
        folder = self._folder(run)
        try:
            summary = read_summary(folder)
        except CaseError:
            summary = {}
        results = summary.get("results") or {}
        # A summary of other parameters is not of this run.
        own = run.parameters.keys() <= (summary.get("parameters") or {}).keys()
        finished = status == 0 and summary.get("status") == "converged" and own and fits(results, Mapping[str, Finite])
        outcome = Outcome(
            run.parameters, folder, "finished" if finished else "failed", status,
            "" if finished else job.said if status else f"exit status 0 without a finished run: {job.said}",
            {name: float(value) for name, value in results.items()} if finished else {},
            working_seconds(summary), mebibytes(summary),
            sum(bool(step.get("negative_pivots")) for step in summary.get("steps") or []), _noise(summary),
        )  # fmt: skip
        # A run that somebody has stopped has not failed: it is to be run.
        if summary.get("error") != "Interrupted":
            keep(outcome, run.identity)
        return outcome


def _wait_for_others(folder: Path) -> None:
    """Wait for a run that a study left behind which was killed; raises CaseError where it goes on."""
    until = time.monotonic() + PATIENCE
    while (holder := holder_of(folder)) is not None and not holder.gone:
        if time.monotonic() > until:
            raise CaseError(f"Process {holder.pid} on {holder.host} runs in {folder}; wait for it, or end it.")
        time.sleep(0.1)


def _noise(summary: Mapping[str, Any]) -> float:
    """Return the share of a result that the solver of a run leaves open: its tolerance, and what makes of that more."""
    if not str(summary.get("solver")).startswith("snes"):
        return NOISE
    try:
        tolerance = float(summary["options"]["snes_rtol"]["value"])
    except (KeyError, TypeError, ValueError):
        return NOISE
    return max(LEAST_NOISE, AMPLIFIED * tolerance) if math.isfinite(tolerance) else NOISE


@dataclass(frozen=True)
class Study:
    """What a study has given.

    Attributes
    ----------
    folder : Path
        Holds ``study.csv``, ``study.json`` and a folder for each run.
    outcomes : list of Outcome
        One for each parameter set, in their order; failed runs are among them, without results.
    convergence : list of Convergence
        How each result converges, where that was asked for.
    """

    folder: Path
    outcomes: list[Outcome]
    convergence: list[Convergence] = field(default_factory=list)

    @property
    def failed(self) -> list[Outcome]:
        """Return the runs that failed."""
        return [outcome for outcome in self.outcomes if not outcome.finished]

    def values(self, name: str) -> dict[str, float]:
        """Return a result by the name of each run that finished."""
        return {one.name: one.results[name] for one in self.outcomes if name in one.results}


@dataclass(frozen=True)
class Refinement:
    """Which parameter makes a study finer.

    ``study`` puts ``f_0 + C h^p`` through each result, with ``h`` this parameter or one over it, for each set of the
    other parameters.

    Parameters
    ----------
    of : str
        ``"dx"`` where it is a size, ``"1/n"`` where it is a number of particles or cells.
    exact : mapping of str to float
        Values of results from elsewhere, that errors are of; what the case expects counts as such where ``expected``.
    expected : bool
        Take what the case expects where ``exact`` has no value.

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
        """Raise CaseError where no parameter of the case is this one, or it is a number of something and no size."""
        refuse_unknown([self.name], kinds, "The case has no parameter")
        if kinds[self.name] not in ("int", "float"):
            raise CaseError(f"Parameter {self.name} is no number, so it is no size.")
        if kinds[self.name] == "int" and not self.of.startswith("1/"):
            raise CaseError(f"Parameter {self.name} is a whole number, so it counts; the size is then 1/{self.name}.")
        if any(self.name not in one for one in sets):
            raise CaseError(f"Every parameter set needs a value of {self.name}, which is to be refined.")

    def found(self, outcomes: Sequence[Outcome], planned: Sequence[PlannedRun]) -> list[Convergence]:
        """Return how each result converges, for each set of the other parameters.

        Raises
        ------
        CaseError
            An exact value is of no result of the runs.
        """
        groups: dict[str, list[tuple[Outcome, PlannedRun]]] = {}
        for outcome, run in zip(outcomes, planned, strict=True):
            rest = {name: value for name, value in outcome.parameters.items() if name != self.name}
            groups.setdefault(json.dumps(sorted(rest.items())), []).append((outcome, run))
        names = list(dict.fromkeys(name for outcome in outcomes for name in outcome.results))
        if names:
            refuse_unknown(self.exact, names, "The case has no result")
        found = [self._one(name, members) for members in groups.values() for name in names]
        # A constant, such as an exact value beside the result, converges to nothing.
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
    """Run a case with many parameter sets, each in a process of its own, and write one table.

    What the folder already holds is not run again: it is the same case file with all that it imports and declares, the
    same parameters, options, ranks and pdpetsc, and its files are as they were left. What failed stays so until
    ``retry``. A study that was stopped, or killed, goes on when it is called again.

    Parameters
    ----------
    case : str or Path
        The case file.
    sets : mapping of str to sequence, or sequence of mappings
        Values of each parameter, of which all combinations are run; or the parameter sets themselves.
    folder : str or Path, optional
        Where the table and a folder for each run go: ``out/study_CASE`` by default.
    ranks, jobs : int
        Ranks of each run, and runs side by side.
    options : sequence of str
        Words for the command line of each run, as ``["-pc_type", "lu"]``.
    retry : bool
        Run again what has failed.
    launcher : str, optional
        What starts ranks: ``"mpirun -n {ranks}"`` by default, and nothing on one rank.
    refine : Refinement or str, optional
        The parameter that makes the study finer: orders of convergence are found along it.
    progress : Progress, optional
        Is told of every run.
    name : str
        Of the tables.

    Returns
    -------
    Study
        Outcomes of all runs; those that failed have no results.

    Raises
    ------
    CaseError
        The case file cannot be read, a parameter is not one of the case or has no such value, every set is refused by
        the case, or the folder is in use or not a study's. Nothing was run.
    OutputError
        A table cannot be written.

    Notes
    -----
    Not collective: it is called by one process, without mpirun.

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
