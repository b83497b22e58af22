"""How many fracture runs reach the end: plate with a hole over spacing, horizon, scheme, law and step size.

    python runs/bench/robustness.py [FOLDER]

108 runs of ``runs/fracture/plate_with_hole.py`` in some ten minutes on one core. Writes ``robustness.csv`` with one
row per run and prints, for every value of every parameter, how many runs end with exit status 0, how many separate (the
last load below a thousandth of the peak), cut-backs, and the median time of the solve.
"""

import csv
import itertools
import json
import statistics
import sys
import time
from pathlib import Path

sys.path.insert(0, str(Path(__file__).resolve().parents[1]))
import study

WORDS = study.start("fracture")

import plate_with_hole  # noqa: E402

import pdpetsc as pd  # noqa: E402

SWEEP = {
    "nx": [24, 30],
    "horizon": [2.015, 3.015],
    "scheme": ["correspondence", "sub_horizons", "bond_associated"],
    "law": ["smooth", "early", "linear"],
    "steps": [10, 30, 90],
}
UNLOADED = 1e-3


def run_one(folder, **parameters):
    """Return the row of one run."""
    G = 0.5 if parameters["scheme"] == "correspondence" else 0.0
    case = plate_with_hole.case(G=G, **parameters)
    before = time.perf_counter()
    try:
        found = study.run(folder, case)
    except pd.PdpetscError as error:
        print(error)
        found = None
    row = {**parameters, "ended": found is not None, "time": time.perf_counter() - before}
    summary = json.loads((folder / "last_run" / "summary.json").read_text())
    row["cut_backs"] = sum(len(step["cut_backs"]) for step in summary["steps"]) + len(summary["failed_attempts"])
    row["sweeps"] = sum(step.get("sweeps", 0) for step in summary["steps"])
    row["solve"] = summary["timings"]["solve"]
    row["peak"], row["separated"] = float("nan"), False
    if found is not None:
        force = found[0]["force"]
        row["peak"], row["separated"] = max(force), abs(force[-1]) < UNLOADED * max(force)
    return row


def report(rows):
    """Print shares and medians for every value of every parameter."""
    print(f"{'':24s} runs  ended  separated  cut-backs  median solve [s]")
    for name, values in [("all", [None]), *SWEEP.items()]:
        for value in values:
            some = [row for row in rows if value is None or row[name] == value]
            ended, separated = (sum(row[key] for row in some) for key in ("ended", "separated"))
            cuts = sum(row["cut_backs"] for row in some)
            median = statistics.median(row["solve"] for row in some)
            label = name if value is None else f"{name} {value}"
            print(f"{label:24s} {len(some):4d}  {ended:5d}  {separated:9d}  {cuts:9d}  {median:8.1f}")


def main():
    folder = study.folder_for(WORDS, "out/robustness")
    rows = []
    with (folder / "robustness.csv").open("w", newline="") as file:
        for values in itertools.product(*SWEEP.values()):
            row = run_one(folder, **dict(zip(SWEEP, values, strict=True)))
            rows.append(row)
            if len(rows) == 1:
                table = csv.DictWriter(file, list(row))
                table.writeheader()
            table.writerow(row)
            file.flush()
    report(rows)


if __name__ == "__main__":
    main()
