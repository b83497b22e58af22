"""Files that are never half written, and rows gathered in creation order."""

from __future__ import annotations

import contextlib
import os
import shutil
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np
from mpi4py import MPI
from numpy.typing import NDArray

from pdpetsc.discrete.cloud import Cloud
from pdpetsc.discrete.communicator import Comm, agreed, exchange, is_root, total
from pdpetsc.errors import CaseError, OutputError

# Room that stays free on the disk, for the small files that end a run.
RESERVE = 2**20


@contextlib.contextmanager
def replacing(path: Path) -> Iterator[Path]:
    """Give a path beside ``path`` to write to, and put it in place of ``path`` when the body succeeded.

    Raises
    ------
    OutputError
        The file could not be written; ``path`` is as it was.
    """
    aside = path.with_name(path.name + ".part")
    try:
        yield aside
        os.replace(aside, path)
    except OSError as error:
        with contextlib.suppress(OSError):
            aside.unlink()
        raise OutputError(f"Cannot write {path}: {error.strerror or error}.") from error


def reserve(path: Path, size: int) -> None:
    """Make sure that a file can grow by ``size`` bytes, before anything in it is changed.

    An HDF5 file whose write stops half way is lost whole. The blocks are allocated here, so that a full disk, a quota
    or a file size limit shows while the file is still as it was.

    Raises
    ------
    OutputError
        There is no room; the file is unchanged.
    """
    free = shutil.disk_usage(path.parent).free
    if size + RESERVE > free:
        raise OutputError(
            f"The disk of {path.parent} has {free / 2**20:.1f} MiB left and {path.name} needs {size / 2**20:.1f} MiB "
            f"more; results are complete up to the step before."
        )
    if not path.exists():
        return
    with path.open("r+b") as file:
        before = os.fstat(file.fileno()).st_size
        try:
            os.posix_fallocate(file.fileno(), before, size)
        except OSError as error:
            os.ftruncate(file.fileno(), before)
            raise OutputError(
                f"{path} cannot grow by {size / 2**20:.1f} MiB ({error.strerror}); results are complete up to the step "
                f"before."
            ) from error


def on_several_nodes(comm: Comm) -> bool:
    """Return whether ranks are on more than one machine (collective)."""
    here = comm.Split_type(MPI.COMM_TYPE_SHARED)
    alone = here.size == comm.size
    here.Free()
    return int(total(comm, int(not alone))) > 0


def prepare_folder(comm: Comm, folder: Path) -> None:
    """Make the output folder and check that it can be written to (collective); raises CaseError on all ranks."""
    with agreed(comm):
        if is_root(comm):
            try:
                folder.mkdir(parents=True, exist_ok=True)
                probe = folder / ".pdpetsc-probe"
                probe.write_bytes(b"x")
                probe.unlink()
            except OSError as error:
                raise CaseError(f"Cannot write to the output folder {folder}: {error.strerror or error}.") from None


def rank_by_rank(comm: Comm, values: NDArray[Any], counts: list[int]) -> Iterator[tuple[slice, NDArray[Any]]]:
    """Yield on rank 0 the rows of all ranks, ``counts`` of each, one rank at a time; nothing elsewhere.

    Exhaust it on every rank. Rank 0 never holds more than two parts.
    """
    mine = np.ascontiguousarray(values)
    if not is_root(comm):
        comm.Send(mine, dest=0, tag=7)
        return
    first = 0
    for rank, count in enumerate(counts):
        part = mine
        if rank > 0:
            part = np.empty((count, *mine.shape[1:]), dtype=mine.dtype)
            comm.Recv(part, source=rank, tag=7)
        yield slice(first, first + count), part
        first += count


class InCreationOrder:
    """Rearranges rows of own particles so that rank ``r`` holds the ``r``-th part of the global ids, in order.

    Notes
    -----
    Every method is collective.
    """

    def __init__(self, cloud: Cloud) -> None:
        self._cloud = cloud
        gid = cloud.gid[: cloud.n_owned]
        size, n = cloud.comm.size, cloud.n_global
        self.starts = np.array([r * n // size for r in range(size + 1)])
        self._destination = np.searchsorted(self.starts, gid, side="right") - 1
        (arrived,), _ = exchange(cloud.comm, self._destination, [gid])
        self._order = np.argsort(arrived)

    def rows(self, values: NDArray[Any]) -> NDArray[Any]:
        """Return this rank's part of the rows in creation order."""
        (arrived,), _ = exchange(self._cloud.comm, self._destination, [np.ascontiguousarray(values)])
        return arrived[self._order]

    def parts_on_root(self, values: NDArray[Any]) -> Iterator[tuple[slice, NDArray[Any]]]:
        """Yield on rank 0 the parts of all ranks, one at a time; nothing elsewhere.

        Exhaust it on every rank. Rank 0 never holds more than two parts.
        """
        return rank_by_rank(self._cloud.comm, self.rows(values), np.diff(self.starts).tolist())

    def from_parts(self, part: NDArray[Any]) -> NDArray[Any]:
        """Return the rows of the own particles from this rank's part in creation order: the inverse of ``rows``."""
        cloud = self._cloud
        gid = cloud.gid[: cloud.n_owned]
        comm = cloud.comm
        (asked,), counts = exchange(comm, self._destination, [gid])
        asker = np.repeat(np.arange(comm.size), counts)
        (answer,), _ = exchange(comm, asker, [part[asked - self.starts[comm.rank]]])
        result = np.empty_like(answer)
        result[np.argsort(self._destination, kind="stable")] = answer
        return result
