"""Which files a run reads while it runs, so that one whose files have changed is none that has finished."""

from __future__ import annotations

import contextlib
import hashlib
import importlib.util
import json
import os
import sys
import time
import uuid
from collections.abc import Mapping
from pathlib import Path
from typing import Any

from pdpetsc import machine
from pdpetsc.output.fingerprint import of_library

# The word on the command line of a run that lets it leave what it has read; only studies give it.
WORD = "--leave-files-read"
# What each rank leaves, until the study has read it.
_LEFT = ".pdpetsc-read-"
# In the place of a fingerprint: the file has changed since it was read.
CHANGED = "changed"
# A file that was changed less than this ago may change again without a newer time [s].
_FRESH = 2.0
# Files of the system that are none, and what caches of others leave.
_SYSTEM = ("/proc/", "/sys/", "/dev/", "/run/")
_CACHES = (".nbi", ".nbc")

# As JSON gives it back, which has no tuples.
Stamp = list[int]


def stamp_of(path: str) -> Stamp | None:
    """Return what tells a file from one that was there before; nothing where there is none, None for no file."""
    found = machine.stamp_of(path)
    return None if found is None else list(found)


class Watch:
    """Hears from now on which files Python opens for reading in this process.

    Files of libraries and below ``apart`` do not count, nor do those that this process has written before. Python
    hears of no file that a library opens by itself, as HDF5 does.

    Parameters
    ----------
    apart : Path, optional
        A folder whose files do not count.
    """

    def __init__(self, apart: Path | None = None) -> None:
        self._here = os.getcwd()
        cache = os.environ.get("XDG_CACHE_HOME") or os.path.expanduser("~/.cache")
        folders = [cache, *([str(apart)] if apart is not None else [])]
        self._apart = (*_SYSTEM, *(f"{os.path.abspath(folder)}{os.sep}" for folder in folders))
        self._read: dict[str, Stamp] = {}
        self._names: dict[str, str] = {}
        self._written: set[str] = set()
        sys.addaudithook(self._heard)

    def _heard(self, event: str, arguments: Any) -> None:
        if event == "open":
            with contextlib.suppress(Exception):
                self._take(*arguments)

    def _take(self, path: Any, mode: Any, flags: Any) -> None:
        if isinstance(path, int) or path is None:
            return
        name = os.fsdecode(path)
        whole = os.path.abspath(name)
        if whole in self._read or whole in self._written:
            return
        writes = set(mode) & set("wax+") if isinstance(mode, str) else flags & (os.O_WRONLY | os.O_RDWR | os.O_CREAT)
        if writes:
            self._written.add(whole)
            return
        if f"{os.sep}__pycache__{os.sep}" in whole:
            if not whole.endswith(".pyc"):
                return
            name = whole = importlib.util.source_from_cache(whole)
        self._add(whole, name)

    def _add(self, whole: str, name: str) -> None:
        if whole in self._read or whole.startswith(self._apart) or whole.endswith(_CACHES):
            return
        if whole in sys.path or of_library(whole) or of_library(os.path.realpath(whole)):
            return
        if (stamp := stamp_of(whole)) is None:
            return
        self._read[whole] = stamp
        # A study in another folder reads another file by a name that is not absolute.
        self._names[whole] = os.path.normpath(name) if os.getcwd() == self._here else whole

    def read(self) -> dict[str, Stamp]:
        """Return the files, by the names that they were opened by, as they were when they were opened first."""
        for module in list(sys.modules.values()):
            file = getattr(module, "__file__", None)
            if isinstance(file, str):
                # Those that are no text have been opened by the system.
                self._add(os.path.abspath(file), file)
        return {self._names[whole]: stamp for whole, stamp in list(self._read.items())}

    def contents(self) -> dict[str, str]:
        """Return the fingerprints of the files; ``CHANGED`` of one that is no longer what was read."""
        return {name: content(name) if stamp_of(name) == stamp else CHANGED for name, stamp in self.read().items()}

    def leave(self, folder: Path) -> None:
        """Write what this process has read into the folder of its run."""
        found = json.dumps(self.read())
        with contextlib.suppress(OSError):
            (folder / f"{_LEFT}{uuid.uuid4().hex}").write_text(found)


def left(folder: Path) -> list[dict[str, Stamp]]:
    """Return what each rank of a run has left, and remove it."""
    found = []
    for path in sorted(folder.glob(f"{_LEFT}*")):
        with contextlib.suppress(OSError, ValueError):
            found.append(dict(json.loads(path.read_text())))
        with contextlib.suppress(OSError):
            path.unlink()
    return found


def content(path: str | Path) -> str:
    """Return the fingerprint of a file; empty where there is none."""
    digest = hashlib.sha256()
    try:
        with open(path, "rb") as file:
            while block := file.read(2**20):
                digest.update(block)
    except OSError:
        return ""
    return digest.hexdigest()[:24]


class Files:
    """Fingerprints of files by names that hold where the folder of the case is moved.

    Parameters
    ----------
    folder : Path
        Of the case.
    """

    def __init__(self, folder: Path) -> None:
        self._folders = [os.path.abspath(folder), os.path.realpath(folder)]
        self._known: dict[str, tuple[Stamp, str]] = {}

    def name(self, path: str) -> str:
        """Return the name of a file, for all studies of this case."""
        if not os.path.isabs(path):
            return f"here:{path}"
        for folder in self._folders:
            if path.startswith(f"{folder}{os.sep}"):
                return f"case:{path[len(folder) + 1 :]}"
        return f"file:{path}"

    def path(self, name: str) -> str:
        """Return the file with a name."""
        kind, _, rest = name.partition(":")
        return os.path.join(self._folders[0], rest) if kind == "case" else rest

    def content(self, name: str) -> str:
        """Return the fingerprint of a file as it is now; a file that has not been touched is not read again."""
        path = self.path(name)
        stamp = stamp_of(path)
        if stamp and path in self._known and self._known[path][0] == stamp:
            return self._known[path][1]
        found = content(path)
        if stamp and time.time() - stamp[0] * 1e-9 > _FRESH:
            self._known[path] = stamp, found
        return found

    def differing(self, fingerprints: Mapping[str, str]) -> list[str]:
        """Return the names of files that are not what they were."""
        return [name for name, was in fingerprints.items() if self.content(name) != was]


def words(names: list[str]) -> str:
    """Return names of files as one reads them."""
    return ", ".join(name.partition(":")[2] for name in names)
