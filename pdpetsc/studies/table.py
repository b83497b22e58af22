"""The tables of a study: on a terminal, and as CSV and JSON."""

from __future__ import annotations

import dataclasses
import json
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

from rich.table import Table

from pdpetsc.output.files import write_whole
from pdpetsc.output.tables import csv_of, text_of
from pdpetsc.running.comparison import columns_of
from pdpetsc.studies.refinement import Convergence
from pdpetsc.studies.run_store import Outcome


def names(name: str) -> tuple[str, ...]:
    """Return the names of the files of ``write``, and of the picture."""
    return f"{name}.csv", f"{name}.json", f"{name}_order.csv", f"{name}.png"


def write(folder: Path, name: str, outcomes: Sequence[Outcome], found: Sequence[Convergence]) -> None:
    """Write ``NAME.csv``, one row per run, and ``NAME.json``; also ``NAME_order.csv`` for orders of convergence.

    A failed run has no numbers in the columns of results.

    Raises
    ------
    OutputError
        A file cannot be written.
    """
    costs: dict[str, list[Any]] = {
        "seconds": [f"{one.seconds:.3f}" for one in outcomes],
        "peak_MiB": [f"{one.memory:.1f}" for one in outcomes],
        "unstable_steps": [one.unstable for one in outcomes],
        "warnings": [len(one.warnings) for one in outcomes],
        "status": [one.status for one in outcomes],
        "exit_status": [one.exit_status for one in outcomes],
        "said": [one.said for one in outcomes],
        "folder": [one.folder.name for one in outcomes],
    }
    write_columns(folder / f"{name}.csv", _columns(outcomes, costs))
    # Costs as numbers.
    runs = [
        {
            "parameters": dict(one.parameters), "status": one.status, "exit_status": one.exit_status, "said": one.said,
            "results": dict(one.results), "seconds": one.seconds, "peak_MiB": one.memory,
            "unstable_steps": one.unstable, "warnings": list(one.warnings), "folder": one.folder.name,
        }
        for one in outcomes
    ]  # fmt: skip
    whole: dict[str, Any] = {"runs": runs}
    if found:
        orders = [dataclasses.asdict(one) for one in found]
        whole["convergence"] = [{"parameters": one.pop("group"), **one} for one in orders]
        write_columns(folder / f"{name}_order.csv", {**_order_columns(found), "note": [one.note for one in found]})
    write_whole(folder / f"{name}.json", json.dumps(whole, indent=1, allow_nan=False) + "\n")


def write_columns(path: Path, columns: Mapping[str, Sequence[Any]]) -> None:
    """Write a CSV with columns by name, None as an empty word, or raise OutputError."""
    write_whole(path, csv_of([list(columns), *zip(*columns.values(), strict=True)]))


def _order_columns(found: Sequence[Convergence]) -> dict[str, list[Any]]:
    others = list(dict.fromkeys(name for one in found for name in one.group))
    return {
        "result": [one.result for one in found],
        **{name: [one.group.get(name) for one in found] for name in others},
        "size": [one.sizes[-1] if one.sizes else None for one in found],
        "value": [one.values[-1] if one.values else None for one in found],
        "order": [one.order for one in found],
        "extrapolated": [one.extrapolated for one in found],
        "error_bar": [one.error_bar for one in found],
        "exact": [one.exact for one in found],
    }


def on_terminal(columns: Mapping[str, Sequence[Any]]) -> Table:
    """Return a table of columns by name, with numbers to six digits."""
    table = Table()
    for name in columns:
        table.add_column(name, justify="right")
    for row in zip(*columns.values(), strict=True):
        table.add_row(*map(text_of, row))
    return table


def of_runs(outcomes: Sequence[Outcome]) -> Table:
    """Return the table of runs."""
    costs: dict[str, list[Any]] = {
        "seconds": [f"{one.seconds:.1f}" for one in outcomes],
        "MiB": [f"{one.memory:.0f}" for one in outcomes],
        "status": [
            ("finished" if one.finished else f"failed, exit status {one.exit_status}")
            + (f", {one.unstable} steps unstable" if one.unstable else "")
            + (f", {len(one.warnings)} warning{'s' * (len(one.warnings) > 1)}" if one.warnings else "")
            for one in outcomes
        ],
    }
    return on_terminal(_columns(outcomes, costs))


def _columns(outcomes: Sequence[Outcome], costs: Mapping[str, list[Any]]) -> dict[str, list[Any]]:
    """Return the table of a study by columns, with its costs last."""
    return columns_of({}, [one.parameters for one in outcomes], [one.results for one in outcomes], costs)


def of_orders(found: Sequence[Convergence]) -> Table:
    """Return the table of orders, with their notes below it."""
    short = {"extrapolated": "limit", "error_bar": "+/-"}
    return on_terminal({short.get(name, name): column for name, column in _order_columns(found).items()})
