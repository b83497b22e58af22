"""Running one case with many parameter sets, and going on with what is there."""

from __future__ import annotations

import contextlib
import dataclasses
import json
import math
import os
import time
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

from pdpetsc.discrete.communicator import alone
from pdpetsc.errors import CaseError, SolveError
from pdpetsc.output.folder import holder_of, holding, set_aside
from pdpetsc.running.comparison import working_seconds
from pdpetsc.running.signals import held
from pdpetsc.studies import table
from pdpetsc.studies.input_files import differing
from pdpetsc.studies.jobs import LOOK, Job, command, end_all, launched
from pdpetsc.studies.refinement import NOISE, Convergence, converging
from pdpetsc.studies.run_identity import CaseFile, Question
from pdpetsc.studies.run_store import LOG, RECORD, Outcome, folder_of, keep, kept, named, take
from pdpetsc.studies.sets import Set, grid, text_of

# How long a run that an earlier study left behind may take to end [s].
PATIENCE = 60.0
# Share of a result that is open, over the tolerance of Newton's residual, and the least that there is [-].
AMPLIFIED, LEAST_NOISE = 100.0, 1e-8
# What tells that a launcher of MPI has started this process.
LAUNCHED = ("OMPI_COMM_WORLD_SIZE", "PMI_SIZE", "PMIX_RANK")


@dataclass(frozen=True)
class How:
    """How the runs of a study are run.

    Attributes
    ----------
    ranks : int
        Of each run.
    jobs : int
        Runs side by side.
    options : sequence of str
        Words for the command line of every run: PETSc's options, ``--solver NAME``.
    retry : bool
        Run again what has failed.
    launcher : str, optional
        What starts ranks, ``mpirun -n {ranks}`` by default.
    """

    ranks: int = 1
    jobs: int = 1
    options: Sequence[str] = ()
    retry: bool = False
    launcher: str | None = None

    def __post_init__(self) -> None:
        for name in ("ranks", "jobs"):
            value = getattr(self, name)
            if isinstance(value, bool) or not isinstance(value, int) or value < 1:
                raise CaseError(f"The number of {name} is a positive whole number, not {value!r}.")


class Progress:
    """Is told how a study goes on; this one keeps it to itself."""

    def asked(self, count: int) -> None:
        """Take how many runs there are."""

    def again(self, question: Question, why: str) -> None:
        """Take that a run is run again though there is one."""

    def started(self, question: Question) -> None:
        """Take that a run has been started."""

    def kept(self, outcome: Outcome) -> None:
        """Take how a run ended in an earlier study."""

    def ended(self, outcome: Outcome) -> None:
        """Take how a run ended in this study."""


