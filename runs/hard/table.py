"""What every method makes of hard cases: python runs/hard/table.py [folder].

Leaves ``hard.csv``: converged or not (with the message), Newton iterations, cut-backs, error against the law itself and
spread of the stress, for random and graded lattices, nearly incompressible material, stretch to 3, compression to 0.6
(the surface of a neo-Hookean block wrinkles at 0.54), horizons from 1.015 to 6 and bodies too thin for a gradient.
"""

import sys
from pathlib import Path

sys.path.insert(0, str(Path(__file__).parent.parent))
import study

words = study.start("hard")

import block

import pdpetsc as pd

METHODS = [(scheme, "none") for scheme in pd.SCHEMES]
METHODS += [("correspondence", control) for control in pd.CONTROLS if control != "none"]
CASES = {
    "lattice, stretch 1.2": {},
    "positions shaken by 0.1": {"shake": 0.1},
    "positions shaken by 0.3": {"shake": 0.3},
    "spacing graded 1 to 3": {"grading": 3.0},
    "nu = 0.499": {"nu": 0.499},
    "stretch 3": {"law": "neo_hookean", "stretch": 3.0, "steps": 10},
    "compression to 0.6": {"law": "neo_hookean", "stretch": 0.6, "steps": 10, "nx": 12, "ny": 24},
    "shaken by 0.3, stretch 3": {"law": "neo_hookean", "shake": 0.3, "stretch": 3.0, "steps": 10},
    "horizon 1.015": {"horizon": 1.015},
    "horizon 3.015": {"horizon": 3.015},
    "horizon 6": {"horizon": 6.0},
    "two particles thick": {"ny": 2},
    "one particle thick": {"ny": 1},
}
SHORT = 110


def attempt(folder, parameters):
    """Return status, Newton iterations, cut-backs, error and spread."""
    try:
        done = study.run(folder, block.case(**parameters))
    except pd.CaseError as error:
        return f"refused: {str(error)[:SHORT]}", 0, 0, float("nan"), float("nan")
    if done is None:
        return "did not converge", 0, 0, float("nan"), float("nan")
    _, summary = done
    iterations = sum(step["newton_iterations"] for step in summary["steps"])
    cut_backs = sum(len(step["cut_backs"]) for step in summary["steps"])
    return "converged", iterations, cut_backs, summary["results"]["error"], summary["results"]["spread"]


def main():
    folder = study.folder_for(words, "out/hard")
    rows = []
    for name, parameters in CASES.items():
        for scheme, control in METHODS:
            found = attempt(folder, parameters | {"scheme": scheme, "control": control})
            rows.append((name, scheme, control, *found))
            print(*(f"{value:.3g}" if isinstance(value, float) else value for value in rows[-1]), sep=" | ", flush=True)
    header = ("case", "scheme", "control", "status", "newton_iterations", "cut_backs", "error", "spread")
    study.write_table(folder, "hard", header, rows)


if __name__ == "__main__":
    main()
