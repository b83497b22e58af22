"""What a run keeps of every converged step: fields, history, broken bonds, checkpoint."""

from __future__ import annotations

import uuid
from collections.abc import Mapping, Sequence
from pathlib import Path

from pdpetsc.discrete.communicator import Comm, is_root
from pdpetsc.output.broken import BrokenBonds, broken_header
from pdpetsc.output.checkpoint import Origin, Record, write_checkpoint
from pdpetsc.output.crack import write_crack
from pdpetsc.output.fields import FieldWriter
from pdpetsc.output.files import InCreationOrder
from pdpetsc.output.folder import set_history_aside, set_pictures_aside
from pdpetsc.output.records import HistoryWriter, whole_rows
from pdpetsc.post.quantities import Quantity
from pdpetsc.post.solution import Field, Solution
from pdpetsc.problem.problem import Problem


class RunWriter:
    """Writes converged steps to the folder of a run.

    Before it writes anything, what an earlier run left in the folder is set aside, unless this run goes on from there.
    The checkpoint of a step is written last, and what belongs to the step is on the disk by then.

    Parameters
    ----------
    folder : Path
        Where everything goes.
    quantities : mapping of str to Quantity
        Columns of ``history.csv`` after step and step time.
    fields : sequence of Field
        What is written as fields; no such files where empty.
    checkpoints : int
        A checkpoint every so many steps, and at the end; 0 for none.
    start : Solution
        The state from which the run goes on; written too.
    order : InCreationOrder
        Of the particles in files.
    origin : Origin, optional
        The checkpoint that ``start`` is from: what lies beside it up to there and belongs to it is taken over.
    declared : mapping of str to str
        Fingerprints of the parts of the case, for the checkpoints.

    Attributes
    ----------
    history : dict of str to list of float
        The columns so far.
    run : str
        What the files of this run say they belong to.
    took_over : bool
        Whether an earlier history was found, where there is a restart.
    so_far : dict of str to float
        What the run has counted and come across, for the checkpoints.

    Raises
    ------
    CaseError
        The folder holds files of another origin under the names that the run writes to.
    OutputError
        A file cannot be written.

    Notes
    -----
    Construction and every method are collective.
    """

    def __init__(
        self, folder: Path, quantities: Mapping[str, Quantity], fields: Sequence[Field], checkpoints: int,
        start: Solution, order: InCreationOrder, origin: Origin | None = None,
        declared: Mapping[str, str] | None = None,
    ) -> None:  # fmt: skip
        cloud, damage = start.cloud, start.problem.damage
        comm = cloud.comm
        self._quantities = quantities
        self._order = order
        self._every = checkpoints
        self._checkpoint = folder / "checkpoint.h5"
        self._last = start
        self._saved = start.step
        self._declared = dict(declared or {})
        self._row: dict[str, float] = {}
        self.so_far: dict[str, float] = {}
        self.history: dict[str, list[float]] = {name: [] for name in ("step", "t", *quantities)}
        header = None if damage is None else broken_header(damage.bonds)
        rows, broken = (None, []) if origin is None else _beside(comm, origin, list(self.history), header)
        self.took_over = origin is None or rows is not None
        for row in rows or []:
            self._remember(row)
        # A run that goes on in its own folder adds to what is there.
        own = origin is not None and origin.inside(folder)
        self.run: str = origin.record.run if own and origin is not None else comm.bcast(uuid.uuid4().hex)
        if own and rows is None:
            # A table of other columns, or of another run, is not lost to the one that begins.
            set_history_aside(comm, folder)
        if own:
            set_pictures_aside(comm, folder)
        self._broken = None if damage is None else BrokenBonds(comm, folder, damage.bonds, broken)
        if self._broken is not None and origin is not None and not broken:
            # Pictures and values between particles know of cracks from this table alone.
            self._broken.list_again(start.step, start.t)
        first = start.step if own else 0
        self._fields = FieldWriter(cloud, order, folder, fields, self.run, first) if fields else None
        # The work of the next step needs these forces, and by then bonds may have failed.
        _ = start.internal_force
        if self._fields is not None:
            self._fields.write(start)
        # One write for all rows: a run that dies here leaves the earlier table or this one.
        self._rows = HistoryWriter(comm, folder, list(self.history), [*(rows or ()), self._evaluated(start)])
        start.forget()

    @property
    def last(self) -> Solution:
        """Return the last converged state (not collective)."""
        return self._last

    @property
    def problem(self) -> Problem:
        """Return what is solved (not collective)."""
        return self._last.problem

    def write(self, solution: Solution, write_fields: bool, work: float | None = None) -> None:
        """Keep the next converged step, with the work since the one before where the solver gives it."""
        solution.follow(self._last, work)
        # The body is in this state from here on, whatever becomes of its record.
        self._last = solution
        if self._broken is not None:
            self._broken.write(solution.step, solution.t)
        self._record(solution, write_fields)
        if self._every > 0 and solution.step % self._every == 0:
            self._checkpoint_now()
        solution.forget()

    def save(self) -> None:
        """Let everything be on the disk, and write the checkpoint of the last step, unless it is there or not wanted.

        This is how a run ends.
        """
        if self._fields is not None:
            self._fields.flush()
        self._checkpoint_now()
        write_crack(self._last.cloud.comm, self._checkpoint.parent, self._quantities.values(), self._last)

    def _checkpoint_now(self) -> None:
        self._rows.flush()
        if self._broken is not None:
            self._broken.flush()
        if self._every > 0 and self._saved != self._last.step:
            record = Record(self.run, self._declared, self._row, self.so_far)
            write_checkpoint(self._last, self._order, self._checkpoint, record)
            self._saved = self._last.step

    def _record(self, solution: Solution, write_fields: bool) -> None:
        if self._fields is not None and write_fields:
            self._fields.write(solution)
        self._rows.write(self._evaluated(solution))

    def _evaluated(self, solution: Solution) -> list[float]:
        """Return the row of a step, and remember it."""
        row = [float(solution.step), float(solution.t)]
        row += [float(quantity.evaluate(solution)) for quantity in self._quantities.values()]
        self._remember(row)
        self._row = dict(zip(self.history, row, strict=True))
        return row

    def _remember(self, row: Sequence[float]) -> None:
        for name, value in zip(self.history, row, strict=True):
            self.history[name].append(value)


def _beside(
    comm: Comm, origin: Origin, names: Sequence[str], broken: Sequence[str] | None
) -> tuple[list[list[float]] | None, list[list[float]]]:
    """Return the rows of history before a checkpoint and of broken bonds up to it, from the files beside it.

    The history is None where there is none with these columns, or it is of another run: one that lacks the last row
    before the checkpoint was written (collective).
    """
    found: tuple[list[list[float]] | None, list[list[float]]] = None, []
    if is_root(comm):
        step = origin.start.step
        rows = whole_rows(origin.path.parent / "history.csv", names)
        if rows is not None:
            known = [origin.record.row.get(name) for name in names]
            same = [row for row in rows if row[0] == known[0]]
            if not same or list(map(repr, same[-1])) != list(map(repr, known)):
                rows = None
        of_bonds = whole_rows(origin.path.parent / "broken_bonds.csv", broken) if broken is not None else None
        found = (
            None if rows is None else [row for row in rows if row[0] < step],
            [row for row in of_bonds or [] if row[0] <= step],
        )
    shared: tuple[list[list[float]] | None, list[list[float]]] = comm.bcast(found)
    return shared
