"""``python -m pdpetsc fit CASE.py name=low:high ... --to measured.csv --columns x,y``: parameters from a curve."""

from __future__ import annotations

import re
from collections.abc import Sequence
from pathlib import Path

from rich.console import Console
from rich.table import Table

from pdpetsc.command_line import study
from pdpetsc.command_line.arguments import split
from pdpetsc.errors import CaseError, Interrupted
from pdpetsc.output.files import replacing
from pdpetsc.studies.fit import Fit, Range, fit
from pdpetsc.studies.jobs import too_many
from pdpetsc.studies.run_identity import Question
from pdpetsc.studies.run_store import Outcome, named
from pdpetsc.studies.study import Progress

USAGE = """usage: python -m pdpetsc fit CASE.py NAME=LOW:HIGH [NAME=...] --to FILE.csv --columns X,Y [--sigma S]
                             [--range LOW:HIGH] [-o DIR] [--ranks N] [--jobs N] [--retry] [--runs N] [--picture]

  NAME=LOW:HIGH    a parameter of the case that is sought between two numbers, from their middle;
                   LOW:START:HIGH from elsewhere, LOW:HIGH:log by its logarithm
  NAME=VALUE       another parameter of the case
  --to FILE.csv    the measured curve, under a line of names
  --columns X,Y    place and value in the history of the runs; X:NAME where the file has another name for it
  --sigma S        column of standard deviations of the values
  --range LOW:HIGH compare between these places only
  -o DIR           folder for fit.json, fit.csv and a folder per run (default: out/fit_CASE)
  --ranks N        run each on N ranks
  --jobs N         runs side by side: as many as there are parameters help
  --retry          run again what has failed
  --runs N         give up after N runs (default: 500)
  --picture        draw fit.png: the measured curve and that of the best run
A run that fails, or ends before the last measured place, is no number: a shorter step is taken. What DIR already holds
is not run again: a fit that was stopped goes on with the same command."""

WITH_VALUE = ("--to", "--columns", "--sigma", "--range", "--ranks", "--jobs", "--runs", "--launcher")
FLAGS = ("--retry", "--picture")
_NUMBER = r"[-+]?(?:\d+\.?\d*|\.\d+)(?:[eE][-+]?\d+)?"
_RANGE = re.compile(rf"({_NUMBER}):(?:({_NUMBER}):)?({_NUMBER})(:log)?")


def main(argv: Sequence[str]) -> int:
    """Run the command ``fit``; return its exit status or raise what ends it."""
    asked = study.taken(argv, WITH_VALUE, FLAGS)
    arguments = split(asked.words)
    case = study.case_of(arguments, "fit", USAGE)
    if case is None:
        return 0
    for option in ("--to", "--columns"):
        if option not in asked.options:
            raise CaseError(f"fit needs {option}; python -m pdpetsc fit -h shows the usage.")
    columns = asked.options["--columns"].split(",")
    if len(columns) != 2 or not all(columns):
        raise CaseError(f"--columns takes two names, place and value, not {asked.options['--columns']!r}.")
    ranges, fixed = {}, {}
    for name, text in arguments.parameters.items():
        if found := _RANGE.fullmatch(text):
            low, start, high, log = found.groups()
            ranges[name] = Range(float(low), float(high), None if start is None else float(start), bool(log))
        else:
            fixed[name] = text
    within = None
    if "--range" in asked.options:
        found = _RANGE.fullmatch(asked.options["--range"])
        if not found or found[2] or found[4]:
            raise CaseError(f"--range takes LOW:HIGH, not {asked.options['--range']!r}.")
        within = float(found[1]), float(found[3])
    folder = arguments.output if arguments.output is not None else Path("out") / f"fit_{case.stem}"
    ranks, jobs = study.count(asked, "--ranks"), study.count(asked, "--jobs")
    console = Console(soft_wrap=True, highlight=False, markup=False)
    if warning := too_many(jobs, ranks):
        console.print(f"pdpetsc: {warning}")
    try:
        done = fit(
            case, ranges, asked.options["--to"], (columns[0], columns[1]), folder, fixed=fixed,
            sigma=asked.options.get("--sigma"), within=within, ranks=ranks, jobs=jobs,
            options=study.options_of(arguments), retry="--retry" in asked.flags,
            launcher=asked.options.get("--launcher"), most=study.count(asked, "--runs", 500),
            progress=Lines(console),
        )  # fmt: skip
    except KeyboardInterrupt:
        raise Interrupted(f"Stopped; the same command goes on with what {folder} holds.") from None
    _show(console, done, folder)
    if "--picture" in asked.flags:
        draw(folder / "fit.png", case.stem, done)
        console.print(f"picture in {folder / 'fit.png'}")
    return 0


class Lines(Progress):
    """Prints a line for every run that ends."""

    def __init__(self, console: Console) -> None:
        self._console = console

    def again(self, question: Question, why: str) -> None:
        """Say why a run is run again."""
        self._console.print(f"{named(question.parameters)} is run again: {why}")

    def kept(self, outcome: Outcome) -> None:
        """Say how a run of an earlier fit ended."""
        self._say(outcome, ", from before")

    def ended(self, outcome: Outcome) -> None:
        """Say how a run ended."""
        self._say(outcome, "")

    def _say(self, outcome: Outcome, when: str) -> None:
        how = "finished" if outcome.finished else f"FAILED, exit status {outcome.exit_status}: {outcome.said}"
        self._console.print(f"{outcome.name}: {how}{when}")


def _show(console: Console, done: Fit, folder: Path) -> None:
    # What makes the numbers of the table worth little stands at the table.
    table = Table(caption=next((note for note in done.notes if note.isupper() or note.startswith("THE CASE")), None))
    for name in ("parameter", "value", "standard error", *(f"with {name}" for name in done.values)):
        table.add_column(name, justify="right")
    for row, (name, value) in zip(done.correlation, done.values.items(), strict=True):
        table.add_row(name, f"{value:.8g}", f"{done.errors[name]:.2g}", *(f"{c:.3f}" for c in row))
    console.print(table)
    console.print(
        f"residual {done.rms:.3g} (root mean square), {done.explained:.6f} of the variance explained"
        + (f", chi squared per degree of freedom {done.chi2:.3g}" if done.chi2 is not None else "")
    )
    console.print(f"{done.runs} runs, {done.failed} of them without a curve; the best one is {done.best}")
    for note in done.notes:
        console.print(f"pdpetsc: {note}.")
    console.print(f"parameters in {folder / 'fit.json'}, curves in {folder / 'fit.csv'}")


def draw(path: Path, title: str, done: Fit) -> None:
    """Draw the measured curve and that of the best run; raises OutputError."""
    from matplotlib.figure import Figure

    figure = Figure(figsize=(7.0, 5.0), layout="constrained")
    words = ", ".join(f"{name} = {value:.5g}" for name, value in done.values.items())
    plot = figure.add_subplot(title=f"{title}: {words}", xlabel=done.curve.x_name, ylabel=done.curve.y_name)
    order = done.curve.x.argsort()
    plot.errorbar(done.curve.x, done.curve.y, done.curve.sigma, fmt="o", markersize=4, label="measured")
    plot.plot(done.curve.x[order], done.fitted[order], "-", label="fitted")
    plot.grid(alpha=0.3)
    plot.legend()
    with replacing(path, wait=False) as aside:
        figure.savefig(aside, dpi=130, format="png")
