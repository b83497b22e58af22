"""Preconditioners without a matrix beside each other: python runs/bench/levels.py [ranks] [scale] [folder].

One linear solve from scratch to 1e-8, each the median of three in one process: on two levels, with a cycle of them
(``-pc_mg_type multiplicative``), and GAMG on the matrix of nearest neighbours (``-pc_type gamg``). ``scale`` multiplies
the sides of the bodies. Leaves ``levels.csv``.
"""

import sys
from pathlib import Path

sys.path[:0] = [str(Path(__file__).parent), str(Path(__file__).parent.parent)]
import study
from scaling import measure

CYCLE = ["-pc_mg_type", "multiplicative"]
# Nearly incompressible bodies need cycles of several steps on a wider part of the spectrum.
LONG = [*CYCLE, "-mg_levels_ksp_max_it", "4", "-mg_levels_ksp_chebyshev_esteig", "0,0.05,0,1.1"]
SUB = {"scheme": "sub_horizons", "G": 0.0}
BODIES = {
    "2D, horizon 2.015": (dict(dim=2, n=201, horizon=2.015), CYCLE),
    "2D, horizon 3.015": (dict(dim=2, n=201), CYCLE),
    "2D, sub-horizons": (dict(dim=2, n=201, **SUB), CYCLE),
    "2D, crack over 60 %": (dict(dim=2, n=201, crack=0.6), CYCLE),
    "2D, 30 % of the bonds broken": (dict(dim=2, n=100, broken=0.3), CYCLE),
    "2D, nu = 0.45": (dict(dim=2, n=201, nu=0.45), CYCLE),
    "2D, nu = 0.499": (dict(dim=2, n=201, nu=0.499), LONG),
    "3D, horizon 2.015": (dict(dim=3, n=32, horizon=2.015), CYCLE),
    "3D, horizon 3.015": (dict(dim=3, n=32), CYCLE),
    "3D, sub-horizons": (dict(dim=3, n=24, **SUB), CYCLE),
    "3D, crack over 60 %": (dict(dim=3, n=32, crack=0.6), CYCLE),
    "3D, nu = 0.45": (dict(dim=3, n=32, nu=0.45), CYCLE),
    "3D, nu = 0.499": (dict(dim=3, n=24, nu=0.499), LONG),
}


def main():
    words = sys.argv[1:]
    ranks = int(words[0]) if words else 1
    scale = float(words[1]) if len(words) > 1 else 1.0
    folder = Path(words[2] if len(words) > 2 else "out/levels")
    folder.mkdir(parents=True, exist_ok=True)
    rows = []
    print(f"{'':32} two levels        cycle             nearest neighbours  ratio")
    for name, (given, cycle) in BODIES.items():
        body = {**given, "n": round(scale * given["n"]), "repeats": 3}
        ways = [], cycle, ["-pc_type", "gamg"]
        found = [measure(folder, ranks, options, **body) for options in ways]
        each = [(way["linear_iterations"], way["scratch"]) for way in found]
        ratio = each[2][1] / each[0][1]
        said = "".join(f"{its:5d} {seconds:7.2f} s   " for its, seconds in each)
        print(f"{name:30} {said} {ratio:6.1f}", flush=True)
        rows.append((name, found[0]["particles"], *(value for pair in each for value in pair), ratio))
    header = ["body", "particles", "its", "s", "its_cycle", "s_cycle", "its_near", "s_near", "near_over_two_levels"]
    study.write_table(folder, "levels", header, rows)


if __name__ == "__main__":
    main()
