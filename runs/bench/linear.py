"""Time one linear solve from scratch: python runs/bench/linear.py [dim] [n] [horizon] [-petsc_option ...].

A block of n^dim particles (2n x n in the plane) of linear elastic material with Silling's control, held at one end and
pulled at the other: pattern, assembly and solve with pdpetsc's default solver for the size, or the one given.
"""

import sys
import tempfile
from pathlib import Path

sys.path.insert(0, str(Path(__file__).parent.parent))
import study

words = study.start()

import pdpetsc as pd  # noqa: E402
from pdpetsc.discrete.communicator import is_root, world  # noqa: E402


def main(dim=2, n=100, horizon=2.015, nu=0.3):
    size = [2.0 * n] + [float(n)] * (dim - 1)
    case = pd.Case(
        particles=pd.Lattice([0.0] * dim, size, 1.0),
        horizon=horizon,
        material=pd.LinearElastic(E=1.0, nu=nu),
        scheme=pd.Correspondence(),
        stabilisation=pd.Silling(0.5),
        conditions=[
            pd.Displacement(pd.region.Slab("x", high=horizon), **dict.fromkeys("xyz"[:dim], 0.0)),
            pd.Traction(pd.region.Slab("x", low=2.0 * n - 1.0), x=1e-3, normal=[1.0] + [0.0] * (dim - 1)),
        ],
        options={"snes_rtol": 1e-8},
    )
    with tempfile.TemporaryDirectory() as folder:
        _, found = study.run(Path(world().bcast(folder)), case)
        world().Barrier()
    if is_root(world()):
        step, timings = found["steps"][0], found["timings"]
        print(f"{found['particles']} particles, horizon {horizon}, {found['ranks']} ranks, {found['solver']}")
        print(f"  matrix {found['matrix_bytes']['predicted'] / 2**20:.0f} MiB")
        print(f"  pattern {timings['pattern']:.2f} s, allocation {timings['allocation']:.2f} s", end="")
        print(f", solve {timings['solve']:.2f} s, {step['linear_iterations']} iterations")
        print(f"  peak memory {sum(found['peak_memory_bytes']) / 2**20:.0f} MiB")


if __name__ == "__main__":
    main(*(kind(word) for kind, word in zip((int, int, float, float), words, strict=False)))
