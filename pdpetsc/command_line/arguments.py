"""Arguments of a command line: a path, parameters, options of pdpetsc and options of PETSc."""

from __future__ import annotations

import re
from collections.abc import Sequence
from dataclasses import dataclass, field
from pathlib import Path

from pdpetsc.bounds import whole_number
from pdpetsc.declared import refuse_unknown, shown
from pdpetsc.errors import CaseError

_ASSIGNMENT = re.compile(r"[A-Za-z_]\w*=")
_OPTION = re.compile(r"-{1,2}[A-Za-z]")
# Options that may be repeated: a script adds its own to those of its user, and the last one is used.
REPEATED = ("-o", "--restart", "--solver", "--ignore")


@dataclass(frozen=True)
class Syntax:
    """Arguments that a command accepts, besides ``-h``.

    Attributes
    ----------
    path : str
        Meaning of the single word without ``=`` and ``-``; empty for a command without it.
    valued, flags : tuple of str
        Options with a value after them, and without.
    parameters : tuple of str or None
        Names of ``NAME=VALUE``; None for the parameters of a case. Options of PETSc are then accepted too.
    """

    path: str
    valued: tuple[str, ...] = ()
    flags: tuple[str, ...] = ()
    parameters: tuple[str, ...] | None = ()


_LONG = {"-h": "--help", "-v": "--verbose"}

RUN = Syntax(
    "case file",
    ("-o", "--restart", "--solver"),
    ("--restart-anyway", "--check", "--report", "--quiet", "-v", "--verbose", "--version"),
    None,
)


@dataclass
class Arguments:
    """A command line, split; ``values`` has the words after each option, in their order."""

    path: Path | None = None
    parameters: dict[str, str] = field(default_factory=dict)
    values: dict[str, list[str]] = field(default_factory=dict)
    flags: set[str] = field(default_factory=set)
    petsc: list[str] = field(default_factory=list)

    def value(self, option: str) -> str | None:
        """Return the word after an option, the last one of a repeated option; None for an option that is absent."""
        return self.values[option][-1] if option in self.values else None

    def count(self, option: str, default: int = 1) -> int:
        """Return the positive whole number after an option; raises CaseError for another word."""
        text = self.value(option)
        number = default if text is None else whole_number(text)
        if not number:
            raise CaseError(f"{option} takes a positive number, not {shown(text)}.")
        return number

    @property
    def output(self) -> Path | None:
        """Return the folder or file after ``-o``."""
        text = self.value("-o")
        return None if text is None else Path(text)


def split(argv: Sequence[str], syntax: Syntax = RUN, name: str = "pdpetsc") -> Arguments:
    """Split a command line.

    The next word is the value of a PETSc option unless it is an option or ``name=value``.

    Parameters
    ----------
    name : str
        Name of the command, for messages.

    Raises
    ------
    CaseError
        A value is missing, an option or a parameter is given twice, or a word is unknown to the command.
    """
    found = Arguments()
    words = list(argv)
    while words:
        word = words.pop(0)
        if word in syntax.valued:
            if not words:
                raise CaseError(f"{word} requires a value after it.")
            if word in found.values and word not in REPEATED:
                raise CaseError(f"{word} is given twice.")
            found.values.setdefault(word, []).append(words.pop(0))
        elif word in ("-h", "--help", *syntax.flags):
            found.flags.add(_LONG.get(word, word))
        elif _OPTION.match(word):
            if word.startswith("--") or syntax.parameters is not None:
                refuse_unknown([word], [*syntax.valued, *syntax.flags, "-h"], f"{name} has no option")
            found.petsc.append(word)
            if words and not _OPTION.match(words[0]) and not _ASSIGNMENT.match(words[0]):
                found.petsc.append(words.pop(0))
        elif _ASSIGNMENT.match(word):
            parameter, value = word.split("=", 1)
            if syntax.parameters is not None:
                refuse_unknown([parameter], syntax.parameters, f"{name} has no parameter")
            if parameter in found.parameters:
                raise CaseError(f"Parameter {parameter} is given twice.")
            found.parameters[parameter] = value
        elif found.path is None and syntax.path:
            found.path = Path(word)
        else:
            path = f"; the {syntax.path} is {found.path}" if syntax.path else ""
            raise CaseError(f"{word!r} is neither NAME=VALUE nor an option{path}.")
    return found
