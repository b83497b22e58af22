"""Elastic-plastic plate with every cure that Yaghoobi and Chorzepa's text speaks of: python runs/plasticity/methods.py.

    python runs/plasticity/methods.py [folder] [spacing ...] [of_table]

``wide`` is horizon 2.015 dx, ``wider`` 3.015 dx, at the largest spacing only; else it is 1.015 dx, where higher-order
weights are those of plain correspondence. Leaves ``methods.csv`` (the results of ``plate.py`` against finite elements
with the same law), the curves of force over displacement, of sigma_yy and of plastic strain along the x axis, and
``numbers.json``, for the spacings 4 and 2 mm or those that are named. Names of numbers end in the method and the
spacing. With ``of_table`` methods are left out of which the table of the papers has no numbers.
"""

import dataclasses
import sys
from pathlib import Path

sys.path.insert(0, str(Path(__file__).parent.parent))
import study

words = study.start("plasticity")

import numpy as np
import plate

import pdpetsc as pd

METHODS = {
    "plain": {"scheme": "correspondence"},
    "silling": {"scheme": "correspondence", "control": "silling"},
    "points": {"scheme": "stress_points"},
    "sectors": {},
    "sectors_whole_cells": {"cells": "whole"},
    "wide_plain": {"scheme": "correspondence", "horizon": 2.015},
    "wide_higher_order": {"scheme": "higher_order", "horizon": 2.015},
    "wide_sectors": {"horizon": 2.015},
    "wider_plain": {"scheme": "correspondence", "horizon": 3.015},
    "wider_higher_order_5": {"scheme": "higher_order", "horizon": 3.015, "order": 5},
}


NOT_IN_TABLE = ("wide_sectors",)
# More accuracy changes numbers by less than 2e-5 of themselves.
ACCURACY = {"snes_rtol": 1e-6}


class Curve(pd.Quantity):
    """Keeps the values along the x axis; its own value is their number."""

    def __init__(self, along):
        self.along = along
        self.x = self.v = np.zeros(0)

    def evaluate(self, solution):
        self.x, self.v, _ = self.along.values(solution)
        return float(len(self.x))


def main():
    folder = study.folder_for(words, "out/plasticity")
    left_out = NOT_IN_TABLE if "of_table" in words[1:] else ()
    try:
        spacings = [float(word) for word in words[1:] if word != "of_table"] or [4.0, 2.0]
    except ValueError:
        sys.exit(f"The words after the folder are spacings in mm, not {' '.join(words[1:])}.")
    rows, numbers = [], {}
    exact = plate.reference()
    for dx in spacings:
        forces, along = {}, {"stress": {}, "plastic": {}}
        for name, words_of in METHODS.items():
            if name in left_out or (name.startswith("wider") and dx < max(spacings)):
                continue
            case = plate.case(dx=dx, **words_of)
            kept = {field: Curve(plate.MeanError(dx, field)) for field in along}
            more = {f"kept_{field}": curve for field, curve in kept.items()}
            done = study.run(folder, dataclasses.replace(case, history={**case.history, **more}, options=ACCURACY))
            if done is None:
                sys.exit(f"The plate with dx = {dx:g} and {name} did not converge; run it by itself to see why.")
            history, summary = done
            found = summary["results"]
            keys = [key for key in found if not key.startswith("kept_")]
            numbers |= {f"{key}_{name}_{dx:g}": found[key] for key in keys}
            rows.append((name, dx, *(found[key] for key in keys)))
            forces[name] = ([plate.PULL * t for t in history["t"]], [force / 1e3 for force in history["force"]])
            for field, curve in kept.items():
                along[field][name] = (curve.x, curve.v)
        label = "finite elements"
        forces[label] = ([plate.PULL * t for t in exact["t"]], [force / 1e3 for force in exact["force"]])
        axes = ("displacement / mm", "force / kN")
        study.write_curves(folder, f"force_{dx:g}", f"Elastic-plastic plate, dx = {dx:g} mm", axes, forces, [label])
        for field, text in (("stress", "sigma_yy / MPa"), ("plastic", "plastic strain")):
            along[field][label] = (exact["x"], exact[field])
            title = f"Elastic-plastic plate, y = 0, dx = {dx:g} mm"
            study.write_curves(folder, f"{field}_{dx:g}", title, ("x / mm", text), along[field], [label])
    study.write_table(folder, "methods", ("method", "dx", *keys), rows)
    study.write_numbers(folder, numbers)


if __name__ == "__main__":
    main()
