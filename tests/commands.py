"""Running pdpetsc as its users do."""

import json
import os
import subprocess
import sys
from pathlib import Path

import h5py
import numpy as np

import pdpetsc as pd
from pdpetsc.command_line.cli import arguments_of, load_case

ROOT = Path(__file__).parent.parent
TIMEOUT = 120


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

    On one rank and without options it runs in this process, which saves the start of Python.
    """
    words = [str(word) for word in arguments]
    if ranks == 1 and not any(word.startswith("-") for word in words):
        function = load_case(ROOT / case)
        parameters = arguments_of(function, dict(word.split("=", 1) for word in words))
        pd.run(function(**parameters), output=output, parameters=parameters)
    else:
        finished = run(case, *words, "--quiet", ranks=ranks, output=output)
        assert finished.returncode == 0, finished.stderr
    return json.loads((output / "summary.json").read_text())


SEVERAL = """
import json
import sys
from pathlib import Path

import petsc4py

petsc4py.init(sys.argv[:1])
import pdpetsc as pd
from pdpetsc.command_line.cli import arguments_of, load_case

for case, words, output in json.loads(sys.argv[1]):
    function = load_case(Path(case))
    parameters = arguments_of(function, dict(word.split("=", 1) for word in words))
    pd.run(function(**parameters), output=output, parameters=parameters)
"""


def run_several(runs, ranks, timeout=TIMEOUT):
    """Run cases ``[(case, arguments, output)]``, which must all succeed, one after the other in one start of MPI."""
    listed = [(str(ROOT / case), [str(word) for word in words], str(output)) for case, words, output in runs]
    done = python_on(ranks, "-c", SEVERAL, json.dumps(listed), timeout=timeout)
    assert done.returncode == 0, done.stderr


def python_on(ranks, *words, timeout=TIMEOUT):
    """Run Python with these words on ``ranks`` ranks; return the finished process with its output as text."""
    words = [str(ROOT / ".ci" / "mpirun"), str(ranks), sys.executable, *map(str, words)]
    environment = {**os.environ, "PYTHONPATH": str(ROOT), "OMP_NUM_THREADS": "1"}
    return subprocess.run(
        words, capture_output=True, text=True, timeout=timeout, cwd=ROOT, env=environment, check=False
    )


class Stop(pd.Quantity):
    """Ends the run once the step time is beyond a number."""

    def __init__(self, after):
        self.after = after

    def evaluate(self, solution):
        if solution.t > self.after:
            raise pd.Interrupted("enough")
        return 0.0


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
