"""``python -m pdpetsc compare CASE.py name=a,b,c ...``: every combination, one table."""

from __future__ import annotations

import csv
import io
import itertools
import json
import math
import os
import signal
import subprocess
import sys
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

from rich.console import Console
from rich.live import Live
from rich.progress import BarColumn, Progress, TextColumn, TimeRemainingColumn
from rich.table import Table

from pdpetsc.errors import CaseError, OutputError, SolveError
from pdpetsc.running.comparison import Outcome, columns_of, mebibytes, results_figure, working_seconds

USAGE = """usage: python -m pdpetsc compare CASE.py NAME=A,B,C [NAME=...] [-o DIR] [-ranks N] [-PETSC_OPTION [VALUE]]

  NAME=A,B,C   values of a parameter of the case; all combinations of all of them are run, one after another
  -o DIR       folder for compare.csv, compare.png and a folder per run (default: out/compare_CASE)
  -ranks N     run each on N ranks, with mpirun
The seconds are those of set-up and solve. What DIR already holds is not run again: an interrupted comparison goes on
where it was."""

# File that marks a folder of a run as one that compare has made.
MARK = ".pdpetsc-compare"
# What compare takes out of such a folder before it runs there again, so that nothing of an earlier run is left to read.
STALE = ("compare.json", "summary.json")


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
        A run ended with status 2: its parameters or the case are wrong; or a folder of a run would be one that
        compare has not made.
    OutputError
        The table or the picture cannot be written.

    Returns
    -------
    list of Outcome
        In the order of the combinations; runs that did not converge are among them.
    """
    if "OMPI_COMM_WORLD_SIZE" in os.environ or "PMI_SIZE" in os.environ:
        raise CaseError("compare starts its runs itself: call it without mpirun and give -ranks N.")
    combinations = [dict(zip(choices, values, strict=True)) for values in itertools.product(*choices.values())]
    source = case.read_text()
    try:
        folder.mkdir(parents=True, exist_ok=True)
    except OSError as error:
        raise CaseError(f"Cannot write to the output folder {folder}: {error.strerror or error}.") from None
    for parameters in combinations:
        _refuse_foreign(_place(folder, parameters))
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


def refuse_failed(done: Sequence[Outcome], folder: Path) -> None:
    """Raise SolveError if runs did not reach their end."""
    failed = sum(outcome.status != "converged" for outcome in done)
    if failed:
        raise SolveError(f"{failed} of {len(done)} runs did not converge; why stands in {folder / 'compare.csv'}.")


def _named(parameters: Mapping[str, str]) -> str:
    return ",".join(f"{name}={value}" for name, value in parameters.items())


def _one(
    case: Path, source: str, parameters: Mapping[str, str], folder: Path, ranks: int, petsc: Sequence[str]
) -> Outcome:
    """Run one combination, or read what an earlier call left of it."""
    place = _place(folder, parameters)
    asked = {"parameters": dict(parameters), "ranks": ranks, "petsc": list(petsc), "case": source}
    finished = place / "compare.json"
    kept = _kept(finished, asked)
    if kept is not None:
        return Outcome(parameters, *kept)
    _refuse_foreign(place)
    try:
        place.mkdir(exist_ok=True)
        (place / MARK).write_text("A folder of pdpetsc compare.\n")
        for name in STALE:
            (place / name).unlink(missing_ok=True)
    except OSError as error:
        raise CaseError(f"Cannot write to the folder {place}: {error.strerror or error}.") from None
    words = [sys.executable, "-m", "pdpetsc", str(case), *(f"{k}={v}" for k, v in parameters.items()), "--quiet"]
    words += ["-o", str(place), *petsc]
    words = ["mpirun", "-n", str(ranks), *words] if ranks > 1 else words
    status, said = _finished(words)
    if status == 2:
        raise CaseError(f"{_named(parameters) or case.stem}: {_sentence(said)}")
    # The status of the process counts, and that of the summary only where they agree: it may be of a run that crashed.
    summary = _summary(place)
    word = summary.get("status")
    if not isinstance(word, str) or word == "running" or status != (0 if word == "converged" else 1):
        word = f"ended with exit status {status}: {_sentence(said)}"
    results = summary.get("results", {}) if word == "converged" else {}
    found: list[Any] = [word, results, working_seconds(summary), mebibytes(summary)]
    # A run that was stopped or crashed may end otherwise the next time.
    if word == "converged" or (word == summary.get("status") and summary.get("error") == "SolveError"):
        _save(finished, json.dumps({"asked": asked, "found": found}))
    return Outcome(parameters, *found)


def _place(folder: Path, parameters: Mapping[str, str]) -> Path:
    """Return the folder of a run."""
    return folder / "".join(c if c.isalnum() or c in "=,._-" else "_" for c in _named(parameters) or "run")


def _refuse_foreign(place: Path) -> None:
    """Raise CaseError where the folder of a run is there already and compare has not made it."""
    if place.is_symlink() or (place.exists() and not place.is_dir()):
        raise CaseError(f"{place} is not a folder that compare has made; give another one with -o.")
    if (
        place.is_dir()
        and any(place.iterdir())
        and not (place / MARK).is_file()
        and _kept(place / "compare.json") is None
    ):
        raise CaseError(f"{place} holds files that compare has not written; give another folder with -o.")


def _kept(path: Path, asked: Mapping[str, Any] | None = None) -> list[Any] | None:
    """Return what an earlier call found for the same question, None where there is nothing or nothing legible."""
    try:
        kept = json.loads(path.read_text())
        status, results, seconds, memory = kept["found"]
        found = [str(status), {str(k): float(v) for k, v in results.items()}, float(seconds), float(memory)]
        return found if asked is None or kept["asked"] == asked else None
    except (OSError, ValueError, KeyError, TypeError, AttributeError):
        return None


def _summary(place: Path) -> dict[str, Any]:
    try:
        found = json.loads((place / "summary.json").read_text())
    except (OSError, ValueError):
        return {}
    return found if isinstance(found, dict) else {}


def _finished(words: Sequence[str]) -> tuple[int, str]:
    """Run a command to its end; return exit status and stderr. Where this process is stopped the command is, first."""
    # The environment as this process found it: MPI, started here to read the case, has since added to it.
    pipes: dict[str, Any] = {"stdout": subprocess.DEVNULL, "stderr": subprocess.PIPE, "text": True}
    try:
        process = subprocess.Popen(words, env=dict(os.environ), **pipes)
    except OSError as error:
        raise CaseError(f"Cannot start {words[0]}: {error.strerror or error}.") from None
    try:
        _, said = process.communicate()
    except BaseException:
        process.send_signal(signal.SIGTERM)
        try:
            process.communicate(timeout=5.0)
        except subprocess.TimeoutExpired:
            process.kill()
            process.communicate()
        raise
    return process.returncode, said


def _save(path: Path, text: str) -> None:
    """Write a small file aside and put it in place, so that it is whole or not there."""
    aside = path.with_name(path.name + ".part")
    try:
        aside.write_text(text)
        os.replace(aside, path)
    except OSError as error:
        raise OutputError(f"Cannot write {path}: {error.strerror or error}.") from error


def _sentence(text: str) -> str:
    lines = [line.removeprefix("pdpetsc: ") for line in text.splitlines() if line.startswith("pdpetsc: ")]
    return lines[-1] if lines else (text.strip().splitlines() or ["no message."])[-1]


def _grid(*parts: Any) -> Table:
    grid = Table.grid()
    for part in parts:
        grid.add_row(part)
    return grid


def _table(done: Sequence[Outcome]) -> Table:
    table = Table()
    columns = columns_of(done)
    for name in columns:
        table.add_column(name, justify="right")
    for row in zip(*columns.values(), strict=True):
        *values, seconds, memory, status = row
        words = [
            "" if value is None else f"{value:.6g}" if isinstance(value, float) else str(value) for value in values
        ]
        table.add_row(*words, f"{seconds:.1f}", f"{memory:.0f}", status if status == "converged" else "failed")
    return table


def _write(folder: Path, done: Sequence[Outcome]) -> None:
    text = io.StringIO()
    table = csv.writer(text)
    columns = columns_of(done)
    table.writerow(["peak_MiB" if name == "MiB" else name for name in columns])
    for row in zip(*columns.values(), strict=True):
        *values, seconds, memory, status = row
        words = ["" if value is None else repr(value) if isinstance(value, float) else value for value in values]
        table.writerow([*words, f"{seconds:.3f}", f"{memory:.1f}", status])
    _save(folder / "compare.csv", text.getvalue())


def _draw(folder: Path, title: str, choices: Mapping[str, Sequence[str]], done: Sequence[Outcome]) -> None:
    """Draw every result against the last numeric parameter, and error against seconds where there is an error."""
    numeric = [name for name, values in choices.items() if len(values) > 1 and all(_is_number(v) for v in values)]
    figure = results_figure(done, numeric[-1] if numeric else None, title)
    path = folder / "compare.png"
    try:
        figure.savefig(path, dpi=130)
    except OSError as error:
        raise OutputError(f"Cannot write {path}: {error.strerror or error}.") from error


def _is_number(text: str) -> bool:
    try:
        return math.isfinite(float(text))
    except ValueError:
        return False
