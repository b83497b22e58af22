"""Newton's residuals in tables 2, 3 and 4 of Hashim, Coombs, Augarde and Hattori: one command.

    python runs/beams/tables.py [folder] [table_2 table_3 table_4]

leaves ``table_2.csv``, ... and ``numbers.json`` with ``table_2_step_6_iteration_1``, ... in the folder (default
``out/tables``), under mpirun too. Each load step starts from the last converged one and takes full Newton steps. The
paper divides by the norm of the external forces; its numbers are met where the reactions of the supports, which are
five to a hundred times larger, count among them: ``norm / sqrt(loads^2 + reactions^2)``, here with the reactions of the
converged step. The unit of length of G, which the text does not state, is fitted: one number for a table
(``beam.UNIT``, ``cantilever.UNIT``).
"""

import dataclasses
import math
import sys
from pathlib import Path

sys.path.insert(0, str(Path(__file__).parent.parent))
import study

words = study.start("beams") if __name__ == "__main__" else []

import beam
import cantilever
import clamped
import simply_supported

FULL_STEPS = {"snes_linesearch_type": "basic", "snes_rtol": 1e-10}
STEPS = range(6, 11)
# The case and the norm of its whole load [N].
TABLES = {
    "table_2": (lambda: clamped.case(ny=3, horizon=3.015, G_printed=0.031), beam.load_norm(3)),
    "table_3": (lambda: simply_supported.case(ny=3, horizon=2.015, G_printed=0.02), beam.load_norm(3)),
    "table_4": (
        lambda: cantilever.case(ny=5, horizon=2.015, G_printed=0.05, plane="strain", pinned="particle"),
        cantilever.FORCE,
    ),
}


def residuals(folder, table):
    """Return {(step, iteration): relative residual norm} of load steps 6 to 10 after each Newton iteration."""
    make, load = TABLES[table]
    _, summary = study.run(folder, dataclasses.replace(make(), options=FULL_STEPS))
    found = {}
    for step in summary["steps"]:
        # The summary has the larger one of loads and reactions, which are the reactions here.
        forces = math.hypot(step["reference"], step["t"] * load)
        if step["step"] in STEPS:
            found |= {(step["step"], k): norm / forces for k, norm in enumerate(step["norms"]) if k > 0}
    return found


def main():
    names = study.chosen(words, TABLES, "table")
    folder = study.folder_for(words, "out/tables")
    numbers = {}
    for table in names:
        found = residuals(folder, table)
        last = max(iteration for _, iteration in found)
        rows = [(k, *(found.get((step, k), math.nan) for step in STEPS)) for k in range(1, last + 1)]
        study.write_table(folder, table, ("iteration", *(f"step_{step}" for step in STEPS)), rows)
        numbers |= {f"{table}_step_{step}_iteration_{k}": value for (step, k), value in found.items()}
        numbers[f"{table}_most_iterations"] = last
    study.write_numbers(folder, numbers)


if __name__ == "__main__":
    main()
