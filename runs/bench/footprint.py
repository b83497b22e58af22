"""Memory and work a particle of one linear solve: python runs/bench/footprint.py.

For 2D and 3D and horizons 1 to 3, assembled with GAMG and without a matrix on two levels, on one rank: what peak memory
grows by from a smaller to a larger body, per particle, and the core time of one solve from scratch, per particle of the
larger. Energy is that time with the power of a core.
"""

import tempfile
from pathlib import Path

from scaling import measure

SIDES = {2: (100, 220), 3: (14, 22)}
HORIZONS = (1.015, 2.015, 3.015)


def main():
    print("dim  horizon  tangent     KiB/particle  core us/particle  iterations")
    for dim, (small, large) in SIDES.items():
        for horizon in HORIZONS:
            for jacobian, solver in (("assembled", ["-pc_type", "gamg"]), ("matfree", [])):
                with tempfile.TemporaryDirectory() as folder:
                    one, two = (
                        measure(Path(folder), 1, solver, dim=dim, n=n, horizon=horizon, jacobian=jacobian)
                        for n in (small, large)
                    )
                more = two["particles"] - one["particles"]
                memory = (two["peak_MiB"] - one["peak_MiB"]) * 1024 / more
                work = 1e6 * two["scratch"] / two["particles"]
                row = f"{dim:3d} {horizon:8.3f}  {jacobian:10} {memory:13.1f} {work:17.1f}"
                print(f"{row} {two['linear_iterations']:11d}", flush=True)


if __name__ == "__main__":
    main()
