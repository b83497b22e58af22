"""Every method on the singular bar: python runs/singular_bar/methods.py [folder] [figure ...].

Figures are ``luo_7`` (displacement, strain and their relative errors at n = 500, and Table 1), ``chowdhury_1`` to
``chowdhury_6``, and ``table``: ``methods.csv`` with error, sawtooth on both halves and the condition number of the
stiffness matrix up to n = 500, for all methods, numbers of particles and horizons. Without words all are made.
``numbers.json`` has what the papers say about the figures as numbers.
"""

import sys
from pathlib import Path

sys.path.insert(0, str(Path(__file__).parent.parent))
import study

words = study.start("singular_bar")

import bar
import numpy as np
import pulled

import pdpetsc as pd

SPRINGS = {100: 0.8, 200: 1.28, 500: 2.0, 1000: 3.0}
AVERAGES = {100: 60.0, 200: 150.0, 500: 500.0, 1000: 1750.0}
SIZES = (100, 200, 500, 1000, 4000)
HORIZONS = (1.015, 2.015, 3.015, 5.1, 10.1)
REFINED = (500, 1000, 2000, 4000)
# What the papers show of the long bars.
MIDDLE = (0.45, 0.55)
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
    "relative springs": {"control": "springs"},
    "relative average": {"control": "averaged_displacement"},
}


def methods(n, horizon):
    """Return the methods with the published constants that exist for this size and horizon."""
    found = dict(METHODS)
    if n in SPRINGS and horizon < 2.0:
        found["springs"] = {"spring": SPRINGS[n]}
        found["averaged displacement"] = {"average": AVERAGES[n]}
        found["penalty"] = {"penalty": SPRINGS[n]}
    return found


def condition(case):
    """Return the condition number of the stiffness matrix without the ends."""
    problem = study.build(case)
    x = problem.body.cloud.x
    K = study.dense_tangent(problem, np.zeros_like(x))
    x = x[:, 0]
    free = (x > x.min()) & (x < x.max())
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
    """Return positions and displacements, or strains F - 1, of the solved bar, and its results."""
    done = pd.run(case, output=folder / "profile")
    values = done.field("deformation_gradient")[:, 0, 0] - 1.0 if strain else done.field("displacement")[:, 0]
    return done.x[:, 0], values, done


def curves(folder, module, name, title, n, chosen, window=(0.0, 1.0), error=False, strain=False):
    """Write displacement or strain, or its relative error, of ``chosen`` {label: parameters} in a window of x.

    Returns {label: (x, values, results of the case)} of the window.
    """
    found, results = {}, {}
    for label, parameters in chosen.items():
        x, u, results[label] = profile(folder, module.case(**({"n": n} | parameters)), strain)
        inside = (x >= window[0]) & (x <= window[1])
        exact = (module.BAR.exact_gradient if strain else module.BAR.exact)(x[:, None], 1.0).reshape(len(x))
        exact = exact - 1.0 if strain else exact
        values = np.abs(u / np.where(exact > 0.0, exact, 1.0) - 1.0) * (exact > 0.0) if error else u
        found[label] = (x[inside], values[inside])
    drawn = dict(found)
    if not error:
        drawn["local solution"] = (x[inside], exact[inside])
    axes = {"yscale": "log", "ylim": (1e-6, 1.0)} if error else {"ylim": (0.0, 0.02)} if strain else {}
    columns = ("x", "relative error" if error else "strain" if strain else "u")
    study.write_curves(folder, name, title, columns, drawn, ["local solution"], **axes)
    return {label: (*found[label], results[label]) for label in found}


def luo_7(folder):
    """Figure 7 and Table 1 of Luo and Sundararaghavan."""
    luo = {
        "no control": {},
        "springs": {"spring": SPRINGS[500]},
        "averaged displacement": {"average": AVERAGES[500]},
        "stress points": {"scheme": "stress_points"},
    }
    found = curves(folder, bar, "luo_fig_7a", "Luo Fig. 7a: displacement, n = 500", 500, luo)
    curves(folder, bar, "luo_fig_7b", "Luo Fig. 7b: amplitude, n = 500", 500, luo, error=True)
    strains = curves(folder, bar, "luo_fig_7c", "Luo Fig. 7c: strain, n = 500", 500, luo, strain=True)
    title = "Luo Fig. 7d: amplitude of the strain, n = 500"
    curves(folder, bar, "luo_fig_7d", title, 500, luo, error=True, strain=True)
    numbers = {}
    for label, (x, strain, results) in strains.items():
        name = label.replace(" ", "_")
        numbers[f"{name}_left"], numbers[f"{name}_right"] = results["sawtooth"], results["sawtooth_right"]
        second = np.abs(np.diff(strain, 2))[(x[1:-1] > 0.1) & (x[1:-1] < 0.4)].max()
        numbers[f"{name}_strain_left"] = second / bar.BAR.alpha
        x, u, _ = found[label]
        numbers[f"{name}_error"] = float(np.abs(u[1:] / bar.BAR.exact(x[1:, None], 1.0)[:, 0] - 1.0).max())
    for n in SPRINGS:
        constants = {"plain": {}, "springs": {"spring": SPRINGS[n]}, "average": {"average": AVERAGES[n]}}
        for name, parameters in constants.items():
            results = study.run(folder, bar.case(n=n, **parameters))[1]["results"]
            numbers[f"{name}_{n}_left"] = results["sawtooth"]
            numbers[f"{name}_{n}_right"] = results["sawtooth_right"]
    strong = study.run(folder, bar.case(n=500, average=500.0 * AVERAGES[500]))[1]["results"]
    return numbers | {"strong_average_left": strong["sawtooth"], "strong_average_error": strong["error"]}


