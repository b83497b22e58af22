"""``python -m pdpetsc study CASE.py name=a,b,c ...``: many runs, one table that resumes."""

from __future__ import annotations

import contextlib
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

from rich.console import Console
from rich.progress import BarColumn, MofNCompleteColumn, TaskID, TextColumn, TimeRemainingColumn
from rich.progress import Progress as Bar

from pdpetsc.bounds import whole_number
from pdpetsc.command_line.arguments import Arguments, split
from pdpetsc.declared import shown
from pdpetsc.errors import CaseError, Interrupted
from pdpetsc.studies.jobs import too_many
from pdpetsc.studies.picture import draw
from pdpetsc.studies.run_identity import Question
from pdpetsc.studies.run_store import Outcome, named
from pdpetsc.studies.sets import combined, grid, read_sets, values_in
from pdpetsc.studies.study import Progress, Refinement, Study, refuse_failed, study
from pdpetsc.studies.table import of_orders, on_terminal

USAGE = """usage: python -m pdpetsc study CASE.py [NAME=A,B,C ...] [--sets FILE] [-o DIR] [--ranks N] [--jobs N]
                               [--retry] [--order NAME] [--exact RESULT=VALUE,...] [--picture] [-PETSC_OPTION [VALUE]]

  NAME=A,B,C       values of a parameter of the case; all combinations are run
  --sets FILE      parameter sets, grids or samples from a .toml, .json or .csv, each with all of these combinations
  -o DIR           folder for study.csv, study.json and a folder per run (default: out/study_CASE)
  --ranks N        run each on N ranks
  --jobs N         runs side by side
  --retry          run again what has failed
  --order NAME     order of convergence, extrapolated value and error bar as the size NAME gets small; 1/NAME where
                   NAME counts particles or cells
  --exact R=V,...  values of results from elsewhere, which orders are then against
  --expected       take what the case expects as such
  --picture        draw study.png: every result along a parameter, errors over seconds
  --launcher TEXT  what starts ranks, with {ranks} where their number goes (default: "mpirun -n {ranks}")
  --solver NAME    the solver of every run
Other -options go to PETSc in every run. What DIR already holds is not run again as long as case, parameters, options,
ranks and pdpetsc are the same: a study that was stopped goes on with the same command."""

# Options that take a word after them, and those that do not.
WITH_VALUE = ("--sets", "--ranks", "--jobs", "--order", "--exact", "--launcher")
FLAGS = ("--retry", "--expected", "--picture")


@dataclass
class Asked:
    """What a command line asks of a study, and the words that are left."""

    options: dict[str, str] = field(default_factory=dict)
    flags: set[str] = field(default_factory=set)
    words: list[str] = field(default_factory=list)


def taken(argv: Sequence[str], with_value: Sequence[str] = WITH_VALUE, flags: Sequence[str] = FLAGS) -> Asked:
    """Take the options of a study out of a command line; raises CaseError where one has no value or is there twice."""
    asked, words = Asked(), list(argv)
    while words:
        word = words.pop(0)
        if word in with_value:
            if not words:
                raise CaseError(f"{word} needs a value after it.")
            if word in asked.options:
                raise CaseError(f"{word} is given twice.")
            asked.options[word] = words.pop(0)
        elif word in flags:
            asked.flags.add(word)
        else:
            asked.words.append(word)
    return asked


def count(asked: Asked, name: str, otherwise: int = 1) -> int:
    """Return the positive number after an option, or what it is otherwise; raises CaseError."""
    text = asked.options.get(name, str(otherwise))
    found = whole_number(text)
    if not found:
        raise CaseError(f"{name} takes a positive number, not {shown(text)}.")
    return found


def numbers_of(text: str, option: str) -> dict[str, float]:
    """Return the numbers of ``NAME=VALUE,NAME=VALUE``; raises CaseError."""
    found = {}
    for word in filter(None, text.split(",")):
        name, _, value = word.partition("=")
        try:
            found[name] = float(value)
        except ValueError:
            raise CaseError(f"{option} takes NAME=NUMBER, not {word!r}.") from None
    return found


