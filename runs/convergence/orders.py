"""Orders of convergence of standard and conforming weights: python runs/convergence/orders.py [folder [case ...]].

Leaves ``orders.csv`` with the errors of three sizes, the slopes of the lines that fit their logarithms best and those
between the last two, ``numbers.json`` with the first slopes, and a picture per case and cloud. Errors of shaken clouds
are the roots of the mean squares over ``SEEDS``: those of one cloud scatter. A row whose weights were refused has no
numbers. It takes about ten minutes.
"""

import re
import sys
from pathlib import Path

import numpy as np

sys.path[:0] = [str(Path(__file__).parent), str(Path(__file__).parent.parent)]
import study

words = study.start("convergence")

import bending
import circle
import cook
import hole
import inflation
import manufactured
import ring

import pdpetsc as pd

SILLING = {"scheme": "correspondence", "horizon": 2.015, "G": 0.5}
SUB_HORIZONS = {"scheme": "sub_horizons", "horizon": 1.5, "G": 0.0}
BOND_ASSOCIATED = {"scheme": "bond_associated", "horizon": 2.015, "G": 0.0}
STRESS_POINTS = {"scheme": "stress_points", "horizon": 2.015, "G": 0.0}
TWO = {"Silling": SILLING, "sub-horizons": SUB_HORIZONS}
ALL = TWO | {"bond-associated": BOND_ASSOCIATED, "stress points": STRESS_POINTS}
# The sectors of a family need more room on irregular clouds, in space, and among cells that are longer than wide; on a
# long strip their weights at horizon 1.5 are found to 2e-9 only.
WIDE = {"Silling": SILLING, "sub-horizons": SUB_HORIZONS | {"horizon": 2.015}}
LONG_CELLS = {"Silling": SILLING, "sub-horizons": SUB_HORIZONS | {"horizon": 2.5}}
NODES = {"Silling": SILLING, "sub-horizons": SUB_HORIZONS | {"horizon": 2.5}}
COOK = {"Silling": SILLING | {"horizon": 2.5}, "sub-horizons": SUB_HORIZONS | {"horizon": 3.015}}
PLANE, SPACE = (16, 32, 64), (5, 10, 15)
SHAKEN = {"shake": 0.2}
SQUARE = {
    "lattice": (PLANE, ALL, {}),
    "shaken": (PLANE, ALL, SHAKEN),
    "nodes of triangles": (PLANE, WIDE, SHAKEN | {"cloud": "simplices"}),
}
ROUND = {
    "quads": (PLANE, LONG_CELLS, {"mesh": "quads"}),
    "triangles": (PLANE, WIDE, {"mesh": "triangles"}),
    "nodes of triangles": (PLANE, NODES, {"mesh": "nodes"}),
}
# The module of each case, and its clouds with the sizes, methods and parameters of each.
CASES = {
    "bending": (bending, SQUARE),
    "bending in space": (
        bending, {
            "lattice": (SPACE, WIDE, {"dim": 3}),
            "shaken": (SPACE, WIDE, {"dim": 3} | SHAKEN),
            "nodes of tetrahedra": (SPACE, WIDE, {"dim": 3, "cloud": "simplices"} | SHAKEN),
        },
    ),
    "manufactured": (manufactured, SQUARE),
    "clamped": (
        manufactured, {
            "1 column of cells": (PLANE, TWO, {"held": 1}),
            "2 columns of cells": (PLANE, TWO, {"held": 2}),
            "nodes on the side": (PLANE, WIDE, {"held": 1, "cloud": "nodes"} | SHAKEN),
            "triangles' nodes on the side": (PLANE, WIDE, {"held": 1, "cloud": "simplices"} | SHAKEN),
        },
    ),
    "ring": (ring, ROUND | {"staircase": (PLANE, LONG_CELLS, {"mesh": "lattice"})}),
    "hole": (hole, ROUND),
    "inflation": (inflation, ROUND),
    "circle": (
        circle, {
            "lattice": ((6, 12, 24), WIDE, {}),
            "nodes of triangles": ((6, 12, 24), NODES, {"cloud": "simplices"} | SHAKEN),
        },
    ),
    "cook": (
        cook, {
            "nodes": (PLANE, COOK, {}),
            "nodes of triangles": (PLANE, COOK, {"cloud": "simplices"} | SHAKEN),
            "cells, 3 columns held": ((8, 16, 32), COOK, {"cloud": "cells"}),
        },
    ),
}  # fmt: skip
SEEDS = (0, 1, 2)
ERRORS = ("error_u", "error_stress", "error_surface_stress")


