"""Atomic replacement of files, and rows gathered in creation order."""

from __future__ import annotations

import contextlib
import errno
import os
import re
import shutil
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import h5py
import numpy as np
from mpi4py import MPI
from numpy.typing import NDArray

from pdpetsc.discrete.cloud import Cloud
from pdpetsc.discrete.communicator import Comm, anywhere, exchange, fetch, is_root
from pdpetsc.errors import OutputError

# Disk space that stays free for the small files at the end of a run [bytes].
RESERVE = 2**20
# Space for the headers of an HDF5 file or dataset; HDF5 writes fewer bytes of them at once [bytes].
HEADERS = 2**14
# Longest time between flushes of files that need not be flushed at once [s].
WAIT = 1.0
# Errors of h5py if a file cannot be written.
WRITE_ERRORS = (OSError, RuntimeError, ValueError)
# Error codes of file systems that cannot flush a folder.
_NO_FLUSH = (errno.EINVAL, errno.ENOTSUP, errno.EBADF, errno.EACCES)


@contextlib.contextmanager
def replacing(path: Path, wait: bool = True) -> Iterator[Path]:
    """Yield a temporary path beside ``path``, and rename it to ``path`` if the body succeeds.

    The temporary file does not exist when the body begins. It is flushed to disk before it replaces ``path``. At any
    moment, also after a loss of power, ``path`` is therefore either the old or the new file.

    Parameters
    ----------
    wait : bool
        Wait for the disk. Without it a loss of power can destroy the file; use this for files that can be rebuilt.

    Raises
    ------
    OutputError
        The file could not be written; ``path`` stays unchanged.
    """
    aside = path.with_name(path.name + ".part")
    try:
        with contextlib.suppress(FileNotFoundError):
            aside.unlink()
        yield aside
        if wait:
            flush(aside)
        os.replace(aside, path)
        if wait:
            flush(path.parent)
    except BaseException as error:
        with contextlib.suppress(OSError):
            aside.unlink()
        if isinstance(error, WRITE_ERRORS):
            raise cannot_write(path, error) from error
        raise


def cannot_write(path: Path, error: Exception) -> OutputError:
    """Return the error for a file that could not be written."""
    if isinstance(error, OutputError):
        # Return a new object: an error that is its own cause would make the chain of causes endless.
        return OutputError(str(error))
    # The message of HDF5 has several lines and contains the message of the system.
    text = " ".join(str(error).split())
    found = re.search(r"error message = '([^']+)'", text)
    words = found.group(1) if found else getattr(error, "strerror", None) or text.rstrip(".")
    return OutputError(f"Cannot write {path.with_name(path.name.removesuffix('.part'))}: {words}.")


def write_whole(path: Path, text: str, wait: bool = True) -> None:
    """Replace the content of a file by a text; raises OutputError and leaves the file unchanged on failure."""
    with replacing(path, wait) as aside:
        descriptor = os.open(aside, os.O_WRONLY | os.O_CREAT | os.O_EXCL | os.O_NOFOLLOW | os.O_CLOEXEC, 0o666)
        try:
            _write_all(descriptor, text.encode())
        finally:
            os.close(descriptor)


def append(path: Path, text: str) -> None:
    """Append text to a file; raises OutputError on failure, after restoring the file if possible."""
    try:
        descriptor = os.open(path, os.O_WRONLY | os.O_APPEND | os.O_NOFOLLOW | os.O_CLOEXEC)
        try:
            before = os.fstat(descriptor).st_size
            try:
                _write_all(descriptor, text.encode())
            except OSError:
                with contextlib.suppress(OSError):
                    os.ftruncate(descriptor, before)
                raise
        finally:
            os.close(descriptor)
    except OSError as error:
        raise cannot_write(path, error) from error


def _write_all(descriptor: int, data: bytes) -> None:
    while data:
        data = data[os.write(descriptor, data) :]


def flush(path: Path) -> None:
    """Flush a file, or the entries of a folder, to disk; raises OSError."""
    descriptor = os.open(path, os.O_RDONLY | os.O_CLOEXEC)
    try:
        os.fsync(descriptor)
    except OSError as error:
        if not (path.is_dir() and error.errno in _NO_FLUSH):
            raise
    finally:
        os.close(descriptor)


def flush_written(path: Path) -> None:
    """Flush a file, or the entries of a folder, to disk; raises OutputError."""
    try:
        flush(path)
    except OSError as error:
        raise cannot_write(path, error) from error


def open_hdf5(path: Path) -> h5py.File:
    """Open an HDF5 file for reading, without the locks of HDF5.

    Files are replaced as a whole, so no process reads a file that is being written. Locks would block other processes,
    and they fail on file systems without locks.
    """
    try:
        return h5py.File(path, "r", locking=False)
    except ValueError as error:
        if "locking" not in str(error):
            raise
        return h5py.File(path, "r")  # an HDF5 that is built without locks