class Runs:
    """The runs of a case in one folder, which no other study is in meanwhile; a context manager.

    Parameters
    ----------
    case : Path
        The case file.
    folder : Path
        Of the study.
    how : How
        How they are run.
    writes : tuple of str
        Names of the files that the study writes into the folder beside those of its runs.

    Raises
    ------
    CaseError
        The case file cannot be read, or the folder is another study's, holds other files under these names, or cannot
        be written to.
    """

    def __init__(self, case: Path, folder: Path, how: How, writes: tuple[str, ...]) -> None:
        self.case, self.folder, self.how, self._writes = Path(case), Path(folder), how, writes
        self.file = CaseFile(self.case, how.options, how.ranks)
        self._stack = contextlib.ExitStack()

    def __enter__(self) -> Runs:
        if any(name in os.environ for name in LAUNCHED):
            raise CaseError("A study starts its runs itself: call it without mpirun and give --ranks N.")
        launched((), self.how.ranks, self.how.launcher)
        return self

    def hold(self) -> None:
        """Take the folder; until then nothing is written."""
        _refuse_symlink(self.folder)
        self._stack.enter_context(holding(alone(), self.folder))
        take(self.folder, self._writes)

    def __exit__(self, *error: Any) -> None:
        self._stack.close()

    def outcomes(self, questions: Sequence[Question], progress: Progress | None = None) -> list[Outcome]:
        """Return how the runs ended, in the order of the questions; run those that are not finished.

        Raises
        ------
        CaseError
            The folder of a run is none that a study has made, holds files of others, or something else runs in it.
        OutputError
            How a run ended cannot be written.
        """
        tell = progress or Progress()
        for question in questions:
            if not question.refused:
                take(folder_of(self.folder, question.parameters))
        found: dict[int, Outcome] = {}
        waiting: list[int] = []
        tell.asked(len(questions))
        for number, question in enumerate(questions):
            folder = folder_of(self.folder, question.parameters)
            if question.refused:
                found[number] = Outcome(question.parameters, folder, "failed", CaseError.exit_status, question.refused)
                continue
            there, why = kept(folder, question.identity)
            if there is not None and (there.finished or not self.how.retry):
                found[number] = dataclasses.replace(there, parameters=question.parameters)
                continue
            if why:
                tell.again(question, why)
            waiting.append(number)
        for number, outcome in found.items():
            (tell.ended if questions[number].refused else tell.kept)(outcome)
        running: dict[int, Job] = {}
        try:
            for number, outcome in self._ended(questions, waiting, running, tell):
                found[number] = outcome
                tell.ended(outcome)
        except BaseException:
            end_all(list(running.values()))
            raise
        return [found[number] for number in range(len(questions))]

    def _ended(
        self, questions: Sequence[Question], waiting: list[int], running: dict[int, Job], tell: Progress
    ) -> Iterator[tuple[int, Outcome]]:
        """Yield runs as they end."""
        while waiting or running:
            while waiting and len(running) < self.how.jobs:
                number = waiting.pop(0)
                if changed := differing(questions[number].files, self.case.parent):
                    folder = folder_of(self.folder, questions[number].parameters)
                    yield number, _of_changed(Outcome(questions[number].parameters, folder, "failed"), changed)
                    continue
                line, log = self._prepared(questions[number])
                with held():
                    running[number] = Job(line, log)
                tell.started(questions[number])
            for number, job in list(running.items()):
                if (status := job.ended) is not None:
                    outcome = self._judged(questions[number], job, status)
                    del running[number]
                    yield number, outcome
            time.sleep(LOOK)

    def _prepared(self, question: Question) -> tuple[list[str], Path]:
        """Make the folder of a run ready; return its command and where its output goes."""
        folder = folder_of(self.folder, question.parameters)
        _wait_for_others(folder)
        # Nothing of an earlier run is left to be taken for what this one gives.
        (folder / RECORD).unlink(missing_ok=True)
        set_aside(alone(), folder)
        given = [f"{name}={value}" for name, value in question.parameters.items()]
        line = command(self.case, given, folder, self.how.options)
        return launched(line, self.how.ranks, self.how.launcher), folder / LOG

    def _judged(self, question: Question, job: Job, status: int) -> Outcome:
        """Return how a run ended, by its exit status and its own summary, and keep that."""
        folder = folder_of(self.folder, question.parameters)
        summary = _summary(folder)
        finished = status == 0 and summary.get("status") == "converged" and _is_asked(summary, question)
        results = summary.get("results") if finished else {}
        if finished and not _are_numbers(results):
            finished, results = False, {}
        steps = summary.get("steps")
        outcome = Outcome(
            question.parameters, folder, "finished" if finished else "failed", status,
            "" if finished else job.said if status else f"exit status 0 without a finished run: {job.said}",
            {name: float(value) for name, value in (results or {}).items()}, working_seconds(summary),
            sum(summary.get("peak_memory_bytes") or []) / 2**20,
            sum(bool(step.get("negative_pivots")) for step in steps) if isinstance(steps, list) else 0,
            _noise(summary),
        )  # fmt: skip
        if changed := differing(question.files, self.case.parent):
            return _of_changed(outcome, changed)
        # A run that somebody has stopped has not failed: it is to be run.
        if summary.get("error") != "Interrupted":
            keep(outcome, question.identity)
        return outcome


def _of_changed(outcome: Outcome, names: Sequence[str]) -> Outcome:
    """Return a failed run, which is not kept: its input files are not those of the question."""
    said = f"the case or its files changed while the study ran: {', '.join(names)}."
    exit_status = outcome.exit_status or SolveError.exit_status
    return dataclasses.replace(outcome, status="failed", said=said, results={}, exit_status=exit_status, changed=True)


def _refuse_symlink(folder: Path) -> None:
    if folder.is_symlink() and not folder.is_dir():
        raise CaseError(f"{folder} is not a folder; give another one with -o.")


def _wait_for_others(folder: Path) -> None:
    """Wait for a run that a study left behind which was killed; raises CaseError where it goes on."""
    until = time.monotonic() + PATIENCE
    while (holder := holder_of(folder)) is not None and not holder.gone:
        if time.monotonic() > until:
            raise CaseError(f"Process {holder.pid} on {holder.host} runs in {folder}; wait for it, or end it.")
        time.sleep(0.1)


def _summary(folder: Path) -> dict[str, Any]:
    try:
        found = json.loads((folder / "summary.json").read_text())
    except (OSError, ValueError):
        return {}
    return found if isinstance(found, dict) else {}


def _noise(summary: Mapping[str, Any]) -> float:
    """Return the share of a result that the solver of a run leaves open: its tolerance, and what makes of that more."""
    try:
        if not str(summary["solver"]).startswith("snes"):
            return NOISE
        tolerance = float(summary["options"]["snes_rtol"]["value"])
    except (KeyError, TypeError, ValueError):
        return NOISE
    return max(LEAST_NOISE, AMPLIFIED * tolerance) if math.isfinite(tolerance) else NOISE


def _is_asked(summary: Mapping[str, Any], question: Question) -> bool:
    """Return whether a summary is of a run with these parameters."""
    of_run = summary.get("parameters")
    return isinstance(of_run, Mapping) and question.parameters.keys() <= of_run.keys()


