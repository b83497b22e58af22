"""What is on this machine: versions of packages, and what tells a file from one that was there before."""

from __future__ import annotations

import os
import platform
import stat
from collections.abc import Sequence
from importlib.metadata import PackageNotFoundError, version
from pathlib import Path

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