def reserve(path: Path, size: int) -> None:
    """Allocate ``size`` more bytes for a file before it is written.

    A full disk, a quota or a file size limit is thus reported in one place, with numbers.

    Raises
    ------
    OutputError
        The space is not available.
    """
    name = path.name.removesuffix(".part")
    free = shutil.disk_usage(path.parent).free
    if size + RESERVE > free:
        raise OutputError(
            f"The disk of {path.parent} has {free / 2**20:.1f} MiB left, of which {RESERVE / 2**20:g} stays free for "
            f"the end of a run, and {name} needs {size / 2**20:.1f} MiB more; results are complete up to the step "
            f"before."
        )
    with path.open("r+b") as file:
        before = os.fstat(file.fileno()).st_size
        try:
            os.posix_fallocate(file.fileno(), before, size)
        except OSError as error:
            if error.errno in (errno.EINVAL, errno.ENOTSUP, errno.ENOSYS):
                return  # a file system that cannot reserve
            raise OutputError(
                f"{path.with_name(name)} cannot grow by {size / 2**20:.1f} MiB ({error.strerror}); results are "
                f"complete up to the step before."
            ) from error


class _Storage:
    """File object for HDF5 that hides write errors from it.

    HDF5 crashes at the end of the process if it could not write a file. The first error is stored in ``error``. Later
    writes that HDF5 may read again, up to ``HEADERS`` bytes each, stay in memory.
    """

    def __init__(self, path: Path, new: bool) -> None:
        flags = os.O_RDWR | os.O_NOFOLLOW | os.O_CLOEXEC | (os.O_CREAT | os.O_EXCL if new else 0)
        self._descriptor = os.open(path, flags, 0o666)
        self._place = 0
        # End of the data of HDF5; ``close`` removes the reserved space beyond it.
        self._end = os.fstat(self._descriptor).st_size
        self._since: list[tuple[int, bytes]] = []
        self.error: OSError | None = None

    def seek(self, place: int, whence: int = os.SEEK_SET) -> int:
        self._place = place if whence == os.SEEK_SET else self._end + place
        return self._place

    def tell(self) -> int:
        return self._place

    def read(self, size: int) -> bytes:
        data = bytearray(size)
        self.readinto(data)
        return bytes(data)

    def readinto(self, buffer: Any) -> int:
        view = memoryview(buffer).cast("B")
        found = os.pread(self._descriptor, len(view), self._place)
        view[: len(found)] = found
        view[len(found) :] = bytes(len(view) - len(found))
        for place, data in self._since:
            begin, end = max(place, self._place), min(place + len(data), self._place + len(view))
            if begin < end:
                view[begin - self._place : end - self._place] = data[begin - place : end - place]
        return len(view)

    def write(self, data: Any) -> int:
        view = memoryview(data).cast("B")
        size = len(view)
        self._end = max(self._end, self._place + size)
        try:
            while self.error is None and len(view):
                done = os.pwrite(self._descriptor, view, self._place)
                view, self._place = view[done:], self._place + done
        except OSError as error:
            self.error = error
        if self.error is not None and len(view) <= HEADERS:
            self._since.append((self._place, bytes(view)))
        return size

    def truncate(self, size: int) -> int:
        self._end = size
        return size

    def flush(self) -> None:
        """Do nothing, because writes are not buffered."""

    def close(self) -> None:
        try:
            if self.error is None:
                os.ftruncate(self._descriptor, self._end)
        except OSError as error:
            self.error = error
        finally:
            os.close(self._descriptor)


@contextlib.contextmanager
def writing_hdf5(path: Path, size: int | None = None, **options: Any) -> Iterator[h5py.File]:
    """Open an HDF5 file for writing: a new file with space for ``size`` bytes, or an existing file without ``size``.

    Raises
    ------
    OSError
        The file could not be written completely.
    OutputError
        There is no space; nothing is written.
    """
    storage = _Storage(path, new=size is not None)
    try:
        if size is not None:
            reserve(path, size)
        with h5py.File(storage, "r+" if size is None else "w", **options) as file:
            if size is not None:
                file.attrs["pdpetsc"] = path.name.removesuffix(".part")
            yield file
    finally:
        storage.close()
    if storage.error is not None:
        raise storage.error


def on_several_nodes(comm: Comm) -> bool:
    """Return True if ranks are on more than one machine (collective)."""
    here = comm.Split_type(MPI.COMM_TYPE_SHARED)
    alone = here.size == comm.size
    here.Free()
    return anywhere(comm, not alone)


def rank_by_rank(comm: Comm, values: NDArray[Any], counts: list[int]) -> Iterator[tuple[slice, NDArray[Any]]]:
    """Yield on rank 0 the rows of all ranks, ``counts`` of each, one rank at a time; nothing on other ranks.

    Every rank must exhaust the iterator. Rank 0 never holds more than two parts.
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
    """Rearrange rows of own particles: rank ``r`` gets the rows of the ``r``-th part of the global ids, in order.

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
        """Yield on rank 0 the parts of all ranks, one at a time; nothing on other ranks.

        Every rank must exhaust the iterator. Rank 0 never holds more than two parts.
        """
        return rank_by_rank(self._cloud.comm, self.rows(values), np.diff(self.starts).tolist())

    def from_parts(self, part: NDArray[Any]) -> NDArray[Any]:
        """Return the rows of the own particles from this rank's part in creation order: the inverse of ``rows``."""
        gid = self._cloud.gid[: self._cloud.n_owned]
        return fetch(self._cloud.comm, self._destination, gid - self.starts[self._destination], part)
