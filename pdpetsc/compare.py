"""``python -m pdpetsc compare CASE.py name=a,b,c ...``: every combination, one table."""

from __future__ import annotations

import csv
import itertools
import json
import os
import shutil
import subprocess
import sys
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from rich.console import Console
from rich.live import Live
from rich.progress import BarColumn, Progress, TextColumn, TimeRemainingColumn
from rich.table import Table

from pdpetsc.errors import CaseError, SolveError

USAGE = """usage: python -m pdpetsc compare CASE.py NAME=A,B,C [NAME=...] [-o DIR] [-ranks N] [-PETSC_OPTION [VALUE]]

  NAME=A,B,C   values of a parameter of the case; all combinations of all of them are run, one after another
  -o DIR       folder for compare.csv, compare.png and a folder per run (default: out/compare_CASE)
  -ranks N     run each on N ranks, with mpirun
The seconds are those of set-up and solve. What DIR already holds is not run again: an interrupted comparison goes on
where it was."""

# Results that are drawn against the time they take.
ERRORS = ("error", "w_error", "max_F_error")


# What counts as the time of a run: not the start of Python, the compilation of kernels or the output.
PHASES = ("particles", "families", "model", "pattern", "allocation", "solve")


@dataclass(frozen=True)
class Outcome:
    """What one combination gave."""

    parameters: Mapping[str, str]
    status: str
    results: Mapping[str, float]
    seconds: float
    memory: float


def compare(
    case: Path, choices: Mapping[str, Sequence[str]], folder: Path, ranks: int, petsc: Sequence[str]
) -> list[Outcome]:
    """Run every combination in a process of its own and write ``compare.csv`` and ``compare.png``.

    Parameters
    ----------
    case : Path
        The case file.
    choices : mapping of str to sequence of str
        Values of each parameter.
    folder : Path
        Where results go.
    ranks : int
        Of each run.
    petsc : sequence of str
        Options passed on.

    Raises
    ------
    CaseError
        A run ended with status 2: its parameters or the case are wrong.

    Returns
    -------
    list of Outcome
        In the order of the combinations; runs that did not converge are among them.
    """
    if "OMPI_COMM_WORLD_SIZE" in os.environ or "PMI_SIZE" in os.environ:
        raise CaseError("compare starts its runs itself: call it without mpirun and give -ranks N.")
    combinations = [dict(zip(choices, values, strict=True)) for values in itertools.product(*choices.values())]
    folder.mkdir(parents=True, exist_ok=True)
    source = case.read_text()
    done: list[Outcome] = []
    columns = TextColumn("{task.description}"), BarColumn(), TextColumn("{task.completed}/{task.total}")
    progress = Progress(*columns, TimeRemainingColumn())
    task = progress.add_task(case.stem, total=len(combinations))
    console = Console(soft_wrap=True)
    with Live(console=console, refresh_per_second=4) as live:
        for parameters in combinations:
            progress.update(task, description=_named(parameters) or case.stem)
            live.update(_grid(progress, _table(done)))
            done.append(_one(case, source, parameters, folder, ranks, petsc))
            progress.advance(task)
            _write(folder, done)
        live.update(_table(done))
    _draw(folder, case.stem, choices, done)
    if not console.is_terminal:
        console.print()
    console.print(f"table in {folder / 'compare.csv'}\npicture in {folder / 'compare.png'}", highlight=False)
    return done


def working_seconds(summary: Mapping[str, Any]) -> float:
    """Return the seconds of set-up and solve of a run from its ``summary.json``."""
    return sum(float(value) for phase, value in summary["timings"].items() if phase in PHASES)


def refuse_failed(done: Sequence[Outcome], folder: Path) -> None:
    """Raise SolveError if runs did not converge."""
    failed = sum(outcome.status != "converged" for outcome in done)
    if failed:
        raise SolveError(f"{failed} of {len(done)} runs did not converge; why stands in {folder / 'compare.csv'}.")


def _named(parameters: Mapping[str, str]) -> str:
    return ",".join(f"{name}={value}" for name, value in parameters.items())


