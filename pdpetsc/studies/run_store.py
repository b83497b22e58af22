"""The folders of a study and of its runs, and what is kept there of runs that have ended."""

from __future__ import annotations

import hashlib
import json
import re
from collections.abc import Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any, Literal

from pdpetsc.declared import Declared, Finite
from pdpetsc.errors import CaseError
from pdpetsc.output.files import write_whole
from pdpetsc.studies.refinement import NOISE
from pdpetsc.studies.run_identity import contents, differing

# Marks a folder that a study has made: nothing is written to another one that is not empty.
MARK = ".pdpetsc-study"
# What a run left and how it ended.
RECORD = "outcome.json"
# Output of the run.
LOG = "log.txt"
# Files of a run that its record is true of.
KEPT = ("summary.json", "history.csv")
# What the record has of an outcome, beside the identity of the run and its files.
RECORDED = ("parameters", "status", "exit_status", "said", "results", "seconds", "memory", "unstable", "noise")
# A name longer than this is cut, and made unique by a fingerprint.
LONGEST = 80


@dataclass(frozen=True)
class Outcome(Declared):
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
    status: Literal["finished", "failed"]
    exit_status: int = 0
    said: str = ""
    results: Mapping[str, Finite] = field(default_factory=dict)
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


def keep(outcome: Outcome, identity: Mapping[str, Any]) -> None:
    """Write how a run ended into its folder; raises OutputError."""
    record = {name: getattr(outcome, name) for name in RECORDED}
    record |= {"identity": identity, "files": contents([outcome.folder / name for name in KEPT], outcome.folder)}
    write_whole(outcome.folder / RECORD, json.dumps(record, indent=1) + "\n")


def kept(folder: Path, identity: Mapping[str, Any]) -> tuple[Outcome | None, str]:
    """Return the outcome of an earlier run with the same identity, or None and what differs."""
    try:
        record = json.loads((folder / RECORD).read_text())
        outcome = Outcome(folder=folder, **{name: record[name] for name in RECORDED})
        before, own = dict(record["identity"]), dict(record["files"])
        inputs_before = dict(before["files"])
    except (OSError, ValueError, KeyError, TypeError, AttributeError):
        return None, ""
    inputs = identity["files"]
    if changed := [name for name in {**inputs, **inputs_before} if inputs.get(name) != inputs_before.get(name)]:
        return None, f"{', '.join(changed)} changed"
    if changed := [name for name in identity if identity[name] != before.get(name)]:
        return None, f"{', '.join(_WORDS.get(name, name) for name in changed)} changed"
    if outcome.finished and differing(own, folder):
        return None, "its files changed"
    return outcome, ""


_WORDS = {
    "declared": "what the case declares", "sources": "pdpetsc's sources", "pdpetsc": "pdpetsc's version",
    "petsc": "PETSc's version", "versions": "versions of Python's packages",
}  # fmt: skip
