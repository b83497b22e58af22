"""Functions of libraries that petsc4py does not wrap."""

from pathlib import Path

import pytest

from tests.commands import python_on


@pytest.mark.skipif(not Path("/proc/self/statm").exists(), reason="the system does not tell the memory of a process")
def test_large_arrays_return_their_memory_to_the_system():
    """SuperLU_DIST, which PETSc loads, turns this off. A process of its own has no freed memory of other tests."""
    text = """
from pathlib import Path
import numpy as np
from pdpetsc.petsc.library import return_freed_memory

def pages():
    return int(Path("/proc/self/statm").read_text().split()[1])

return_freed_memory(True)
before, most = pages(), []
for _ in range(2):
    values = np.ones(2**24)
    most.append(pages())
    del values
print(before, *most, pages())
"""
    done = python_on(1, "-c", text)
    before, *most, after = map(int, done.stdout.split())
    pages = 2**27 // 4096
    assert min(most) - before > 0.9 * pages and after - before < 0.1 * pages
