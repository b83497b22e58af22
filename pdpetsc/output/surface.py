"""``fields/surface.h5``: the facets of the body, which tell what is inside of it where places of particles do not."""

from __future__ import annotations

from pathlib import Path

import numpy as np

from pdpetsc.arrays import Float
from pdpetsc.declare.particles import Particles
from pdpetsc.discrete.communicator import Comm, agreed, is_root, smallest
from pdpetsc.errors import CaseError
from pdpetsc.output.checkpoint import HEAD, seal, whole
from pdpetsc.output.files import HEADERS, WRITE_ERRORS, cannot_write, open_hdf5, replacing, writing_hdf5
from pdpetsc.output.folder import FIELDS, SURFACE
from pdpetsc.post.point_location import Facets


def write_surface(comm: Comm, folder: Path, run: str, particles: Particles) -> None:
    """Write the surface of a body, if its particles know it and are not those of a lattice (collective).

    Raises
    ------
    OutputError
        The file cannot be written, on all ranks.
    """
    if particles.fills_boxes:
        return
    mine: tuple[Float, ...] = ()
    try:
        x, area, _, _ = particles.surface(comm.rank, comm.size).arrays
        triangles = particles.triangles(comm.rank, comm.size)
        mine = (x, area, np.empty((0, 3, 3)) if triangles is None else triangles)
    except CaseError:
        pass
    if not smallest(comm, len(mine)):
        return
    parts = comm.gather(mine)
    with agreed(comm):
        if is_root(comm) and parts is not None:
            names = ("position", "area", "triangles")
            arrays = {name: np.concatenate([part[n] for part in parts]) for n, name in enumerate(names)}
            path = folder / FIELDS / SURFACE
            size = sum(array.nbytes for array in arrays.values()) + 4 * HEADERS
            try:
                with replacing(path) as aside:
                    with writing_hdf5(aside, size, userblock_size=HEAD) as file:
                        file.attrs["run"] = run
                        for name, array in arrays.items():
                            file.create_dataset(name, data=array)
                    seal(aside)
            except WRITE_ERRORS as error:
                raise cannot_write(path, error) from error


def read_surface(folder: Path, run: str | None) -> Facets | None:
    """Return the surface that a run wrote; None without any, raises CaseError where the file is damaged."""
    path = folder / FIELDS / SURFACE
    if not path.exists():
        return None
    try:
        # HDF5 does not survive every damage. Files of earlier versions have no seal.
        with path.open("rb") as file:
            sealed = file.read(4) != b"\x89HDF"
        if sealed and not whole(path):
            raise ValueError("it is damaged")
        with open_hdf5(path) as stored:
            if run is not None and stored.attrs["run"] != run:
                return None
            x, area, triangles = (np.asarray(stored[name], dtype=float) for name in ("position", "area", "triangles"))
        shaped = x.ndim == 2 and x.shape[1] in (1, 2, 3) and area.shape == x.shape and triangles.shape[1:] == (3, 3)
        if not (shaped and all(np.isfinite(array).all() for array in (x, area, triangles))):
            raise ValueError("it holds no facets")
    except Exception as error:  # whatever HDF5, h5py and numpy say of a damaged file
        why = " ".join(str(error).split()).rstrip(".") or type(error).__name__
        raise CaseError(f"Cannot read {path}: {why}; run the case again, or remove the file.") from None
    return Facets(x, area, triangles)
