"""Redraw figures 9, 11, 12, 14-18, 20-23 and 25-27 of Hashim, Coombs, Augarde and Hattori: one command.

    python runs/beams/figures.py [folder] [figure ...]

leaves ``fig_11.csv``, ``fig_11.png``, ... and ``numbers.json``, with what each figure says as a number, in the folder
(default ``out/figures``), under mpirun too. The coefficient of the zero-energy control is the paper's G
(``pdpetsc.SillingMicromodulus``). The text does not state its unit of length: 15.933 mm for the slender beams
(``beam.UNIT``) and 1.041 m for the cantilever (``cantilever.UNIT``) are fitted to tables 2 and 4; one metre for the
plate puts the least error of figure 11 where the text has it. ``runs/papers/hashim_beams.toml`` compares the numbers
with the paper and says where they differ.
"""

import dataclasses
import math
import sys
from pathlib import Path

sys.path.insert(0, str(Path(__file__).parent.parent))
import study

words = study.start("beams", "patch")

import beam
import cantilever
import clamped
import elastica
import hydrostatic
import numpy as np
import simply_supported
import strip
from scipy.optimize import brentq

import pdpetsc as pd
from pdpetsc.discrete.communicator import is_root, world

HORIZONS = (1.015, 2.015, 3.015)
BEAM_G = (0.0, 0.002, 0.007, 0.013, 0.02, 0.031, 0.05)
CANTILEVER_G = (0.0, 0.02, 0.1, 0.2, 0.5, 1.0)
PLATE_G = (0.0, 0.001, 0.003, 0.01, 0.03, 0.1, 0.3, 1.0)
PLATES = (13, 25, 49)
# The G of figures 17 and 18, and those that sections 4.3 and 4.4 both state, for figures 22 and 26.
CLAMPED_BEST = (0.002, 0.013, 0.031)
CLAMPED_CONTOURS = (0.0, 0.002, 0.004, 0.006, 0.007, 0.008)
SUPPORTED_CONTOURS = (0.0, 0.0025, 0.005, 0.01, 0.02)
STATED = (0.0, 0.05, 0.315)
LOADS = [0.1 * i for i in range(11)]
# For figure 22 the text repeats those of the cantilever; the last two are that of Table 3 and one that fits.
SUPPORTED_BEST = (*zip(HORIZONS, STATED, strict=True), (2.015, 0.02), (3.015, 0.05))
FULL_STEPS = {"snes_linesearch_type": "basic"}
ACCURACY = {"snes_rtol": 1e-8}


def solve(folder, case):
    """Return the history of a case, or None where it did not converge with its steps cut twice."""
    steps = case.steps.count
    done = study.run(folder, dataclasses.replace(case, checkpoints=0, steps=pd.Steps(steps, smallest=0.25 / steps)))
    return None if done is None else done[0]


def end(folder, case):
    """Return the history of an elastic case of which only the end counts: in four load steps, each less accurate."""
    done = solve(folder, dataclasses.replace(case, options=ACCURACY, steps=pd.Steps(min(case.steps.count, 4))))
    return solve(folder, case) if done is None else done


def final(history, name, scale):
    """Return the last value over a scale; nan where the run did not converge."""
    return math.nan if history is None else history[name][-1] / scale


def write(folder, name, title, columns, curves, **axes):
    exact = [label for label in curves if label.startswith(("strip", "elastica"))]
    study.write_curves(folder, name, title, columns, curves, exact, **axes)


def sweep(folder, make, key, scale, coefficients, **parameters):
    """Return the final value against the paper's G, one curve per horizon."""
    curves = {}
    for horizon in HORIZONS:
        runs = [end(folder, make(horizon=horizon, G_printed=G, **parameters)) for G in coefficients]
        curves[f"horizon {horizon} dx"] = (coefficients, [final(run, key, scale) for run in runs])
    return curves


