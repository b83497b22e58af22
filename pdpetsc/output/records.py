"""``history.csv``, one row per step, and ``summary.json``."""

from __future__ import annotations

import csv
import json
import math
from collections.abc import Sequence
from pathlib import Path
from typing import Any

from pdpetsc.discrete.communicator import Comm, agreed, is_root
from pdpetsc.errors import OutputError
from pdpetsc.output.files import replacing


def earlier_history(comm: Comm, path: Path, names: Sequence[str], first: int) -> list[list[float]] | None:
    """Return the rows before step ``first`` of a ``history.csv`` with these columns, or None (collective)."""
    rows: list[list[float]] | None = None
    if is_root(comm):
        try:
            with path.open(newline="") as file:
                header, *body = csv.reader(file)
            values = [[float(value) for value in row] for row in body]
            if header == [*names] and all(len(row) == len(header) for row in values):
                rows = [row for row in values if row[0] < first]
        except (OSError, ValueError):
            rows = None
    shared: list[list[float]] | None = comm.bcast(rows)
    return shared


def write_rows(comm: Comm, path: Path, mode: str, rows: Sequence[Sequence[Any]]) -> None:
    """Write or append rows to a table on rank 0 (not collective); raises OutputError there."""
    if not is_root(comm):
        return
    try:
        with path.open(mode, newline="") as file:
            csv.writer(file).writerows(rows)
    except OSError as error:
        raise OutputError(f"Cannot write {path}: {error.strerror or error}.") from error


class HistoryWriter:
    """Appends one row of numbers per step to ``history.csv``.

    Parameters
    ----------
    comm : Comm
        All ranks.
    folder : Path
        Where the file goes.
    names : sequence of str
        The columns.
    kept : sequence of rows
        What an earlier run wrote before this one goes on.

    Notes
    -----
    Construction and ``write`` are collective; rank 0 writes.
    """

    def __init__(self, comm: Comm, folder: Path, names: Sequence[str], kept: Sequence[Sequence[float]] = ()) -> None:
        self._comm = comm
        self._path = folder / "history.csv"
        with agreed(comm):
            write_rows(comm, self._path, "w", [names])
        for row in kept:
            self.write(row)

    def write(self, row: Sequence[float]) -> None:
        """Append a row: step, step time and the values in the order of the names."""
        with agreed(self._comm):
            write_rows(self._comm, self._path, "a", [[int(row[0]), *(repr(float(value)) for value in row[1:])]])


def write_summary(comm: Comm, folder: Path, summary: dict[str, Any]) -> None:
    """Write ``summary.json`` (collective; rank 0 writes). Numbers that JSON cannot hold become null."""
    with agreed(comm):
        if is_root(comm):
            with replacing(folder / "summary.json") as aside:
                aside.write_text(json.dumps(_plain(summary), indent=1) + "\n")


def _plain(value: Any) -> Any:
    if isinstance(value, dict):
        return {str(key): _plain(item) for key, item in value.items()}
    if isinstance(value, list | tuple):
        return [_plain(item) for item in value]
    if isinstance(value, bool | str | int) or value is None:
        return value
    if isinstance(value, float):
        return value if math.isfinite(value) else None
    return str(value)
