"""``fields/surface.h5`` and ``fields/cells.h5``: facets of the body and cells of its particles."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from pdpetsc.arrays import Float
from pdpetsc.declare.particles import Particles
from pdpetsc.declare.tiling import Cells
from pdpetsc.discrete.communicator import Comm, agreed, is_root, smallest
from pdpetsc.errors import CaseError
from pdpetsc.output.checkpoint import HEAD, seal, whole
from pdpetsc.output.files import HEADERS, WRITE_ERRORS, cannot_write, open_hdf5, replacing, writing_hdf5
from pdpetsc.output.folder import CELLS, FIELDS, SURFACE
from pdpetsc.output.index import storable, topology
from pdpetsc.post.point_location import Facets

# Largest number of particles whose cells are written, because one rank creates them.
MOST_CELLS = 1_000_000


def write_surface(comm: Comm, folder: Path, run: str, particles: Particles) -> None:
    """Write the surface of each body, if it is known and the particles do not fill equal boxes (collective).

    Raises
    ------
    OutputError
        The file cannot be written, on all ranks.
    """
    names, arrays = ("position", "area", "triangles"), dict[str, Float]()
    for number, body in enumerate(particles.bodies):
        if body.fills_boxes:
            continue
        mine: tuple[Float, ...] = ()
        try:
            x, area, _, _ = body.surface(comm.rank, comm.size).arrays
            triangles = body.triangles(comm.rank, comm.size)
            mine = (x, area, np.empty((0, 3, 3)) if triangles is None else triangles)
        except CaseError:
            pass
        if smallest(comm, len(mine)):
            parts = comm.gather(mine) or []
            arrays |= {_of(number, name): _joined(parts, n) for n, name in enumerate(names) if parts}
    with agreed(comm):
        if arrays and is_root(comm):
            _write(folder / FIELDS / SURFACE, run, arrays)


def _of(number: int, name: str) -> str:
    """Return the name of an array of a body in the file."""
    return f"{name}_{number}" if number else name


def _joined(parts: Sequence[tuple[Float, ...]], n: int) -> Float:
    """Return an array of all ranks."""
    return np.concatenate([part[n] for part in parts])


def write_cells(comm: Comm, folder: Path, run: str, particles: Particles, n: int) -> Cells | None:
    """Write the cells of ``n`` particles, and return them on rank 0; None for too large a body (collective).

    Raises
    ------
    OutputError
        The file cannot be written, on all ranks.
    """
    cells: Cells | None = None
    with agreed(comm):
        if is_root(comm) and n <= MOST_CELLS:
            cells = particles.cells()
            arrays = {"points": storable(cells.points), "corners": cells.corners, "offsets": cells.offsets}
            arrays |= {"dim": np.array(cells.points.shape[1]), "topology": topology(cells)}
            if cells.particle is not None:
                arrays["particle"] = cells.particle
            _write(folder / FIELDS / CELLS, run, arrays)
    return cells


def _write(path: Path, run: str, arrays: Mapping[str, NDArray[Any]]) -> None:
    size = sum(array.nbytes for array in arrays.values()) + (1 + len(arrays)) * HEADERS
    try:
        path.parent.mkdir(exist_ok=True)
        with replacing(path) as aside:
            with writing_hdf5(aside, size, userblock_size=HEAD) as file:
                file.attrs["run"] = run
                for name, array in arrays.items():
                    file.create_dataset(name, data=array)
            seal(aside)
    except WRITE_ERRORS as error:
        raise cannot_write(path, error) from error


def read_surface(folder: Path, run: str | None, body: int = 0) -> Facets | None:
    """Return the stored surface of a body of a run, None without one; raises CaseError if the file is damaged."""
    path = folder / FIELDS / SURFACE
    arrays = _read(path, run)
    stored = [] if arrays is None else [name for name in arrays if name.startswith("position")]
    if arrays is None or (stored and _of(body, "position") not in stored):
        return None
    x, area, triangles = (arrays.get(_of(body, name), np.empty(0)) for name in ("position", "area", "triangles"))
    shaped = x.ndim == 2 and x.shape[1] in (1, 2, 3) and area.shape == x.shape and triangles.shape[1:] == (3, 3)
    if not (shaped and all(np.isfinite(array).all() for array in (x, area, triangles))):
        raise _damaged(path, "it holds no facets")
    return Facets(x, area, triangles)


def read_cells(folder: Path, run: str | None) -> Cells | None:
    """Return the stored cells of a run, None without any; raises CaseError if the file is damaged."""
    path = folder / FIELDS / CELLS
    arrays = _read(path, run)
    if arrays is None:
        return None
    try:
        points, corners, offsets = (arrays[name] for name in ("points", "corners", "offsets"))
        cells = Cells(
            points.reshape(len(points), -1)[:, : int(arrays["dim"])], corners, offsets, arrays.get("particle")
        )
        cells.points[cells.corners[cells.offsets[:-1]]]
    except (KeyError, IndexError, TypeError):
        raise _damaged(path, "it holds no cells") from None
    return cells


def _read(path: Path, run: str | None) -> dict[str, NDArray[Any]] | None:
    """Return the arrays of a sealed file; None if it is missing or of another run."""
    if not path.exists():
        return None
    try:
        # HDF5 can crash on damaged files. Files of earlier versions have no checksum.
        with path.open("rb") as file:
            sealed = file.read(4) != b"\x89HDF"
        if sealed and not whole(path):
            raise ValueError("it is damaged")
        with open_hdf5(path) as stored:
            if run is not None and stored.attrs["run"] != run:
                return None
            return {name: np.asarray(array) for name, array in stored.items()}
    except Exception as error:  # any error of HDF5, h5py and numpy on a damaged file
        raise _damaged(path, " ".join(str(error).split()).rstrip(".") or type(error).__name__) from None


def _damaged(path: Path, why: str) -> CaseError:
    return CaseError(f"Cannot read {path}: {why}; run the case again, or remove the file.")
