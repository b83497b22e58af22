"""The words of the command line: case, parameters, options of pdpetsc and of PETSc."""

from __future__ import annotations

import re
from collections.abc import Sequence
from dataclasses import dataclass, field
from pathlib import Path

from pdpetsc.errors import CaseError

_ASSIGNMENT = re.compile(r"[A-Za-z_]\w*=")
_OPTION = re.compile(r"-{1,2}[A-Za-z]")


FLAGS = ("--restart-anyway", "--check", "--report", "--quiet", "--version", "--help", "-h")


@dataclass
class Arguments:
    """The command line, split; ``flags`` are the options of pdpetsc that take no value."""

    path: Path | None = None
    parameters: dict[str, str] = field(default_factory=dict)
    output: Path | None = None
    restart: Path | None = None
    solver: str | None = None
    flags: set[str] = field(default_factory=set)
    petsc: list[str] = field(default_factory=list)


def split(argv: Sequence[str]) -> Arguments:
    """Split the command line into case, parameters, pdpetsc's own options and PETSc's.

    A PETSc option takes the next word as its value unless that is an option or ``name=value``.

    Raises
    ------
    CaseError
        A value is missing or a word is not understood.
    """
    found = Arguments()
    words = list(argv)
    while words:
        word = words.pop(0)
        if word in ("-o", "--restart"):
            if not words:
                raise CaseError(f"{word} needs a path after it.")
            path = Path(words.pop(0))
            found.output, found.restart = (path, found.restart) if word == "-o" else (found.output, path)
        elif word == "--solver":
            if not words:
                raise CaseError("--solver needs a name after it.")
            found.solver = words.pop(0)
        elif word in FLAGS:
            found.flags.add("--help" if word == "-h" else word)
        elif word.startswith("--"):
            raise CaseError(
                f"Unknown option {word}; pdpetsc has -o, --restart, --restart-anyway, --solver, --check, --report, "
                f"--quiet, --version, -h."
            )
        elif _OPTION.match(word):
            found.petsc.append(word)
            if words and not _OPTION.match(words[0]) and not _ASSIGNMENT.match(words[0]):
                found.petsc.append(words.pop(0))
        elif _ASSIGNMENT.match(word):
            name, value = word.split("=", 1)
            if name in found.parameters:
                raise CaseError(f"Parameter {name} is given twice.")
            found.parameters[name] = value
        elif found.path is None:
            found.path = Path(word)
        else:
            raise CaseError(f"{word!r} is neither NAME=VALUE nor an option; the case file is {found.path}.")
    return found
