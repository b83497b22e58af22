"""Every benchmark: python runs/bench/all.py [--quick] [--base DIR] [--record] [folder].

``--quick`` takes under three minutes and prints what was measured as ratios of two measurements of the same run, which
do not depend on how fast the machine is, beside those recorded in ``recorded.json``; ``--record`` writes them there.
``--base`` measures another checkout in the same run, and prints how many times as long its solves from scratch and how
much more memory they take, and how many fewer particles its kernels evaluate in a second.
Without ``--quick`` the studies follow, which take an hour or more, with tables and pictures in the folder.
"""

import json
import os
import subprocess
import sys
import tempfile
import time
from pathlib import Path

HERE = Path(__file__).parent
sys.path[:0] = [str(HERE), str(HERE.parent)]
from scaling import measure

RECORDED = HERE / "recorded.json"
REPEATS = 3
# A ratio this far from the recorded one is marked.
FAR = 1.5
STUDIES = (
    ["assembly.py"], ["events.py"], ["nonlinear.py", "{folder}/nonlinear"], ["implicit.py"],
    ["conforming.py", "300000", "{folder}/conforming"], ["fronts.py", "{folder}/fronts"],
    ["levels.py", "1", "1", "{folder}/levels"], ["kernels.py"], ["explicit.py"], ["local.py"],
    ["robustness.py"], ["performance_model.py"],
    ["footprint.py"], ["scaling.py", "{folder}/scaling"],
    ["../beams/speed.py", "{folder}/speed"],
)  # fmt: skip


def quick(folder):
    """Return the ratios, by what they are of."""
    common = {"repeats": REPEATS}
    plane = measure(folder, 1, dim=2, n=201, horizon=3.015, **common)
    direct = measure(folder, 1, ["-pc_type", "cholesky"], dim=2, n=201, horizon=3.015, jacobian="assembled")
    assembled = measure(folder, 1, ["-pc_type", "gamg"], dim=2, n=201, horizon=3.015, jacobian="assembled")
    sub_horizons = measure(folder, 1, dim=2, n=201, horizon=3.015, scheme="sub_horizons", G=0.0, **common)
    small = measure(folder, 1, dim=3, n=16, horizon=3.015, **common)
    solid = measure(folder, 1, dim=3, n=30, horizon=3.015, **common)
    two = measure(folder, 2, dim=3, n=30, horizon=3.015, **common)
    broken = measure(folder, 1, dim=2, n=100, horizon=3.015, broken=0.3)
    crack = measure(folder, 1, dim=2, n=100, horizon=3.015, crack=0.6)
    near = measure(folder, 1, ["-pc_type", "gamg"], dim=3, n=30, horizon=3.015, **common)
    applied = sub_horizons["seconds"]["operator"] / plane["seconds"]["operator"]
    growth = (solid["scratch"] / solid["particles"]) / (small["scratch"] / small["particles"])
    return {
        "2D 40401, horizon 3.015: MUMPS Cholesky / without a matrix": direct["scratch"] / plane["scratch"],
        "2D 40401, horizon 3.015: assembled GAMG / without a matrix": assembled["scratch"] / plane["scratch"],
        "2D 40401: memory, MUMPS / without a matrix": direct["peak_MiB"] / plane["peak_MiB"],
        "2D 40401: operator, sub-horizons / Silling": applied,
        "2D 40401: set-up of the preconditioner / one iteration": plane["seconds"]["preconditioner"]
        * plane["linear_iterations"]
        / plane["seconds"]["iterations"],
        "3D 27000, horizon 3.015: nearest neighbours / two levels": near["scratch"] / solid["scratch"],
        "3D 27000, horizon 3.015: preconditioner / operator": solid["seconds"]["cycle"] / solid["seconds"]["operator"],
        "3D, horizon 3.015: seconds a particle, 27000 / 4096": growth,
        "3D 27000, horizon 3.015: one rank / two ranks": solid["scratch"] / two["scratch"],
        "iterations, 2D 40401": plane["linear_iterations"],
        "iterations, 2D 40401 sub-horizons": sub_horizons["linear_iterations"],
        "iterations, 2D 10000 with 30 % broken bonds": broken["linear_iterations"],
        "iterations, 2D 10000 with a crack across 60 %": crack["linear_iterations"],
        "iterations, 3D 27000": solid["linear_iterations"],
    }, {"2D 40401": plane["scratch"], "3D 27000": solid["scratch"], "3D 27000 on two ranks": two["scratch"]}


