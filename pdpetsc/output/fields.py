"""Fields of each step: one file per step in ``fields/``, joined by ``fields.h5`` and ``fields.xdmf``."""

from __future__ import annotations

import contextlib
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import h5py
import numpy as np
from numpy.typing import NDArray

from pdpetsc.declare.particles import Particles
from pdpetsc.declare.tiling import Cells
from pdpetsc.declared import name_of
from pdpetsc.discrete.cloud import Cloud
from pdpetsc.discrete.communicator import agreed, is_root
from pdpetsc.errors import CaseError
from pdpetsc.output.files import (
    HEADERS,
    WRITE_ERRORS,
    InCreationOrder,
    cannot_write,
    on_several_nodes,
    open_hdf5,
    replacing,
    reserve,
    writing_hdf5,
)
from pdpetsc.output.folder import FIELDS
from pdpetsc.output.index import Index, Step, entries, part_of, remove, steps_in, storable
from pdpetsc.output.observer import Observed, Observer
from pdpetsc.output.progress import Report
from pdpetsc.output.surface import write_cells, write_surface
from pdpetsc.post.solution import Field, Solution, in_space, rows_of_field
from pdpetsc.solvers.protocol import Converged


class Fields(Observer):
    """Write the declared fields at the steps that are selected for output.

    Parameters
    ----------
    fields : sequence of Field
        At least one.
    particles : Particles
        Their surface and cells are written beside the fields.
    """

    def __init__(self, fields: Sequence[Field], particles: Particles) -> None:
        self._fields = fields
        self._particles = particles

    def rehearse(self, start: Solution, report: Report) -> None:
        """Evaluate the fields; raises CaseError unless each has one row per particle."""
        for field in self._fields:
            _evaluated(field, field, start)

    def begin(self, observed: Observed) -> None:
        """Write the fields of the start, the surface and the cells."""
        super().begin(observed)
        start, folder, run = observed.last, observed.folder, observed.run
        first = start.step if observed.in_own_folder else 0
        cells = write_cells(observed.comm, folder, run, self._particles, start.cloud.n_global)
        self._writer = FieldWriter(start.cloud, observed.order, folder, self._fields, run, first, cells)
        self._writer.write(start)
        write_surface(observed.comm, folder, run, self._particles)

    def step(self, solution: Solution, converged: Converged) -> Mapping[str, Any]:
        """Write the fields of a step."""
        if converged.write_fields:
            self._writer.write(solution)
        return {}

    def end(self) -> None:
        """Flush all files to disk."""
        self._writer.flush()


