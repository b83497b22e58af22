"""Load-displacement curves of the fracture cases, with half the spacing and half the step.

    python runs/fracture/figures.py [FOLDER] [plate edge cantilever beam panel ...]

Each is a table and a picture in FOLDER, out/fracture by default. All take about half an hour on one core; plate, edge
and cantilever five minutes.
"""

import dataclasses
import sys
from pathlib import Path

sys.path.insert(0, str(Path(__file__).parent.parent))
import study

WORDS = study.start("fracture")

import double_cantilever
import edge_crack
import l_panel
import notched_beam
import numpy as np
import plate_with_hole

import pdpetsc as pd


def curve(folder, case, x, y, factor=(1.0, 1.0)):
    """Return two columns of the history of a case, times factors."""
    found = study.run(folder, case)
    if found is None:
        raise SystemExit("a case of the figures did not converge")
    return [[scale * value for value in found[0][name]] for name, scale in zip((x, y), factor, strict=True)]


def plate(folder):
    case = plate_with_hole.case
    path = dataclasses.replace(case(), solver=pd.PathFollowing(pd.BondStretch(0.05)))
    curves = {f"{steps} steps": curve(folder, case(steps=steps), "displacement", "force") for steps in (15, 30, 60)}
    curves["path"] = curve(folder, path, "displacement", "force")
    study.write_curves(folder, "plate", "Plate with a hole, 30 x 10", ["end displacement [mm]", "force [N]"], curves)


def edge(folder):
    exact = edge_crack.griffith()
    factor = (1.0, edge_crack.MOST)
    cases = {f"n = {n}": edge_crack.case(n=n, law="brittle") for n in (10, 20, 40)}
    curves = {name: curve(folder, case, "opening", "t", factor) for name, case in cases.items()}
    curves["Griffith"] = [[0.0, 0.2], [1.0, 1.0]]
    title = f"Edge crack: stress over Griffith's, {exact:.3f} MPa"
    study.write_curves(folder, "edge", title, ["displacement [mm]", "stress ratio [-]"], curves, ["Griffith"])


def cantilever(folder):
    H, E, GC = double_cantilever.H, double_cantilever.E, double_cantilever.GC
    cases = {f"n = {n}": double_cantilever.case(n=n) for n in (10, 20)}
    curves = {name: curve(folder, case, "deflection", "load", (2.0, 1.0)) for name, case in cases.items()}
    a = np.linspace(double_cantilever.CRACK, 60.0, 50) + double_cantilever.ROOT * H
    load = np.sqrt(E * GC * H**3 / 12.0) / a
    opening = 8.0 * load * a**3 / (E * H**3)
    curves["beam theory"] = [[0.0, *opening], [0.0, *load]]
    names = ["opening [mm]", "load [N / mm]"]
    study.write_curves(folder, "cantilever", "Double cantilever beam", names, curves, ["beam theory"])


def beam(folder):
    cases = {
        "dx = 10, step 0.02": notched_beam.case(),
        "dx = 10, step 0.01": notched_beam.case(step=0.01),
        "dx = 5, step 0.02": notched_beam.case(n=40),
    }
    curves = {name: curve(folder, case, "deflection", "t", (-1.0, 1.0)) for name, case in cases.items()}
    study.write_curves(folder, "beam", "Notched concrete beam", ["deflection [mm]", "load [kN]"], curves)


def panel(folder):
    cases = {
        "dx = 10, step 0.02": l_panel.case(),
        "dx = 10, step 0.01": l_panel.case(step=0.01),
        "dx = 5, step 0.02": l_panel.case(n=50),
    }
    curves = {name: curve(folder, case, "displacement", "t", (1.0, 10.0)) for name, case in cases.items()}
    study.write_curves(folder, "panel", "L-shaped panel", ["displacement [mm]", "load [kN]"], curves)


FIGURES = {"plate": plate, "edge": edge, "cantilever": cantilever, "beam": beam, "panel": panel}


def main():
    folder = study.folder_for(WORDS, "out/fracture")
    for name in WORDS[1:] or FIGURES:
        FIGURES[name](folder)


if __name__ == "__main__":
    main()