def against(folder, base):
    """Return what solves and kernels of another checkout take over what those of this one take."""
    common, ratios = {"horizon": 3.015, "repeats": REPEATS}, {}
    bodies = {
        "2D 40401": {"dim": 2, "n": 201},
        "2D 40401, sub-horizons": {"dim": 2, "n": 201, "scheme": "sub_horizons", "G": 0.0},
        "3D 27000": {"dim": 3, "n": 30},
        "3D 13824, sub-horizons": {"dim": 3, "n": 24, "scheme": "sub_horizons", "G": 0.0, "repeats": 1},
        "3D 13824, 2 % broken": {"dim": 3, "n": 24, "broken": 0.02, "repeats": 1},
    }
    for name, body in bodies.items():
        ours, theirs = (measure(folder, 1, checkout=where, **{**common, **body}) for where in (HERE.parents[1], base))
        ratios[f"{name}: solve from scratch, other / this"] = theirs["scratch"] / ours["scratch"]
        ratios[f"{name}: memory, other / this"] = theirs["peak_MiB"] / ours["peak_MiB"]
        ratios[f"{name}: iterations, other / this"] = theirs["linear_iterations"] / ours["linear_iterations"]
        if "broken" in body:
            for phase in ("model", "operator"):
                ratios[f"{name}: {phase}, other / this"] = theirs["seconds"][phase] / ours["seconds"][phase]
    ours, theirs = (evaluated(folder, where) for where in (HERE.parents[1], base))
    for name, values in ours.items():
        for what, mine, other in zip(("forces", "tangent"), values, theirs[name], strict=True):
            ratios[f"3D 27000, {name}: {what} a second, this / other"] = mine / other
    return ratios


def evaluated(folder, checkout):
    """Return the particles that a core evaluates in a second with the package of a checkout."""
    found = (folder / "evaluated.json").resolve()
    command = [sys.executable, str(HERE / "kernels.py"), "n=30", f"json={found}"]
    environment = {**os.environ, "PYTHONPATH": str(Path(checkout).resolve())}
    subprocess.run(command, check=True, stdout=subprocess.DEVNULL, cwd=checkout, env=environment)
    return json.loads(found.read_text())


def report(ratios, recorded):
    """Print a table of current against recorded ratios."""
    print(f"{'':64} {'now':>8} {'recorded':>9}")
    for name, value in ratios.items():
        old = recorded.get(name)
        far = old is not None and not 1.0 / FAR <= value / old <= FAR
        print(f"{name:64} {value:8.2f} {'-' if old is None else f'{old:9.2f}'}{'  <- far' if far else ''}")


def main():
    given = sys.argv[1:]
    base = given.pop(given.index("--base") + 1) if "--base" in given else None
    words = [word for word in given if not word.startswith("--")]
    folder = Path(words[0] if words else "out/bench")
    before = time.perf_counter()
    with tempfile.TemporaryDirectory() as scratch:
        if base is not None:
            report(against(Path(scratch), base), {})
            print(f"{time.perf_counter() - before:.0f} s")
            return
        ratios, seconds = quick(Path(scratch))
    recorded = json.loads(RECORDED.read_text()) if RECORDED.exists() else {}
    report(ratios, recorded)
    print("one solve from scratch: " + ", ".join(f"{name} {value:.2f} s" for name, value in seconds.items()))
    print(f"{time.perf_counter() - before:.0f} s", flush=True)
    if "--record" in sys.argv:
        RECORDED.write_text(json.dumps(ratios, indent=2) + "\n")
    if "--quick" in sys.argv:
        return
    for script, *arguments in STUDIES:
        print(f"== {script}", flush=True)
        given = [word.format(folder=folder) for word in arguments]
        subprocess.run([sys.executable, str(HERE / script), *given], check=False)


if __name__ == "__main__":
    main()
