"""Higher-order weights with every influence function, beside the controls of the papers.

    python runs/singular_bar/weights.py [folder] [bar|layers|symbol|plate ...]        # default out/weights and all

``bar``: the singular bar, one particle held and one displaced, n = 100 to 1000, horizons 2.015 to 10.1 spacings, orders
1 (plain), 3, 5 and the highest that the family allows, ``2 m - 1`` for m neighbours on a side, up to 11. ``layers``:
n = 500, all particles nearer to an end than the horizon with the exact displacement, an easier problem. ``symbol``:
what F sees of a wave, ``sum_j g_j sin(k xi_j) / k``, whose zeros are zero-energy modes. ``plate``: the plate with a
square opening. ``of_bar`` and ``of_plate`` are those parts of ``bar`` and ``plate`` whose numbers the table of the
papers has, and run only where they are named. Curves are left as CSV and pictures, and ``numbers.json`` has the numbers
of one call: the sawtooth is the largest second difference over the end displacement on the left half, where the exact
displacement is linear; ``failed`` is how many of the four influence functions give a mean error above 100 % or no
solution, ``spread`` the range of their errors over the least.
Reference: Yaghoobi, Chorzepa (2017), abstract and section 1.
"""

import dataclasses
import sys
from pathlib import Path

sys.path.insert(0, str(Path(__file__).parent.parent))
import study

words = study.start("singular_bar", "plates")

import bar
import numpy as np
import square_opening

import pdpetsc as pd
from pdpetsc.discrete.communicator import total

SIZES = (100, 200, 500, 1000)
HORIZONS = (2.015, 3.015, 5.1, 10.1)
INFLUENCES = {
    "constant": pd.influence.Constant(),
    "linear": pd.influence.Linear(),
    "cubic": pd.influence.Cubic(),
    "gaussian": pd.influence.Gaussian(),
}
OTHERS = {
    "Silling": {"control": "silling"},
    "Littlewood": {"control": "littlewood"},
    "springs": {"control": "springs"},
    "averaged displacement": {"control": "averaged_displacement"},
    "Wan": {"control": "wan"},
    "sub-horizons": {"scheme": "sub_horizons"},
}
BEYOND_REPAIR = 1.0


def orders(horizon):
    """Return 1, 3, 5 and the highest order of a family with that many neighbours on a side."""
    return sorted({1, 3, 5, min(2 * int(horizon) - 1, 11)})


def solve(folder, case):
    """Return mean error and sawtooth on the left and the right half; nan where there is no solution."""
    done = study.run(folder, case)
    return tuple(done[1]["results"].values()) if done else (np.nan,) * 3


def weighted(case, influence):
    return dataclasses.replace(case, influence=INFLUENCES[influence])


def in_layers(case):
    """Return the bar with the exact displacement prescribed up to one horizon from its ends."""

    def u(x, t):
        return t * bar.BAR.exact(x, t)[:, 0]

    ends = (pd.region.Slab("x", high=case.horizon), pd.region.Slab("x", low=1.0 - case.horizon))
    return dataclasses.replace(case, conditions=[pd.Displacement(end, x=u) for end in ends])


def unchanged(case):
    return case


def sweep(folder, name, sizes, change, compare):
    """Solve bars with all weights, and with the other methods; write a table and the curves of n = 500.

    ``sizes`` has the horizons of each n.
    """
    rows, numbers, curves = [], {}, {}
    for n, horizons in sizes.items():
        for horizon in horizons:
            for order in orders(horizon):
                found = {}
                for influence in INFLUENCES:
                    case = bar.case(n=n, horizon=horizon, scheme="higher_order", order=order)
                    found[influence] = solve(folder, change(weighted(case, influence)))
                    rows.append((n, horizon, f"order {order}", influence, *found[influence]))
                    # A number that depends on round-off is none.
                    if found[influence][0] < BEYOND_REPAIR:
                        for key, value in zip(("error", "sawtooth"), found[influence], strict=False):
                            numbers[f"{key}_{n}_{horizon:g}_{influence}_{order}"] = value
                errors, sawtooth = np.array([values[:2] for values in found.values()]).T
                useful = errors < BEYOND_REPAIR
                numbers[f"failed_{n}_{horizon:g}_{order}"] = np.count_nonzero(~useful)
                if useful.all():
                    numbers[f"spread_{n}_{horizon:g}_{order}"] = np.ptp(errors) / errors.min()
                if n == 500 and useful.any():
                    label = f"order {order}, best of four weights" if order < 7 else "highest order, best of four"
                    curves.setdefault(label, []).append((horizon, sawtooth[useful].min()))
            for label, parameters in compare.items():
                found = solve(folder, change(bar.case(n=n, horizon=horizon, **parameters)))
                rows.append((n, horizon, label, "constant", *found))
                numbers |= {f"error_{n}_{horizon:g}_{label}": found[0], f"sawtooth_{n}_{horizon:g}_{label}": found[1]}
                if n == 500:
                    curves.setdefault(label, []).append((horizon, max(found[1], 1e-18)))
    header = ["n", "horizon_over_dx", "method", "influence", "error", "sawtooth", "sawtooth_right"]
    study.write_table(folder, name, header, rows)
    columns = ["horizon / dx", "second difference / u_end"]
    several = {label: tuple(zip(*points, strict=True)) for label, points in curves.items()}
    study.write_curves(folder, f"{name}_sawtooth", f"{name}, n = 500", columns, several, yscale="log")
    return {f"{name}.{key}": value for key, value in numbers.items()}


