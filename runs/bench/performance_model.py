"""Predict scaling to many ranks, and check its counts: python runs/bench/performance_model.py [n] [horizon] [scene].

The model, for a cube of n^3 particles on P ranks and one iteration of conjugate gradients without a matrix:

    T = (c_op + c_cycle) N/P + messages alpha + bytes / beta + R log2(P) alpha

with one application of the operator and its two exchanges of ghosts; a rank has ghosts within the horizon of its faces,
edges and corners, from 26 ranks in the middle of the body. Going to the nodes of the background grid and back takes two
more exchanges, and the levels of GAMG below them add their own messages; R reductions.
c_op and c_cycle, the seconds a particle of both, are measured on one rank. Ghosts, ranks they are from, exchanges and
reductions are then counted on 2, 4 and 8 ranks and set beside the model's; alpha and beta are those of a usual network.
Neither the imbalance of parts nor the direct solve on the coarsest level is in it.

Of the scenes ``broken`` and ``tetrahedra`` (``counts.py``) it prints what is counted on 1 to 16 ranks only.
"""

import json
import subprocess
import sys
from pathlib import Path

import numpy as np

ALPHA, BETA = 1.5e-6, 10e9
APPLIED = 1
REDUCTIONS = 3
# Nodes of a level of GAMG over those of the one above, and the exchanges of all cycles on each level.
COARSENING, EXCHANGES = 1.0 / 20.0, 18
COUNTS = Path(__file__).parent / "counts.py"


def boxes(ranks):
    """Return how many parts recursive bisection makes of a cube along each axis."""
    parts = [1, 1, 1]
    for level in range(int(np.log2(ranks))):
        parts[level % 3] *= 2
    return np.array(parts)


def within(horizon, dim):
    """Return how many lattice points with positive coordinates lie within the horizon of the origin."""
    axes = np.meshgrid(*[np.arange(1, int(horizon) + 1)] * dim)
    return int((sum(axis**2 for axis in axes) <= horizon**2).sum())


def halo(n, horizon, ranks):
    """Return the ghosts of the rank with most, beyond its faces, edges and corners, and the ranks it has them from."""
    parts = boxes(ranks)
    sides = n / parts
    # A part in the middle has neighbours on both sides of an axis, one of two parts on one side.
    a = np.minimum(parts - 1, 2)
    faces = sum(a[d] * sides[(d + 1) % 3] * sides[(d + 2) % 3] for d in range(3))
    edges = sum(a[(d + 1) % 3] * a[(d + 2) % 3] * sides[d] for d in range(3))
    ghosts = within(horizon, 1) * faces + within(horizon, 2) * edges + within(horizon, 3) * np.prod(a)
    return float(ghosts), int(np.prod(a + 1) - 1)


def iteration(n, horizon, ranks, c_op, c_cycle):
    """Return seconds of an iteration: work, messages, bytes, reductions."""
    local = n**3 / ranks
    ghosts, neighbours = halo(n, horizon, ranks)
    nodes = n**3 / horizon**3
    levels = max(1, int(np.ceil(np.log(nodes / 50.0) / np.log(1.0 / COARSENING))))
    messages = (2 * APPLIED + 2 + levels * EXCHANGES) * neighbours
    volume = 2 * APPLIED * ghosts * 24.0
    work = (c_op + c_cycle) * local
    return work, messages * ALPHA, volume / BETA, REDUCTIONS * np.log2(max(ranks, 1)) * ALPHA


def measured(n, horizon, ranks, scene="intact"):
    """Return what ``counts.py`` counts on some ranks."""
    words = [str(ranks), sys.executable, str(COUNTS), str(n), str(horizon), scene]
    command = [str(COUNTS.parents[2] / ".ci" / "mpirun"), *words]
    return json.loads(subprocess.run(command, check=True, capture_output=True, text=True).stdout.splitlines()[-1])


def table(title, sizes, horizon, c_op, c_cycle):
    """Print the parts of an iteration and the efficiency for (n, ranks)."""
    print(title)
    print("   ranks  particles/rank   work ms  messages ms  bytes ms  reductions ms   efficiency")
    first = None
    for n, ranks in sizes:
        parts = np.array(iteration(n, horizon, ranks, c_op, c_cycle))
        ideal = parts[0] if first is None else first / (ranks * sizes[0][0] ** 3 / (sizes[0][1] * n**3)) * 1.0
        first = parts[0] if first is None else first
        print(
            f"{ranks:8d} {n**3 / ranks:15.0f} {1e3 * parts[0]:9.3f} {1e3 * parts[1]:12.3f} {1e3 * parts[2]:9.3f} "
            f"{1e3 * parts[3]:14.3f} {100 * ideal / parts.sum():11.0f} %"
        )


def counted_only(n, horizon, scene):
    """Print what is counted on 1 to 16 ranks."""
    print("ranks  particles  imbalance  ghosts of a rank  from ranks  iterations  exchanges, reductions an iteration")
    for ranks in (1, 2, 4, 8, 16):
        found = measured(n, horizon, ranks, scene)
        print(
            f"{ranks:5d} {found['particles']:10d} {found['imbalance']:10.2f} {found['ghosts']:17d} "
            f"{found['neighbours']:11d} {found['linear_iterations']:11d} {found['exchanges']:11.1f} "
            f"{found['reductions']:11.1f}"
        )


def main():
    # No MPI in this process: it starts others that have it.
    words = sys.argv[1:]
    n = int(words[0]) if words else 32
    horizon = float(words[1]) if len(words) > 1 else 3.015
    if len(words) > 2:
        counted_only(n, horizon, words[2])
        return
    one = measured(n, horizon, 1)
    c_op, c_cycle = one["operator"] / n**3, one["cycle"] / n**3
    print(f"{n}^3 particles, horizon {horizon}: operator {1e6 * c_op:.2f} us, cycle {1e6 * c_cycle:.2f} us a particle")
    print("ranks   ghosts of a rank, at most      from ranks      exchanges, reductions an iteration")
    print("        model  counted  ratio       model counted         model counted  model counted")
    for ranks in (2, 4, 8):
        counted, (ghosts, neighbours) = measured(n, horizon, ranks), halo(n, horizon, ranks)
        print(
            f"{ranks:5d} {ghosts:8.0f} {counted['ghosts']:8d} {counted['ghosts'] / ghosts:6.2f} {neighbours:11d} "
            f"{counted['neighbours']:7d} {2 * APPLIED:13d} {counted['exchanges']:7.1f} {REDUCTIONS:6d} "
            f"{counted['reductions']:7.1f}"
        )
    print(f"alpha {1e6 * ALPHA:.1f} us, beta {BETA / 1e9:.0f} GB/s")
    table("strong scaling of 400^3", [(400, p) for p in (64, 512, 1024, 4096, 8192, 16384)], horizon, c_op, c_cycle)
    weak = [(round(25.0 * p ** (1.0 / 3.0)), p) for p in (1, 8, 64, 512, 4096, 16384)]
    table("weak scaling of 25^3 a rank", weak, horizon, c_op, c_cycle)


main()
