"""Functions of libraries that petsc4py does not wrap."""

from pathlib import Path

import numpy as np
import pytest

from pdpetsc.petsc.library import return_freed_memory

STATM = Path("/proc/self/statm")


@pytest.mark.skipif(not STATM.exists(), reason="the system does not tell the memory of a process")
def test_large_arrays_return_their_memory_to_the_system():
    """SuperLU_DIST, which PETSc loads, turns this off."""
    return_freed_memory(True)
    before, most = int(STATM.read_text().split()[1]), []
    for _ in range(2):
        values = np.ones(2**24)
        most.append(int(STATM.read_text().split()[1]))
        del values
    after, pages = int(STATM.read_text().split()[1]), 2**27 // 4096
    assert min(most) - before > 0.9 * pages and after - before < 0.1 * pages
