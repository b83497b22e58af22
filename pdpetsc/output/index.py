"""``fields.h5`` and ``fields.xdmf``, which join the files of all steps, for scripts and ParaView."""

from __future__ import annotations

import shutil
import time
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from xml.sax.saxutils import escape, quoteattr

import h5py
import numpy as np
from numpy.typing import NDArray

from pdpetsc.arrays import GlobalIndex
from pdpetsc.declare.tiling import Cells
from pdpetsc.output.files import WAIT, cannot_write, flush_written, open_hdf5, replacing, write_whole, writing_hdf5
from pdpetsc.output.folder import CELLS, FIELDS

_KINDS = {1: "Scalar", 3: "Vector", 9: "Tensor"}
# XDMF types of solid cells, by number of corners.
_POLYHEDRA = {4: 6, 5: 7, 6: 8, 8: 9}
_POLYLINE, _POLYGON = 2, 3
_NUMBERS = {"f": "Float", "i": "Int", "u": "UInt"}
_HEAD = """<?xml version="1.0"?>
<Xdmf Version="3.0"><Domain>
<Grid Name="steps" GridType="Collection" CollectionType="Temporal">
"""
_FOOT = "</Grid></Domain></Xdmf>\n"


@dataclass(frozen=True)
class Part:
    """An array on disk: name, components per particle and number type."""

    name: str
    width: int
    dtype: str


@dataclass(frozen=True)
class Step:
    """A step whose fields are on disk."""

    number: int
    t: float
    parts: Sequence[Part]

    @property
    def group(self) -> str:
        """Return the name of its group in ``fields.h5``."""
        return f"step_{self.number:05d}"

    @property
    def file(self) -> str:
        """Return the path of its file, relative to the folder of the run."""
        return f"{FIELDS}/{self.group}.h5"


class Index:
    """Keep both files consistent with the stored steps (one rank only).

    ``fields.h5`` links to the file of each step, as in ``fields.h5["step_00005/displacement"]``.
    The time to add a step hardly depends on the number of steps. Both files can be rebuilt from the files of the steps,
    so they are flushed to disk at most once a second, and by ``flush``.

    Parameters
    ----------
    folder : Path
        Folder of the run.
    n : int
        Number of particles.
    steps : sequence of Step
        Steps that are stored already, in order.
    cells : Cells, optional
        The cells in ``fields/cells.h5``; without them ParaView shows points.

    Raises
    ------
    OutputError
        A file cannot be written; both files stay unchanged or consistent with the steps.
    """

    def __init__(self, folder: Path, n: int, steps: Sequence[Step], cells: Cells | None = None) -> None:
        self._links = folder / "fields.h5"
        self._xdmf = folder / "fields.xdmf"
        self._n = n
        self._last = steps[-1].number if steps else -1
        self._flushed = time.monotonic()
        self._waiting = False
        self._body, self._center = self._geometry(cells)
        self._grids = [self._grid(step) for step in steps]
        with replacing(self._links) as aside, writing_hdf5(aside, 0) as file:
            file["particles"] = h5py.ExternalLink(f"{FIELDS}/particles.h5", "/")
            if cells is not None:
                file["cells"] = h5py.ExternalLink(f"{FIELDS}/{CELLS}", "/")
            for step in steps:
                file[step.group] = h5py.ExternalLink(step.file, "/")
        write_whole(self._xdmf, "".join([_HEAD, *self._grids, _FOOT]))

    def add(self, step: Step) -> None:
        """Add a step whose file is stored; replace the last step if it has the same number."""
        wait = time.monotonic() - self._flushed > WAIT
        with replacing(self._links, wait) as aside:
            shutil.copyfile(self._links, aside, follow_symlinks=False)
            with writing_hdf5(aside) as file:
                if step.group not in file:
                    file[step.group] = h5py.ExternalLink(step.file, "/")
        if self._last == step.number:
            self._grids.pop()
        self._last = step.number
        self._grids.append(self._grid(step))
        write_whole(self._xdmf, "".join([_HEAD, *self._grids, _FOOT]), wait)
        self._waiting = not wait
        if wait:
            self._flushed = time.monotonic()

    def flush(self) -> None:
        """Flush both files to disk; raises OutputError."""
        if self._waiting:
            for path in (self._links, self._xdmf, self._links.parent):
                flush_written(path)
            self._flushed, self._waiting = time.monotonic(), False

    def _geometry(self, cells: Cells | None) -> tuple[str, str]:
        """Return topology and geometry in XDMF, of cells or else of points, and where the values are: cell or node."""
        places, center = self._item(Part("position", 3, "f8"), f"{FIELDS}/particles.h5", self._n), "Node"
        shape = f'<Topology TopologyType="Polyvertex" NumberOfElements="{self._n}"/>'
        # In XDMF several cells cannot share the value of a particle.
        if cells is not None and (cells.particle is None or len(cells.particle) == self._n):
            file = f"{FIELDS}/{CELLS}"
            numbers = self._item(Part("topology", 1, "i8"), file, len(topology(cells)))
            shape = f'<Topology TopologyType="Mixed" NumberOfElements="{len(cells.count)}">{numbers}</Topology>'
            if cells.particle is not None:
                places, center = self._item(Part("points", 3, "f8"), file, len(cells.points)), "Cell"
        return f'{shape}\n<Geometry GeometryType="XYZ">{places}</Geometry>', center

    def _grid(self, step: Step) -> str:
        """Return the grid of a step in XDMF."""
        values = [(Part("volume", 1, "f8"), f"{FIELDS}/particles.h5")]
        values += [(part, step.file) for part in sorted(step.parts, key=lambda part: part.name)]
        lines = [
            f'<Grid Name="step {step.number}" GridType="Uniform"><Time Value="{step.t!r}"/>',
            self._body,
            *(
                f'<Attribute Name={quoteattr(part.name)} AttributeType="{_KINDS.get(part.width, "Matrix")}" '
                f'Center="{self._center}">{self._item(part, file, self._n)}</Attribute>'
                for part, file in values
            ),
            "</Grid>\n",
        ]
        return "\n".join(lines)

    @staticmethod
    def _item(part: Part, file: str, n: int) -> str:
        shape = f"{n} {part.width}" if part.width > 1 else f"{n}"
        number, size = _NUMBERS[part.dtype[0]], int(part.dtype[1:])
        return (
            f'<DataItem Dimensions="{shape}" NumberType="{number}" Precision="{size}" Format="HDF">'
            f"{escape(f'{file}:/{part.name}')}</DataItem>"
        )