def _are_numbers(results: Any) -> bool:
    return isinstance(results, Mapping) and all(
        isinstance(value, int | float) and math.isfinite(value) for value in results.values()
    )


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
        if self.name not in kinds:
            raise CaseError(f"The case has no parameter {self.name!r} to refine; it has {', '.join(kinds) or 'none'}.")
        if kinds[self.name] not in ("int", "float"):
            raise CaseError(f"Parameter {self.name} is no number, so it is no size.")
        if kinds[self.name] == "int" and not self.of.startswith("1/"):
            raise CaseError(f"Parameter {self.name} is a whole number, so it counts; the size is then 1/{self.name}.")
        if any(self.name not in one for one in sets):
            raise CaseError(f"Every parameter set needs a value of {self.name}, which is to be refined.")

    def found(self, outcomes: Sequence[Outcome], questions: Sequence[Question]) -> list[Convergence]:
        """Return how each result converges, for each set of the other parameters.

        Raises
        ------
        CaseError
            An exact value is of no result of the runs.
        """
        groups: dict[str, list[tuple[Outcome, Question]]] = {}
        for outcome, question in zip(outcomes, questions, strict=True):
            rest = {name: value for name, value in outcome.parameters.items() if name != self.name}
            groups.setdefault(json.dumps(sorted(rest.items())), []).append((outcome, question))
        names = list(dict.fromkeys(name for outcome in outcomes for name in outcome.results))
        for name in self.exact:
            if names and name not in names:
                raise CaseError(f"The runs have no result {name!r}; they have {', '.join(names)}.")
        return [self._one(name, members) for members in groups.values() for name in names]

    def _one(self, name: str, members: Sequence[tuple[Outcome, Question]]) -> Convergence:
        have = [(outcome, question) for outcome, question in members if name in outcome.results]
        sizes = [float(outcome.parameters[self.name]) for outcome, _ in have]
        sizes = [1.0 / size if size else 0.0 for size in sizes] if self.of.startswith("1/") else sizes
        rest = {key: value for key, value in members[0][0].parameters.items() if key != self.name}
        exact, notes = self.exact.get(name), []
        if exact is None and self.expected:
            wanted = {question.expected.get(name) for _, question in have}
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
    progress: Callable[[Sequence[Question]], contextlib.AbstractContextManager[Progress]] | None = None,
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
    progress : callable, optional
        Is given the questions and returns a context with what is told how the study goes on.
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
    listed: list[Set] = grid(sets) if isinstance(sets, Mapping) else [_texts(one) for one in sets]
    along = Refinement(refine) if isinstance(refine, str) else refine
    with Runs(path, place, How(ranks, jobs, options, retry, launcher), table.names(name)) as runs:
        if not listed:
            raise CaseError("A study needs a parameter set.")
        questions = runs.file.ask(listed)
        if along is not None:
            along.check(runs.file.kinds, [question.parameters for question in questions])
        if all(question.refused for question in questions):
            raise CaseError(questions[0].refused)
        runs.hold()
        with (progress or _silent)(questions) as told:
            outcomes = runs.outcomes(questions, _Writing(told, place, name, questions))
        found = along.found(outcomes, questions) if along is not None else []
        table.write(place, name, outcomes, found)
    return Study(place, outcomes, found)


def _texts(one: Mapping[str, Any]) -> Set:
    return {name: text_of(value) for name, value in one.items()}


@contextlib.contextmanager
def _silent(questions: Sequence[Question]) -> Iterator[Progress]:
    yield Progress()


class _Writing(Progress):
    """Writes the table whenever a run has ended, and passes on what it is told."""

    def __init__(self, to: Progress, folder: Path, name: str, questions: Sequence[Question]) -> None:
        self._to, self._folder, self._name = to, folder, name
        self._order = [named(question.parameters) for question in questions]
        self._known: dict[str, Outcome] = {}

    def asked(self, count: int) -> None:
        self._to.asked(count)

    def again(self, question: Question, why: str) -> None:
        self._to.again(question, why)

    def started(self, question: Question) -> None:
        self._to.started(question)

    def kept(self, outcome: Outcome) -> None:
        self._known[named(outcome.parameters)] = outcome
        self._to.kept(outcome)

    def ended(self, outcome: Outcome) -> None:
        self._known[named(outcome.parameters)] = outcome
        table.write(self._folder, self._name, [self._known[one] for one in self._order if one in self._known], [])
        self._to.ended(outcome)


def refuse_failed(done: Study, name: str = "study") -> None:
    """Raise SolveError if runs did not reach their end, with what the first of them said."""
    if done.failed:
        first = done.failed[0]
        raise SolveError(
            f"{len(done.failed)} of {len(done.outcomes)} runs failed, the first one, {first.name}, with exit status "
            f"{first.exit_status}: {first.said.rstrip('.')}; all are in {done.folder / f'{name}.csv'}, and --retry "
            f"runs them again."
        )
