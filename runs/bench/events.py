"""Cost of an event: corrections to an old factor against factoring anew at every event.

    python runs/bench/events.py [n] [bonds per particle]     # defaults: 1000 10

The bar of the periodic cell with critical stretch increasing with the length of the bond, in which events are many.
First what a step costs that assembles and factors the tangent matrix and solves once, as an algorithm needs at every
event that keeps no factor. Then for several numbers of changed bonds at which the matrix is factored anew: number of
factorisations, mean and median milliseconds per event of the solver alone (1 factors once for every bond, whose failure
is two events), and how many times faster than that step an event is. PETSc options as on the command line.
"""

import sys
import time
from pathlib import Path

sys.path.insert(0, str(Path(__file__).parent.parent))
import study

words = study.start("localisation")

import numpy as np
from periodic_cell import case

from pdpetsc.declare.solvers import EventDriven
from pdpetsc.discrete.communicator import is_root, world
from pdpetsc.discrete.families import find_families
from pdpetsc.petsc.defaults import default_options
from pdpetsc.petsc.jacobian import choose
from pdpetsc.petsc.options import Options
from pdpetsc.problem.assembly import Assembler
from pdpetsc.running.build import make_cloud, make_problem
from pdpetsc.solvers.event_driven.solver import EventSolver
from pdpetsc.solvers.protocol import Start

EVENTS = 600
FACTORISATIONS = 30


def measure(scene, updates):
    """Return seconds of each event and the number of factorisations."""
    cloud = make_cloud(world(), scene)
    problem = make_problem(scene, cloud, find_families(cloud))
    choice = choose(problem, {}, EventDriven())
    with Options({}).suggest(default_options(problem, EventDriven(), choice)).active():
        solver = EventSolver(problem, Assembler(problem), EventDriven(updates), lambda: False)
        start = np.zeros((cloud.n_rows, problem.dim))
        spent, before = [], time.perf_counter()
        for _, _ in zip(range(EVENTS), solver.march(Start(start), lambda *_: None), strict=False):
            now = time.perf_counter()
            spent.append(now - before)
            before = now
        described = solver.description()
        anew = []
        for _ in range(FACTORISATIONS):
            problem.damage.version += 1
            before = time.perf_counter()
            solver.solver.factor()
            anew.append(time.perf_counter() - before)
        solver.destroy()
    return np.array(spent), solver.factored, described, float(np.median(anew))


def main():
    n, m = (int(word) for word in (*words, *("1000", "10")[len(words) :]))
    scene = case(n=n, critical="increasing", horizon=m / n)
    measure(scene, None)
    rows = []
    for updates in (1, 16, 32, None, 128, 256):
        spent, factored, described, anew = measure(scene, updates)
        rows.append((updates or "default", factored, spent.mean(), float(np.median(spent)), described, anew))
    if is_root(world()):
        anew = float(np.median([row[-1] for row in rows]))
        print(f"{n} particles, {n * m} bonds, first {EVENTS} events; {rows[0][4]}")
        print(f"assembly, factor and one solve: {1e3 * anew:.2f} ms")
        print("updates  factored  mean ms  median ms  faster")
        for updates, factored, mean, median, *_ in rows:
            print(f"{updates!s:>7} {factored:9d} {1e3 * mean:8.3f} {1e3 * median:10.3f} {anew / mean:7.1f}")


main()
