"""Time and memory of one linear solve against size: python runs/bench/scaling.py [folder] [largest].

Cubes and squares from 10^4 particles up to ``largest`` (110000 where absent; 1000000 takes 20 GiB and ten minutes) at
horizons 2.015 and 3.015 on one and two ranks, each in a process of its own. Leaves ``scaling.csv`` and pictures of
seconds, iterations and memory against the number of particles; the exponent of a line is printed with it.
"""

import json
import os
import subprocess
import sys
from pathlib import Path

import numpy as np

sys.path.insert(0, str(Path(__file__).parent.parent))
import study

HERE = Path(__file__).parent
SIDES = {2: (100, 201, 330, 1000), 3: (22, 34, 47, 100)}
HORIZONS = (2.015, 3.015)
# One rank holds no more than this.
MOST_ON_ONE = 150_000


def measure(folder, ranks, options=(), checkout=HERE.parents[1], **parameters):
    """Return what ``linear.py`` of a checkout measures in a process of its own on some ranks."""
    found, checkout = (folder / "found.json").resolve(), Path(checkout).resolve()
    given = [f"{name}={value}" for name, value in parameters.items()]
    command = [sys.executable, str(checkout / "runs" / "bench" / "linear.py"), *given, f"json={found}", *options]
    if ranks > 1:
        command = [str(HERE.parents[1] / ".ci" / "mpirun"), str(ranks), *command]
    environment = {**os.environ, "PYTHONPATH": str(checkout)}
    subprocess.run(command, check=True, stdout=subprocess.DEVNULL, cwd=checkout, env=environment)
    return json.loads(found.read_text())


def exponent(n, seconds):
    """Return the slope of a line through the logarithms."""
    return float(np.polyfit(np.log(n), np.log(seconds), 1)[0])


def main():
    # No MPI in this process before the others, which have it, are done.
    words = sys.argv[1:]
    folder = Path(words[0] if words else "out/scaling")
    folder.mkdir(parents=True, exist_ok=True)
    largest = int(words[1]) if len(words) > 1 else 110_000
    rows, seconds, memory, iterations = [], {}, {}, {}
    for dim, sides in SIDES.items():
        for horizon in HORIZONS:
            for ranks in (1, 2):
                label = f"{dim}D, horizon {horizon}, {ranks} rank{'s' if ranks > 1 else ''}"
                n, t, m, its = [], [], [], []
                for side in sides:
                    if side**dim > largest or (ranks == 1 and side**dim > MOST_ON_ONE):
                        continue
                    found = measure(folder, ranks, dim=dim, n=side, horizon=horizon)
                    n.append(found["particles"])
                    t.append(found["scratch"])
                    m.append(found["peak_MiB"])
                    its.append(found["linear_iterations"])
                    rows.append((dim, horizon, ranks, n[-1], t[-1], its[-1], m[-1], *found["seconds"].values()))
                seconds[label], memory[label], iterations[label] = (n, t), (n, m), (n, its)
                times = ", ".join(f"{a} {b:.2f} s" for a, b in zip(n, t, strict=True))
                each = (m[-1] - m[0]) / (n[-1] - n[0]) * 1024
                print(
                    f"{label}: {times}; N^{exponent(n, t):.2f}, {min(its)} to {max(its)} iterations, {each:.1f} KiB a "
                    f"particle",
                    flush=True,
                )
    header = ["dim", "horizon", "ranks", "particles", "seconds", "iterations", "peak_MiB", *found["seconds"]]
    study.write_table(folder, "scaling", header, rows)
    scales = {"xscale": "log", "yscale": "log"}
    study.write_curves(folder, "seconds", "One linear solve from scratch", ("particles", "seconds"), seconds, **scales)
    study.write_curves(folder, "memory", "Peak memory", ("particles", "MiB"), memory, **scales)
    study.write_curves(folder, "iterations", "To 1e-8", ("particles", "iterations"), iterations, xscale="log")


if __name__ == "__main__":
    main()
