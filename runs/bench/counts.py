"""Count what ranks exchange in one linear solve; ``performance_model.py`` runs it: counts.py n horizon [scene].

``scene`` is intact, a lattice of n^3 particles; broken, the same with 2 % of the bonds broken; or tetrahedra, the cells
of a mesh of n^3 shaken cubes with conforming weights.
"""

import contextlib
import json
import sys
from pathlib import Path

sys.path.insert(0, str(Path(__file__).parent.parent))
import study

words = study.start("bench")

from box import case
from linear import solve
from mesh import block_of
from petsc4py import PETSc

from pdpetsc.discrete.communicator import is_root, largest, world
from pdpetsc.discrete.halo import Halo
from pdpetsc.running.build import make_cloud

BROKEN = 0.02
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
    n, horizon, kind = int(words[0]), float(words[1]), words[2] if len(words) > 2 else "intact"
    broken = BROKEN if kind == "broken" else 0.0
    if kind == "tetrahedra":
        scene = block_of(kind, n, horizon, 0.2, "conforming")
    else:
        scene = case(dim=3, n=n, horizon=horizon, breakable=broken > 0.0)
    cloud = make_cloud(comm, scene)
    halo = cloud.halo
    PETSc.Log.begin()
    found = solve(scene, "matfree", broken, around=counting)
    iterations = max(found["linear_iterations"], 1)
    info = PETSc.Log.Event("KSPSolve").getPerfInfo()
    counted = {
        "particles": found["particles"],
        "imbalance": largest(comm, cloud.n_owned) * comm.size / found["particles"],
        "linear_iterations": found["linear_iterations"],
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
