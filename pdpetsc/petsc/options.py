"""PETSc options: their sources, the options in force, and unused ones."""

from __future__ import annotations

import contextlib
import os
import re
import shlex
from collections.abc import Iterator, Mapping
from pathlib import Path
from typing import Any, ClassVar

from petsc4py import PETSc

from pdpetsc.discrete.communicator import Comm, agreed, is_root
from pdpetsc.errors import CaseError
from pdpetsc.petsc.library import option_used

# Option that prevents PETSc from reading .petscrc in the home and the working directory.
SKIP_FILES = "skip_petscrc"
# Endings of options that require a number. PETSc ignores such an option without value.
NEEDS_NUMBER = re.compile(r"(tol|tolerance|max_it|max_fail|max_funcs|max_linear_solve_fail)$")
# Largest tolerance of Newton's method: a tolerance of 1 accepts the undeformed body.
LARGEST_TOLERANCE = 0.01
# Beginnings of options that PETSc reads only at its end.
READ_AT_THE_END = ("log_", "malloc", "memory_view", "objects_", "options_", "on_error", "debug", "start_in_debugger")


def refuse_names(chosen: Mapping[str, Any]) -> None:
    """Raise CaseError for an invalid option name (not collective; the same on all ranks)."""
    for name in chosen:
        if not isinstance(name, str) or not re.fullmatch(r"[A-Za-z]\w*([-.:]\w+)*", name):
            raise CaseError(f"A PETSc option is named without its dash, like 'snes_rtol', not {name!r}.")


def refuse_files(comm: Comm, in_force: Mapping[str, Mapping[str, Any]]) -> None:
    """Raise CaseError if the output file of a viewer or monitor cannot be written (collective).

    PETSc opens the file of -log_view at its end, on rank 0, and the other ranks would wait for it.
    """
    of_files = {}
    for name, option in in_force.items():
        words = str(option["value"] or "").split(":")
        if re.search(r"view|monitor|log_|history", name) and len(words) > 1 and words[1]:
            of_files[name] = Path(words[1])
    try:
        with agreed(comm):
            for name, path in of_files.items() if is_root(comm) else ():
                if path.is_dir() or not os.access(path if path.exists() else path.parent, os.W_OK):
                    raise CaseError(f"The option -{name} writes to {path}, which cannot be written.")
    except CaseError:
        for name in of_files:
            PETSc.Options().delValue(name)
        raise


def _number(text: str) -> float:
    """Return a number as PETSc reads it, also ``inf`` and hexadecimal ones; 0 for text that PETSc refuses."""
    # Python also reads "abc" as hexadecimal, PETSc only what begins with 0x.
    with contextlib.suppress(ValueError, OverflowError):
        return float.fromhex(text) if "0x" in text.lower() else float(text)
    return 0.0


def _refuse_values(in_force: Mapping[str, Mapping[str, Any]]) -> None:
    """Raise CaseError for nan, a missing value of an option that requires a number, and a tolerance without meaning."""
    for name, option in in_force.items():
        value = str(option["value"] or "").strip()
        if value.lower().lstrip("+-") == "nan":
            raise CaseError(f"The option -{name} is nan; give it a number.")
        if not value and NEEDS_NUMBER.search(name):
            raise CaseError(f"The option -{name} has no value; write a number after it.")
        if name == "snes_rtol" and _number(value) > LARGEST_TOLERANCE:
            raise CaseError(
                f"The option -{name} is {value}: steps end with a residual of that share of the loads. Use at most "
                f"{LARGEST_TOLERANCE:g}."
            )


class Options:
    """Insert the PETSc options of one run into PETSc's database, while the run uses PETSc.

    Options of the command line and the environment take precedence over ``chosen``, which takes precedence over the
    defaults of pdpetsc. Several runs in one process, sequential, alternating or nested, have separate options.

    Parameters
    ----------
    chosen : mapping
        Options of case and caller; None for an option without value.

    Attributes
    ----------
    chosen : mapping
        As given.
    in_force : dict
        Value and source of every option, by name.

    Raises
    ------
    CaseError
        A name is invalid, or a value is not a number although the option requires one.
    """

    # Instances whose options are in the database; PETSc uses the last one.
    _active: ClassVar[list[Options]] = []

    def __init__(self, chosen: Mapping[str, Any]) -> None:
        refuse_names(chosen)
        self.chosen: Mapping[str, Any] = chosen
        self._defaults: dict[str, Any] = {}
        self._inserted: list[str] = []
        self._used: set[str] = set()
        self.in_force: dict[str, dict[str, Any]] = {}
        self.suggest({})

    def suggest(self, defaults: Mapping[str, Any]) -> Options:
        """Add defaults of pdpetsc, and return the instance."""
        self._defaults |= defaults
        with self.active():
            self.in_force = self._found()
        _refuse_values(self.in_force)
        return self

    @contextlib.contextmanager
    def active(self) -> Iterator[None]:
        """Insert the options for the ``with`` block (not collective; the same on all ranks)."""
        outer = self._active[-1] if self._active else None
        if outer is not None:
            outer._remove()
        self._insert()
        self._active.append(self)
        try:
            yield
        finally:
            self._active.pop()
            self._remove()
            if outer is not None:
                outer._insert()

    def unused(self) -> list[str]:
        """Return the options in force that PETSc has not looked up (not collective).

        Defaults of pdpetsc are omitted. Options of the command line and the environment that PETSc reads at its end are
        omitted too; options of a case are removed before.
        """
        self._note_used()
        return [
            name
            for name, option in self.in_force.items()
            if option["from"] != "pdpetsc"
            and name not in self._used
            and (option["from"] == "case" or not name.startswith(READ_AT_THE_END))
        ]

    def _insert(self) -> None:
        database = PETSc.Options()
        # A query for a single name would count as its use.
        there = {name.lower() for name in database.getAll()}
        for name, value in [*self.chosen.items(), *self._defaults.items()]:
            if name.lower() not in there:
                database.setValue(name, _text(value))
                there.add(name.lower())
                self._inserted.append(name)

    def _remove(self) -> None:
        self._note_used()
        database = PETSc.Options()
        for name in self._inserted:
            database.delValue(name)
        self._inserted.clear()

    def _note_used(self) -> None:
        """Store which options have been looked up, since PETSc forgets it when the option is removed."""
        self._used |= {name for name in self.in_force if option_used(name)}

    def _found(self) -> dict[str, dict[str, Any]]:
        sources = {"case": self.chosen, "environment": _environment(), "pdpetsc": self._defaults}
        found: dict[str, dict[str, Any]] = {}
        for name, value in sorted(PETSc.Options().getAll().items()):
            if name != SKIP_FILES:
                same = (of for of, known in sources.items() if name in known and _text(known[name]) == _text(value))
                found[name] = {"value": value, "from": next(same, "command line")}
        return found


def _environment() -> dict[str, str]:
    """Return the options of PETSC_OPTIONS."""
    found: dict[str, str] = {}
    name = ""
    with contextlib.suppress(ValueError):
        for word in shlex.split(os.environ.get("PETSC_OPTIONS", "")):
            if re.match(r"-{1,2}[A-Za-z]", word):
                name = word[1:]
                found[name] = ""
            elif name:
                found[name], name = word, ""
    return found


def _text(value: Any) -> str:
    return "" if value is None else str(value)
