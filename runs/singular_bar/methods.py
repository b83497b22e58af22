"""Every method on the singular bar: python runs/singular_bar/methods.py [folder].

Leaves ``methods.csv`` (error, sawtooth on both halves, condition number of the stiffness matrix up to n = 500) for all
methods, numbers of particles and horizons, and the curves of figure 7 of Luo and Sundararaghavan (displacement, strain
and their relative errors at n = 500) and of figures 1 to 6 of Chowdhury et al. (n = 4000).
"""

import sys
from pathlib import Path

sys.path.insert(0, str(Path(__file__).parent.parent))
import study

words = study.start("singular_bar")

import bar  # noqa: E402
import h5py  # noqa: E402
import numpy as np  # noqa: E402

import pdpetsc as pd  # noqa: E402

SPRINGS = {100: 0.8, 200: 1.28, 500: 2.0, 1000: 3.0}
AVERAGES = {100: 60.0, 200: 150.0, 500: 500.0, 1000: 1750.0}
SIZES = (100, 200, 500, 1000, 4000)
HORIZONS = (1.015, 2.015, 3.015, 5.1, 10.1)
METHODS = {
    "plain": {},
    "stress points": {"scheme": "stress_points"},
    "2 sub-horizons": {"scheme": "sub_horizons"},
    "4 sub-horizons": {"scheme": "sub_horizons", "sectors": 4},
    "bond-associated": {"scheme": "bond_associated"},
    "corrected, order 2": {"scheme": "corrected", "order": 2},
    "corrected, order 4": {"scheme": "corrected", "order": 4},
    "corrected, order 6": {"scheme": "corrected", "order": 6},
    "higher order 3": {"scheme": "higher_order", "order": 3},
    "higher order 5": {"scheme": "higher_order", "order": 5},
    "Silling": {"control": "silling"},
    "Littlewood": {"control": "littlewood"},
    "Wan": {"control": "wan"},
}


def methods(n, horizon):
    """Return the methods with the published constants that exist for this size and horizon."""
    found = dict(METHODS)
    if n in SPRINGS and horizon < 2.0:
        found["springs"] = {"spring": SPRINGS[n]}
        found["averaged displacement"] = {"average": AVERAGES[n]}
    return found


def condition(case):
    """Return the condition number of the stiffness matrix without the ends."""
    model = study.build(case)
    K = study.dense_tangent(model, np.zeros_like(model.cloud.x))
    x = model.cloud.x[:, 0]
    free = (x > case.horizon) & (x < 1.0 - case.horizon)
    values = np.abs(np.linalg.eigvalsh(K[np.ix_(free, free)]))
    return values.max() / values.min()


def table(folder):
    rows = []
    for n in SIZES:
        for horizon in HORIZONS:
            for name, parameters in methods(n, horizon).items():
                case = bar.case(n=n, horizon=horizon, **parameters)
                done = study.run(folder, case)
                results = done[1]["results"] if done else dict.fromkeys(("error", "sawtooth", "sawtooth_right"), np.nan)
                number = condition(case) if n <= 500 else np.nan
                rows.append((name, n, horizon, *results.values(), number))
        print(f"n = {n} done", flush=True)
    header = ("method", "n", "horizon_over_dx", "error", "sawtooth", "sawtooth_right", "condition")
    study.write_table(folder, "methods", header, rows)
    return rows


def profile(folder, case, strain):
    """Return positions and displacements, or strains F - 1, of the solved bar."""
    pd.run(case, output=folder / "profile", quiet=True)
    with h5py.File(folder / "profile" / "fields.h5") as file:
        x, step = file["particles/position"][:, 0], file["step_00001"]
        return x, step["deformation_gradient"][:, 0] - 1.0 if strain else step["displacement"][:, 0]


def curves(folder, name, title, n, chosen, window=(0.0, 1.0), error=False, strain=False):
    """Write displacement or strain, or its relative error, of ``chosen`` {label: parameters} in a window of x."""
    found = {}
    for label, parameters in chosen.items():
        x, u = profile(folder, bar.case(n=n, **parameters), strain)
        inside = (x >= window[0]) & (x <= window[1])
        exact = bar.exact_gradient(x[:, None], 1.0)[:, 0, 0] - 1.0 if strain else bar.exact(x[:, None], 1.0)[:, 0]
        values = np.abs(u / np.where(exact > 0.0, exact, 1.0) - 1.0) * (exact > 0.0) if error else u
        found[label] = (x[inside], values[inside])
    if not error:
        found["local solution"] = (x[inside], exact[inside])
    axes = {"yscale": "log", "ylim": (1e-6, 1.0)} if error else {"ylim": (0.0, 0.02)} if strain else {}
    columns = ("x", "relative error" if error else "strain" if strain else "u")
    study.write_curves(folder, name, title, columns, found, ["local solution"], **axes)