def best_coefficient(folder, make, key, scale, exact, horizon, curve, **parameters):
    """Return the paper's G that gives the exact final value, between those of a curve; 0 where G = 0 is too stiff."""

    def above(value):
        return min(value / exact - 1.0, 1.0) if math.isfinite(value) else 1.0

    def excess(G):
        return above(final(end(folder, make(horizon=horizon, G_printed=G, **parameters)), key, scale))

    known = [(G, above(value)) for G, value in zip(*curve, strict=True)]
    if known[0][1] <= 0.0:
        return 0.0
    last = next(number for number, (_, value) in enumerate(known) if value <= 0.0)
    of = dict(known[last - 1 : last + 1])
    low, high = of
    return brentq(lambda G: of[G] if G in of else excess(G), low, high, xtol=2e-5 * known[-1][0])


def finite(numbers):
    """Return the numbers that there are: a run that did not converge has none."""
    return {name: value for name, value in numbers.items() if math.isfinite(value)}


# Section 4.1: square plate under hydrostatic extension.


def plate(n, horizon, G):
    return hydrostatic.case(n=n, horizon=horizon, G_printed=G, loading="layer", steps=1)


def figure_9(folder):
    """The plate before and after at horizon 2.015 and G = 1; displacement of the middle of its right side."""
    x, u, _ = fields(folder, plate(25, 2.015, 1.0))
    if is_root(world()):
        figure, (axes,) = panels(1, 1, (6.0, 6.0))
        for y, colour in ((x, "tab:red"), (x + u, "tab:blue")):
            axes.plot(*y.T, ".", color=colour, markersize=2)
        axes.set(xlabel="x / m", ylabel="y / m", aspect="equal", title="Hydrostatic extension")
        save(figure, folder, "fig_9")
    side = np.argmin(np.hypot(x[:, 0] - x[:, 0].max(), x[:, 1]))
    # The outermost particles lie half a spacing inside the side.
    return {"fig_9_side": float(u[side, 0] * 0.5 / x[side, 0])}


def figure_11(folder):
    """Hydrostatic extension under load: error against G, horizons and spacings."""
    curves, numbers = {}, {}
    for n in PLATES:
        for horizon in HORIZONS:
            # With less control wide horizons have no stable equilibrium under the whole load on coarse lattices.
            least = {1.015: 0.0, 2.015: 0.003, 3.015: 0.03}[horizon]
            G = [g for g in PLATE_G if g >= least]
            error = [final(solve(folder, plate(n, horizon, g)), "error", 1.0) for g in G]
            curves[f"horizon {horizon} dx, dx/L = 1/{n}"] = (G, error)
            least = int(np.nanargmin(error))
            numbers[f"fig_11_n{n}_horizon_{horizon}_least_at"] = G[least]
            numbers[f"fig_11_n{n}_horizon_{horizon}_least_error"] = error[least]
            numbers[f"fig_11_n{n}_horizon_{horizon}_error_at_1"] = error[-1]
    title = "Hydrostatic extension: displacement error"
    write(folder, "fig_11", title, ("G", "error"), curves, xscale="log", yscale="log")
    return finite(numbers)


def figure_12(folder):
    """Hydrostatic extension under load: order of convergence at G = 0.01 and 1, and without control."""
    curves, numbers = {}, {}
    for horizon in HORIZONS[:2]:
        for G in (0.0, 0.01, 1.0) if horizon < 2 else (0.01, 1.0):
            error = [final(solve(folder, plate(n, horizon, G)), "error", 1.0) for n in PLATES]
            order = math.log(error[-2] / error[-1]) / math.log(PLATES[-1] / PLATES[-2])
            numbers[f"fig_12_horizon_{horizon}_G_{G:g}_order"] = order
            curves[f"horizon {horizon} dx, G = {G:g}: order {order:.2f}"] = ([1.0 / n for n in PLATES], error)
    title = "Hydrostatic extension: convergence with the spacing"
    write(folder, "fig_12", title, ("dx/L", "error"), curves, xscale="log", yscale="log")
    return finite(numbers)


# Sections 4.2 and 4.3: slender beams.


def exact_deflection(support, part=1.0):
    if part == 0.0:
        return 0.0
    return strip.deflection(support, part * beam.PRESSURE, beam.LENGTH, beam.THICKNESS, beam.E, beam.NU)


def named(module):
    return f"{module.__name__.replace('_', ' ').capitalize()} beam"


