"""Figures 4 to 7 of the localisation paper: force against inelastic displacement, damage and broken bonds.

    python runs/localisation/figures.py [folder]        # default out/localisation

Figure 4 for n = 10, 20, 50, 100, 200 with constant critical stretch; figures 5 to 7 for n = 100 with constant,
decreasing and increasing critical stretch: curves as CSV, one picture each, and a table of the results of ten
realisations.
"""

import csv
import sys
from pathlib import Path

sys.path.insert(0, str(Path(__file__).parent.parent))
import study

words = study.start("localisation")

import numpy as np  # noqa: E402
from periodic_cell import E, case  # noqa: E402

import pdpetsc as pd  # noqa: E402
from pdpetsc.discrete.communicator import is_root, world  # noqa: E402

SIZES = (10, 20, 50, 100, 200)
REALISATIONS = 10
NAMES = ("max_force", "final_displacement", "max_damage", "dissipated", "events")


def run(folder, n, critical, seed):
    """Return results, inelastic displacement and force over E A of every event, and the broken bonds."""
    scratch = folder / "last_run"
    found = pd.run(case(n=n, critical=critical, seed=seed), output=scratch, quiet=True)
    with (scratch / "history.csv").open() as file:
        rows = list(csv.DictReader(file))
    u, force = (np.array([float(row[name]) for row in rows]) for name in ("displacement", "force"))
    with (scratch / "broken_bonds.csv").open() as file:
        bonds = np.array([[float(row["x"]), float(row["length"])] for row in csv.DictReader(file)])
    # After the last bond the displacement grows without force.
    return found, (u - force * u[1] / force[1])[:-1], force[:-1] / E, bonds


def damage(bonds, n):
    """Return the sections between particles and the share of broken bonds that cross each."""
    m = round(0.1 * n)
    section = (np.arange(n) + 1.0) / n
    apart = np.abs((bonds[:, 0, None] - section + 0.5) % 1.0 - 0.5)
    return section, (apart < 0.5 * bonds[:, 1, None]).sum(axis=0) / (0.5 * m * (m + 1))


def picture(folder, name, title, curve, bonds, n):
    """Draw final damage, broken bonds and force against inelastic displacement as the paper does."""
    from matplotlib.figure import Figure

    figure = Figure(figsize=(10.0, 5.0), layout="constrained")
    figure.suptitle(title)
    plots = figure.subplot_mosaic([["profile", "path"], ["places", "path"]])
    profile, places, path = (plots[key] for key in ("profile", "places", "path"))
    profile.set(ylabel="damage [-]", xlim=(0, 1), ylim=(0, 1.05))
    section, share = damage(bonds, n)
    profile.step(section, share, where="mid")
    places.set(xlabel="x / l", ylabel="length / l", xlim=(0, 1), ylim=(0, 0.11))
    places.plot(bonds[:, 0] % 1.0, bonds[:, 1], ".", markersize=3)
    path.set(xlabel="inelastic displacement / l [1e-2]", ylabel="force / E A [1e-2]")
    path.plot(100.0 * curve[0], 100.0 * curve[1], linewidth=0.8)
    path.grid(alpha=0.3)
    figure.savefig(folder / f"{name}.png", dpi=130)


def main():
    folder = study.folder_for(words, "out/localisation")
    curves = {}
    for n in SIZES:
        _, u, force, _ = run(folder, n, "constant", 1)
        curves[f"n = {n}"] = (100.0 * u, 100.0 * force)
    columns = ["inelastic displacement / l [1e-2]", "force / E A [1e-2]"]
    study.write_curves(folder, "figure_4", "Constant critical stretch", columns, curves)
    table = []
    for number, critical in enumerate(("constant", "decreasing", "increasing"), start=5):
        for seed in range(1, REALISATIONS + 1):
            found, u, force, bonds = run(folder, 100, critical, seed)
            table.append((critical, seed, *(found[name] for name in NAMES)))
            if seed == 1:
                name = f"figure_{number}"
                study.write_table(folder, f"{name}_curve", columns, zip(100.0 * u, 100.0 * force, strict=True))
                study.write_table(folder, f"{name}_broken", ["x / l", "length / l"], bonds)
                study.write_table(folder, f"{name}_damage", ["x / l", "damage"], zip(*damage(bonds, 100), strict=True))
                if is_root(world()):
                    picture(folder, name, f"Critical stretch {critical}", (u, force), bonds, 100)
                    print(f"{folder / name}.png and three tables", flush=True)
    study.write_table(folder, "realisations", ["critical", "seed", *NAMES], table)
    for n in SIZES:
        for critical in ("constant", "decreasing", "increasing"):
            means = run(folder, n, critical, 1)[0]
            if is_root(world()):
                print(f"n = {n:3d} {critical:10s}", ", ".join(f"{name} {means[name]:.6g}" for name in NAMES))


main()