def run(
    case: Path, parameters: Mapping[str, str], output: Path | None, options: Sequence[str], asked: Asked,
    name: str = "study",
) -> Study:  # fmt: skip
    """Run a study as its command line asks, and print its table.

    Raises
    ------
    CaseError, OutputError
        As ``study`` does.
    SolveError
        Runs failed.
    Interrupted
        It was stopped.
    """
    sets = grid({key: values_in(text) for key, text in parameters.items()})
    if "--sets" in asked.options:
        sets = combined(sets, read_sets(Path(asked.options["--sets"])))
    ranks, jobs = count(asked, "--ranks"), count(asked, "--jobs")
    refine = None
    if "--order" in asked.options:
        exact = numbers_of(asked.options.get("--exact", ""), "--exact")
        refine = Refinement(asked.options["--order"], exact, "--expected" in asked.flags)
    elif "--exact" in asked.options or "--expected" in asked.flags:
        raise CaseError("--exact and --expected are for --order NAME, which says along which parameter.")
    folder = output if output is not None else Path("out") / f"{name}_{case.stem}"
    console = Console(soft_wrap=True, highlight=False, markup=False)
    if warning := too_many(jobs, ranks):
        console.print(f"pdpetsc: {warning}")

    @contextlib.contextmanager
    def shown(questions: Sequence[Question]) -> Iterator[Progress]:
        with Shown(console, case.stem) as progress:
            yield progress

    try:
        done = study(
            case, sets, folder, ranks=ranks, jobs=jobs, options=options, retry="--retry" in asked.flags,
            launcher=asked.options.get("--launcher"), refine=refine, progress=shown, name=name,
        )  # fmt: skip
    except KeyboardInterrupt:
        raise Interrupted(f"Stopped; the same command goes on with what {folder} holds.") from None
    console.print(on_terminal(done.outcomes))
    if done.convergence:
        console.print(of_orders(done.convergence))
        for one in done.convergence:
            if one.note:
                console.print(f"{', '.join(filter(None, [named(one.group), one.result]))}: {one.note}")
    for outcome in done.failed:
        console.print(f"{outcome.name}: exit status {outcome.exit_status}: {outcome.said}")
    console.print(f"table in {folder / f'{name}.csv'}")
    if "--picture" in asked.flags:
        draw(folder / f"{name}.png", case.stem, done.outcomes)
        console.print(f"picture in {folder / f'{name}.png'}")
    refuse_failed(done, name)
    return done


class Shown(Progress):
    """Shows on a terminal how a study goes on: a line for each run that ends, and a bar; a context manager."""

    def __init__(self, console: Console, title: str) -> None:
        columns = TextColumn("{task.description}"), BarColumn(), MofNCompleteColumn(), TimeRemainingColumn()
        self._console = console
        self._bar = Bar(*columns, console=console, transient=True, disable=not console.is_terminal)
        self._task: TaskID = self._bar.add_task(title, total=None)
        self._kept = 0

    def __enter__(self) -> Shown:
        self._bar.start()
        return self

    def __exit__(self, *error: Any) -> None:
        self._bar.stop()

    def asked(self, count: int) -> None:
        """Set the length of the bar."""
        self._bar.update(self._task, total=count)

    def again(self, question: Question, why: str) -> None:
        """Say why a run is run again."""
        self._console.print(f"{named(question.parameters) or 'the case'} is run again: {why}")

    def started(self, question: Question) -> None:
        """Say how many were there."""
        if self._kept:
            self._console.print(f"{self._kept} runs are there from before")
            self._kept = 0

    def kept(self, outcome: Outcome) -> None:
        """Move the bar, and count the run."""
        self._bar.advance(self._task)
        self._kept += 1

    def ended(self, outcome: Outcome) -> None:
        """Move the bar, and say how the run ended."""
        self._bar.advance(self._task)
        how = "finished" if outcome.finished else f"FAILED, exit status {outcome.exit_status}: {outcome.said}"
        self._console.print(f"{outcome.name}: {how}")


def main(argv: Sequence[str]) -> int:
    """Run the command ``study``; return its exit status or raise what ends it."""
    asked = taken(argv)
    arguments = split(asked.words)
    case = case_of(arguments, "study", USAGE)
    if case is not None:
        run(case, arguments.parameters, arguments.output, options_of(arguments), asked)
    return 0


def case_of(arguments: Arguments, name: str, usage: str) -> Path | None:
    """Return the case file, or None after the usage has been printed.

    Raises
    ------
    CaseError
        There is no case file, or an option is one of a single run.
    """
    if "--help" in arguments.flags:
        print(usage)
        return None
    if arguments.path is None:
        raise CaseError(f"No case file is given; python -m pdpetsc {name} -h shows the usage.")
    if arguments.restart is not None or "--restart-anyway" in arguments.flags:
        raise CaseError(f"{name} takes no --restart; every run starts from the beginning.")
    for word in ("check", "quiet", "version"):
        if f"--{word}" in arguments.flags:
            raise CaseError(f"{name} takes no --{word}; python -m pdpetsc {name} -h shows what it takes.")
    return arguments.path


def options_of(arguments: Arguments) -> list[str]:
    """Return the words that go to every run."""
    return [*arguments.petsc, *(["--solver", arguments.solver] if arguments.solver is not None else [])]
