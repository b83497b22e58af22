"""PETSc starts once for all tests, without looking at pytest's command line."""

import numpy as np
import petsc4py
import pytest

petsc4py.init(["pytest"])


@pytest.fixture
def rng():
    return np.random.default_rng(20240607)