def chowdhury_1(folder):
    """Chowdhury Fig. 1: the gradient of y = x + a sin(2 pi x / L) by plain and corrected operators, 400 particles."""
    length, n = 0.2, 400
    amplitude = 0.9 * length / (2.0 * np.pi)
    schemes = {"plain": pd.Correspondence(), "order 3": pd.Corrected(3), "order 6": pd.Corrected(6)}
    found = {}
    for name, scheme in schemes.items():
        case = pd.Case(
            particles=pd.Lattice((0.0,), (3.0 * length,), length / n),
            horizon=0.5 * length,
            material=pd.LinearElastic(E=1.0, nu=0.0),
            scheme=scheme,
            conditions=[],
        )
        problem = study.build(case)
        x = problem.body.cloud.x
        F = 1.0 + problem.material_term.operator.gradient(amplitude * np.sin(2.0 * np.pi * x / length))[:, 0, 0]
        middle = (x[:, 0] > length) & (x[:, 0] < 2.0 * length)
        found[name] = (x[middle, 0] - length, F[middle])
    s = found["plain"][0]
    found["local F"] = (s, 1.0 + 0.9 * np.cos(2.0 * np.pi * s / length))
    title = "Chowdhury Fig. 1: deformation gradients, horizon L/2"
    study.write_curves(folder, "chowdhury_fig_1", title, ("x", "F"), found, ["local F"])
    exact = found["local F"][1]
    return {f"{name.replace(' ', '_')}_off": float(np.abs(found[name][1] - exact).max()) for name in schemes}


def chowdhury_2(folder):
    """Chowdhury Fig. 2: plain correspondence at four horizons."""
    chosen = {f"horizon {h} dx": {"horizon": h} for h in (1.1, 2.1, 4.1, 5.1)}
    found = curves(folder, pulled, "chowdhury_fig_2", "Chowdhury Fig. 2: plain, n = 4000", 4000, chosen, MIDDLE)
    return {f"plain_{label.split()[1]}": results["sawtooth"] for label, (*_, results) in found.items()}


def chowdhury_3(folder):
    """Chowdhury Fig. 3: corrected gradients of three orders."""
    chosen = {f"order {N}": {"scheme": "corrected", "order": N} for N in (6, 7, 8)}
    title = "Chowdhury Fig. 3: corrected, horizon 5.1 dx, n = 4000"
    found = curves(folder, pulled, "chowdhury_fig_3", title, 4000, chosen, MIDDLE)
    return {label.replace(" ", "_"): results["sawtooth"] for label, (*_, results) in found.items()}


def chowdhury_4(folder):
    """Chowdhury Fig. 4: two sub-horizons at four horizons."""
    chosen = {f"horizon {h} dx": {"horizon": h, "scheme": "sub_horizons"} for h in (1.1, 2.1, 5.1, 10.1)}
    found = curves(folder, pulled, "chowdhury_fig_4", "Chowdhury Fig. 4: two sub-horizons, n = 4000", 4000, chosen)
    numbers = {f"end_{label.split()[1]}": results["end"] for label, (*_, results) in found.items()}
    return numbers | {"sawtooth": max(results["sawtooth"] for *_, results in found.values())}


def chowdhury_5(folder):
    """Chowdhury Fig. 5: two and four sub-horizons."""
    chosen = {f"{N} sub-horizons": {"horizon": 10.1, "scheme": "sub_horizons", "sectors": N} for N in (2, 4)}
    title = "Chowdhury Fig. 5: horizon 10.1 dx, n = 4000"
    (_, two, _), (_, four, _) = curves(folder, pulled, "chowdhury_fig_5", title, 4000, chosen).values()
    return {"two_against_four": float(np.abs(two - four).max() / pulled.BAR.end)}


def chowdhury_6(folder):
    """Chowdhury Fig. 6: refined under a fixed horizon and with the horizon."""
    fixed = {f"dx = L/{n}": {"n": n, "horizon": 0.01 * n, "scheme": "sub_horizons"} for n in REFINED}
    title = "Chowdhury Fig. 6: nonlocal, horizon 0.01 L"
    nonlocal_ = curves(folder, pulled, "chowdhury_fig_6_nonlocal", title, 4000, fixed)
    local = {f"dx = L/{n}": {"n": n, "horizon": 1.1, "scheme": "sub_horizons"} for n in REFINED}
    found = curves(folder, pulled, "chowdhury_fig_6_local", "Chowdhury Fig. 6: local, 1.1 dx", 4000, local)
    numbers = {f"local_error_{n}": found[f"dx = L/{n}"][2]["error"] for n in REFINED}
    x, finest, _ = nonlocal_[f"dx = L/{REFINED[-1]}"]
    for n in REFINED[:-1]:
        coarse_x, u, _ = nonlocal_[f"dx = L/{n}"]
        numbers[f"nonlocal_{n}"] = float(np.abs(u - np.interp(coarse_x, x, finest)).max() / pulled.BAR.end)
    return numbers


def draw_table(folder):
    """Write the table of all methods and its picture."""
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
    return {}


FIGURES = {
    "luo_7": luo_7,
    "chowdhury_1": chowdhury_1,
    "chowdhury_2": chowdhury_2,
    "chowdhury_3": chowdhury_3,
    "chowdhury_4": chowdhury_4,
    "chowdhury_5": chowdhury_5,
    "chowdhury_6": chowdhury_6,
    "table": draw_table,
}


def main():
    names = study.chosen(words, FIGURES)
    folder = study.folder_for(words, "out/singular_bar")
    numbers = {}
    for name in names:
        numbers |= {f"{name}.{key}": value for key, value in FIGURES[name](folder).items()}
    study.write_numbers(folder, numbers)


if __name__ == "__main__":
    main()
