"""``python -m pdpetsc compare CASE.py name=a,b,c ...``: a study with a picture."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

from pdpetsc.command_line import study

USAGE = """usage: python -m pdpetsc compare CASE.py NAME=A,B,C [NAME=...] [-o DIR] [--ranks N] [-PETSC_OPTION [VALUE]]

  NAME=A,B,C   values of a parameter of the case; all combinations of all of them are run
  -o DIR       folder for compare.csv, compare.png and a folder per run (default: out/compare_CASE)
  --ranks N    run each on N ranks, with mpirun
The seconds are those of set-up and solve. It is `study --picture` with another name for its files, one run after
another unless --jobs says otherwise, and takes all of its options: python -m pdpetsc study -h."""


def taken(argv: Sequence[str]) -> study.Asked:
    """Take the options of a study out of a command line, also in the one spelling that was that of compare alone."""
    return study.taken(["--ranks" if word == "-ranks" else word for word in argv])


def main(asked: study.Asked, arguments: Any) -> int:
    """Run the command ``compare``; return its exit status or raise what ends it."""
    if not study.ready(arguments, "compare", USAGE):
        return 0
    asked.flags.add("--picture")
    study.run(arguments.path, arguments.parameters, arguments.output, study.options_of(arguments), asked, "compare")
    return 0
