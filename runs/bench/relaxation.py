"""Cost of stress points under dynamic relaxation: python runs/bench/relaxation.py (Luo, Sundararaghavan, figure 14).

Seconds and time steps of bar, plate with a square opening and brick at three sizes with plain correspondence and with
stress points, and seconds over those of the smallest plain case of each.
"""

import sys
import tempfile
from pathlib import Path

sys.path.insert(0, str(Path(__file__).parent.parent))
import study

study.start("singular_bar", "plates")

import dataclasses  # noqa: E402

import bar  # noqa: E402
import brick  # noqa: E402
import square_opening  # noqa: E402

import pdpetsc as pd  # noqa: E402

PROBLEMS = {
    "bar": (bar.case, "n", (50, 100, 200)),
    "plate": (square_opening.case, "dx", (5.0, 4.0, 2.5)),
    "brick": (brick.case, "dx", (10.0, 5.0, 4.0)),
}


def main():
    for name, (make, size, sizes) in PROBLEMS.items():
        first = None
        for value in sizes:
            for scheme in ("correspondence", "stress_points"):
                case = dataclasses.replace(make(**{size: value, "scheme": scheme}), solver=pd.DynamicRelaxation())
                with tempfile.TemporaryDirectory() as folder:
                    done = study.run(Path(folder), case)
                if done is None:
                    print(f"{name} {size} = {value} {scheme}: not at rest after the largest number of time steps")
                    continue
                summary = done[1]
                seconds, steps = summary["timings"]["solve"], summary["steps"][0]["relaxation_iterations"]
                first = first or seconds
                print(
                    f"{name} {summary['particles']} particles {scheme}: {seconds:.2f} s, {steps} time steps, "
                    f"{seconds / first:.1f}", flush=True,
                )  # fmt: skip


if __name__ == "__main__":
    main()
