"""What conforming weights cost: python runs/bench/conforming.py [largest number of particles] [folder].

Blocks under uniform tension on lattices and on clouds shaken by 0.3 spacings, linear elastic, Silling's control at
horizon 2.015: the seconds that the weights add to the set-up, over those of one elastic solve of the same body, medians
of three runs one after the other. Bodies of more than some hundred thousand particles need some GiB of memory.
"""

import dataclasses
import sys
from pathlib import Path

import numpy as np

sys.path.insert(0, str(Path(__file__).parent.parent))
import study

words = study.start("patch")

import tension

import pdpetsc as pd

REPEATS = 3
# Particles a side of a block 2 x 1 (x 1).
SIZES = {2: (50, 100, 200, 400, 700), 3: (12, 20, 37, 63, 79)}


def timings(folder, **parameters):
    """Return the seconds of set-up and solve of a run, and what the log says of the weights."""
    case = tension.case(distribution="surface", horizon=2.015, **parameters)
    case = dataclasses.replace(case, material=pd.LinearElastic(E=tension.E, nu=tension.NU), fields=[], checkpoints=0)
    summary = pd.run(case, folder / "last_run").summary
    seconds = summary["timings"]
    return seconds["model"], seconds["solve"], summary["particles"], summary["scheme"]["note"]


def main():
    most = int(float(words[0])) if words else 100_000
    folder = study.folder_for(words[1:], "out/bench_conforming")
    rows = []
    for dim, sizes in SIZES.items():
        for n in sizes:
            if 2 * n**dim > most:
                continue
            for shake in (0.0, 0.3):
                given = {"dim": dim, "n": n, "shake": shake}
                timings(folder, **given, weights="conforming")  # fills caches
                pairs = [
                    [timings(folder, **given, weights=weights) for weights in ("standard", "conforming")]
                    for _ in range(REPEATS)
                ]
                added = float(np.median([two[0] - one[0] for one, two in pairs]))
                solve = float(np.median([one[1] for one, _ in pairs]))
                particles, note = pairs[0][1][2:]
                iterations = int(note.split(" iterations")[0].split()[-1])
                rows.append((dim, particles, shake, iterations, added, solve, added / solve))
                print(
                    f"{dim}D {particles:8d} particles, shaken by {shake}: {iterations:4d} iterations, {added:.2f} s "
                    f"over {solve:.2f} s of a solve: {added / solve:.2f}",
                    flush=True,
                )
    header = ["dim", "particles", "shake", "iterations", "added seconds", "solve seconds", "ratio"]
    study.write_table(folder, "conforming", header, rows)


if __name__ == "__main__":
    main()
