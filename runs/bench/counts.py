"""Count what ranks exchange in one linear solve; ``performance_model.py`` runs it: counts.py n horizon."""

import contextlib
import json
import sys
from pathlib import Path

sys.path.insert(0, str(Path(__file__).parent.parent))
import study

words = study.start("bench")

from box import case  # noqa: E402
from linear import solve  # noqa: E402
from petsc4py import PETSc  # noqa: E402

from pdpetsc.discrete.communicator import is_root, largest, world  # noqa: E402
from pdpetsc.discrete.halo import Halo  # noqa: E402
from pdpetsc.running.build import make_cloud  # noqa: E402

exchanges = []


@contextlib.contextmanager
def counting():
    """Count the exchanges of ghosts that start in the body."""
    start = Halo._start

    def counted(*arguments):
        exchanges.append(1)
        return start(*arguments)

    Halo._start = counted
    yield
    Halo._start = start


def main():
    comm = world()
    n, horizon = int(words[0]), float(words[1])
    scene = case(dim=3, n=n, horizon=horizon)
    halo = make_cloud(comm, scene).halo
    PETSc.Log.begin()
    found = solve(scene, "matfree", around=counting)
    iterations = max(found["linear_iterations"], 1)
    info = PETSc.Log.Event("KSPSolve").getPerfInfo()
    counted = {
        "ghosts": int(largest(comm, halo.n_ghost)),
        "neighbours": int(largest(comm, len(halo.sources))),
        "exchanges": len(exchanges) / iterations,
        "reductions": largest(comm, info["numReductions"]) / iterations,
        "operator": found["seconds"]["operator"],
        "cycle": found["seconds"]["cycle"],
    }
    if is_root(comm):
        print(json.dumps(counted))


main()