def measured(folder, module, n, parameters, seeds):
    """Return the root of the mean square of each error over the seeds; nothing where one is refused or fails."""
    found = []
    for seed in seeds:
        try:
            done = study.run(folder, module.case(n=n, seed=seed, **parameters))
        except pd.CaseError as error:
            print(f"  n = {n}: {str(error)[:120]} ...", flush=True)
            return None
        if done is None:
            return None
        found.append(done[1]["results"])
    return {name: float(np.sqrt(np.mean([row[name] ** 2 for row in found]))) for name in found[0]}


def order(sizes, values):
    """Return the slope of the line that fits the logarithms best, with the sign of an order."""
    return float(-np.polyfit(np.log(sizes), np.log(values), 1)[0])


def study_of(folder, name):
    """Run one case; return rows of the table, orders by name, errors of the displacement as curves of each cloud."""
    module, clouds = CASES[name]
    rows, numbers, curves = [], {}, {}
    for cloud, (sizes, methods, parameters) in clouds.items():
        # Only what is random has seeds.
        seeds = SEEDS if "shake" in parameters or parameters.get("mesh") in ("triangles", "nodes") else SEEDS[:1]
        for weights in pd.WEIGHTS:
            for method, how in methods.items():
                all_of_it = parameters | how | {"weights": weights}
                found = []
                for n in sizes:
                    found.append(measured(folder, module, n, all_of_it, seeds))
                    if found[-1] is None:
                        break
                if found[-1] is None:
                    rows.append((name, cloud, weights, method, "refused"))
                    print(*rows[-1], sep=" | ", flush=True)
                    continue
                for error in (error for error in ERRORS if error in found[0]):
                    values = [of_size[error] for of_size in found]
                    slope = order(sizes, values)
                    rows.append((name, cloud, weights, method, error, *values, slope, order(sizes[1:], values[1:])))
                    print(*(f"{v:.3g}" if isinstance(v, float) else v for v in rows[-1]), sep=" | ", flush=True)
                    numbers[f"{name}, {cloud}, {weights}, {method}, {error}"] = slope
                of_u = [of_size["error_u"] for of_size in found]
                curves.setdefault(cloud, {})[f"{weights}, {method}"] = sizes, of_u
    return rows, numbers, curves


def main():
    names = study.chosen(words, CASES, "case")
    folder = study.folder_for(words, "out/convergence")
    rows, numbers = [], {}
    for name in names:
        found, slopes, curves = study_of(folder, name)
        rows += found
        numbers |= slopes
        for cloud, of_cloud in curves.items():
            sizes = np.array(next(iter(of_cloud.values()))[0], dtype=float)
            top = max(values[0] for _, values in of_cloud.values())
            powers = {f"order {power}": (sizes, top * (sizes[0] / sizes) ** power) for power in (1, 2)}
            study.write_curves(
                folder, re.sub(r"\W+", "_", f"{name}_{cloud}"), f"{name}, {cloud}: relative error of the displacement",
                ["n", "error"], of_cloud | powers, reference=powers, xscale="log", yscale="log",
            )  # fmt: skip
    header = ("case", "cloud", "weights", "method", "error", "size 1", "size 2", "size 3", "order", "last order")
    study.write_table(folder, "orders", header, rows)
    study.write_numbers(folder, numbers)


if __name__ == "__main__":
    main()