def symbol(folder):
    """Write what F sees of sines, and where it first sees nothing of them [share of the shortest wave number]."""
    waves = np.linspace(0.0, 1.0, 401)[1:]
    curves, rows, numbers = {}, [], {}
    for horizon in HORIZONS:
        for order in orders(horizon):
            for influence in INFLUENCES:
                case = bar.case(n=101, horizon=horizon, scheme="higher_order", order=order)
                problem = study.build(
                    dataclasses.replace(weighted(case, influence), material=pd.LinearElastic(E=1.0, nu=0.0))
                )
                xi = problem.body.cloud.x - 0.5
                middle = np.abs(xi[: problem.body.cloud.n_owned, 0]) < 1e-6
                k = waves * np.pi * 100.0
                seen = [
                    problem.material_term.operator.gradient(np.sin(one * xi) / one)[middle, 0, 0].sum() for one in k
                ]
                seen = total(problem.body.cloud.comm, np.array(seen))
                zero = waves[np.flatnonzero(seen < 1e-9)[0]]
                rows.append((horizon, order, influence, zero))
                numbers[f"symbol.zero_{horizon:g}_{influence}_{order}"] = zero
                if influence in ("constant", "cubic") and horizon < 10.0:
                    curves[f"horizon {horizon:g}, order {order}, {influence}"] = (waves, seen)
    study.write_table(folder, "zeros", ["horizon_over_dx", "order", "influence", "first zero"], rows)
    study.write_curves(folder, "symbol", "What F sees of a wave", ["k dx / pi", "F - 1 over the exact one"], curves)
    return numbers


def on_plates():
    """Return horizon, method and influence of everything that runs on the plate."""
    methods = []
    for horizon in (2.015, 3.015):
        methods += [(horizon, order, influence) for order in orders(horizon) for influence in INFLUENCES]
        methods += [(horizon, label, "constant") for label in OTHERS]
    return methods


# Those that the table of the papers has numbers of.
IN_THE_TABLE = (
    (2.015, 1, "cubic"), (2.015, 3, "constant"), (2.015, 3, "cubic"), (3.015, 5, "cubic"),
    *((2.015, label, "constant") for label in ("Silling", "Littlewood", "springs", "averaged displacement")),
    (3.015, "Silling", "constant"),
)  # fmt: skip


def plates(folder, methods):
    """Return errors and oscillations of the plate with a square opening, by orders or other methods."""
    rows, numbers = [], {}
    for horizon, method, influence in methods:
        if method in OTHERS:
            case, label = square_opening.case(horizon=horizon, **OTHERS[method]), method
        else:
            case, label = square_opening.case(horizon=horizon), f"order {method}"
            case = dataclasses.replace(weighted(case, influence), scheme=pd.HigherOrder(method))
        rows.append((horizon, label, influence, study.run(folder, case)))
    keys = ("u_amplitude", "u_oscillation", "stress_amplitude", "stress_oscillation")
    table = []
    for horizon, method, influence, done in rows:
        found = [done[1]["results"][key] if done else np.nan for key in keys]
        table.append((horizon, method, influence, *found))
        if found[0] < BEYOND_REPAIR:
            name = f"{horizon:g}_{method}" + (f"_{influence}" if method.startswith("order") else "")
            numbers |= {f"plate.{key}_{name}": value for key, value in zip(keys, found, strict=True)}
    study.write_table(folder, "plate", ["horizon_over_dx", "method", "influence", *keys], table)
    return numbers


STUDIES = {
    "bar": lambda folder: sweep(folder, "bar", dict.fromkeys(SIZES, HORIZONS), unchanged, OTHERS),
    "layers": lambda folder: sweep(folder, "layers", {500: HORIZONS}, in_layers, OTHERS),
    "symbol": symbol,
    "plate": lambda folder: plates(folder, on_plates()),
}
# Of what others run too.
PARTS = {
    "of_bar": lambda folder: sweep(
        folder, "bar", dict.fromkeys(SIZES, HORIZONS[:1]) | {500: HORIZONS}, unchanged, OTHERS
    ),
    "of_plate": lambda folder: plates(folder, IN_THE_TABLE),
}


if __name__ == "__main__":
    study.draw_chosen(words, STUDIES, "out/weights", "study", PARTS)