def beam_against_G(folder, name, module, support, ny):
    """Midpoint deflection of a slender beam against G, and the G of the exact one."""
    curves = sweep(folder, module.case, "w", -beam.THICKNESS, BEAM_G, ny=ny)
    exact, numbers = exact_deflection(support), {}
    for horizon in HORIZONS:
        values = curves[f"horizon {horizon} dx"][1]
        numbers[f"{name}_horizon_{horizon}_at_0"] = values[0] / exact - 1.0
        numbers[f"{name}_horizon_{horizon}_at_0.05"] = values[-1] / exact - 1.0
        numbers[f"{name}_horizon_{horizon}_best"] = best_coefficient(
            folder, module.case, "w", -beam.THICKNESS, exact, horizon, curves[f"horizon {horizon} dx"], ny=ny
        )
    curves["strip"] = (BEAM_G, [exact] * len(BEAM_G))
    write(folder, name, f"{named(module)}, {ny} x {25 * ny} particles", ("G", "deflection / thickness"), curves)
    return finite(numbers)


def beam_under_load(folder, name, module, support, choices):
    """Deflection of a slender beam against pressure, for pairs of horizon and G."""
    curves, numbers = {}, {}
    exact = [exact_deflection(support, t) for t in LOADS]
    for horizon, G in choices:
        history = solve(folder, module.case(ny=3, horizon=horizon, G_printed=G))
        w = [-value / beam.THICKNESS for value in history["w"]]
        curves[f"horizon {horizon} dx, G = {G:.3f}"] = ([t * beam.PRESSURE / 1e3 for t in history["t"]], w)
        numbers[f"{name}_horizon_{horizon}_G_{G:g}"] = w[-1] / exact[-1] - 1.0
        furthest = max(abs(found - right) for found, right in zip(w[-len(LOADS) + 1 :], exact[1:], strict=True))
        numbers[f"{name}_horizon_{horizon}_G_{G:g}_furthest"] = furthest / exact[-1]
    curves["strip"] = ([t * beam.PRESSURE / 1e3 for t in LOADS], exact)
    write(folder, name, f"{named(module)}, 3 x 75 particles", ("pressure / kPa", "deflection / thickness"), curves)
    return numbers


def figure_16(folder):
    """Clamped beam in ten load steps, by Newton's method and by explicit dynamic relaxation: error against time."""
    curves, numbers = {}, {}
    study.run(folder, clamped.case(ny=3))  # so that no kernel is compiled or loaded while the clock runs
    for label, solver in (("implicit", pd.Newton()), ("explicit", pd.DynamicRelaxation(tolerance=1e-4))):
        seconds, errors = [], []
        for ny in (3, 5):
            case = dataclasses.replace(clamped.case(ny=ny), solver=solver, checkpoints=0)
            _, summary = study.run(folder, case)
            seconds.append(summary["timings"]["solve"])
            errors.append(summary["results"]["error"])
            numbers[f"fig_16_{label}_ny{ny}_error"] = errors[-1]
        curves[label] = (seconds, errors)
    for index, ny in enumerate((3, 5)):
        times_slower = curves["explicit"][0][index] / curves["implicit"][0][index]
        numbers[f"fig_16_ny{ny}_orders_slower"] = math.log10(times_slower)
    title = "Clamped beam, 3 x 75 and 5 x 125 particles"
    write(folder, "fig_16", title, ("seconds", "error"), curves, xscale="log", yscale="log")
    return numbers


# Section 4.4: cantilever.


def deep(**parameters):
    return cantilever.case(plane="strain", **parameters)


def cantilever_load(t):
    """Return P L^2 / E I of the cantilever at step time ``t``.

    A body in plane strain bends with E / (1 - nu^2), but only with E does G = 0 fit at horizon 1.015, as the text says.
    """
    return t * cantilever.FORCE * cantilever.LENGTH**2 * 12.0 / (cantilever.E * cantilever.DEPTH**3)