def gradients(folder):
    """Chowdhury Fig. 1: the gradient of y = x + a sin(2 pi x / L) by plain and corrected operators, 400 particles."""
    length, n = 0.2, 400
    amplitude = 0.9 * length / (2.0 * np.pi)
    schemes = {"plain": pd.Correspondence(), "order 3": pd.Corrected(3), "order 6": pd.Corrected(6)}
    found = {}
    for name, scheme in schemes.items():
        case = pd.Case(
            particles=pd.Lattice((0.0,), (3.0 * length,), length / n),
            horizon=0.5 * length,
            material=pd.LinearElastic(E=1.0),
            scheme=scheme,
            conditions=[],
        )
        model = study.build(case)
        x = model.cloud.x
        F = 1.0 + model.operator.gradient(amplitude * np.sin(2.0 * np.pi * x / length))[:, 0, 0]
        middle = (x[:, 0] > length) & (x[:, 0] < 2.0 * length)
        found[name] = (x[middle, 0] - length, F[middle])
    s = found["plain"][0]
    found["local F"] = (s, 1.0 + 0.9 * np.cos(2.0 * np.pi * s / length))
    title = "Chowdhury Fig. 1: deformation gradients, horizon L/2"
    study.write_curves(folder, "chowdhury_fig_1", title, ("x", "F"), found, ["local F"])


def main():
    folder = study.folder_for(words, "out/singular_bar")
    gradients(folder)
    luo = {
        "no control": {},
        "springs": {"spring": SPRINGS[500]},
        "averaged displacement": {"average": AVERAGES[500]},
        "stress points": {"scheme": "stress_points"},
    }
    curves(folder, "luo_fig_7a", "Luo Fig. 7a: displacement, n = 500", 500, luo)
    curves(folder, "luo_fig_7b", "Luo Fig. 7b: amplitude, n = 500", 500, luo, error=True)
    curves(folder, "luo_fig_7c", "Luo Fig. 7c: strain, n = 500", 500, luo, strain=True)
    curves(folder, "luo_fig_7d", "Luo Fig. 7d: amplitude of the strain, n = 500", 500, luo, error=True, strain=True)
    plain = {f"plain, horizon {h} dx": {"horizon": h} for h in (1.1, 2.1, 4.1, 5.1)}
    curves(folder, "chowdhury_fig_2", "Chowdhury Fig. 2: plain, n = 4000", 4000, plain, (0.45, 0.55))
    orders = {f"order {N}": {"horizon": 5.1, "scheme": "corrected", "order": N} for N in (6, 7, 8)}
    curves(folder, "chowdhury_fig_3", "Chowdhury Fig. 3: corrected, horizon 5.1 dx", 4000, orders, (0.45, 0.55))
    halves = {f"{N} sub-horizons": {"horizon": 10.1, "scheme": "sub_horizons", "sectors": N} for N in (2, 4)}
    curves(folder, "chowdhury_fig_5", "Chowdhury Fig. 4, 5: sub-horizons, horizon 10.1 dx", 4000, halves, (0.45, 0.55))
    convergence = {
        "horizon 0.01": {"horizon": 40.0, "scheme": "sub_horizons"},
        "horizon 1.1 dx": {"horizon": 1.1, "scheme": "sub_horizons"},
    }
    curves(folder, "chowdhury_fig_6", "Chowdhury Fig. 6: nonlocal and local, n = 4000", 4000, convergence, (0.45, 0.55))
    rows = table(folder)
    names = dict.fromkeys(row[0] for row in rows)
    by_horizon = {
        name: zip(*[(row[2], max(row[4], 1e-18)) for row in rows if row[0] == name and row[1] == 500], strict=True)
        for name in names
    }
    study.write_curves(
        folder, "sawtooth", "Sawtooth on the linear half, n = 500", ("horizon / dx", "second difference / u_end"),
        {name: tuple(points) for name, points in by_horizon.items()}, yscale="log",
    )  # fmt: skip


if __name__ == "__main__":
    main()
