"""Speed against error of every method: python runs/beams/speed.py [folder] [clamped|cantilever|plate|relaxation ...].

Clamped beam, cantilever and plate with a square opening, with every scheme and plain correspondence with every control,
at horizons 1 to 3 and three spacings, each run in a process of its own; then the clamped beam in one load step by
Newton's method and by dynamic relaxation (in ten: ``figures.py``). Leaves one table and one picture a problem:
seconds of set-up and solve and peak memory against the relative error. An interrupted study goes on where it was.
"""

import sys
from pathlib import Path

sys.path.insert(0, str(Path(__file__).parent.parent))
import study

words = study.start("beams")

import pdpetsc as pd

CONTROLLED = [name for name in pd.CONTROLS if name != "none"]
HORIZONS = ("1.015", "2.015", "3.015")
# Case file, the parameter that sets the spacing, its values, the result that is the error.
PROBLEMS = {
    "clamped": ("beams/clamped.py", "ny", ("3", "5", "9"), "error"),
    "cantilever": ("beams/cantilever.py", "ny", ("5", "9", "15"), "w_error"),
    "plate": ("plates/square_opening.py", "dx", ("4", "2", "1"), "error"),
}
# A quarter has nearly the displacements of the whole plate, in a quarter of the time.
FIXED = {"plate": {"part": ["quarter_cut"]}}


def outcomes(folder, case, choices, words=()):
    """Run all combinations and return them, failed ones included."""
    return pd.study(study.RUNS / case, choices, folder, options=words).outcomes


def save(folder, name, title, done, error, label):
    rows = []
    curves = {}
    for outcome in done:
        value = abs(outcome.results[error]) if error in outcome.results else float("nan")
        rows.append((*outcome.parameters.values(), value, outcome.seconds, outcome.memory, outcome.status))
        x, y = curves.setdefault(label(outcome.parameters), ([], []))
        x.append(outcome.seconds)
        y.append(value)
    header = (*done[0].parameters, "error", "seconds", "peak_MiB", "status")
    study.write_table(folder, f"{name}_table", header, rows)
    axes = {"xscale": "log", "yscale": "log"}
    study.write_curves(folder, name, title, ("seconds of set-up and solve", "relative error"), curves, **axes)


def methods(folder, name):
    """Every method on one problem, a picture per horizon."""
    path, size, sizes, error = PROBLEMS[name]
    for horizon in HORIZONS:
        plain = {
            "scheme": list(pd.SCHEMES),
            "control": ["none"],
            "horizon": [horizon],
            size: sizes,
            **FIXED.get(name, {}),
        }
        other = plain | {"scheme": ["correspondence"], "control": CONTROLLED}
        done = outcomes(folder / name, path, plain) + outcomes(folder / name, path, other)

        def label(parameters):
            return parameters["scheme"] if parameters["control"] == "none" else parameters["control"]

        save(folder, f"{name}_{horizon}", f"{name.capitalize()}, horizon {horizon} dx", done, error, label)


def relaxation(folder):
    """The clamped beam in one step by Newton's method and by dynamic relaxation."""
    path, size, sizes, error = PROBLEMS["clamped"]
    choices = {size: sizes, "steps": ["1"]}
    done = outcomes(folder / "newton", path, choices)
    relaxed = outcomes(folder / "relaxation", path, choices, ("--solver", "relaxation"))
    for name, found in (("newton", done), ("relaxation", relaxed)):
        for outcome in found:
            outcome.parameters["solver"] = name
    save(
        folder,
        "relaxation",
        "Clamped beam in one load step",
        done + relaxed,
        error,
        lambda parameters: parameters["solver"],
    )


def main():
    chosen = words[1:] or [*PROBLEMS, "relaxation"]
    folder = study.folder_for(words, "out/speed")
    for name in chosen:
        if name == "relaxation":
            relaxation(folder)
        elif name in PROBLEMS:
            methods(folder, name)
        else:
            sys.exit(f"There is no study {name}; choose from {', '.join(PROBLEMS)}, relaxation.")


if __name__ == "__main__":
    main()
