"""Fit parameters of a case to a measured curve.

usage: python -m pdpetsc fit CASE.py NAME=LOW:HIGH [NAME=...] --to FILE.csv --columns X,Y [--sigma S]
                             [--range LOW:HIGH] [-o DIR] [--ranks N] [--jobs N] [--retry] [--runs N] [--picture]

  NAME=LOW:HIGH    a parameter of the case, searched between two numbers from their middle;
                   LOW:START:HIGH from START, LOW:HIGH:log on a logarithmic scale
  NAME=VALUE       another parameter of the case
  --to FILE.csv    the measured curve, with a header of names
  --columns X,Y    position and value in the history of the runs; X:NAME if the file has another name
  --sigma S        column of standard deviations of the values
  --range LOW:HIGH compare only between these positions
  -o DIR           folder for fit.json, fit.csv and a folder per run (default: out/fit_CASE)
  --ranks N        ranks of each run
  --jobs N         parallel runs: useful up to the number of parameters
  --retry          repeat failed runs
  --runs N         largest number of runs (default: 500)
  --picture        draw fit.png: the measured curve and that of the best run
If a run fails, or ends before the last measured position, a shorter step is tried. Finished runs in DIR are not
repeated: the same command continues a stopped fit.
"""

from __future__ import annotations

import re
from pathlib import Path
from typing import Any

from rich.console import Console
from rich.table import Table

from pdpetsc.command_line.arguments import Arguments
from pdpetsc.command_line.plot import save
from pdpetsc.command_line.study import table_console, watched
from pdpetsc.errors import CaseError
from pdpetsc.studies.fit import Fit, fit
from pdpetsc.studies.sets import Range

_NUMBER = r"[-+]?(?:\d+\.?\d*|\.\d+)(?:[eE][-+]?\d+)?"
_RANGE = re.compile(rf"({_NUMBER}):(?:({_NUMBER}):)?({_NUMBER})(:log)?")


def run(path: Path, arguments: Arguments) -> int:
    """Execute the command."""
    to, columns = arguments.value("--to"), (arguments.value("--columns") or "").split(",")
    if to is None or "--columns" not in arguments.values:
        missing = "--to" if to is None else "--columns"
        raise CaseError(f"fit needs {missing}; python -m pdpetsc fit -h shows the usage.")
    if len(columns) != 2 or not all(columns):
        raise CaseError(f"--columns requires two names, place and value, not {arguments.value('--columns')!r}.")
    ranges, fixed = {}, {}
    for name, text in arguments.parameters.items():
        if found := _RANGE.fullmatch(text):
            low, start, high, log = found.groups()
            ranges[name] = Range(
                float(low), float(high), None if start is None else float(start), "log" if log else "linear"
            )
        else:
            fixed[name] = text
    within = None
    if (ends := arguments.value("--range")) is not None:
        found = _RANGE.fullmatch(ends)
        if not found or found[2] or found[4]:
            raise CaseError(f"--range takes LOW:HIGH, not {ends!r}.")
        within = float(found[1]), float(found[3])
    folder = arguments.output or Path("out") / f"fit_{path.stem}"
    console = table_console()
    with watched(arguments, folder, path.stem, console) as how:
        done = fit(
            path, ranges, to, (columns[0], columns[1]), **how, fixed=fixed, sigma=arguments.value("--sigma"),
            within=within, most=arguments.count("--runs", 500),
        )  # fmt: skip
    _show(console, done, folder)
    if "--picture" in arguments.flags:
        console.print(f"picture in {save(_figure(path.stem, done), folder / 'fit.png')}")
    return 0


def _show(console: Console, done: Fit, folder: Path) -> None:
    # Notes on the reliability of the numbers are printed with the table.
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
    console.print(f"{done.runs} runs, {done.failed} of them without a curve; best run: {done.best}")
    for note in done.notes:
        console.print(f"pdpetsc: {note}.")
    console.print(f"parameters in {folder / 'fit.json'}, curves in {folder / 'fit.csv'}")


def _figure(title: str, done: Fit) -> Any:
    """Return a figure of the measured curve and that of the best run."""
    from matplotlib.figure import Figure

    figure = Figure(figsize=(7.0, 5.0), layout="constrained")
    words = ", ".join(f"{name} = {value:.5g}" for name, value in done.values.items())
    plot = figure.add_subplot(title=f"{title}: {words}", xlabel=done.curve.x_name, ylabel=done.curve.y_name)
    order = done.curve.x.argsort()
    plot.errorbar(done.curve.x, done.curve.y, done.curve.sigma, fmt="o", markersize=4, label="measured")
    plot.plot(done.curve.x[order], done.fitted[order], "-", label="fitted")
    plot.grid(alpha=0.3)
    plot.legend()
    return figure