def _one(
    case: Path, source: str, parameters: Mapping[str, str], folder: Path, ranks: int, petsc: Sequence[str]
) -> Outcome:
    """Run one combination, or read what an earlier call left of it."""
    place = folder / "".join(c if c.isalnum() or c in "=,._-" else "_" for c in _named(parameters) or "run")
    asked = {"parameters": dict(parameters), "ranks": ranks, "petsc": list(petsc), "case": source}
    finished = place / "compare.json"
    if finished.exists():
        kept = json.loads(finished.read_text())
        if kept["asked"] == asked:
            return Outcome(parameters, *kept["found"])
    shutil.rmtree(place, ignore_errors=True)
    words = [sys.executable, "-m", "pdpetsc", str(case), *(f"{k}={v}" for k, v in parameters.items()), "--quiet"]
    words += ["-o", str(place), *petsc]
    words = ["mpirun", "-n", str(ranks), *words] if ranks > 1 else words
    # The environment as this process found it: MPI, started here to read the case, has since added to it.
    process = subprocess.run(words, env=dict(os.environ), capture_output=True, text=True, check=False)
    if process.returncode == 2:
        raise CaseError(f"{_named(parameters)}: {_sentence(process.stderr)}")
    try:
        summary: dict[str, Any] = json.loads((place / "summary.json").read_text())
    except (OSError, ValueError):
        raise CaseError(f"{_named(parameters)} ended without a summary: {_sentence(process.stderr)}") from None
    memory = sum(summary["peak_memory_bytes"]) / 2**20
    seconds = working_seconds(summary)
    status = "converged" if process.returncode == 0 else summary["status"]
    found = [status, summary["results"], seconds, memory]
    if process.returncode in (0, 1) and not status.startswith("Stopped"):
        finished.write_text(json.dumps({"asked": asked, "found": found}))
    return Outcome(parameters, *found)


def _sentence(text: str) -> str:
    lines = [line.removeprefix("pdpetsc: ") for line in text.splitlines() if line.startswith("pdpetsc: ")]
    return lines[-1] if lines else (text.strip().splitlines() or ["no message."])[-1]


def _columns(done: Sequence[Outcome]) -> list[str]:
    return list(dict.fromkeys(name for outcome in done for name in outcome.results))


def _grid(*parts: Any) -> Table:
    grid = Table.grid()
    for part in parts:
        grid.add_row(part)
    return grid


def _table(done: Sequence[Outcome]) -> Table:
    table = Table()
    names = _columns(done)
    for name in (*(done[0].parameters if done else ()), *names, "seconds", "MiB", "status"):
        table.add_column(name, justify="right")
    for outcome in done:
        values = [f"{outcome.results[name]:.6g}" if name in outcome.results else "" for name in names]
        status = "converged" if outcome.status == "converged" else "failed"
        table.add_row(*outcome.parameters.values(), *values, f"{outcome.seconds:.1f}", f"{outcome.memory:.0f}", status)
    return table


def _write(folder: Path, done: Sequence[Outcome]) -> None:
    names = _columns(done)
    with (folder / "compare.csv").open("w", newline="") as file:
        table = csv.writer(file)
        table.writerow([*done[0].parameters, *names, "seconds", "peak_MiB", "status"])
        for outcome in done:
            values = [repr(outcome.results[name]) if name in outcome.results else "" for name in names]
            costs = [f"{outcome.seconds:.3f}", f"{outcome.memory:.1f}", outcome.status]
            table.writerow([*outcome.parameters.values(), *values, *costs])


def _draw(folder: Path, title: str, choices: Mapping[str, Sequence[str]], done: Sequence[Outcome]) -> None:
    """Draw every result against the last numeric parameter, and error against seconds where there is an error."""
    from matplotlib.figure import Figure

    numeric = [name for name, values in choices.items() if len(values) > 1 and all(_is_number(v) for v in values)]
    along = numeric[-1] if numeric else None
    names = _columns(done)
    error = next((name for name in ERRORS if name in names), None)
    panels = len(names) + (error is not None)
    figure = Figure(figsize=(7.0, 1.0 + 3.2 * max(panels, 1)), layout="constrained")
    axes = list(figure.subplots(max(panels, 1), 1, squeeze=False)[:, 0])
    groups: dict[str, list[Outcome]] = {}
    for outcome in done:
        rest = {name: value for name, value in outcome.parameters.items() if name != along}
        groups.setdefault(_named(rest), []).append(outcome)
    for label, outcomes in groups.items():
        for axis, name in zip(axes, names, strict=False):
            have = [o for o in outcomes if name in o.results]
            x = [float(o.parameters[along]) for o in have] if along else list(range(len(have)))
            axis.plot(x, [o.results[name] for o in have], "o-", markersize=4, label=label)
            axis.set(xlabel=along or "run", ylabel=name)
        if error is not None:
            have = [o for o in outcomes if error in o.results]
            axes[-1].loglog(
                [o.seconds for o in have], [abs(o.results[error]) for o in have], "o-", markersize=4, label=label
            )
            axes[-1].set(xlabel="seconds", ylabel=f"|{error}|")
    for axis in axes:
        axis.grid(alpha=0.3)
    axes[0].set_title(title)
    if len(groups) > 1:
        axes[0].legend(fontsize=7)
    figure.savefig(folder / "compare.png", dpi=130)


def _is_number(text: str) -> bool:
    try:
        float(text)
    except ValueError:
        return False
    return True
