"""Tables of rows per step, and ``summary.json``."""

from __future__ import annotations

import csv
import io
import json
import math
import time
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np

from pdpetsc.discrete.communicator import Comm, agreed, is_root
from pdpetsc.output.files import WAIT, append, cannot_write, flush_written, write_whole
from pdpetsc.output.tables import csv_of


class Table:
    """A table that grows by rows at its end; readers ignore an incomplete last row.

    Parameters
    ----------
    comm : Comm
        All ranks; rank 0 writes.
    path : Path
        The file, which is replaced.
    rows : sequence of rows
        Header and first rows.

    Raises
    ------
    OutputError
        The file cannot be written, on all ranks.

    Notes
    -----
    Construction and every method are collective.
    """

    def __init__(self, comm: Comm, path: Path, rows: Sequence[Sequence[Any]]) -> None:
        self._comm = comm
        self.path = path
        self._flushed = time.monotonic()
        self._waiting = False
        with agreed(comm):
            if is_root(comm):
                write_whole(path, csv_of(rows))

    def append(self, rows: Sequence[Sequence[Any]]) -> None:
        """Append the rows of rank 0."""
        with agreed(self._comm):
            if is_root(self._comm):
                append(self.path, csv_of(rows))
                self._waiting = True
                if time.monotonic() - self._flushed > WAIT:
                    self._flush()

    def flush(self) -> None:
        """Flush all rows to disk."""
        with agreed(self._comm):
            if is_root(self._comm) and self._waiting:
                self._flush()

    def read(self) -> tuple[str, bytes]:
        """Return name and content of the file (not collective). Raise OutputError if it cannot be read."""
        try:
            return self.path.stem, self.path.read_bytes()
        except OSError as error:
            raise cannot_write(self.path, error) from error

    def _flush(self) -> None:
        flush_written(self.path)
        self._flushed, self._waiting = time.monotonic(), False


def rows_of(text: str, header: Sequence[str]) -> list[list[float]] | None:
    """Return the rows of numbers of a table up to the first incomplete one; None if it has other columns."""
    whole = text[: text.rfind("\n") + 1]
    found: list[list[float]] = []
    try:
        rows = csv.reader(io.StringIO(whole, newline=""))
        if next(rows, None) != [*header]:
            return None
        for words in rows:
            row = [float(word) for word in words]
            if len(row) != len(header) or not row[0].is_integer():
                break
            found.append(row)
    except (ValueError, csv.Error):
        pass
    return found


def write_summary(comm: Comm, folder: Path, summary: Mapping[str, Any]) -> None:
    """Replace ``summary.json`` whole (collective; rank 0 writes). Numbers that JSON cannot hold become null.

    Raises
    ------
    OutputError
        The file cannot be written, on all ranks; the previous summary stays.
    """
    with agreed(comm):
        if is_root(comm):
            write_whole(folder / "summary.json", json.dumps(plain(summary), indent=1) + "\n")


def plain(value: Any) -> Any:
    """Return a value as JSON reads it back: arrays as lists, and None for numbers that JSON cannot hold."""
    if isinstance(value, Mapping):
        return {str(key): plain(item) for key, item in value.items()}
    if isinstance(value, list | tuple):
        return [plain(item) for item in value]
    if isinstance(value, np.ndarray | np.generic):
        return plain(value.tolist())
    if isinstance(value, bool | str | int) or value is None:
        return value
    if isinstance(value, float):
        return value if math.isfinite(value) else None
    return str(value)
