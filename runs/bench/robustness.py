"""How many fracture runs reach the end with the plate apart: plate with a hole over lattices, schemes, laws and steps.

    python runs/bench/robustness.py [FOLDER] [quick] [snap] [soften] [schemes] [steps]

Runs of ``runs/fracture/plate_with_hole.py``, 318 in all: ``snap``, bonds that snap on five lattices with two horizons
and three schemes (30 runs); ``soften``, four laws of bonds that soften on the same (120); ``schemes``, the other three
schemes with all laws on two lattices (60); ``steps``, three numbers of load steps (108). ``quick`` is 18 runs with
bonds that snap. All but ``quick`` where no word is given.

Writes ``robustness.csv`` with one row per run and prints, for every value of every parameter, how many runs end with
exit status 0, how many separate (the last load below a thousandth of the peak), how many are symmetric (first moments
of the damage below a millionth; stress points have random directions and are not), the largest share of the peak load
that is left, cut-backs, and the median time of the solve.
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

import plate_with_hole

from pdpetsc.errors import Interrupted, PdpetscError

SWEEPS = {
    "quick": {
        "nx": [30, 36, 42],
        "horizon": [2.015, 3.015],
        "scheme": ["correspondence", "sub_horizons", "stress_points"],
        "law": ["brittle"],
        "steps": [20],
    },
    "snap": {
        "nx": [30, 36, 42, 48, 60],
        "horizon": [2.015, 3.015],
        "scheme": ["correspondence", "sub_horizons", "stress_points"],
        "law": ["brittle"],
        "steps": [20],
    },
    "soften": {
        "nx": [30, 36, 42, 48, 60],
        "horizon": [2.015, 3.015],
        "scheme": ["correspondence", "sub_horizons", "stress_points"],
        "law": ["linear", "exponential", "bilinear", "smooth"],
        "steps": [20],
    },
    "schemes": {
        "nx": [30, 36],
        "horizon": [2.015, 3.015],
        "scheme": ["corrected", "higher_order", "bond_associated"],
        "law": ["brittle", "linear", "exponential", "bilinear", "smooth"],
        "steps": [20],
    },
    "steps": {
        "nx": [24, 30],
        "horizon": [2.015, 3.015],
        "scheme": ["correspondence", "sub_horizons", "bond_associated"],
        "law": ["smooth", "early", "linear"],
        "steps": [10, 30, 90],
    },
}
WHOLE = ["snap", "soften", "schemes", "steps"]
# Schemes with one gradient for a whole family take Silling's control.
CONTROLLED = ("correspondence", "corrected", "higher_order")
UNLOADED = 1e-3
SYMMETRIC = 1e-6


def run_one(folder, **parameters):
    """Return the row of one run."""
    G = 0.5 if parameters["scheme"] in CONTROLLED else 0.0
    case = plate_with_hole.case(G=G, **parameters)
    before = time.perf_counter()
    try:
        found = study.run(folder, case)
    except Interrupted as error:
        raise SystemExit(f"{error} The table holds the runs before.") from error
    except PdpetscError as error:
        print(error)
        found = None
    row = {**parameters, "ended": found is not None, "time": time.perf_counter() - before}
    summary = json.loads((folder / "last_run" / "summary.json").read_text())
    row["cut_backs"] = sum(len(step["cut_backs"]) for step in summary["steps"]) + len(summary["failed_attempts"])
    row["sweeps"] = sum(step.get("sweeps", 0) for step in summary["steps"])
    row["solve"] = summary["timings"].get("solve", 0.0)
    row |= {"peak": float("nan"), "left": float("nan"), "asymmetry": float("nan"), "broken": float("nan")}
    if found is not None:
        history = found[0]
        row["peak"], row["left"] = max(history["force"]), abs(history["force"][-1]) / max(history["force"])
        row["asymmetry"], row["broken"] = history["asymmetry"][-1], history["broken"][-1]
    row["separated"], row["symmetric"] = row["left"] < UNLOADED, row["asymmetry"] < SYMMETRIC
    return row


def report(rows, sweep):
    """Print shares and medians for every value of every parameter."""
    print(f"{'':24s} runs  ended  separated  symmetric  largest left  cut-backs  median solve [s]")
    for name, values in [("all", [None]), *sweep.items()]:
        for value in values:
            some = [row for row in rows if value is None or row[name] == value]
            ended, separated, symmetric = (sum(row[key] for row in some) for key in ("ended", "separated", "symmetric"))
            cuts = sum(row["cut_backs"] for row in some)
            left = max((row["left"] for row in some if row["ended"]), default=float("nan"))
            median = statistics.median(row["solve"] for row in some)
            label = name if value is None else f"{name} {value}"
            print(
                f"{label:24s} {len(some):4d}  {ended:5d}  {separated:9d}  {symmetric:9d}  {left:12.1e}  {cuts:9d}  "
                f"{median:8.1f}",
                flush=True,
            )
    for row in rows:
        if not row["separated"]:
            where = ", ".join(f"{name}={row[name]}" for name in sweep)
            print(f"not apart: {where}: {row['left']:.2g} of the peak left" if row["ended"] else f"no end: {where}")


def main():
    chosen = [word for word in WORDS if word in SWEEPS] or WHOLE
    folder = study.folder_for([word for word in WORDS if word not in SWEEPS], "out/robustness")
    table, written = None, 0
    with (folder / "robustness.csv").open("w", newline="") as file:
        for name in chosen:
            sweep, rows, before = SWEEPS[name], [], time.perf_counter()
            for values in itertools.product(*sweep.values()):
                row = run_one(folder, **dict(zip(sweep, values, strict=True)))
                rows.append(row)
                written += 1
                if table is None:
                    table = csv.DictWriter(file, ["sweep", *row])
                    table.writeheader()
                table.writerow({"sweep": name, **row})
                file.flush()
            print(f"{name}: {len(rows)} runs in {(time.perf_counter() - before) / 60.0:.1f} minutes")
            report(rows, sweep)
    print(f"{written} runs, {folder / 'robustness.csv'}")


if __name__ == "__main__":
    main()
