"""PETSc's options: where they come from, which are in force, and which nothing has used."""

from __future__ import annotations

import contextlib
import os
import re
import shlex
from collections.abc import Iterator, Mapping
from pathlib import Path
from typing import Any

from petsc4py import PETSc

from pdpetsc.discrete.communicator import Comm, agreed, is_root
from pdpetsc.errors import CaseError
from pdpetsc.petsc.library import option_used

# Option that keeps PETSc from reading .petscrc in the home and the working folder.
SKIP_FILES = "skip_petscrc"
# Beginnings of options that PETSc looks up only when it ends.
READ_AT_THE_END = ("log_", "malloc", "memory_view", "objects_", "options_", "on_error", "debug", "start_in_debugger")


def refuse_names(chosen: Mapping[str, Any]) -> None:
    """Raise CaseError for a name that cannot be an option's (not collective; the same on all ranks)."""
    for name in chosen:
        if not isinstance(name, str) or not re.fullmatch(r"[A-Za-z]\w*([-.:]\w+)*", name):
            raise CaseError(f"A PETSc option is named without its dash, like 'snes_rtol', not {name!r}.")


def refuse_files(comm: Comm, in_force: Mapping[str, Mapping[str, Any]]) -> None:
    """Raise CaseError for a file of a viewer or monitor that cannot be made (collective).

    PETSc opens that of -log_view as it ends, on rank 0, and the others would wait for it.
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


@contextlib.contextmanager
def options(chosen: Mapping[str, Any], defaults: Mapping[str, Any]) -> Iterator[None]:
    """Put options into PETSc's database for the time of a run.

    What is already there, from the command line or the environment, wins over ``chosen``, which wins over ``defaults``.
    A value of None stands for an option without value.
    """
    database = PETSc.Options()
    # Asking for a name would count as its use.
    there = {name.lower() for name in database.getAll()}
    inserted = []
    for name, value in [*chosen.items(), *defaults.items()]:
        if name.lower() not in there:
            database.setValue(name, _text(value))
            there.add(name.lower())
            inserted.append(name)
    try:
        yield
    finally:
        for name in inserted:
            database.delValue(name)


def options_in_force(chosen: Mapping[str, Any], defaults: Mapping[str, Any]) -> dict[str, dict[str, Any]]:
    """Return value and source of every option in PETSc's database, in the body of ``options`` (not collective)."""
    sources = {"case": chosen, "environment": _environment(), "pdpetsc": defaults}
    found: dict[str, dict[str, Any]] = {}
    for name, value in sorted(PETSc.Options().getAll().items()):
        if name != SKIP_FILES:
            same = (of for of, known in sources.items() if name in known and _text(known[name]) == _text(value))
            found[name] = {"value": value, "from": next(same, "command line")}
    return found


def unused(in_force: Mapping[str, Mapping[str, Any]]) -> list[str]:
    """Return the options in force that nothing has looked up, in the body of ``options`` (not collective).

    Those that pdpetsc suggests are not among them, nor those that PETSc reads when it ends.
    """
    return [
        name
        for name, option in in_force.items()
        if option["from"] != "pdpetsc" and not name.startswith(READ_AT_THE_END) and not option_used(name)
    ]


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
