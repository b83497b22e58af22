"""What a run keeps of every converged step: fields, history, broken bonds, checkpoint."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import Path

from pdpetsc.model import Model
from pdpetsc.output.broken import BrokenBonds
from pdpetsc.output.checkpoint import write_checkpoint
from pdpetsc.output.fields import FieldWriter
from pdpetsc.output.files import InCreationOrder
from pdpetsc.output.records import HistoryWriter, earlier_history
from pdpetsc.quantities import Quantity
from pdpetsc.solution import Field, Solution


class Keeper:
    """Writes converged steps to the folder of a run.

    Parameters
    ----------
    folder : Path
        Where everything goes.
    quantities : mapping of str to Quantity
        Columns of ``history.csv`` after step and step time.
    fields : sequence of Field
        What ``fields.h5`` holds; no such file where empty.
    checkpoints : int
        A checkpoint every so many steps, and at the end; 0 for none.
    start : Solution
        The state from which the run goes on; written too.
    order : InCreationOrder
        Of the particles in files.
    restart : Path, optional
        Checkpoint that ``start`` is from: what lies beside it up to there is taken over.

    Attributes
    ----------
    history : dict of str to list of float
        The columns so far.
    took_over : bool
        Whether an earlier history was found, where there is a restart.

    Raises
    ------
    OutputError
        A file cannot be written.

    Notes
    -----
    Construction and every method are collective.
    """

    def __init__(
        self, folder: Path, quantities: Mapping[str, Quantity], fields: Sequence[Field], checkpoints: int,
        start: Solution, order: InCreationOrder, restart: Path | None = None,
    ) -> None:  # fmt: skip
        cloud, comm = start.model.cloud, start.model.cloud.comm
        self._quantities = quantities
        self._order = order
        self._every = checkpoints
        self._checkpoint = folder / "checkpoint.h5"
        self._last = start
        self._saved = start.step
        self.history: dict[str, list[float]] = {name: [] for name in ("step", "t", *quantities)}
        beside = None if restart is None else restart.parent
        rows = [] if beside is None else earlier_history(comm, beside / "history.csv", list(self.history), start.step)
        self.took_over = rows is not None
        for row in rows or []:
            self._remember(row)
        # A run that goes on in its own folder appends its fields to those that are there.
        first = start.step if beside is not None and beside.resolve() == folder.resolve() else 0
        self._fields = FieldWriter(cloud, order, folder, fields, first) if fields else None
        self._rows = HistoryWriter(comm, folder, list(self.history), rows or ())
        self._broken = None
        if start.model.failure is not None:
            earlier = None if beside is None else beside / "broken_bonds.csv"
            self._broken = BrokenBonds(comm, folder, start.model.failure, earlier, start.step)
        self._record(start, write_fields=True)

    @property
    def model(self) -> Model:
        """Return the body (not collective)."""
        return self._last.model

    def write(self, solution: Solution, write_fields: bool) -> None:
        """Keep the next converged step."""
        solution.follow(self._last)
        # The body is in this state from here on, whatever becomes of its record.
        self._last = solution
        if self._broken is not None:
            self._broken.write(solution.step, solution.t)
        self._record(solution, write_fields)
        if self._every > 0 and solution.step % self._every == 0:
            self.save()

    def save(self) -> None:
        """Write the checkpoint of the last step, unless it is there already or not wanted."""
        if self._every > 0 and self._saved != self._last.step:
            write_checkpoint(self._last, self._order, self._checkpoint)
            self._saved = self._last.step

    def _record(self, solution: Solution, write_fields: bool) -> None:
        if self._fields is not None and write_fields:
            self._fields.write(solution)
        row = [float(solution.step), solution.t]
        row += [quantity.evaluate(solution) for quantity in self._quantities.values()]
        self._remember(row)
        self._rows.write(row)

    def _remember(self, row: Sequence[float]) -> None:
        for name, value in zip(self.history, row, strict=True):
            self.history[name].append(value)
