"""PETSc starts once for all tests of a process, without looking at pytest's command line."""

import numpy as np
import petsc4py
import pytest


def pytest_configure(config):
    # The process that only hands tests to others must not start MPI: they would inherit its environment.
    if not getattr(config.option, "numprocesses", None) or hasattr(config, "workerinput"):
        petsc4py.init(["pytest"])


@pytest.fixture
def rng():
    return np.random.default_rng(20240607)
