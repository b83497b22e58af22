"""The identity of a run, computed by a separate process that calls the case file."""

from __future__ import annotations

import functools
import hashlib
import json
import os
import subprocess
import sys
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

from pdpetsc.command_line.start import files_of_options
from pdpetsc.errors import CaseError
from pdpetsc.machine import digest_of
from pdpetsc.studies.jobs import PACKAGE, environment

# Subpackages without effect on the results of a run.
BESIDE = ("studies", "command_line")


@dataclass(frozen=True)
class PlannedRun:
    """A run of a parameter set, with its identity.

    Attributes
    ----------
    parameters : mapping of str to str
        The arguments of the run on its command line.
    identity : mapping
        Parameters, declared values, fingerprints of the input files, options, ranks and versions. Runs with equal
        identity have equal results. Empty for a refused run.
    refused : str
        Why the case refuses these parameters; empty if it accepts them.
    expected : mapping of str to float
        Values that the case expects of its results.
    """

    parameters: Mapping[str, str]
    identity: Mapping[str, Any] = field(default_factory=dict)
    refused: str = ""
    expected: Mapping[str, float] = field(default_factory=dict)

    @property
    def files(self) -> Mapping[str, str]:
        """Return the fingerprints of the input files by their names relative to the folder of the case file."""
        return dict(self.identity.get("files", {}))


@dataclass(frozen=True)
class CaseFile:
    """A case file, which another process loads again for each list of parameter sets.

    Parameters
    ----------
    path : Path
        The case file.
    options : sequence of str
        Options of the runs, a part of their identity.
    ranks : int
        Ranks of each run, a part of its identity.
    """

    path: Path
    options: Sequence[str]
    ranks: int

    @functools.cached_property
    def kinds(self) -> dict[str, str]:
        """Return the names of the parameters of the case and the types of their defaults."""
        kinds: dict[str, str] = self._answers([])[0]["kinds"]
        return kinds

    def plan(self, sets: Iterable[Mapping[str, str]]) -> list[PlannedRun]:
        """Return the runs of parameter sets, each once: 1 and 1.0 are equal.

        Raises
        ------
        CaseError
            The case file cannot be read, or a set has an unknown parameter or a value of another type.
        """
        of_options = contents(files_of_options(self.options), self.path.parent)
        common = {"options": list(self.options), "ranks": self.ranks} | {
            name: os.environ.get(name, "") for name in ("PETSC_OPTIONS", "PETSC_OPTIONS_YAML")
        }
        asked = [dict(parameters) for parameters in sets]
        answers: list[dict[str, Any]] = []
        while len(answers) < len(asked):
            answers += self._answers(asked[len(answers) :])[1:]
        planned: dict[str, PlannedRun] = {}
        for parameters, answer in zip(asked, answers, strict=True):
            if "wrong" in answer:
                raise CaseError(answer["wrong"])
            given: dict[str, str] = answer.get("given", parameters)
            identity = answer.get("identity", {})
            if identity:
                identity = {**identity, **common, "files": identity["files"] | of_options}
            run = PlannedRun(given, identity, answer.get("refused", ""), answer.get("expected", {}))
            planned.setdefault(json.dumps(sorted(given.items())), run)
        return list(planned.values())

    def _answers(self, sets: Sequence[Mapping[str, str]]) -> list[dict[str, Any]]:
        """Return the description of the case and an answer for each set up to one that ends the process."""
        words = [sys.executable, "-m", "pdpetsc.command_line.identify", str(self.path)]
        process = subprocess.run(
            words, input=json.dumps(sets), stdout=subprocess.PIPE, stderr=subprocess.DEVNULL, text=True,
            env=environment(), check=False,
        )  # fmt: skip
        answers: list[dict[str, Any]] = [json.loads(line) for line in process.stdout.splitlines()]
        ended = f"The case file {self.path} ended the process that read it, with exit status {process.returncode}."
        if not answers:
            raise CaseError(ended)
        if "refused" in answers[0]:
            raise CaseError(answers[0]["refused"])
        if len(answers) <= len(sets):
            answers.append({"refused": ended})
        return answers


def own_sources() -> str:
    """Return the fingerprint of the sources that affect results: a checkout may change without a new version."""
    digest = hashlib.sha256()
    for path in sorted(PACKAGE.rglob("*.py")):
        relative = path.relative_to(PACKAGE)
        if relative.parts[0] not in BESIDE:
            digest.update(f"{relative}\n".encode() + path.read_bytes())
    return digest.hexdigest()[:24]


def content(path: str | Path) -> str:
    """Return the fingerprint of a file; empty for a file that cannot be read."""
    return (digest_of(path) or "")[:24]


def contents(paths: Iterable[str | Path], folder: Path) -> dict[str, str]:
    """Return the fingerprints of files by their names relative to a folder."""
    return {os.path.relpath(path, folder): content(path) for path in paths}


def differing(fingerprints: Mapping[str, str], folder: Path) -> list[str]:
    """Return the names of files, relative to a folder, that differ from their fingerprints."""
    return [name for name, fingerprint in fingerprints.items() if content(folder / name) != fingerprint]
