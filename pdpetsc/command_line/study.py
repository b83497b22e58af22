"""Run a case with many parameter sets, and write one table that resumes.

usage: python -m pdpetsc study CASE.py [NAME=A,B,C ...] [--sets FILE] [-o DIR] [--ranks N] [--jobs N]
                               [--retry] [--order NAME] [--exact RESULT=VALUE,...] [--picture] [-PETSC_OPTION [VALUE]]

  NAME=A,B,C       values of a parameter of the case; all combinations are run
  --sets FILE      parameter sets, grids or samples from a .toml, .json or .csv, each with all of these combinations
  -o DIR           folder for study.csv, study.json and a folder per run (default: out/study_CASE)
  --ranks N        ranks of each run
  --jobs N         parallel runs
  --retry          repeat failed runs
  --order NAME     order of convergence, extrapolated value and error bar for the size NAME; 1/NAME if NAME is a
                   number of particles or cells
  --exact R=V,...  exact values of results from another source, for the orders
  --expected       use the expected results of the case as exact values
  --picture        draw study.png: every result against a parameter, errors against seconds
  --launcher TEXT  launcher of ranks, with {ranks} for their number (default: "mpirun -n {ranks}")
  --solver NAME    the solver of every run
Other -options go to PETSc in every run. Finished runs in DIR are not repeated if case, parameters, options, ranks and
pdpetsc are unchanged: the same command continues a stopped study.
"""

from __future__ import annotations

import contextlib
import sys
from collections.abc import Iterator, Sequence
from pathlib import Path
from typing import Any

from rich.console import Console
from rich.progress import BarColumn, MofNCompleteColumn, TextColumn, TimeRemainingColumn
from rich.progress import Progress as Bar

from pdpetsc.bounds import real_number
from pdpetsc.command_line.arguments import Arguments
from pdpetsc.command_line.plot import save
from pdpetsc.errors import CaseError, Interrupted, SolveError
from pdpetsc.running.comparison import results_figure
from pdpetsc.studies.jobs import too_many
from pdpetsc.studies.run_identity import PlannedRun
from pdpetsc.studies.run_store import Outcome, named
from pdpetsc.studies.sets import combined, grid, read_sets, values_in
from pdpetsc.studies.study import Progress, Refinement, study
from pdpetsc.studies.table import of_orders, of_runs

# Line width of tables that are not printed to a terminal.
WIDTH = 1000


def table_console() -> Console:
    """Return a console that does not cut tables in files and pipes."""
    width = None if sys.stdout.isatty() else WIDTH
    return Console(soft_wrap=True, highlight=False, markup=False, width=width)


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


@contextlib.contextmanager
def watched(arguments: Arguments, folder: Path, title: str, console: Console) -> Iterator[dict[str, Any]]:
    """Yield the keywords for runs that ``study`` and ``fit`` share, and show the progress of the runs.

    Raises
    ------
    CaseError
        The number of ranks or jobs is invalid.
    Interrupted
        A signal stopped the body.
    """
    ranks, jobs, solver = arguments.count("--ranks"), arguments.count("--jobs"), arguments.value("--solver")
    if warning := too_many(jobs, ranks):
        console.print(f"pdpetsc: {warning}")
    columns = TextColumn("{task.description}"), BarColumn(), MofNCompleteColumn(), TimeRemainingColumn()
    try:
        with Bar(*columns, console=console, transient=True, disable=not console.is_terminal) as bar:
            yield {
                "folder": folder, "ranks": ranks, "jobs": jobs, "launcher": arguments.value("--launcher"),
                "options": [*arguments.petsc, *([] if solver is None else ["--solver", solver])],
                "retry": "--retry" in arguments.flags, "progress": RunLog(bar, title),
            }  # fmt: skip
    except KeyboardInterrupt:
        raise Interrupted(f"Stopped. The same command continues with the finished runs in {folder}.") from None


