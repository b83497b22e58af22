"""Versions of packages, cores and threads of this machine, and stamps and digests of files."""

from __future__ import annotations

import hashlib
import os
import platform
import stat
from collections.abc import Sequence
from importlib.metadata import PackageNotFoundError, version
from pathlib import Path

from pdpetsc.bounds import whole_number

# Packages that may affect results, besides pdpetsc and PETSc.
OF_NUMBERS = ("numpy", "scipy", "numba")


def versions(packages: Sequence[str] = OF_NUMBERS) -> dict[str, str]:
    """Return the versions of Python and of packages, without those that are not installed."""
    found = {"python": platform.python_version()}
    for package in packages:
        try:
            found[package] = version(package)
        except PackageNotFoundError:
            continue
    return found


def cores() -> int:
    """Return the number of cores that this process may use."""
    return len(os.sched_getaffinity(0)) if hasattr(os, "sched_getaffinity") else os.cpu_count() or 1


def threads() -> int:
    """Return the number of threads per rank."""
    return whole_number(os.environ.get("OMP_NUM_THREADS", "1")) or 1


def stamp_of(path: str | Path) -> tuple[int, ...] | None:
    """Return modification time, size and inode of a file, to detect that it was changed or replaced.

    The result is empty if the file is missing or cannot be accessed, and None for a pipe, a folder or a device. A file
    that replaced another one by renaming has a new inode, even if its time and size are equal.
    """
    try:
        found = os.stat(path)
    except (OSError, ValueError):
        return ()
    return (found.st_mtime_ns, found.st_size, found.st_ino) if stat.S_ISREG(found.st_mode) else None


def digest_of(path: str | Path) -> str | None:
    """Return a digest of the content of a file; None if it cannot be read or is no regular file."""
    digest = hashlib.sha256()
    try:
        if not stat.S_ISREG(Path(path).stat().st_mode):  # a pipe would wait for a writer
            return None
        with Path(path).open("rb") as file:
            while block := file.read(2**20):
                digest.update(block)
    except OSError:
        return None
    return digest.hexdigest()
