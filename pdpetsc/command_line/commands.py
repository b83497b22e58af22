"""Commands besides running a case: the module of each command, imported on first use.

The docstring of the module is the usage of the command; its function ``run`` executes it.
"""

from __future__ import annotations

import inspect
from collections.abc import Mapping, Sequence
from importlib import import_module
from pathlib import Path

from pdpetsc.command_line.arguments import Syntax, split
from pdpetsc.command_line.start import processes_started
from pdpetsc.declared import meant
from pdpetsc.errors import CaseError

OF_RUNS = ("-o", "--ranks", "--jobs", "--launcher", "--solver")
STUDY = Syntax("case file", (*OF_RUNS, "--sets", "--order", "--exact"), ("--retry", "--expected", "--picture"), None)

COMMANDS: Mapping[str, tuple[str, Syntax]] = {
    "plot": (
        "plot",
        Syntax("folder", ("--cut",), ("--animate",), ("field", "component", "scale", "step", "x", "y", "format")),
    ),
    "report": ("report", Syntax("folder", parameters=("field", "component", "scale"))),
    "compare": ("compare", STUDY),
    "study": ("study", STUDY),
    "fit": (
        "fit",
        Syntax(
            "case file", (*OF_RUNS, "--to", "--columns", "--sigma", "--range", "--runs"), ("--retry", "--picture"), None
        ),
    ),
    "new": ("new", Syntax("case file")),
    "import": ("import_deck", Syntax("deck", ("-o", "--ignore"), ("--static", "--overwrite"))),
    "doctor": ("doctor", Syntax("")),
}
# Commands for a single process: several would write the same files.
ALONE = ("plot", "report", "new", "import")


def usage_of(module: str) -> str:
    """Return the usage of a command from the docstring of its module."""
    return inspect.getdoc(import_module(f"pdpetsc.command_line.{module}")) or ""


def refuse_command(argv: Sequence[str]) -> None:
    """Raise CaseError if the first word is no case file, and almost a command."""
    word = argv[0] if argv else ""
    if word.isidentifier() and not Path(word).exists() and (near := meant(word, COMMANDS, "did you mean {}?")):
        raise CaseError(f"No command {word}; {near}")


def command(name: str, argv: Sequence[str]) -> int:
    """Execute a command and return its exit status.

    Raises
    ------
    CaseError
        A word is unknown to the command or missing, or a launcher has started several processes of a command that
        works in one.
    """
    module, syntax = COMMANDS[name]
    if name in ALONE and processes_started() > 1:
        raise CaseError(f"{name} works in one process; call it without mpirun.")
    arguments = split(argv, syntax, name)
    if "--help" in arguments.flags or (syntax.path and not argv):
        print(usage_of(module))
        return 0 if argv else 2
    if syntax.path and arguments.path is None:
        raise CaseError(f"No {syntax.path} is given; python -m pdpetsc {name} -h shows the usage.")
    return int(import_module(f"pdpetsc.command_line.{module}").run(arguments.path, arguments))
