"""The folders of a study and of its runs, and the records of finished runs."""

from __future__ import annotations

import hashlib
import json
import re
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any, Literal

from pdpetsc.declared import Declared, Finite
from pdpetsc.errors import CaseError
from pdpetsc.output.files import write_whole
from pdpetsc.output.folder import STUDY
from pdpetsc.studies.refinement import NOISE
from pdpetsc.studies.run_identity import contents, differing

# The record of the end of a run.
RECORD = "outcome.json"
# Output of the run.
LOG = "log.txt"
# Files of a run that its record describes.
KEPT = ("summary.json", "history.csv")
# Fields of an outcome in the record, besides the identity of the run and its files.
RECORDED = (
    "parameters", "status", "exit_status", "said", "results", "seconds", "memory", "unstable", "warnings", "noise",
)  # fmt: skip
# Largest length of a name; a longer name is cut, and made unique by a fingerprint.
LONGEST = 80


@dataclass(frozen=True)
class Outcome(Declared):
    """The outcome of one run.

    Attributes
    ----------
    parameters : mapping of str to str
        Parameters of the run.
    folder : Path
        Folder of the run.
    status : {"finished", "failed"}
        Finished: the exit status is 0, and the summary agrees. A failed run has no results.
    exit_status : int
        Exit status of the process, negative after a signal.
    said : str
        The message of a failed run.
    results : mapping of str to float
        Its named results.
    seconds : float
        Time of set-up and solve.
    memory : float
        Peak memory of all ranks together [MiB].
    unstable : int
        Number of load steps with an unstable equilibrium.
    warnings : sequence of str
        Warnings of a finished run.
    noise : float
        Relative error of a result by the tolerance of its solver.
    changed : bool
        True if it failed because the case or its files changed during the run; such an outcome is not stored.
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
    warnings: Sequence[str] = ()
    noise: float = NOISE
    changed: bool = False

    @property
    def finished(self) -> bool:
        """Return True if the run finished."""
        return self.status == "finished"

    @property
    def name(self) -> str:
        """Return its parameters as one word."""
        return named(self.parameters) or self.folder.name


def named(parameters: Mapping[str, str]) -> str:
    """Return parameters as one word."""
    return ",".join(f"{name}={value}" for name, value in parameters.items())


def folder_of(study: Path, parameters: Mapping[str, str]) -> Path:
    """Return the folder of a run in that of its study: unique for every parameter set, in any order."""
    text = named(dict(sorted(parameters.items()))) or "run"
    plain = re.sub(r"[^A-Za-z0-9=,._-]", "_", text)
    if plain != text or len(plain) > LONGEST or plain.startswith("."):
        plain = f"{plain[:LONGEST]}-{hashlib.sha256(text.encode()).hexdigest()[:10]}"
    return study / plain


def claim_folder(folder: Path, writes: tuple[str, ...] = ()) -> None:
    """Create a folder for a study, or check an existing one.

    Parameters
    ----------
    folder : Path
        Folder of the study, or of one of its runs.
    writes : tuple of str
        If given, the folder may have other files, but none with these names.

    Raises
    ------
    CaseError
        The path is no folder, cannot be written to, or has files not written by a study.
    """
    try:
        if folder.is_symlink() or (folder.exists() and not folder.is_dir()):
            raise CaseError(f"{folder} is not a folder that a study has made; give another one with -o.")
        folder.mkdir(parents=True, exist_ok=True)
        if (folder / STUDY).is_file():
            return
        foreign = [path.name for path in folder.iterdir() if not path.name.startswith(".pdpetsc-lock")]
        if writes:
            foreign = [name for name in foreign if name in writes]
        if foreign:
            raise CaseError(f"{folder} holds files that no study has written; give another folder with -o.")
        (folder / STUDY).write_text("A folder of pdpetsc study.\n")
    except OSError as error:
        raise CaseError(f"Cannot write to the folder {folder}: {error.strerror or error}.") from None


def write_outcome(outcome: Outcome, identity: Mapping[str, Any]) -> None:
    """Write the outcome of a run to its folder, or raise OutputError."""
    record = {name: getattr(outcome, name) for name in RECORDED}
    record |= {"identity": identity, "files": contents([outcome.folder / name for name in KEPT], outcome.folder)}
    write_whole(outcome.folder / RECORD, json.dumps(record, indent=1) + "\n")


def read_outcome(folder: Path, identity: Mapping[str, Any]) -> tuple[Outcome | None, str]:
    """Return the outcome of an earlier run with equal identity, or None and the difference."""
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
