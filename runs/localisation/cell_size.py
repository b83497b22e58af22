"""Square periodic cells of growing size, pulled apart: strength and fracture energy against cell size.

    python runs/localisation/cell_size.py [folder]        # default out/cell_size

Spacing and horizon stay; the cell grows from 6 to 24 spacings. Three kinds of critical stretch, bonds that snap and
bonds that soften to three times their critical stretch. The fracture energy is what is dissipated per section of the
cell; if damage is confined to one section it does not grow with the cell, if it spreads it does. Compared with the
energy of breaking every bond across a plane between two layers, once.
"""

import sys
from pathlib import Path

sys.path.insert(0, str(Path(__file__).parent.parent))
import study

words = study.start("localisation")

import numpy as np
from cell_2d import case

import pdpetsc as pd
from pdpetsc.discrete.communicator import is_root, world

DX = 0.05
SIZES = (6, 8, 12, 16, 24)
KINDS = [(critical, ratio) for critical in ("constant", "decreasing", "increasing") for ratio in (1.0, 3.0)]
REALISATIONS = 3


def cut_energy(n, critical, ratio):
    """Return the energy per length of breaking every bond across a plane between two layers."""
    problem = study.build(case(n, n * DX, critical=critical, ratio=ratio, perturbation=0.0))
    each = 0.5 * problem.material_term.k * problem.damage.limit**2 * ratio
    # A bond that advances by a layers is cut by a of the n planes; bonds count from both ends.
    layers = np.abs(problem.body.families.bonds(problem.body.cloud.x)[:, 0]) / DX
    return float(each @ layers) / n / (n * DX)


def main():
    folder = study.folder_for(words, "out/cell_size")
    rows, energies, strengths = [], {}, {}
    for critical, ratio in KINDS:
        name = f"{critical}, {'snap' if ratio == 1.0 else 'soften'}"
        means = []
        for n in SIZES:
            found = [
                pd.run(case(n, n * DX, critical=critical, ratio=ratio, seed=seed), output=folder / "last_run")
                for seed in range(1, REALISATIONS + 1)
            ]
            mean = {key: float(np.mean([one[key] for one in found])) for key in found[0]}
            spread = float(np.std([one["fracture_energy"] for one in found]))
            means.append((mean["fracture_energy"], mean["max_stress"]))
            rows.append((critical, ratio, n, *mean.values(), spread))
            if is_root(world()):
                print(name, n, ", ".join(f"{key} {value:.5g}" for key, value in mean.items()), flush=True)
        one_cut = cut_energy(12, critical, ratio)
        energies[name] = (SIZES, [energy / one_cut for energy, _ in means])
        strengths[name] = (SIZES, [stress for _, stress in means])
    header = ["critical", "ratio", "n", "max_stress", "fracture_energy", "broken_bonds", "events", "spread of energy"]
    study.write_table(folder, "cell_size", header, rows)
    columns = ["cell size / spacing", "fracture energy / energy of one plane cut"]
    study.write_curves(folder, "fracture_energy", "Fracture energy of a square cell", columns, energies)
    study.write_curves(folder, "strength", "Strength of a square cell", [columns[0], "largest stress"], strengths)


main()
