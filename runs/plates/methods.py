"""Every method on the plates.

    python runs/plates/methods.py [folder] [square_opening | quarter | quarter_cut | diamond_hole | brick ...]

``square_opening`` is the whole plate, ``quarter`` its quarter before mirror planes and ``quarter_cut`` that on symmetry
lines, which are supports that cut families. Leaves ``methods.csv``: amplitude and oscillation of displacement and
stress along the papers' lines, on all of them and away from corners and supports, against finite elements, and seconds
of set-up and solve; and ``numbers.json`` with those of the narrowest horizon. Curves along the lines are in
``figures.py``.
"""

import functools
import sys
from pathlib import Path

sys.path.insert(0, str(Path(__file__).parent.parent))
import study

words = study.start("plates")

import brick
import diamond_hole
import numpy as np
import square_opening

import pdpetsc as pd
from pdpetsc.studies.study import working_seconds

PLATES = {
    "square_opening": (square_opening.case, (1.015, 2.015)),
    "quarter": (functools.partial(square_opening.case, part="quarter"), (1.015, 2.015)),
    "quarter_cut": (functools.partial(square_opening.case, part="quarter_cut"), (1.015, 2.015)),
    "diamond_hole": (diamond_hole.case, (1.1, 2.1, 3.1)),
    "brick": (brick.case, (1.015,)),
}
METHODS = [(scheme, "none") for scheme in pd.SCHEMES]
METHODS += [("correspondence", control) for control in pd.CONTROLS if control != "none"]
# A family per bond of the widest horizon would take gigabytes.
LEFT_OUT = {("diamond_hole", 3.1, "bond_associated")}
PARTS = ("", "_away")


def main():
    names = study.chosen(words, PLATES, "plate")
    folder = study.folder_for(words, "out/plates")
    columns = [f"{number}{part}" for part in PARTS for number in ("amplitude", "oscillation")]
    header = ("plate", "horizon", "scheme", "control", "quantity", *columns, "seconds")
    rows, numbers = [], {}
    for name in names:
        make, horizons = PLATES[name]
        for horizon in horizons:
            for scheme, control in METHODS:
                if (name, horizon, scheme) in LEFT_OUT:
                    continue
                done = study.run(folder, make(horizon=horizon, scheme=scheme, control=control))
                label = scheme if control == "none" else control
                for quantity in ("u", "stress"):
                    if done is None:
                        rows.append((name, horizon, scheme, control, quantity, *[np.nan] * len(columns), np.nan))
                        continue
                    history, summary = done
                    if f"{quantity}_amplitude" not in history:
                        continue
                    found = {column: history[f"{quantity}_{column}"][-1] for column in columns}
                    seconds = working_seconds(summary)
                    rows.append((name, horizon, scheme, control, quantity, *found.values(), seconds))
                    if horizon == horizons[0]:
                        numbers |= {f"{name}_{quantity}_{key}_{label}": value for key, value in found.items()}
            study.write_table(folder, "methods", header, rows)
    study.write_numbers(folder, numbers)


if __name__ == "__main__":
    main()
