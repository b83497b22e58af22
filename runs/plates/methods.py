"""Every method on the three plates: python runs/plates/methods.py [folder] [square_opening|diamond_hole|brick ...].

Leaves ``methods.csv`` (amplitude and oscillation of displacement and stress along the papers' lines, seconds of set-up
and solve) and the curves along the lines beside finite elements: figures 10 and 13 of Luo and Sundararaghavan, figure 9
of Chowdhury et al.
"""

import sys
from pathlib import Path

sys.path.insert(0, str(Path(__file__).parent.parent))
import study

words = study.start("plates")

import brick  # noqa: E402
import diamond_hole  # noqa: E402
import numpy as np  # noqa: E402
import plate  # noqa: E402
import square_opening  # noqa: E402

import pdpetsc as pd  # noqa: E402
from pdpetsc.compare import working_seconds  # noqa: E402

PLATES = {"square_opening": square_opening, "diamond_hole": diamond_hole, "brick": brick}
HORIZONS = {"square_opening": (1.015, 2.015), "diamond_hole": (1.1, 2.1, 3.1), "brick": (1.015,)}
METHODS = [(scheme, "none") for scheme in pd.SCHEMES]
METHODS += [("correspondence", control) for control in pd.CONTROLS if control != "none"]
DRAWN = [("correspondence", "none"), ("correspondence", "silling"), ("stress_points", "none"), ("sub_horizons", "none")]
# A family per bond of the widest horizon would take gigabytes.
LEFT_OUT = {("diamond_hole", 3.1, "bond_associated")}


def main():
    unknown = [word for word in words[1:] if word not in PLATES]
    if unknown:
        sys.exit(f"There is no plate {unknown[0]}; choose from {', '.join(PLATES)}.")
    folder = study.folder_for(words, "out/plates")
    header = ("plate", "horizon", "scheme", "control", "quantity", "amplitude", "oscillation", "seconds")
    rows = []
    for name in words[1:] or PLATES:
        for horizon in HORIZONS[name]:
            curves = {}
            for scheme, control in METHODS:
                if (name, horizon, scheme) in LEFT_OUT:
                    continue
                case = PLATES[name].case(horizon=horizon, scheme=scheme, control=control)
                amplitudes = {k: q for k, q in case.history.items() if k.endswith("_amplitude")}
                profiles = {k.removesuffix("_amplitude"): plate.Profile(q.line, q.field) for k, q in amplitudes.items()}
                for k, profile in profiles.items():
                    case.history[f"{k}_profile"] = profile
                done = study.run(folder, case)
                for k, profile in profiles.items():
                    if done is None:
                        rows.append((name, horizon, scheme, control, k, np.nan, np.nan, np.nan))
                        continue
                    history, summary = done
                    seconds = working_seconds(summary)
                    found = history[f"{k}_amplitude"][-1], history[f"{k}_oscillation"][-1]
                    rows.append((name, horizon, scheme, control, k, *found, seconds))
                    if (scheme, control) in DRAWN:
                        label = scheme if control == "none" else control
                        curves.setdefault(k, {})[label] = (profile.s, profile.v)
                        exact = amplitudes[f"{k}_amplitude"].line.reference(k, profile.s)
                        curves[k]["finite elements"] = (profile.s, exact)
            for k, drawn in curves.items():
                title = f"{name.replace('_', ' ')}, horizon {horizon}, along the line"
                study.write_curves(folder, f"{name}_{horizon}_{k}", title, ("s", k), drawn, ["finite elements"])
        study.write_table(folder, "methods", header, rows)


if __name__ == "__main__":
    main()
