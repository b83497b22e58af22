"""Newton iterations and failures of every line search on the verification cases: python runs/bench/nonlinear.py [dir].

Leaves ``nonlinear.csv``: for each case and search the iterations of the first step, the most of a later one, cut-backs,
and seconds; a search that ends before the load does is marked. Elastic cases first, then plasticity and damage.
"""

import dataclasses
import json
import sys
import time
from pathlib import Path

sys.path.insert(0, str(Path(__file__).parent.parent))
import study

words = study.start()

import pdpetsc as pd
from pdpetsc.command_line.cli import arguments_of, load_case

CASES = {
    "clamped beam": ("beams/clamped.py", {"ny": 5, "scheme": "sub_horizons"}),
    "clamped beam, G = 0": ("beams/clamped.py", {"ny": 3}),
    "supported beam": ("beams/simply_supported.py", {"ny": 5, "scheme": "sub_horizons"}),
    "cantilever": ("beams/cantilever.py", {"ny": 5, "scheme": "sub_horizons"}),
    "cantilever, horizon 3": ("beams/cantilever.py", {"ny": 5, "horizon": 3.015, "G": 0.5}),
    "hydrostatic": ("patch/hydrostatic.py", {"n": 15}),
    "tension 3D": ("patch/tension.py", {"dim": 3, "n": 5}),
    "square opening": ("plates/square_opening.py", {"scheme": "sub_horizons"}),
    "brick": ("plates/brick.py", {"dx": 5.0, "scheme": "sub_horizons"}),
    "block to 3": ("hard/block.py", {"law": "neo_hookean", "stretch": 3.0, "steps": 10}),
    "block to 0.6": ("hard/block.py", {"law": "neo_hookean", "stretch": 0.6, "steps": 10, "nx": 12, "ny": 24}),
    "shaken block to 3": ("hard/block.py", {"law": "neo_hookean", "stretch": 3.0, "steps": 10, "shake": 0.3}),
    "nu = 0.499": ("hard/block.py", {"nu": 0.499}),
    "plastic plate": ("plasticity/plate.py", {}),
    "plate with hole": ("fracture/plate_with_hole.py", {"steps": 10}),
}
SEARCHES = {
    "cp, ten steps": {},
    "cp, one step": {"snes_linesearch_max_it": 1},
    "basic": {"snes_linesearch_type": "basic"},
    "bt": {"snes_linesearch_type": "bt"},
    "l2": {"snes_linesearch_type": "l2"},
    "nleqerr": {"snes_linesearch_type": "nleqerr"},
    "trust region": {"snes_type": "newtontr"},
}
CUTS = 4


def attempt(folder, name, options):
    """Return iterations of the first step, the most of later ones, cut-backs, seconds, and if the load was reached."""
    path, parameters = CASES[name]
    function = load_case(study.RUNS / path)
    case = function(**arguments_of(function, {key: str(value) for key, value in parameters.items()}))
    steps = case.steps
    if isinstance(steps, pd.Steps):
        steps = dataclasses.replace(steps, smallest=1.0 / (steps.count * 2**CUTS))
    case = dataclasses.replace(case, steps=steps, fields=[], picture=None)
    before, reached = time.perf_counter(), True
    try:
        pd.run(case, output=folder / "last_run", options=options)
    except pd.SolveError:
        reached = False
    spent = time.perf_counter() - before
    found = json.loads((folder / "last_run" / "summary.json").read_text())["steps"]
    iterations = [step["newton_iterations"] for step in found] or [0]
    cuts = sum(len(step["cut_backs"]) for step in found) + (0 if reached else CUTS)
    return iterations[0], max(iterations[1:], default=0), cuts, spent, reached


def main():
    folder = study.folder_for(words, "out/nonlinear")
    rows = []
    print(f"{'first step / most later, cut-backs':>36} " + " ".join(f"{name:>14}" for name in SEARCHES), flush=True)
    for name in CASES:
        cells = []
        for search, options in SEARCHES.items():
            first, later, cuts, spent, reached = attempt(folder, name, options)
            rows.append((name, search, first, later, cuts, f"{spent:.2f}", reached))
            cells.append(f"{first}/{later}{f', {cuts}' if cuts else ''}" if reached else "fails")
        print(f"{name:>36} " + " ".join(f"{cell:>14}" for cell in cells), flush=True)
    header = ["case", "search", "first_step", "most_of_a_later_step", "cut_backs", "seconds", "reached"]
    study.write_table(folder, "nonlinear", header, rows)


main()