class FieldWriter:
    """Write fields of all particles, in the order of creation on any number of ranks.

    Vectors and tensors are stored with three dimensions for bodies of any dimension. On several nodes each rank writes
    its part of the ids if h5py has parallel HDF5. Otherwise rank 0 writes the parts one after another, which is three
    times as fast on one node. No rank holds a whole field.
    Each step has its own file, which is written under a temporary name, renamed, and never opened for writing again.
    The entries of a tensor are also available by name, as ``stress_xx``: views of its columns that use no disk space.

    Parameters
    ----------
    cloud : Cloud
        The particles.
    order : InCreationOrder
        Order of the particles in files.
    folder : Path
        Folder of ``fields/``, ``fields.h5`` and ``fields.xdmf``.
    fields : sequence of Field
        The fields to write, named on disk by their functions.
    run : str
        Identifier of the run.
    first : int
        Last step of this run that is kept in the folder, for a restart in the same folder.
    cells : Cells, optional
        The cells in the folder, on rank 0.

    Attributes
    ----------
    parallel : bool
        True if all ranks write at once; equal on all ranks.

    Raises
    ------
    CaseError
        A field has no valid name, or two fields have the same name; on all ranks.
    OutputError
        The disk is full or a file cannot be written, on all ranks.

    Notes
    -----
    Construction and every method are collective.
    """

    def __init__(
        self, cloud: Cloud, order: InCreationOrder, folder: Path, fields: Sequence[Field], run: str = "",
        first: int = 0, cells: Cells | None = None,
    ) -> None:  # fmt: skip
        self._cloud = cloud
        self._order = order
        self._folder = folder
        self._run = run
        self._fields = dict(zip(_names(fields), fields, strict=True))
        self.parallel = on_several_nodes(cloud.comm) and h5py.get_config().mpi
        self._index: Index | None = None
        earlier: list[Step] = []
        there = False
        with agreed(cloud.comm):
            if is_root(cloud.comm):
                try:
                    (folder / FIELDS).mkdir(exist_ok=True)
                    for unfinished in (folder / FIELDS).glob("step_*.h5.part"):
                        unfinished.unlink()
                    earlier = steps_in(folder, run, cloud.n_global) if first > 0 else []
                    there = first > 0 and _is_of(folder / FIELDS / "particles.h5", run, cloud.n_global)
                except OSError as error:
                    raise cannot_write(folder / FIELDS, error) from error
        if not cloud.comm.bcast(there):
            n = cloud.n_owned
            values = {"position": cloud.x[:n], "id": cloud.gid[:n], "volume": cloud.volume[:n]}
            if cloud.body is not None:
                values["body"] = cloud.body[:n]
            self._store(folder / FIELDS / "particles.h5", {name: storable(array) for name, array in values.items()})
        with agreed(cloud.comm):
            if is_root(cloud.comm):
                self._index = Index(folder, cloud.n_global, [step for step in earlier if step.number <= first], cells)
                # Steps after ``first`` will be computed again.
                remove(folder, [step for step in earlier if step.number > first])

    def write(self, solution: Solution) -> None:
        """Write the fields of a step."""
        values = {name: _evaluated(field, in_space(field), solution) for name, field in self._fields.items()}
        self.put(solution.step, solution.t, values)

    def put(self, number: int, t: float, values: dict[str, NDArray[Any]]) -> None:
        """Write named arrays of the own particles as the fields of a step."""
        stored = {name: storable(array) for name, array in values.items()}
        parts = [part_of(name, array.shape, array.dtype) for name, array in stored.items()]
        parts += [part_of(name, (1,), stored[of].dtype) for name, of, _ in self._views(stored)]
        step = Step(number, t, parts)
        self._store(self._folder / step.file, stored, t)
        with agreed(self._cloud.comm):
            if self._index is not None:
                self._index.add(step)

    def flush(self) -> None:
        """Flush all files to disk."""
        with agreed(self._cloud.comm):
            if self._index is not None:
                self._index.flush()

    def _store(self, path: Path, values: dict[str, NDArray[Any]], t: float = 0.0) -> None:
        """Write named arrays of the own particles into a new file."""
        comm, n = self._cloud.comm, self._cloud.n_global
        with contextlib.ExitStack() as stack:
            aside: Path | None = None
            file: h5py.File | None = None
            with agreed(comm):
                if is_root(comm):
                    rows = sum(array.dtype.itemsize * int(np.prod(array.shape[1:])) for array in values.values())
                    size = n * rows + HEADERS * (1 + len(values) + len(self._views(values)))
                    try:
                        aside = stack.enter_context(replacing(path))
                        file = stack.enter_context(made := contextlib.ExitStack()).enter_context(
                            writing_hdf5(aside, size, track_order=True)
                        )
                        file.attrs["t"], file.attrs["run"] = t, self._run
                        if self.parallel:
                            # All ranks open the file again with parallel HDF5.
                            made.close()
                            reserve(aside, size)
                    except WRITE_ERRORS as error:
                        raise cannot_write(path, error) from error
            aside = comm.bcast(aside)
            failure = self._at_once(aside, values) if self.parallel else self._in_turn(file, values)
            with agreed(comm):
                if failure is not None:
                    raise cannot_write(path, failure) from failure
            with agreed(comm):
                stack.close()

    def _at_once(self, path: Path | None, values: dict[str, NDArray[Any]]) -> Exception | None:
        """Write with parallel HDF5, each rank its part of the ids; return the error, if any."""
        comm, starts = self._cloud.comm, self._order.starts
        mine = slice(int(starts[comm.rank]), int(starts[comm.rank + 1]))
        try:
            with h5py.File(path, "r+", driver="mpio", comm=comm) as file:
                for name, array in values.items():
                    dataset = file.create_dataset(name, (self._cloud.n_global, *array.shape[1:]), array.dtype)
                    with dataset.collective:
                        dataset[mine] = self._order.rows(array)
                self._name_entries(file, values)
        except WRITE_ERRORS as error:
            return error
        return None

    def _in_turn(self, file: h5py.File | None, values: dict[str, NDArray[Any]]) -> Exception | None:
        """Write the parts of all ranks to the file of root, one after another; return the error, if any."""
        failure: Exception | None = None
        for name, array in values.items():
            dataset = None
            for rows, part in self._order.parts_on_root(array):
                # Root continues to receive after a failure, so that no rank hangs in a send.
                if failure is not None or file is None:
                    continue
                try:
                    if dataset is None:
                        shape = (self._cloud.n_global, *part.shape[1:])
                        dataset = file.create_dataset(name, shape, part.dtype)
                    dataset[rows] = part
                except WRITE_ERRORS as error:
                    failure = error
        if failure is None and file is not None:
            try:
                self._name_entries(file, values)
            except WRITE_ERRORS as error:
                failure = error
        return failure

    def _views(self, values: dict[str, NDArray[Any]]) -> list[tuple[str, str, int]]:
        """Return name, tensor and column of each tensor entry, except names that a field has."""
        tensors = [name for name, array in values.items() if array.ndim == 2 and array.shape[1] == 9]
        found = [(f"{name}_{entry}", name, column) for name in tensors for column, entry in entries(self._cloud.dim)]
        return [view for view in found if view[0] not in values]

    def _name_entries(self, file: h5py.File, values: dict[str, NDArray[Any]]) -> None:
        """Name the columns of tensors by virtual datasets of HDF5, which all readers treat as data.

        XDMF can also select columns, but two of the three XDMF readers of ParaView 5.11 skip such arrays.
        """
        n = self._cloud.n_global
        for name, tensor, column in self._views(values):
            layout = h5py.VirtualLayout((n,), values[tensor].dtype)
            layout[:] = h5py.VirtualSource(".", tensor, (n, 9), values[tensor].dtype)[:, column]
            file.create_virtual_dataset(name, layout)


