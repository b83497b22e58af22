"""Runs a case again and again with its n-th write failing, then goes on from what is left; prints a line for each n.

    LD_PRELOAD=failing_writes.so python kill_everywhere.py CASE.py FOLDER HOW [FIRST STRIDE]

Every run is a fork of this process, which has everything loaded already. A line has n, the exit status of the run that
was hit (negative for a signal), what it said that an undisturbed run does not, the steps of history, fields and
checkpoint that were left, and the exit status of the run that went on.
"""

import ctypes
import json
import os
import signal
import sys
import tempfile
import traceback
from pathlib import Path

import petsc4py

petsc4py.init(["pdpetsc"])
import h5py

from pdpetsc.command_line import cli
from pdpetsc.running import runner  # noqa: F401

case, folder, how = sys.argv[1], Path(sys.argv[2]), sys.argv[3]
first, stride = map(int, sys.argv[4:6]) if len(sys.argv) > 4 else (1, 1)
failing = ctypes.CDLL(None).failing_writes


def run(place, at, *words, log=-1):
    """Run the case in a fork; return its exit status and what it wrote to stderr."""
    with tempfile.TemporaryFile() as said:
        child = os.fork()
        if child == 0:
            status = 70
            try:
                # A run that hangs is ended, and counts as one that does.
                signal.alarm(60)
                os.dup2(said.fileno(), 2)
                if at is not None:
                    failing(str(place).encode(), at, how.encode(), log)
                cli.main([case, "-o", str(place), "--quiet", *words])
            except SystemExit as end:
                status = end.code
            except BaseException:
                traceback.print_exc()
            finally:
                sys.stderr.flush()
                os._exit(status or 0)
        _, status = os.waitpid(child, 0)
        said.seek(0)
        return os.waitstatus_to_exitcode(status), said.read().decode()


def left(place):
    """Return the last whole row of history, the steps with readable fields and the step of the checkpoint."""
    rows, steps, saved = -1, [], -1
    if (place / "history.csv").exists():
        lines = (place / "history.csv").read_text().splitlines(keepends=True)
        rows = sum(line.endswith("\n") for line in lines) - 2
    if (place / "fields.h5").exists():
        with h5py.File(place / "fields.h5") as file:
            steps = sorted(int(name[5:]) for name in file if name.startswith("step_"))
            for step in steps:
                file[f"step_{step:05d}/displacement"][:]
    if (place / "checkpoint.h5").exists():
        with h5py.File(place / "checkpoint.h5") as file:
            saved = int(json.loads(file.attrs["head"])["step"])
            file["u"][:]
    if (place / "summary.json").exists():
        json.loads((place / "summary.json").read_text())
    return rows, steps, saved


def main():
    whole = folder / "whole"
    with (folder / "log").open("w+") as log:
        status, usual = run(whole, 0, log=log.fileno())
        calls = len(log.seek(0) or log.readlines())
    assert status == 0, usual
    print(json.dumps({"calls": calls}), flush=True)
    for n in range(first, calls + 1, stride):
        place = folder / str(n)
        with (folder / f"log_{n}").open("w+") as log:
            status, said = run(place, n, log=log.fileno())
            if len(log.seek(0) or log.readlines()) < n:  # runs that are quicker write less often
                break
        said = "\n".join(line for line in said.splitlines() if line not in usual.splitlines())
        found = {"n": n, "status": status, "said": said, "left": left(place)}
        words = ("--restart", str(place)) if (place / "checkpoint.h5").exists() else ()
        again, why = run(place, None, *words)
        same = all(
            (place / name).read_bytes() == (whole / name).read_bytes()
            for name in ("history.csv", "broken_bonds.csv", "fields.xdmf")
            if again == 0
        )
        print(json.dumps({**found, "again": again, "why": why, "same": same, "left again": left(place)}), flush=True)


main()
