"""Contents of the files that a run depends on, by names relative to the folder of the case file."""

from __future__ import annotations

import hashlib
import os
from collections.abc import Iterable, Mapping
from pathlib import Path


def content(path: str | Path) -> str:
    """Return the fingerprint of a file; empty for a file that cannot be read."""
    digest = hashlib.sha256()
    try:
        with open(path, "rb") as file:
            while block := file.read(2**20):
                digest.update(block)
    except OSError:
        return ""
    return digest.hexdigest()[:24]


def contents(paths: Iterable[str | Path], folder: Path) -> dict[str, str]:
    """Return the fingerprints of files by their names relative to a folder."""
    return {os.path.relpath(path, folder): content(path) for path in paths}


def differing(fingerprints: Mapping[str, str], folder: Path) -> list[str]:
    """Return the names of files relative to a folder whose content is not that of their fingerprints."""
    return [name for name, fingerprint in fingerprints.items() if content(folder / name) != fingerprint]
