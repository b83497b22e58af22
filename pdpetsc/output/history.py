"""``history.csv``: the quantities of a case, a row for each step."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np

from pdpetsc.declared import ByName
from pdpetsc.discrete.communicator import agreed, is_root
from pdpetsc.errors import CaseError
from pdpetsc.output.folder import set_history_aside
from pdpetsc.output.observer import Observed, Observer
from pdpetsc.output.progress import Report
from pdpetsc.output.records import Table, rows_of
from pdpetsc.post.quantities import Quantity
from pdpetsc.post.solution import Solution
from pdpetsc.solvers.protocol import Converged


class History(Observer):
    """Evaluate and write the quantities of a case.

    Parameters
    ----------
    quantities : mapping of str to Quantity
        Quantities by the names of their columns, which follow step and step time.

    Attributes
    ----------
    columns : dict of str to list of float
        The history so far, including the rows before a restart.
    table : Table
        The file.
    """

    table: Table

    def __init__(self, quantities: Mapping[str, Quantity]) -> None:
        self.quantities = quantities
        self.columns = ByName[list[float]]("history", {name: [] for name in ("step", "t", *quantities)})

    def rehearse(self, start: Solution, report: Report) -> None:
        """Evaluate the quantities and print their notes; raises CaseError unless they are numbers."""
        for name, quantity in self.quantities.items():
            value = quantity.evaluate(start)
            note = quantity.note(start)
            if note:
                report.warn(f"{name} of the history {note}.")
            with agreed(start.cloud.comm):
                if isinstance(value, Sequence) or np.ndim(value) or np.asarray(value).dtype.kind not in "fiub":
                    raise CaseError(
                        f"{type(quantity).__name__} of the history must return a number, not {type(value).__name__}."
                    )

    def begin(self, observed: Observed) -> None:
        """Write the rows before a restart and the row of the initial state at once."""
        super().begin(observed)
        start, origin, comm = observed.last, observed.origin, observed.comm
        rows: list[list[float]] | None = []
        if origin is not None:
            rows = comm.bcast(rows_of(origin.tables.get("history", ""), list(self.columns)) if is_root(comm) else None)
            if rows is None:
                observed.report.warn(
                    f"The history in the checkpoint has other columns: that of this run starts at step {start.step}, "
                    f"and results that are made of it, as its largest force, know of nothing before."
                )
                if observed.in_own_folder:
                    set_history_aside(comm, observed.folder)
        # The row of the start is that of its step: friction and bodies in contact forget how they came there.
        rows = [row for row in rows or [] if row[0] <= start.step]
        for row in rows:
            self._remember(row)
        if not rows or rows[-1][0] < start.step:
            rows.append(self._evaluated(start))
        # One write for all rows: a run that is killed here leaves either the earlier table or this one.
        self.table = Table(comm, observed.folder / "history.csv", [list(self.columns), *map(_written, rows)])

    def step(self, solution: Solution, converged: Converged) -> Mapping[str, Any]:
        """Append the row of a step."""
        self.table.append([_written(self._evaluated(solution))])
        return {}

    def end(self) -> None:
        """Flush all rows to disk."""
        self.table.flush()

    def _evaluated(self, solution: Solution) -> list[float]:
        row = [float(solution.step), float(solution.t)]
        row += [float(quantity.evaluate(solution)) for quantity in self.quantities.values()]
        self._remember(row)
        return row

    def _remember(self, row: Sequence[float]) -> None:
        for column, value in zip(self.columns.values(), row, strict=True):
            column.append(value)


def _written(row: Sequence[float]) -> list[Any]:
    return [int(row[0]), *(repr(float(value)) for value in row[1:])]
