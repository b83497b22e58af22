"""``broken_bonds.csv``: which bonds broke, when and where."""

from __future__ import annotations

import csv
from pathlib import Path

import numpy as np

from pdpetsc.arrays import Float
from pdpetsc.discrete.communicator import Comm, agreed, is_root, total
from pdpetsc.model.failure import BondFailure
from pdpetsc.output.records import write_rows


class BrokenBonds:
    """Appends a row for every bond that has broken since the last step, in the order of the ids within a step.

    Parameters
    ----------
    comm : Comm
        All ranks.
    folder : Path
        Where the file goes.
    failure : BondFailure
        The state of the bonds; those that are broken already count as listed.
    before, step : Path, int
        What an earlier run wrote, of which the rows up to ``step`` are taken over.

    Notes
    -----
    Construction and ``write`` are collective; rank 0 writes.
    """

    def __init__(
        self, comm: Comm, folder: Path, failure: BondFailure, before: Path | None = None, step: int = 0
    ) -> None:
        self._comm = comm
        self._path = folder / "broken_bonds.csv"
        self._failure = failure
        self._listed = ~failure.intact
        header = ["step", "t", "i", "j", "length", *"xyz"[: failure.middle.shape[1]]]
        with agreed(comm):
            kept = _earlier(before, header, step) if before is not None and is_root(comm) else []
            write_rows(comm, self._path, "w", [header, *kept])

    def write(self, step: int, t: float) -> None:
        """Append the bonds that broke in a step, with the ids of their ends, their length and their middle."""
        failure = self._failure
        new = np.flatnonzero((failure.integrity == 0.0) & ~self._listed)
        if int(total(self._comm, len(new))) == 0:
            return
        self._listed[new] = True
        rows = np.column_stack([failure.keys[new], failure.length[new], failure.middle[new]])
        parts: list[Float] | None = self._comm.gather(rows)
        with agreed(self._comm):
            if parts is not None:
                _, first = np.unique(np.concatenate(parts)[:, :3], axis=0, return_index=True)
                found = np.concatenate(parts)[first]
                rows_of = [[step, repr(t), int(r[0]), int(r[1]), *map(repr, r[3:].tolist())] for r in found]
                write_rows(self._comm, self._path, "a", rows_of)


def _earlier(path: Path, header: list[str], step: int) -> list[list[str]]:
    """Return the rows up to ``step`` of a table with this header, none where there is no such table."""
    try:
        with path.open(newline="") as file:
            first, *rows = csv.reader(file)
    except (OSError, ValueError):
        return []
    return [row for row in rows if first == header and int(row[0]) <= step]
