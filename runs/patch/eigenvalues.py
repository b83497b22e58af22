"""Smallest non-rigid eigenvalue of a free block: python runs/patch/eigenvalues.py [folder].

Leaves ``eigenvalues.csv``: for every method the smallest eigenvalue of the stiffness matrix above the rigid motions,
over the largest, on a lattice of 8 x 8 (2D) and 5 x 5 x 5 particles (3D), and how many are below 1e-10 of the largest.
"""

import sys
from pathlib import Path

sys.path.insert(0, str(Path(__file__).parent.parent))
import study

words = study.start("patch")

import numpy as np

import pdpetsc as pd

RIGID = {2: 3, 3: 6}
SIDE = {2: 8, 3: 5}


def spectrum(dim, horizon, scheme, control):
    case = pd.Case(
        particles=pd.Lattice((0.0,) * dim, (float(SIDE[dim]),) * dim, 1.0),
        horizon=horizon,
        material=pd.LinearElastic(E=1.0, nu=0.3),
        scheme=scheme,
        control=control,
        conditions=[],
    )
    problem = study.build(case)
    return np.linalg.eigvalsh(study.dense_tangent(problem, np.zeros_like(problem.body.cloud.x)))


def main():
    folder = study.folder_for(words, "out/eigenvalues")
    rows = []
    for dim in (2, 3):
        for horizon in (1.015, 2.015):
            for name, scheme in pd.SCHEMES.items():
                for control, chosen in pd.CONTROLS.items():
                    if chosen is not None and name != "correspondence":
                        continue
                    values = spectrum(dim, horizon, scheme, chosen)
                    least = max(values[RIGID[dim]], 0.0) / values[-1]
                    zero = int((values < 1e-10 * values[-1]).sum()) - RIGID[dim]
                    rows.append((dim, horizon, name, control, least, zero))
                    print(*(f"{v:.3g}" if isinstance(v, float) else v for v in rows[-1]), sep=" | ", flush=True)
    header = ("dim", "horizon", "scheme", "control", "least_over_largest", "zero_energy_modes")
    study.write_table(folder, "eigenvalues", header, rows)


if __name__ == "__main__":
    main()
