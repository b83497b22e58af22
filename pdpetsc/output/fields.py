"""Fields per step in ``fields.h5`` with ``fields.xdmf`` beside it, which ParaView opens."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import Any

import h5py
import numpy as np
from numpy.typing import NDArray

from pdpetsc.discrete.cloud import Cloud
from pdpetsc.discrete.communicator import agreed, is_root
from pdpetsc.errors import OutputError
from pdpetsc.output.files import InCreationOrder, on_several_nodes, replacing, reserve
from pdpetsc.solution import Field, Solution, in_space

# Room for the headers of a group or dataset [bytes].
HEADERS = 2**14
_KINDS = {1: "Scalar", 3: "Vector", 9: "Tensor"}


class FieldWriter:
    """Writes fields of all particles, in the order of creation on any rank count.

    Vectors and tensors have three dimensions on disk whatever the body has. On several nodes every rank writes its part
    of the ids, if h5py has parallel HDF5; on one node, where that is a third as fast, and with any other build, rank 0
    writes the parts one after another. No rank holds a whole field.
    The file is closed between steps: what was written stays readable whatever happens later.

    Parameters
    ----------
    cloud : Cloud
        The particles.
    folder : Path
        Where ``fields.h5`` and ``fields.xdmf`` go.
    fields : sequence of Field
        What is written; the names on disk are the functions' names.
    first : int
        Steps before it that the folder holds are kept: a restart goes on in its own folder.

    Attributes
    ----------
    together : bool
        Whether all ranks write at once; the same on all.

    Raises
    ------
    OutputError
        The disk is full or the file cannot be written, on all ranks.

    Notes
    -----
    Construction and ``write`` are collective.
    """

    def __init__(
        self, cloud: Cloud, order: InCreationOrder, folder: Path, fields: Sequence[Field], first: int = 0
    ) -> None:
        self._cloud = cloud
        self._order = order
        self._path = folder / "fields.h5"
        self._xdmf = folder / "fields.xdmf"
        self._fields = fields
        self._steps: list[tuple[int, float, dict[str, int]]] = []
        self.together = on_several_nodes(cloud.comm) and h5py.get_config().mpi
        with agreed(cloud.comm):
            if is_root(cloud.comm):
                self._steps = _kept_steps(self._path, first)
                if not self._steps:
                    self._path.unlink(missing_ok=True)
        if not cloud.comm.bcast(bool(self._steps)):
            n = cloud.n_owned
            self._store("particles", {"position": cloud.x[:n], "id": cloud.gid[:n], "volume": cloud.volume[:n]})

    def write(self, solution: Solution) -> None:
        """Append one step."""
        values = {field.__name__: in_space(field)(solution) for field in self._fields}
        group = f"step_{solution.step:05d}"
        widths = self._store(group, values, solution.t)
        self._steps.append((solution.step, solution.t, widths))
        with agreed(self._cloud.comm):
            if is_root(self._cloud.comm):
                with replacing(self._xdmf) as aside:
                    aside.write_text(self._markup())

    def _store(self, group: str, values: dict[str, NDArray[Any]], t: float = 0.0) -> dict[str, int]:
        """Write named arrays into a new group of step time ``t``; return the number of components of each."""
        comm, n = self._cloud.comm, self._cloud.n_global
        padded = {name: _padded(array) for name, array in values.items()}
        with agreed(comm):
            if is_root(comm):
                rows = sum(array.dtype.itemsize * int(np.prod(array.shape[1:])) for array in padded.values())
                reserve(self._path, n * rows + HEADERS * (1 + len(padded)))
        write = self._at_once if self.together else self._in_turn
        failure = write(group, padded, t)
        with agreed(comm):
            if failure is not None:
                raise OutputError(f"Cannot write {group} to {self._path}: {failure}.")
        return {name: int(np.prod(array.shape[1:])) for name, array in padded.items()}

    def _at_once(self, group: str, values: dict[str, NDArray[Any]], t: float) -> Exception | None:
        """Write with parallel HDF5, every rank its part of the ids; return what went wrong."""
        comm, starts = self._cloud.comm, self._order.starts
        mine = slice(int(starts[comm.rank]), int(starts[comm.rank + 1]))
        try:
            with h5py.File(self._path, "a", driver="mpio", comm=comm) as file:
                for name, array in values.items():
                    shape = (self._cloud.n_global, *array.shape[1:])
                    dataset = file.create_dataset(f"{group}/{name}", shape, array.dtype)
                    with dataset.collective:
                        dataset[mine] = self._order.rows(array)
                file[group].attrs["t"] = t
        except (OSError, RuntimeError) as error:
            return error
        return None

    def _in_turn(self, group: str, values: dict[str, NDArray[Any]], t: float) -> Exception | None:
        """Write on rank 0, the parts of the others one after another; return what went wrong."""
        n = self._cloud.n_global
        failure: Exception | None = None
        file = None
        for name, array in values.items():
            dataset = None
            for rows_of, part in self._order.parts_on_root(array):
                # Root goes on receiving after a failure, so that no rank is left in a send.
                try:
                    if file is None and failure is None:
                        file = h5py.File(self._path, "a")
                    if dataset is None and file is not None and failure is None:
                        dataset = file.create_dataset(f"{group}/{name}", (n, *part.shape[1:]), part.dtype)
                    if dataset is not None and failure is None:
                        dataset[rows_of] = part
                except (OSError, RuntimeError) as error:
                    failure = error
        try:
            if file is not None:
                if failure is None:
                    file[group].attrs["t"] = t
                file.close()
        except (OSError, RuntimeError) as error:
            failure = error
        return failure

    def _markup(self) -> str:
        n, h5 = self._cloud.n_global, self._path.name
        lines = [
            '<?xml version="1.0"?>',
            '<Xdmf Version="3.0"><Domain>',
            '<Grid Name="steps" GridType="Collection" CollectionType="Temporal">',
        ]
        for step, t, widths in self._steps:
            lines += [
                f'<Grid Name="step {step}" GridType="Uniform"><Time Value="{t!r}"/>',
                f'<Topology TopologyType="Polyvertex" NumberOfElements="{n}"/>',
                '<Geometry GeometryType="XYZ">'
                f'<DataItem Dimensions="{n} 3" NumberType="Float" Precision="8" Format="HDF">'
                f"{h5}:/particles/position</DataItem></Geometry>",
                '<Attribute Name="volume" AttributeType="Scalar" Center="Node">'
                f'<DataItem Dimensions="{n}" NumberType="Float" Precision="8" Format="HDF">'
                f"{h5}:/particles/volume</DataItem></Attribute>",
            ]
            for name, width in widths.items():
                lines.append(
                    f'<Attribute Name="{name}" AttributeType="{_KINDS.get(width, "Matrix")}" Center="Node">'
                    f'<DataItem Dimensions="{n}{f" {width}" if width > 1 else ""}" NumberType="Float" Precision="8" '
                    f'Format="HDF">{h5}:/step_{step:05d}/{name}</DataItem></Attribute>'
                )
            lines.append("</Grid>")
        return "\n".join([*lines, "</Grid></Domain></Xdmf>", ""])


def _kept_steps(path: Path, first: int) -> list[tuple[int, float, dict[str, int]]]:
    """Delete the steps from ``first`` on in a file of fields; return number, time and components of the others."""
    if first == 0 or not path.exists():
        return []
    kept = []
    try:
        with h5py.File(path, "a") as file:
            for group in sorted(name for name in file if name.startswith("step_")):
                number = int(group.removeprefix("step_"))
                if number >= first:
                    del file[group]
                    continue
                widths = {name: int(np.prod(data.shape[1:])) for name, data in file[group].items()}
                kept.append((number, float(file[group].attrs["t"]), widths))
    except (OSError, KeyError, RuntimeError) as error:
        raise OutputError(f"Cannot go on in {path}: {error}; restart into another folder.") from error
    return kept


def _padded(values: NDArray[Any]) -> NDArray[Any]:
    """Return vectors as (n, 3) and tensors as (n, 9), zero where the body has no such dimension."""
    if values.ndim == 1:
        return values
    shape = (len(values), *(3,) * (values.ndim - 1))
    padded = np.zeros(shape, dtype=values.dtype)
    padded[tuple(slice(0, size) for size in values.shape)] = values
    return padded.reshape(len(values), -1)
