"""Running pdpetsc as its users do."""

import csv
import json
import os
import subprocess
import sys
import time
from pathlib import Path

import h5py
import numpy as np
import pytest

import pdpetsc as pd
from tests.ranks import asked, run_case

ROOT = Path(__file__).parent.parent
# Longer than anything takes on a busy machine [s].
TIMEOUT = 300


def command(case, *arguments, ranks=1, output=None):
    """Return the command line for a case file, on ``ranks`` ranks."""
    words = [sys.executable, "-m", "pdpetsc", str(case), *map(str, arguments)]
    if output is not None:
        words += ["-o", str(output)]
    return words if ranks == 1 else [str(ROOT / ".ci" / "mpirun"), str(ranks), *words]


def run(case, *arguments, ranks=1, output=None, **options):
    """Run a case file to its end; return the finished process with its output as text."""
    environment = {**os.environ, "PYTHONPATH": str(ROOT), "OMP_NUM_THREADS": "1"}
    words = command(case, *arguments, ranks=ranks, output=output)
    return subprocess.run(
        words, capture_output=True, text=True, timeout=TIMEOUT, cwd=ROOT, env=environment, check=False, **options
    )


def results(case, *arguments, ranks=1, output):
    """Run a case file, which must succeed, and return its summary.

    It runs in this process, or on ranks that are there already, which saves the start of Python.
    """
    if ranks == 1:
        run_case([str(ROOT / case), *map(str, arguments)], output)
    else:
        printed(case, *arguments, ranks=ranks, output=output)
    return summary(output)


def printed(case, *arguments, ranks=1, output, timeout=TIMEOUT):
    """Run a case file, which must succeed, on ranks that stay for the next one; return what it printed."""
    words = [str(ROOT / case), *map(str, arguments)]
    answers = asked(ranks, {"what": "run", "words": words, "output": str(output)}, timeout)
    return "".join(answer["stdout"] for answer in answers)


def called(*words, ranks=1, cwd=ROOT):
    """Call the command line on ranks that stay; return a finished process, with the most that a rank left as status.

    For what does not start PETSc with options of its own, and does not test the process itself.
    """
    answers = asked(ranks, {"what": "command", "words": [str(word) for word in words], "folder": str(cwd)}, TIMEOUT)
    out, err = ("".join(answer[name] for answer in answers) for name in ("stdout", "stderr"))
    statuses = {answer["status"] for answer in answers}
    assert len(statuses) == 1, (statuses, err)
    return subprocess.CompletedProcess(words, statuses.pop(), out, err)


def run_several(runs, ranks, timeout=TIMEOUT):
    """Run cases ``[(case, arguments, output)]``, which must all succeed, one after the other on the same ranks."""
    for case, words, output in runs:
        printed(case, *words, ranks=ranks, output=output, timeout=timeout)


def script_on(ranks, text, *words, timeout=TIMEOUT):
    """Execute the text of a script, which must succeed, on ranks that stay; return what it printed."""
    request = {"what": "script", "text": text, "words": [str(word) for word in words]}
    return "".join(answer["stdout"] for answer in asked(ranks, request, timeout))


def python_on(ranks, *words, timeout=TIMEOUT):
    """Run Python with these words on ``ranks`` ranks; return the finished process with its output as text."""
    words = [str(ROOT / ".ci" / "mpirun"), str(ranks), sys.executable, *map(str, words)]
    environment = {**os.environ, "PYTHONPATH": str(ROOT), "OMP_NUM_THREADS": "1"}
    return subprocess.run(
        words, capture_output=True, text=True, timeout=timeout, cwd=ROOT, env=environment, check=False
    )


def wait_until(condition, what, seconds=60.0, every=0.02):
    """Wait until ``condition()`` holds, which must come in time; return what it gave."""
    end = time.monotonic() + seconds
    while not (found := condition()):
        assert time.monotonic() < end, f"{what} did not come within {seconds:g} s"
        time.sleep(every)
    return found


class Stop(pd.Quantity):
    """Ends the run once the step time, or the number of the step, is beyond a number."""

    def __init__(self, after, of="t"):
        self.after, self.of = after, of

    def evaluate(self, solution):
        if getattr(solution, self.of) > self.after:
            raise pd.Interrupted("enough")
        return 0.0


# Begins the text of a case file whose ``history`` has a ``Stopping()``, which ``stopped_and_continued`` uses.
STOPPING = """
import pdpetsc as pd

class Stopping(pd.Quantity):
    at = 2.0

    def evaluate(self, solution):
        if solution.t > Stopping.at:
            raise pd.SolveError("It stops here.")
        return 0.0
"""


def stopped_and_continued(text, *arguments, output):
    """Return the result of a case file with ``STOPPING`` that fails beyond step time 0.6 and is restarted."""
    space = {}
    exec(text, space)
    space["Stopping"].at = 0.6
    with pytest.raises(pd.SolveError):
        pd.run(space["case"](*arguments), output / "half")
    space["Stopping"].at = 2.0
    return pd.run(space["case"](*arguments), output / "again", restart=output / "half")


def summary(output):
    """Return ``summary.json`` of a run."""
    return json.loads((output / "summary.json").read_text())


def history(output):
    """Return the columns of ``history.csv`` of a run by name."""
    with (output / "history.csv").open() as file:
        rows = list(csv.DictReader(file))
    return {name: np.array([float(row[name]) for row in rows]) for name in rows[0]}


def field(output, name, step=-1):
    """Return a field of a step by global id."""
    with h5py.File(output / "fields.h5", "r") as file:
        steps = sorted(group for group in file if group.startswith("step_"))
        assert np.array_equal(file["particles/id"], np.arange(len(file["particles/id"])))
        return np.asarray(file[steps[step]][name])


def jacobian_ratios(text):
    """Return what -snes_test_jacobian printed: relative differences between the tangent and differences."""
    key = "||J - Jfd||_F/||J||_F = "
    return [float(line.split(key)[1].split(",")[0].rstrip(".")) for line in text.splitlines() if key in line]
