"""The tables of a study: on a terminal, and as CSV and JSON."""

from __future__ import annotations

import csv
import io
import json
from collections.abc import Sequence
from pathlib import Path
from typing import Any

from rich.table import Table

from pdpetsc.output.files import write_whole
from pdpetsc.studies.refinement import Convergence
from pdpetsc.studies.run_store import Outcome

# The columns after those of parameters and results.
COSTS = ("seconds", "peak_MiB", "unstable_steps", "status", "exit_status", "said", "folder")


def names(name: str) -> tuple[str, ...]:
    """Return the names of the files that ``write`` writes, and of the picture."""
    return f"{name}.csv", f"{name}.json", f"{name}_order.csv", f"{name}.png"


def columns(outcomes: Sequence[Outcome]) -> tuple[list[str], list[str]]:
    """Return the names of parameters and of results, in the order in which they first appear."""
    parameters = dict.fromkeys(name for outcome in outcomes for name in outcome.parameters)
    return list(parameters), list(dict.fromkeys(name for outcome in outcomes for name in outcome.results))


def write(folder: Path, name: str, outcomes: Sequence[Outcome], found: Sequence[Convergence]) -> None:
    """Write ``NAME.csv``, a row a run, and ``NAME.json``; ``NAME_order.csv`` where orders were asked for.

    A run that failed has no numbers in the columns of results.

    Raises
    ------
    OutputError
        A file cannot be written.
    """
    parameters, results = columns(outcomes)
    taken = {*parameters, *COSTS}
    rows: list[list[Any]] = [[*parameters, *(f"{r} (result)" if r in taken else r for r in results), *COSTS]]
    for one in outcomes:
        values = [repr(one.results[key]) if key in one.results else "" for key in results]
        costs = [f"{one.seconds:.3f}", f"{one.memory:.1f}", one.unstable]
        given = [one.parameters.get(key, "") for key in parameters]
        rows.append([*given, *values, *costs, one.status, one.exit_status, one.said, one.folder.name])
    write_whole(folder / f"{name}.csv", _csv(rows))
    runs = [
        {
            "parameters": dict(one.parameters), "status": one.status, "exit_status": one.exit_status, "said": one.said,
            "results": dict(one.results), "seconds": one.seconds, "peak_MiB": one.memory,
            "unstable_steps": one.unstable, "folder": one.folder.name,
        }
        for one in outcomes
    ]  # fmt: skip
    orders = [
        {
            "result": one.result, "parameters": dict(one.group), "sizes": one.sizes, "values": one.values,
            "order": one.order, "orders": one.orders, "extrapolated": one.extrapolated, "error_bar": one.error_bar,
            "exact": one.exact, "note": one.note,
        }
        for one in found
    ]  # fmt: skip
    whole = {"runs": runs, **({"convergence": orders} if found else {})}
    write_whole(folder / f"{name}.json", json.dumps(whole, indent=1, allow_nan=False) + "\n")
    if found:
        write_whole(folder / f"{name}_order.csv", _csv(_order_rows(found)))


def _order_rows(found: Sequence[Convergence]) -> list[list[Any]]:
    others = list(dict.fromkeys(name for one in found for name in one.group))
    header = ["result", *others, "size", "value", "order", "extrapolated", "error_bar", "exact", "note"]
    rows: list[list[Any]] = [header]
    for one in found:
        numbers = [one.sizes[-1] if one.sizes else None, one.values[-1] if one.values else None]
        numbers += [one.order, one.extrapolated, one.error_bar, one.exact]
        given = [one.group.get(name, "") for name in others]
        rows.append([one.result, *given, *("" if v is None else repr(v) for v in numbers), one.note])
    return rows


def _csv(rows: Sequence[Sequence[Any]]) -> str:
    text = io.StringIO(newline="")
    csv.writer(text).writerows(rows)
    return text.getvalue()


def on_terminal(outcomes: Sequence[Outcome]) -> Table:
    """Return the table of runs."""
    parameters, results = columns(outcomes)
    table = Table()
    for name in (*parameters, *results, "seconds", "MiB", "status"):
        table.add_column(name, justify="right")
    for one in outcomes:
        values = [f"{one.results[name]:.6g}" if name in one.results else "" for name in results]
        status = "finished" if one.finished else f"failed, exit status {one.exit_status}"
        if one.unstable:
            status += f", {one.unstable} steps unstable"
        given = [one.parameters.get(name, "") for name in parameters]
        table.add_row(*given, *values, f"{one.seconds:.1f}", f"{one.memory:.0f}", status)
    return table


def of_orders(found: Sequence[Convergence]) -> Table:
    """Return the table of orders; their notes are sentences and stand below it."""
    rows = _order_rows(found)
    table = Table()
    for name in rows[0][:-1]:
        table.add_column({"extrapolated": "limit", "error_bar": "+/-"}.get(name, name), justify="right")
    for row in rows[1:]:
        given, numbers = row[: len(row) - 7], row[len(row) - 7 : -1]
        table.add_row(*given, *(f"{float(value):.6g}" if value else "" for value in numbers))
    return table
