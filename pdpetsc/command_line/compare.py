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
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from rich.console import Console
from rich.live import Live
from rich.progress import BarColumn, Progress, TextColumn, TimeRemainingColumn
from rich.table import Table

from pdpetsc.errors import CaseError, OutputError, SolveError

USAGE = """usage: python -m pdpetsc compare CASE.py NAME=A,B,C [NAME=...] [-o DIR] [-ranks N] [-PETSC_OPTION [VALUE]]

  NAME=A,B,C   values of a parameter of the case; all combinations of all of them are run, one after another
  -o DIR       folder for compare.csv, compare.png and a folder per run (default: out/compare_CASE)
  -ranks N     run each on N ranks, with mpirun
The seconds are those of set-up and solve. What DIR already holds is not run again: an interrupted comparison goes on
where it was."""

# Results that are drawn against the time they take.
ERRORS = ("error", "w_error", "max_F_error")


# File that marks a folder of a run as one that compare has made.
MARK = ".pdpetsc-compare"
# What compare takes out of such a folder before it runs there again, so that nothing of an earlier run is left to read.
STALE = ("compare.json", "summary.json")

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


def working_seconds(summary: Mapping[str, Any]) -> float:
    """Return the seconds of set-up and solve of a run from its ``summary.json``."""
    return sum(float(value) for phase, value in summary.get("timings", {}).items() if phase in PHASES)


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
    memory = sum(summary.get("peak_memory_bytes", [])) / 2**20
    found = [word, results, working_seconds(summary), memory]
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
    text = io.StringIO()
    table = csv.writer(text)
    table.writerow([*done[0].parameters, *names, "seconds", "peak_MiB", "status"])
    for outcome in done:
        values = [repr(outcome.results[name]) if name in outcome.results else "" for name in names]
        costs = [f"{outcome.seconds:.3f}", f"{outcome.memory:.1f}", outcome.status]
        table.writerow([*outcome.parameters.values(), *values, *costs])
    _save(folder / "compare.csv", text.getvalue())


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
