"""``python -m pdpetsc compare CASE.py name=a,b,c ...``: a study with a picture."""

from __future__ import annotations

from collections.abc import Sequence

from pdpetsc.command_line import study
from pdpetsc.command_line.arguments import split

USAGE = """usage: python -m pdpetsc compare CASE.py NAME=A,B,C [NAME=...] [-o DIR] [--ranks N] [-PETSC_OPTION [VALUE]]

  NAME=A,B,C   values of a parameter of the case; all combinations of all of them are run
  -o DIR       folder for compare.csv, compare.png and a folder per run (default: out/compare_CASE)
  --ranks N    run each on N ranks, with mpirun
The seconds are those of set-up and solve. It is `study --picture` with another name for its files, one run after
another unless --jobs says otherwise, and takes all of its options: python -m pdpetsc study -h."""


def main(argv: Sequence[str]) -> int:
    """Run the command ``compare``; return its exit status or raise what ends it."""
    # The one spelling that was that of compare alone.
    asked = study.taken(["--ranks" if word == "-ranks" else word for word in argv])
    arguments = split(asked.words)
    case = study.case_of(arguments, "compare", USAGE)
    if case is None:
        return 0
    asked.flags.add("--picture")
    study.run(case, arguments.parameters, arguments.output, study.options_of(arguments), asked, "compare")
    return 0