def figure_25(folder):
    """Cantilever: deflection under a tenth of the load against G."""
    curves = sweep(folder, deep, "w", -cantilever.LENGTH, CANTILEVER_G, force=0.1 * cantilever.FORCE)
    exact = elastica.tip(cantilever_load(0.1))[0]
    numbers = {}
    for horizon in HORIZONS:
        values = curves[f"horizon {horizon} dx"][1]
        numbers[f"fig_25_horizon_{horizon}_at_0"] = values[0]
        numbers[f"fig_25_horizon_{horizon}_at_1"] = values[-1] / exact - 1.0
        numbers[f"fig_25_horizon_{horizon}_best"] = best_coefficient(
            folder,
            deep,
            "w",
            -cantilever.LENGTH,
            exact,
            horizon,
            curves[f"horizon {horizon} dx"],
            force=0.1 * cantilever.FORCE,
        )
    numbers["fig_25_elastica"] = exact
    curves["elastica"] = (CANTILEVER_G, [exact] * len(CANTILEVER_G))
    write(folder, "fig_25", "Cantilever, 5 x 50 particles, 10 kN", ("G", "w / L"), curves)
    return finite(numbers)


def figure_26(folder):
    """Cantilever: both displacements against the load with the G of the paper."""
    exact = [(0.0, 0.0), *(elastica.tip(cantilever_load(t)) for t in LOADS[1:])]
    curves, numbers = {}, {}
    for horizon, G in zip(HORIZONS, STATED, strict=True):
        history = solve(folder, deep(horizon=horizon, G_printed=G))
        load = [t * cantilever.FORCE / 1e3 for t in history["t"]]
        for index, name in enumerate(("w", "u")):
            values = [-value / cantilever.LENGTH for value in history[name]]
            curves[f"{name} / L, horizon {horizon} dx, G = {G:g}"] = (load, values)
            numbers[f"fig_26_horizon_{horizon}_{name}"] = values[-1] / exact[-1][index] - 1.0
    for index, name in enumerate(("w", "u")):
        curves[f"elastica {name} / L"] = ([t * cantilever.FORCE / 1e3 for t in LOADS], [row[index] for row in exact])
    write(folder, "fig_26", "Cantilever, 5 x 50 particles", ("force / kN", "displacement / L"), curves)
    return numbers


# Contours of stress on the deformed body.


def fields(folder, case):
    """Run a case and return positions, displacements (n, dim) and stress (n, 3, 3) of its end, on every rank."""
    done = pd.run(dataclasses.replace(case, picture=None, checkpoints=0), output=folder / "last_run")
    found = done.x[:, :2], done.field("displacement")[:, :2], done.field("stress")
    world().Barrier()
    return found


def oscillation(x, values, away):
    """Return the largest second difference of a field along the rows of a beam over its range.

    Parameters
    ----------
    x : (n, 2) float64
        Positions; the body lies at x > 0 [length].
    values : (n,) float64
        The field.
    away : float
        Columns this close to either end are left out: families that an end cuts see another stress there [length].
    """
    inside = x[:, 0] > 0.0
    x, values = x[inside], values[inside]
    order = np.lexsort((x[:, 0], np.round(x[:, 1] / np.ptp(x[:, 1]), 6)))
    columns = len(np.unique(np.round(x[:, 0] / np.ptp(x[:, 0]), 6)))
    rows, along = values[order].reshape(-1, columns), x[order, 0].reshape(-1, columns)
    second = np.abs(np.diff(rows, 2, axis=1))
    kept = (along[:, 1:-1] > away) & (along[:, 1:-1] < x[:, 0].max() - away)
    return float(second[kept].max() / np.ptp(values))


def panels(rows, columns, size):
    from matplotlib.figure import Figure

    figure = Figure(figsize=size, layout="constrained")
    return figure, np.ravel(figure.subplots(rows, columns))


def save(figure, folder, name):
    figure.savefig(folder / f"{name}.png", dpi=130)
    print(f"{folder / name}.png", flush=True)


def contour(figure, axes, x, u, values, title, limits, unit, size, height=1.0):
    """Draw the deformed body, coloured by stress in kPa; particles are boxes so many times as high as wide."""
    inside = x[:, 0] > 0.0
    y = (x + u)[inside] / unit[0]
    box = [(-1.0, -height), (1.0, -height), (1.0, height), (-1.0, height)]
    drawn = axes.scatter(
        *y.T, c=values[inside] / 1e3, s=size, marker=box, linewidths=0, cmap="jet", vmin=limits[0], vmax=limits[1]
    )
    figure.colorbar(drawn, ax=axes, label="kPa", pad=0.01)
    axes.set(title=title, ylabel=f"y / {unit[1]}", xlabel=f"x / {unit[1]}")
    axes.title.set_fontsize(9)