def run_study(case: Path, arguments: Arguments, name: str) -> None:
    """Run a study from its command line, and print its table.

    Raises
    ------
    CaseError, OutputError
        As for ``study``.
    SolveError
        Runs failed.
    Interrupted
        The study was stopped.
    """
    sets = grid({key: values_in(text) for key, text in arguments.parameters.items()})
    if (file := arguments.value("--sets")) is not None:
        sets = combined(sets, read_sets(Path(file)))
    order, exact = arguments.value("--order"), arguments.value("--exact")
    expected = "--expected" in arguments.flags
    if order is None and (exact is not None or expected):
        raise CaseError("--exact and --expected require --order NAME, the parameter to refine.")
    refine = None if order is None else Refinement(order, numbers_of(exact or "", "--exact"), expected)
    folder = arguments.output or Path("out") / f"{name}_{case.stem}"
    console = table_console()

    with watched(arguments, folder, case.stem, console) as how:
        done = study(case, sets, **how, refine=refine, name=name)
    console.print(of_runs(done.outcomes))
    if done.convergence:
        console.print(of_orders(done.convergence))
        for one in done.convergence:
            if one.note:
                console.print(f"{', '.join(filter(None, [named(one.group), one.result]))}: {one.note}")
    warned: dict[str, list[str]] = {}
    for outcome in done.outcomes:
        for warning in outcome.warnings:
            warned.setdefault(warning, []).append(outcome.name)
    for warning, (name_of_run, *others) in warned.items():
        console.print(f"{name_of_run}{f' and {len(others)} more' if others else ''}: {warning}")
    for outcome in done.failed:
        console.print(f"{outcome.name}: exit status {outcome.exit_status}: {outcome.said}")
    console.print(f"table in {folder / f'{name}.csv'}")
    if "--picture" in arguments.flags:
        numbers = [key for key in arguments.parameters if _varies(key, done.outcomes)]
        figure = results_figure(done.outcomes, numbers[-1] if numbers else None, case.stem)
        console.print(f"picture in {save(figure, folder / f'{name}.png')}")
    if done.failed:
        first = done.failed[0]
        raise SolveError(
            f"{len(done.failed)} of {len(done.outcomes)} runs failed. The first, {first.name}, has exit status "
            f"{first.exit_status}: {first.said.rstrip('.')}. All are in {folder / f'{name}.csv'}; --retry repeats them."
        )


def _varies(name: str, outcomes: Sequence[Outcome]) -> bool:
    """Return True if a parameter has several values and all are numbers."""
    values = {outcome.parameters.get(name, "") for outcome in outcomes}
    return len(values) > 1 and None not in map(real_number, values)


class RunLog(Progress):
    """Prints a line for each finished run, and a progress bar on a terminal."""

    def __init__(self, bar: Bar, title: str) -> None:
        self._bar, self._task = bar, bar.add_task(title, total=0)
        self._earlier = self._total = 0

    def asked(self, count: int) -> None:
        """Set the length of the bar."""
        self._total += count
        self._bar.update(self._task, total=self._total)

    def again(self, run: PlannedRun, why: str) -> None:
        """Print why a run is repeated."""
        self._bar.console.print(f"{named(run.parameters) or 'the case'} is repeated: {why}")

    def started(self, run: PlannedRun) -> None:
        """Print the number of earlier runs."""
        if self._earlier:
            self._bar.console.print(f"{self._earlier} finished runs of an earlier study are used")
            self._earlier = 0

    def kept(self, outcome: Outcome) -> None:
        """Advance the bar, and count the run."""
        self._bar.advance(self._task)
        self._earlier += 1

    def ended(self, outcome: Outcome) -> None:
        """Advance the bar, and print the outcome of the run."""
        self._bar.advance(self._task)
        how = "finished" if outcome.finished else f"FAILED, exit status {outcome.exit_status}: {outcome.said}"
        self._bar.console.print(f"{outcome.name}: {how}")


def run(path: Path, arguments: Arguments) -> int:
    """Execute the command."""
    run_study(path, arguments, "study")
    return 0