def _evaluated(field: Field, function: Field, solution: Solution) -> NDArray[Any]:
    """Evaluate a field by ``function`` and check its shape (collective).

    Raises
    ------
    CaseError
        A field of this shape cannot be written; on all ranks.
    """
    evaluated, n = function(solution), len(solution.u)
    with agreed(solution.cloud.comm):
        values = rows_of_field(field, evaluated, n)
        name = name_of(field)
        if values.ndim > 3 or max(values.shape[1:], default=1) > 3:
            raise CaseError(
                f"The field {name} must be ({n},), or with one or two dimensions of at most 3 after that, not "
                f"{values.shape}."
            )
        return values


def _names(fields: Sequence[Field]) -> list[str]:
    """Return the names of fields; raises CaseError if a name is invalid or occurs twice."""
    names = [str(getattr(field, "__name__", "")) for field in fields]
    for name in names:
        if not name or "/" in name or "\0" in name or name.strip(".") == "":
            raise CaseError(f"A field is written under the name of its function, and {name!r} is none; use a def.")
        if names.count(name) > 1:
            raise CaseError(f"Two fields are named {name!r}; give their functions different names.")
    return names


def _is_of(path: Path, run: str, n: int) -> bool:
    """Return True if a file of particles is complete and of this run."""
    try:
        with open_hdf5(path) as file:
            return bool(file.attrs["run"] == run) and all(len(file[name]) == n for name in ("position", "id", "volume"))
    except (OSError, RuntimeError, KeyError, ValueError, TypeError):
        return False
