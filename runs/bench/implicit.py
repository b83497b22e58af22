"""Newton's method against dynamic relaxation at the same error: python runs/bench/implicit.py [smallest|all].

Clamped beam, cantilever and brick at three sizes, one load step each: both find equilibrium of the same equations, so
the error is the same; printed are seconds, the factor, and how far the results are apart.
"""

import dataclasses
import sys
import tempfile
from pathlib import Path

sys.path.insert(0, str(Path(__file__).parent.parent))
import study

words = study.start("beams", "plates")

import brick
import cantilever
import clamped

import pdpetsc as pd

# How the case is made, the parameter of its size with three values, and the others.
PROBLEMS = {
    "clamped beam": (clamped.case, "ny", (3, 5, 9), {"steps": 1, "scheme": "sub_horizons"}),
    "cantilever": (cantilever.case, "ny", (3, 5, 7), {"steps": 1, "scheme": "sub_horizons", "force": 1.0}),
    "brick": (brick.case, "dx", (10.0, 5.0, 4.0), {"scheme": "sub_horizons"}),
}


def run(case):
    """Return the summary of a run; None where it did not reach the load."""
    with tempfile.TemporaryDirectory() as folder:
        done = study.run(Path(folder), case)
    return None if done is None else done[1]


def main():
    for name, (make, size, values, others) in PROBLEMS.items():
        for value in values[:1] if words == ["smallest"] else values:
            case = make(**{size: value}, **others)
            newton, relaxed = (run(dataclasses.replace(case, solver=s)) for s in (pd.Newton(), pd.DynamicRelaxation()))
            if newton is None or relaxed is None:
                failed = "Newton" if newton is None else "relaxation"
                print(f"{name} {size} = {value}: {failed} did not end", flush=True)
                continue
            one, two = newton["timings"]["solve"], relaxed["timings"]["solve"]
            steps = relaxed["steps"][0]["relaxation_iterations"]
            apart = max(
                abs(relaxed["results"][key] - number) / max(abs(number), 1e-300)
                for key, number in newton["results"].items()
            )
            print(
                f"{name} {newton['particles']} particles: Newton {one:.3f} s, relaxation {two:.2f} s ({steps} time "
                f"steps), factor {two / one:.0f}, results {apart:.0e} apart",
                flush=True,
            )


if __name__ == "__main__":
    main()
