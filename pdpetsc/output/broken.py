"""``broken_bonds.csv``: which bonds broke, when and where."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

import numpy as np

from pdpetsc.arrays import Float
from pdpetsc.damage.state import FailingBonds
from pdpetsc.discrete.communicator import Comm, total
from pdpetsc.output.records import Table


class BrokenBonds:
    """Appends a row for every bond that has broken since the last step, in the order of the ids within a step.

    Parameters
    ----------
    comm : Comm
        All ranks.
    folder : Path
        Where the file goes.
    failure : FailingBonds
        The state of the bonds; those that are broken already count as listed.
    kept : sequence of rows
        What an earlier run wrote before this one goes on.

    Notes
    -----
    Construction and every method are collective; rank 0 writes.
    """

    def __init__(self, comm: Comm, folder: Path, failure: FailingBonds, kept: Sequence[Sequence[float]] = ()) -> None:
        self._comm = comm
        self._failure = failure
        self._listed = ~failure.intact
        self._table = Table(comm, folder / "broken_bonds.csv", [broken_header(failure), *map(_row, kept)])

    def write(self, step: int, t: float) -> None:
        """Append the bonds that broke in a step, with the ids of their ends, their length and their middle."""
        failure = self._failure
        new = np.flatnonzero((failure.phi == 0.0) & ~self._listed)
        if int(total(self._comm, len(new))) == 0:
            return
        self._listed[new] = True
        rows = np.column_stack([failure.keys[new], failure.length[new], failure.middle[new]])
        parts: list[Float] | None = self._comm.gather(rows)
        found: list[list[str]] = []
        if parts is not None:
            _, first = np.unique(np.concatenate(parts)[:, :3], axis=0, return_index=True)
            found = [_row([step, t, r[0], r[1], *r[3:]]) for r in np.concatenate(parts)[first].tolist()]
        self._table.append(found)

    def list_again(self, step: int, t: float) -> None:
        """Append all bonds that are broken already, as of a step: where nothing is known of when they broke."""
        self._listed[:] = False
        self.write(step, t)

    def flush(self) -> None:
        """Wait until all rows are on the disk."""
        self._table.flush()


def broken_header(failure: FailingBonds) -> list[str]:
    """Return the columns of the table (not collective)."""
    return ["step", "t", "i", "j", "length", *"xyz"[: failure.middle.shape[1]]]


def _row(values: Sequence[float]) -> list[str]:
    """Return a row as it is written: step and ids as whole numbers."""
    return [str(int(value)) if n in (0, 2, 3) else repr(float(value)) for n, value in enumerate(values)]