def beam_contours(folder, name, module, horizon, coefficients):
    """Stress along a slender beam of 5 x 125 particles on its deformed shape, for several G; colours are shared."""
    found, numbers = {}, {}
    for G in coefficients:
        x, u, stress = fields(folder, module.case(ny=5, horizon=horizon, G_printed=G))
        found[G] = x, u, stress[:, 0, 0]
        for place, away in (("everywhere", 0.0), ("inside", 2.0 * horizon * beam.THICKNESS / 5)):
            numbers[f"{name}_G_{G:g}_{place}"] = oscillation(x, stress[:, 0, 0], away)
        numbers[f"{name}_G_{G:g}_deflection"] = -float(u[np.argmax(x[:, 0] - abs(x[:, 1])), 1]) / beam.THICKNESS
    if is_root(world()):
        smooth = found[coefficients[-1]]
        limits = np.percentile(smooth[2][smooth[0][:, 0] > 0.0] / 1e3, [1, 99])
        figure, axes = panels(len(found), 1, (10.0, 1.9 * len(found)))
        for one, (G, (x, u, values)) in zip(axes, found.items(), strict=True):
            contour(
                figure, one, x, u, values, f"sigma_xx, horizon {horizon} dx, G = {G:g}", limits, (1e-3, "mm"), 60, 2.0
            )
        save(figure, folder, name)
    return numbers


def figure_27(folder):
    """Three components of the stress of the cantilever, with the G of the paper and without control."""
    numbers = {}
    for G in (0.05, 0.0):
        x, u, stress = fields(folder, deep(horizon=2.015, G_printed=G, pinned="particle"))
        figure, axes = panels(1, 3, (12.0, 5.0))
        for one, (component, i, j) in zip(axes, (("xx", 0, 0), ("yy", 1, 1), ("xy", 0, 1)), strict=True):
            values = stress[:, i, j]
            numbers[f"fig_27_G_{G:g}_{component}"] = oscillation(x, values, 2.0 * 2.015 * cantilever.DEPTH / 5)
            limits = np.percentile(values[x[:, 0] > 0.0] / 1e3, [1, 99])
            contour(figure, one, x, u, values, f"sigma_{component}, G = {G:g}", limits, (1.0, "m"), 45)
            one.set_aspect("equal")
        if is_root(world()):
            save(figure, folder, "fig_27" if G else "fig_27_without_control")
    for G in (0.0, 0.01, 0.02, 0.03, 0.04, 0.05):
        case = deep(horizon=2.015, G_printed=G, pinned="particle")
        done = study.run(folder, dataclasses.replace(case, options=FULL_STEPS, steps=pd.Steps(10, smallest=0.1)))
        numbers[f"fig_27_G_{G:g}_full_steps_converge"] = float(done is not None)
    return numbers


FIGURES = {
    "9": figure_9,
    "11": figure_11,
    "12": figure_12,
    "14": lambda folder: beam_against_G(folder, "fig_14", clamped, "clamped", 3),
    "15": lambda folder: beam_against_G(folder, "fig_15", clamped, "clamped", 5),
    "16": figure_16,
    "17": lambda folder: beam_under_load(
        folder, "fig_17", clamped, "clamped", list(zip(HORIZONS, CLAMPED_BEST, strict=True))
    ),
    "18": lambda folder: beam_contours(folder, "fig_18", clamped, 2.015, CLAMPED_CONTOURS),
    "20": lambda folder: beam_against_G(folder, "fig_20", simply_supported, "hinged", 3),
    "21": lambda folder: beam_against_G(folder, "fig_21", simply_supported, "hinged", 5),
    "22": lambda folder: beam_under_load(folder, "fig_22", simply_supported, "hinged", SUPPORTED_BEST),
    "23": lambda folder: (
        beam_contours(folder, "fig_23", simply_supported, 2.015, SUPPORTED_CONTOURS)
        | beam_contours(folder, "fig_23_horizon_1.015", simply_supported, 1.015, SUPPORTED_CONTOURS)
    ),
    "25": figure_25,
    "26": figure_26,
    "27": figure_27,
}


if __name__ == "__main__":
    study.draw_chosen(words, FIGURES, "out/figures")
