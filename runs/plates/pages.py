"""Pictures of the pages on methods: python runs/plates/pages.py [folder] draws one a method (docs/theory).

Left the singular bar at horizon 3.015 dx (oscillation of the displacement on its linear half), right the displacement
along the plate with a diamond hole at 1.1 diagonals, both beside plain correspondence.
"""

import dataclasses
import shutil
import sys
from pathlib import Path

sys.path.insert(0, str(Path(__file__).parent.parent))
import study

words = study.start("plates", "singular_bar")

import bar
import diamond_hole
import plate
from matplotlib.figure import Figure

import pdpetsc as pd

PAGES = {
    "correspondence": ({}, {}),
    "stress_points": ({"scheme": "stress_points"},) * 2,
    "sub_horizons": ({"scheme": "sub_horizons"},) * 2,
    "corrected": ({"scheme": "corrected", "order": 6}, {"scheme": "corrected"}),
    "higher_order": ({"scheme": "higher_order", "order": 5}, {"scheme": "higher_order"}),
    "bond_associated": ({"scheme": "bond_associated"},) * 2,
    "silling": ({"control": "silling"},) * 2,
    "littlewood": ({"control": "littlewood"},) * 2,
    "wan": ({"control": "wan"},) * 2,
    "springs": ({"control": "springs"},) * 2,
    "averaged_displacement": ({"control": "averaged_displacement"},) * 2,
    "smoothed_displacement": ({}, None),
}
# What no word of the cases stands for.
CHANGES = {"smoothed_displacement": {"scheme": pd.SmoothedDisplacement()}}


def values(folder, case, line):
    along = plate.Profile(line, plate.displacement_x)
    case.history["along"] = along
    study.run(folder, case)
    return along.s, along.v


def main():
    folder = study.folder_for(words, "docs/pictures")
    n = 500
    whole = plate.Line("bar", 0, {}, 1.0 / (n - 1))
    wide = {"n": n, "horizon": 3.015}
    plain_bar = values(folder, bar.case(**wide), whole)
    case = diamond_hole.case()
    line = case.history["u_amplitude"].line
    plain_plate = values(folder, case, line)
    for name, (on_bar, on_plate) in PAGES.items():
        figure = Figure(figsize=(10.0, 3.4), layout="constrained")
        left, right = figure.subplots(1, 2)
        s, plain = plain_bar
        linear = (s > 0.1) & (s < 0.4)
        left.plot(s[linear], (plain - bar.BAR.alpha * s)[linear] / bar.BAR.end, color="0.7", label="correspondence")
        if name != "correspondence":
            s, u = values(folder, dataclasses.replace(bar.case(**wide, **on_bar), **CHANGES.get(name, {})), whole)
            left.plot(s[linear], (u - bar.BAR.alpha * s)[linear] / bar.BAR.end, label=name)
        left.set(xlabel="x / L", ylabel="(u - u_exact) / u_end", title="singular bar, linear half")
        if on_plate is None:
            right.axis("off")
        else:
            right.plot(*plain_plate, color="0.7", label="correspondence")
            if name != "correspondence":
                s, u = values(folder, diamond_hole.case(**on_plate), line)
                right.plot(s, u, label=name)
            right.plot(
                s if name != "correspondence" else plain_plate[0],
                line.reference("u", plain_plate[0]),
                "k--",
                label="FE",
            )
            right.set(xlabel="x", ylabel="u_x", title="plate with diamond hole, middle line")
            right.legend(fontsize=8)
        left.legend(fontsize=8)
        figure.savefig(folder / f"{name}.png", dpi=80)
    shutil.rmtree(folder / "last_run")


if __name__ == "__main__":
    main()
