"""PETSc starts once for all tests of a process, without looking at pytest's command line."""

import contextlib
import os
import signal
import sys

# For this process before numpy is loaded, and for all that tests start: tests run side by side on every core, where
# more threads, and ranks that wait for others at full speed, take the time of what has something to do.
os.environ.setdefault("OMP_NUM_THREADS", "1")
os.environ.setdefault("OMPI_MCA_mpi_yield_when_idle", "1")
# Every process that tests start reads the compiled modules of this one, also where the environment would not keep them.
os.environ.pop("PYTHONDONTWRITEBYTECODE", None)
sys.dont_write_bytecode = False

import numpy as np
import petsc4py
import pytest


def pytest_configure(config):
    # A shell that starts tests in the background lets them ignore SIGINT, and what they start would ignore it too.
    with contextlib.suppress(ValueError):  # not the main thread
        if signal.getsignal(signal.SIGINT) is signal.SIG_IGN:
            signal.signal(signal.SIGINT, signal.default_int_handler)
    # The process that only hands tests to others must not start MPI: they would inherit its environment.
    if not getattr(config.option, "numprocesses", None) or hasattr(config, "workerinput"):
        petsc4py.init(["pytest"])


@pytest.fixture
def rng():
    return np.random.default_rng(20240607)
