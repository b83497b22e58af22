"""Run every combination of some values, and make one table and picture.

usage: python -m pdpetsc compare CASE.py NAME=A,B,C [NAME=...] [-o DIR] [--ranks N] [-PETSC_OPTION [VALUE]]

  NAME=A,B,C   values of a parameter of the case; all combinations of all of them are run
  -o DIR       folder for compare.csv, compare.png and a folder per run (default: out/compare_CASE)
  --ranks N    run each on N ranks, with mpirun
The seconds are those of set-up and solve. It is `study --picture` with another name for its files, one run after
another unless --jobs says otherwise, and takes all of its options: python -m pdpetsc study -h.
"""

from __future__ import annotations

from pathlib import Path

from pdpetsc.command_line.arguments import Arguments
from pdpetsc.command_line.study import run_study


def run(path: Path, arguments: Arguments) -> int:
    """Carry out the command."""
    arguments.flags.add("--picture")
    run_study(path, arguments, "compare")
    return 0
