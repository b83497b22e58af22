"""Time set-up, residual and tangent assembly: python runs/bench/assembly.py [n] [horizon] [scheme].

Medians of five on a square lattice of n x n particles, Hencky material, into the PETSc matrix, by default with plain
correspondence; under mpirun the slowest rank counts. Published single-core figures of PeriLab for 40,401 particles:
assembly 4.00 s and 0.80 s at horizons 3.015 and 2.015.
"""

import sys
import time

import numpy as np
import petsc4py

petsc4py.init(["bench"])

import pdpetsc as pd
from pdpetsc.discrete.communicator import is_root, largest, world
from pdpetsc.discrete.families import find_families
from pdpetsc.petsc.matrix import TangentMatrix, predicted_bytes
from pdpetsc.problem.assembly import Assembler
from pdpetsc.problem.state import State
from pdpetsc.running.build import make_cloud, make_problem

REPEATS = 5


def timed(comm, call):
    """Return the time of a call on the slowest rank and its answer."""
    comm.Barrier()
    before = time.perf_counter()
    answer = call()
    return largest(comm, time.perf_counter() - before), answer


def main(n=201, horizon=3.015, scheme="correspondence"):
    comm = world()
    lattice = pd.Lattice((0.0, 0.0), (float(n), float(n)), 1.0)
    chosen = pd.choose("scheme", scheme, pd.SCHEMES)
    material = pd.Hencky(E=1.0, nu=0.3)
    case = pd.Case(particles=lattice, horizon=horizon, material=material, scheme=chosen, conditions=[])
    times = {name: [] for name in ("set-up", "pattern", "residual", "tangent")}
    for repeat in range(REPEATS + 1):
        t_cloud, cloud = timed(comm, lambda: make_cloud(comm, case))
        t_families, families = timed(comm, lambda: find_families(cloud))
        t_model, problem = timed(comm, lambda: make_problem(case, cloud, families))
        t_pattern, assembler = timed(comm, lambda: Assembler(problem))
        u = 1e-3 * np.sin(cloud.x[: cloud.n_owned])
        timed(comm, lambda: problem.internal_force(State(problem.body, u)))
        t_residual = timed(comm, lambda: problem.internal_force(State(problem.body, u)))[0]
        matrix = TangentMatrix(assembler, np.zeros((cloud.n_owned, 2), dtype=bool), 1.0)
        timed(comm, lambda: matrix.update(State(problem.body, u)))
        t_tangent = timed(comm, lambda: matrix.update(State(problem.body, u)))[0]
        matrix.destroy()
        if repeat:
            for name, value in zip(
                times, (t_cloud + t_families + t_model, t_pattern, t_residual, t_tangent), strict=True
            ):
                times[name].append(value)
    size = predicted_bytes(assembler.pattern, 2)
    if is_root(comm):
        print(f"{n * n} particles, horizon {horizon}, {scheme}, {comm.size} ranks, matrix {size / 2**20:.0f} MiB")
        for name, values in times.items():
            print(f"  {name:9s} {np.median(values):8.4f} s")


if __name__ == "__main__":
    main(*(kind(word) for kind, word in zip((int, float, str), sys.argv[1:], strict=False)))
