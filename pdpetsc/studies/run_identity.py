"""What a run would be of, asked of the case file in a process of its own, so that two runs can be told apart."""

from __future__ import annotations

import contextlib
import functools
import hashlib
import json
import os
import signal
import subprocess
import sys
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

from pdpetsc.errors import CaseError
from pdpetsc.studies.input_files import Files, content

PACKAGE = Path(__file__).parent.parent
# Rooms of the package that no number of a run depends on.
BESIDE = ("studies", "command_line")
# Options of PETSc that name a file of options.
OPTIONS_FILES = ("options_file", "options_file_yaml")


@dataclass(frozen=True)
class Question:
    """One run that is asked for.

    Attributes
    ----------
    parameters : mapping of str to str
        As the command line of the run takes them.
    identity : mapping or None
        What the run is of; None where that could not be found out: such a run is never taken for finished.
    refused : str
        Why the case refuses these parameters; empty where it takes them.
    expected : mapping of str to float
        What the case expects of its results.
    files : mapping of str to str
        Fingerprints of the files that were read to find this out.
    """

    parameters: Mapping[str, str]
    identity: Mapping[str, Any] | None = None
    refused: str = ""
    expected: Mapping[str, float] = field(default_factory=dict)
    files: Mapping[str, str] = field(default_factory=dict)


class CaseFile:
    """A case file, read in another process, which stays until ``close``.

    It reads the file and what that imports anew, and calls its function in a fork for each question: what one call
    imports, changes or breaks is nothing to the next one or to this process.

    Parameters
    ----------
    path : Path
        The case file.
    options : sequence of str
        Options of the runs, which are part of what they are.
    ranks : int
        Of each run; likewise.

    Attributes
    ----------
    kinds : dict of str to str
        The parameters of the case, and of which type their defaults are.

    Raises
    ------
    CaseError
        The case file cannot be read.
    """

    def __init__(self, path: Path, options: Sequence[str], ranks: int) -> None:
        words = [sys.executable, "-m", "pdpetsc.command_line.identify", str(path)]
        self._files = Files(path.parent)
        self._of_options = {self._files.name(file): content(file) for file in files_of_options(options)}
        self._common = {
            "options": list(options), "ranks": ranks, "PETSC_OPTIONS": os.environ.get("PETSC_OPTIONS", ""),
            "PETSC_OPTIONS_YAML": os.environ.get("PETSC_OPTIONS_YAML", ""), "options_files": self._of_options,
            "pdpetsc": own_version(), "sources": own_sources(),
        }  # fmt: skip
        self._process = subprocess.Popen(
            words, stdin=subprocess.PIPE, stdout=subprocess.PIPE, stderr=subprocess.DEVNULL, text=True,
            env=environment(), start_new_session=True,
        )  # fmt: skip
        self._path = path
        try:
            first = self._answer()
            if "refused" in first:
                raise CaseError(first["refused"])
        except BaseException:
            self.close()
            raise
        self.kinds: dict[str, str] = first["kinds"]
        self._common.update(petsc=first["petsc"], versions=first["versions"])

    def ask(self, sets: Iterable[Mapping[str, str]]) -> list[Question]:
        """Return what the runs of some parameter sets are, each once: 1 and 1.0 are one number.

        Raises
        ------
        CaseError
            A set names no parameter of the case, or gives it no value of its type.
        """
        found: dict[str, Question] = {}
        for parameters in sets:
            answer = self._told(parameters)
            if "wrong" in answer:
                raise CaseError(answer["wrong"])
            asked: dict[str, str] = answer["given"]
            identity = {**answer["identity"], **self._common} if "identity" in answer else None
            files = {self._files.name(file): was for file, was in answer.get("files", {}).items()} | self._of_options
            one = Question(asked, identity, answer.get("refused", ""), answer.get("expected", {}), files)
            found.setdefault(json.dumps(sorted(asked.items())), one)
        return list(found.values())

    def _told(self, parameters: Mapping[str, str]) -> dict[str, Any]:
        assert self._process.stdin is not None
        with contextlib.suppress(BrokenPipeError):
            self._process.stdin.write(json.dumps(dict(parameters)) + "\n")
            self._process.stdin.flush()
        return self._answer()

    def _answer(self) -> dict[str, Any]:
        assert self._process.stdout is not None
        line = self._process.stdout.readline()
        if not line:
            status = self._process.wait()
            raise CaseError(f"The case file {self._path} ended the process that read it, with exit status {status}.")
        answer: dict[str, Any] = json.loads(line)
        return answer

    def close(self) -> None:
        """End the other process."""
        for stream in (self._process.stdin, self._process.stdout):
            if stream is not None:
                with contextlib.suppress(OSError):
                    stream.close()
        with contextlib.suppress(subprocess.TimeoutExpired):
            self._process.wait(timeout=1.0)
        # Its forks too: a call of the case may take for ever.
        with contextlib.suppress(OSError):
            os.killpg(self._process.pid, signal.SIGKILL)
        self._process.wait()


def environment() -> dict[str, str]:
    """Return the environment of a run: this process's own as it found it, with this pdpetsc and one thread a rank."""
    found = dict(os.environ)
    found.setdefault("OMP_NUM_THREADS", "1")
    if not {"site-packages", "dist-packages"} & set(PACKAGE.parts):
        paths = [str(PACKAGE.parent), *filter(None, [found.get("PYTHONPATH")])]
        found["PYTHONPATH"] = os.pathsep.join(dict.fromkeys(paths))
    return found


def files_of_options(options: Sequence[str]) -> list[str]:
    """Return the files that PETSc takes options from, those that such files name too."""
    found: list[str] = []
    waiting = [*options, *os.environ.get("PETSC_OPTIONS", "").split()]
    while waiting:
        word = waiting.pop(0)
        if word.lower().lstrip("-") not in OPTIONS_FILES or not waiting:
            continue
        # One that is there or not, a file may be followed by a word on what PETSc does with it: "q.txt:yaml".
        for file in {waiting[0], waiting[0].rpartition(":")[0]} - {"", *found}:
            found.append(file)
            with contextlib.suppress(OSError):
                lines = Path(file).read_text(errors="replace").splitlines()
                waiting += [word for line in lines for word in line.partition("#")[0].split()]
    return found


def own_version() -> str:
    """Return the version of this pdpetsc."""
    from pdpetsc import __version__

    return str(__version__)


@functools.cache
def own_sources() -> str:
    """Return the fingerprint of the sources that results depend on: a checkout changes and keeps its version."""
    digest = hashlib.sha256()
    for path in sorted(PACKAGE.rglob("*.py")):
        relative = path.relative_to(PACKAGE)
        if relative.parts[0] not in BESIDE:
            digest.update(f"{relative}\n".encode() + path.read_bytes())
    return digest.hexdigest()[:24]
