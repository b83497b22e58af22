"""``broken_bonds.csv``: the broken bonds, with step and position."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np

from pdpetsc.arrays import Float
from pdpetsc.damage.state import FailingBonds
from pdpetsc.discrete.communicator import anywhere, is_root
from pdpetsc.output.observer import Observed, Observer
from pdpetsc.output.records import Table, rows_of
from pdpetsc.post.solution import Solution
from pdpetsc.solvers.protocol import Converged


class BrokenBonds(Observer):
    """Record the bonds that break in each step, sorted by the ids of their ends.

    Parameters
    ----------
    bonds : FailingBonds
        The state of the bonds. Bonds that are broken at the start of the run count as listed.

    Attributes
    ----------
    table : Table
        The file.
    """

    table: Table

    def __init__(self, bonds: FailingBonds) -> None:
        self._bonds = bonds

    def begin(self, observed: Observed) -> None:
        """Write the header and the rows before a restart."""
        super().begin(observed)
        comm, origin = observed.comm, observed.origin
        header = ["step", "t", "i", "j", "length", *"xyz"[: self._bonds.of.cloud.dim]]
        rows: list[list[float]] = []
        if origin is not None and is_root(comm):
            earlier = rows_of(origin.tables.get("broken_bonds", ""), header) or []
            rows = [row for row in earlier if row[0] <= origin.start.step]
        self._listed = ~self._bonds.intact
        self.table = Table(comm, observed.folder / "broken_bonds.csv", [header, *map(_row, rows)])
        if origin is not None and not comm.bcast(len(rows)):
            # The checkpoint has no table; pictures and interpolation read cracks from this table only.
            self._listed[:] = False
            self._append(origin.start.step, origin.start.t)

    def step(self, solution: Solution, converged: Converged) -> Mapping[str, Any]:
        """Append the bonds that broke in a step."""
        self._append(solution.step, solution.t)
        return {}

    def end(self) -> None:
        """Flush all rows to disk."""
        self.table.flush()

    def _append(self, step: int, t: float) -> None:
        """Append the broken bonds that are not yet listed: ids of both ends, length and midpoint."""
        bonds, comm = self._bonds, self.observed.comm
        new = np.flatnonzero((bonds.phi == 0.0) & ~self._listed)
        if not anywhere(comm, len(new)):
            return
        self._listed[new] = True
        rows = np.column_stack([bonds.of.keys(new), bonds.of.lengths_of(new), bonds.of.middle(new)])
        parts: list[Float] | None = comm.gather(rows)
        written: list[list[str]] = []
        if parts is not None:
            gathered = np.concatenate(parts)
            _, first = np.unique(gathered[:, :3], axis=0, return_index=True)
            written = [_row([step, t, r[0], r[1], *r[3:]]) for r in gathered[first].tolist()]
        self.table.append(written)


def _row(values: Sequence[float]) -> list[str]:
    """Return a row as text, with step and ids as integers."""
    return [str(int(value)) if n in (0, 2, 3) else repr(float(value)) for n, value in enumerate(values)]
