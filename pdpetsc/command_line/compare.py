"""Run every combination of values, and write one table and picture.

usage: python -m pdpetsc compare CASE.py NAME=A,B,C [NAME=...] [-o DIR] [--ranks N] [-PETSC_OPTION [VALUE]]

  NAME=A,B,C   values of a parameter of the case; all combinations are run
  -o DIR       folder for compare.csv, compare.png and a folder per run (default: out/compare_CASE)
  --ranks N    run each case on N ranks, with mpirun
Seconds are those of set-up and solve. The command is `study --picture` with other file names, one run at a time unless
--jobs is given, and accepts all options of study: python -m pdpetsc study -h.
"""

from __future__ import annotations

from pathlib import Path

from pdpetsc.command_line.arguments import Arguments
from pdpetsc.command_line.study import run_study


def run(path: Path, arguments: Arguments) -> int:
    """Execute the command."""
    arguments.flags.add("--picture")
    run_study(path, arguments, "compare")
    return 0
