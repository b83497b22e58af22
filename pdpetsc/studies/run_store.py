"""The folders of a study and of its runs, and what is kept there of runs that have ended."""

from __future__ import annotations

import hashlib
import json
import re
from collections.abc import Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

from pdpetsc.errors import CaseError
from pdpetsc.output.files import write_whole
from pdpetsc.studies.input_files import Files, content, words
from pdpetsc.studies.refinement import NOISE

# Marks a folder that a study has made: nothing is written to another one that is not empty.
MARK = ".pdpetsc-study"
# What a run left and how it ended.
RECORD = "outcome.json"
# Output of the run.
LOG = "log.txt"
# Files of a run that its record is true of.
KEPT = ("summary.json", "history.csv")
# A name longer than this is cut, and made unique by a fingerprint.
LONGEST = 80


@dataclass(frozen=True)
class Outcome:
    """How one run ended.

    Attributes
    ----------
    parameters : mapping of str to str
        What the run was given.
    folder : Path
        Where it ran.
    status : {"finished", "failed"}
        Finished means that it ended with exit status 0 and that its summary says so too. A failed run has no results.
    exit_status : int
        Of the process, negative after a signal.
    said : str
        The sentence that a failed run ended with.
    results : mapping of str to float
        Its named results.
    seconds : float
        Of set-up and solve.
    memory : float
        The most that its ranks took, together [MiB].
    unstable : int
        Load steps whose equilibrium is unstable.
    noise : float
        Share of a result that its solver leaves open.
    changed : bool
        It failed as the case or its files changed while it ran, and is not kept.
    """

    parameters: Mapping[str, str]
    folder: Path
    status: str
    exit_status: int = 0
    said: str = ""
    results: Mapping[str, float] = field(default_factory=dict)
    seconds: float = 0.0
    memory: float = 0.0
    unstable: int = 0
    noise: float = NOISE
    changed: bool = False

    @property
    def finished(self) -> bool:
        """Return whether the run ended as it should."""
        return self.status == "finished"

    @property
    def name(self) -> str:
        """Return its parameters in one word."""
        return named(self.parameters) or self.folder.name


def named(parameters: Mapping[str, str]) -> str:
    """Return parameters in one word."""
    return ",".join(f"{name}={value}" for name, value in parameters.items())


def folder_of(study: Path, parameters: Mapping[str, str]) -> Path:
    """Return the folder of a run in that of its study: another one for every parameter set, whatever its order."""
    text = named(dict(sorted(parameters.items()))) or "run"
    plain = re.sub(r"[^A-Za-z0-9=,._-]", "_", text)
    if plain != text or len(plain) > LONGEST or plain.startswith("."):
        plain = f"{plain[:LONGEST]}-{hashlib.sha256(text.encode()).hexdigest()[:10]}"
    return study / plain


def take(folder: Path, writes: tuple[str, ...] = ()) -> None:
    """Make a folder that a study may write to, or find that it is one.

    Parameters
    ----------
    folder : Path
        Of the study, or of one of its runs.
    writes : tuple of str
        Where given the folder may hold other things, but nothing under these names.

    Raises
    ------
    CaseError
        It is no folder, cannot be written to, or holds files that no study has written.
    """
    try:
        if folder.is_symlink() or (folder.exists() and not folder.is_dir()):
            raise CaseError(f"{folder} is not a folder that a study has made; give another one with -o.")
        folder.mkdir(parents=True, exist_ok=True)
        if (folder / MARK).is_file():
            return
        foreign = [path.name for path in folder.iterdir() if not path.name.startswith(".pdpetsc-lock")]
        if writes:
            foreign = [name for name in foreign if name in writes]
        if foreign:
            raise CaseError(f"{folder} holds files that no study has written; give another folder with -o.")
        (folder / MARK).write_text("A folder of pdpetsc study.\n")
    except OSError as error:
        raise CaseError(f"Cannot write to the folder {folder}: {error.strerror or error}.") from None


def keep(outcome: Outcome, identity: Mapping[str, Any], read: Mapping[str, str]) -> None:
    """Write how a run ended and fingerprints of what it has read into its folder; raises OutputError."""
    found = {
        "identity": dict(identity), "parameters": dict(outcome.parameters), "status": outcome.status,
        "exit_status": outcome.exit_status, "said": outcome.said, "results": dict(outcome.results),
        "seconds": outcome.seconds, "memory": outcome.memory, "unstable": outcome.unstable, "noise": outcome.noise,
        "files": {name: content(outcome.folder / name) for name in KEPT}, "read": dict(read),
    }  # fmt: skip
    write_whole(outcome.folder / RECORD, json.dumps(found, indent=1) + "\n")


def kept(folder: Path, identity: Mapping[str, Any] | None, files: Files) -> tuple[Outcome | None, str, dict[str, str]]:
    """Return what an earlier run left that was of the same, otherwise in a few words what is not; what it has read."""
    try:
        found = json.loads((folder / RECORD).read_text())
        outcome = Outcome(
            dict(found["parameters"]), folder, str(found["status"]), int(found["exit_status"]), str(found["said"]),
            {str(name): float(value) for name, value in found["results"].items()}, float(found["seconds"]),
            float(found["memory"]), int(found["unstable"]), float(found["noise"]),
        )  # fmt: skip
        was, own, read = dict(found["identity"]), dict(found["files"]), dict(found["read"])
    except (OSError, ValueError, KeyError, TypeError, AttributeError):
        return None, "", {}
    if identity is None:
        return None, "what the case declares could not be found out", {}
    if differing := [name for name in identity if identity[name] != was.get(name)]:
        return None, f"{', '.join(_WORDS.get(name, name) for name in differing)} changed", {}
    if outcome.finished and any(content(folder / name) != own.get(name) for name in KEPT):
        return None, "its files changed", {}
    if changed := files.differing(read):
        return None, f"{words(changed)} changed, which it has read", {}
    return outcome, "", read


_WORDS = {
    "declared": "what the case declares", "text": "the case file or what it imports", "sources": "pdpetsc's sources",
    "pdpetsc": "pdpetsc's version", "petsc": "PETSc's version",
    "versions": "versions of Python's packages", "options_files": "files of options",
}  # fmt: skip
