"""What is on this machine: versions of packages, and what tells a file from one that was there before."""

from __future__ import annotations

import hashlib
import os
import platform
import stat
from collections.abc import Sequence
from importlib.metadata import PackageNotFoundError, version
from pathlib import Path

from pdpetsc.bounds import whole_number

# What the numbers of a run may depend on, besides pdpetsc and PETSc.
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
    """Return how many cores this process may use."""
    return len(os.sched_getaffinity(0)) if hasattr(os, "sched_getaffinity") else os.cpu_count() or 1


def threads() -> int:
    """Return how many threads a rank has."""
    return whole_number(os.environ.get("OMP_NUM_THREADS", "1")) or 1


def stamp_of(path: str | Path) -> tuple[int, ...] | None:
    """Return what tells a file from one that was there before: when it changed, its size and its number on the disk.

    Nothing in it where no file is there or it cannot be looked at, None for what is no file, as a pipe or a folder. A
    file that is written aside and renamed has a new number, also where its time and size are those of before.
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