def topology(cells: Cells) -> GlobalIndex:
    """Return the topology of XDMF: type, number of corners (of lines and polygons) and corners of each cell."""
    dim, count = cells.points.shape[1], cells.count
    if dim == 3:
        kinds = np.zeros(max(_POLYHEDRA) + 1, dtype=np.int64)
        kinds[list(_POLYHEDRA)] = list(_POLYHEDRA.values())
        return np.insert(cells.corners, cells.offsets[:-1], kinds[count])
    head = np.stack([np.full_like(count, _POLYLINE if dim == 1 else _POLYGON), count], axis=1)
    return np.insert(cells.corners, np.repeat(cells.offsets[:-1], 2), head.ravel())


def entries(dim: int) -> list[tuple[int, str]]:
    """Return column and name of the entries of a tensor (n, 9) that may be nonzero in ``dim`` dimensions."""
    names = [(i, j) for i in range(3) for j in range(3) if i == j or (i < dim and j < dim)]
    return [(3 * i + j, "xyz"[i] + "xyz"[j]) for i, j in names]


def part_of(name: str, shape: tuple[int, ...], dtype: np.dtype) -> Part:  # type: ignore[type-arg]
    """Return the description of an array (n, ...) of this type on disk."""
    return Part(name, int(np.prod(shape[1:])), f"{dtype.kind}{dtype.itemsize}")


def storable(values: NDArray[np.generic]) -> NDArray[np.generic]:
    """Return vectors as (n, 3) and tensors as (n, 9), padded with zeros, in a number type of XDMF."""
    if values.dtype.kind == "b":
        values = values.astype(np.uint8)
    elif not (values.dtype.kind in "iu" or values.dtype in (np.float32, np.float64)):
        values = values.astype(np.float64)
    if values.ndim == 1:
        return values
    shape = (len(values), *(3,) * (values.ndim - 1))
    padded = np.zeros(shape, dtype=values.dtype)
    padded[tuple(slice(0, size) for size in values.shape)] = values
    return padded.reshape(len(values), -1)


def steps_in(folder: Path, run: str, n: int) -> list[Step]:
    """Return the stored steps of a run in order, without files that cannot be read."""
    found = []
    for path in (folder / FIELDS).glob("step_*.h5"):
        try:
            with open_hdf5(path) as file:
                if file.attrs["run"] != run or any(len(data) != n for data in file.values()):
                    continue
                parts = [part_of(name, data.shape, data.dtype) for name, data in file.items()]
                found.append(Step(int(path.stem.removeprefix("step_")), float(file.attrs["t"]), parts))
        except (OSError, RuntimeError, KeyError, ValueError, TypeError, AttributeError):
            continue
    return sorted(found, key=lambda step: step.number)


def remove(folder: Path, steps: Sequence[Step]) -> None:
    """Remove the files of steps that are no longer in the index; raises OutputError."""
    for step in steps:
        try:
            (folder / step.file).unlink()
        except OSError as error:
            raise cannot_write(folder / step.file, error) from error
    if steps:
        flush_written(folder / FIELDS)
