"""Redraw figures 11, 12, 14, 15, 17, 20-22, 25 and 26 of Hashim, Coombs, Augarde and Hattori: one command.

    python runs/beams/figures.py [folder] [figure ...]

leaves ``fig_11.csv``, ``fig_11.png``, ... in the folder (default ``out/figures``), under mpirun too. The coefficient of
the zero-energy control is the pure number G of ``pdpetsc.Silling``, not the paper's, which carries a unit: its values
0.002, 0.013 and 0.031, called optimal, depend on the unit of length. ``docs/notes.md`` says where curves differ from
the paper's text.
"""

import math
import sys
from pathlib import Path

sys.path.insert(0, str(Path(__file__).parent.parent))
import study

words = study.start("beams", "patch")

import beam  # noqa: E402
import cantilever  # noqa: E402
import clamped  # noqa: E402
import elastica  # noqa: E402
import hydrostatic  # noqa: E402
import simply_supported  # noqa: E402
import strip  # noqa: E402
from scipy.optimize import brentq  # noqa: E402

HORIZONS = (1.015, 2.015, 3.015)
COEFFICIENTS = (0.0, 0.02, 0.05, 0.1, 0.2, 0.35, 0.5, 0.7, 1.0, 1.5, 2.0)
LOADS = [0.1 * i for i in range(11)]


def solve(folder, case):
    """Return the history of a case, or None where it did not converge."""
    done = study.run(folder, case)
    return None if done is None else done[0]


def final(history, name, scale):
    """Return the last value over a scale; nan where the run did not converge."""
    return math.nan if history is None else history[name][-1] / scale


def write(folder, name, title, columns, curves, **axes):
    exact = [label for label in curves if label.startswith(("strip", "elastica"))]
    study.write_curves(folder, name, title, columns, curves, exact, **axes)


def sweep(folder, make, key, scale, horizons=HORIZONS, **parameters):
    """Return the final value against G, one curve per horizon."""
    curves = {}
    for horizon in horizons:
        runs = [solve(folder, make(horizon=horizon, G=G, **parameters)) for G in COEFFICIENTS]
        curves[f"horizon {horizon} dx"] = (COEFFICIENTS, [final(run, key, scale) for run in runs])
    return curves


def best_coefficient(folder, make, key, scale, exact, horizon, **parameters):
    """Return the G that gives the exact final value, or 0 where even G = 0 is too stiff."""

    def excess(G):
        value = final(solve(folder, make(horizon=horizon, G=G, **parameters)), key, scale)
        return value / exact - 1.0 if math.isfinite(value) else math.inf

    if excess(0.0) <= 0.0:
        return 0.0
    return brentq(lambda G: min(excess(G), 1.0), 0.0, 20.0, xtol=2e-3)


def figure_11(folder):
    """Hydrostatic extension under load: error against G, horizons and spacings."""
    curves = {}
    for n in (13, 25, 49):
        found = sweep(folder, hydrostatic.case, "error", 1.0, n=n, loading="layer")
        curves |= {f"{label}, dx/L = 1/{n}": curve for label, curve in found.items()}
    title = "Hydrostatic extension: displacement error"
    write(folder, "fig_11", title, ("G", "error"), curves, yscale="log")


def figure_12(folder):
    """Hydrostatic extension under load: order of convergence."""
    curves = {}
    sizes = (9, 17, 33, 65)
    for horizon in HORIZONS[:2]:
        for G in (0.0, 0.5):
            error = [
                final(solve(folder, hydrostatic.case(n=n, horizon=horizon, G=G, loading="layer")), "error", 1.0)
                for n in sizes
            ]
            order = math.log(error[-2] / error[-1]) / math.log(sizes[-1] / sizes[-2])
            label = f"order {order:.2f}" if math.isfinite(order) else "did not converge"
            curves[f"horizon {horizon} dx, G = {G:g}: {label}"] = ([1.0 / n for n in sizes], error)
    title = "Hydrostatic extension: convergence with the spacing"
    write(folder, "fig_12", title, ("dx/L", "error"), curves, xscale="log", yscale="log")


def beam_against_G(folder, name, module, support, ny):
    """Midpoint deflection of a slender beam against G."""
    curves = sweep(folder, module.case, "w", -beam.THICKNESS, ny=ny)
    exact = strip.deflection(support, beam.PRESSURE, beam.LENGTH, beam.THICKNESS, beam.E, beam.NU)
    curves["strip"] = (COEFFICIENTS, [exact] * len(COEFFICIENTS))
    title = f"{module.__name__.replace('_', ' ').capitalize()} beam, {ny} x {25 * ny} particles"
    write(folder, name, title, ("G", "deflection / thickness"), curves)


def beam_under_load(folder, name, module, support):
    """Deflection of a slender beam against pressure, with the G that gives the exact one at full pressure."""
    exact = strip.deflection(support, beam.PRESSURE, beam.LENGTH, beam.THICKNESS, beam.E, beam.NU)
    curves = {}
    for horizon in HORIZONS:
        G = best_coefficient(folder, module.case, "w", -beam.THICKNESS, exact, horizon, ny=3)
        history = solve(folder, module.case(ny=3, horizon=horizon, G=G))
        w = [-value / beam.THICKNESS for value in history["w"]]
        curves[f"horizon {horizon} dx, G = {G:.2f}"] = ([t * beam.PRESSURE / 1e3 for t in history["t"]], w)
    deflection = [
        strip.deflection(support, t * beam.PRESSURE, beam.LENGTH, beam.THICKNESS, beam.E, beam.NU) if t else 0.0
        for t in LOADS
    ]
    curves["strip"] = ([t * beam.PRESSURE / 1e3 for t in LOADS], deflection)
    title = f"{module.__name__.replace('_', ' ').capitalize()} beam, 3 x 75 particles"
    write(folder, name, title, ("pressure / kPa", "deflection / thickness"), curves)


def cantilever_load(t, plane):
    """Return P L^2 / E I of the cantilever at step time ``t``."""
    E = cantilever.E / (1.0 - cantilever.NU**2) if plane == "strain" else cantilever.E
    return t * cantilever.FORCE * cantilever.LENGTH**2 * 12.0 / (E * cantilever.DEPTH**3)


def figure_25(folder):
    """Cantilever: deflection under a tenth of the load against G, in plane strain."""
    curves = sweep(folder, cantilever.case, "w", -cantilever.LENGTH, plane="strain", force=1e4)
    exact = elastica.tip(cantilever_load(0.1, "strain"))[0]
    curves["elastica"] = (COEFFICIENTS, [exact] * len(COEFFICIENTS))
    write(folder, "fig_25", "Cantilever, 5 x 50 particles, 10 kN", ("G", "w / L"), curves)


def figure_26(folder):
    """Cantilever: both displacements against the load, with the G that gives the exact deflection under 10 kN."""
    exact = [(0.0, 0.0), *(elastica.tip(cantilever_load(t, "strain")) for t in LOADS[1:])]
    curves = {}
    for horizon in HORIZONS:
        G = best_coefficient(
            folder, cantilever.case, "w", -cantilever.LENGTH, exact[1][0], horizon, plane="strain", force=1e4
        )
        history = solve(folder, cantilever.case(horizon=horizon, G=G, plane="strain"))
        load = [t * cantilever.FORCE / 1e3 for t in history["t"]]
        for name in ("w", "u"):
            values = [-value / cantilever.LENGTH for value in history[name]]
            curves[f"{name} / L, horizon {horizon} dx, G = {G:.2f}"] = (load, values)
    for index, name in enumerate(("w", "u")):
        curves[f"elastica {name} / L"] = ([t * cantilever.FORCE / 1e3 for t in LOADS], [row[index] for row in exact])
    write(folder, "fig_26", "Cantilever, 5 x 50 particles", ("force / kN", "displacement / L"), curves)


FIGURES = {
    "11": figure_11,
    "12": figure_12,
    "14": lambda folder: beam_against_G(folder, "fig_14", clamped, "clamped", 3),
    "15": lambda folder: beam_against_G(folder, "fig_15", clamped, "clamped", 5),
    "17": lambda folder: beam_under_load(folder, "fig_17", clamped, "clamped"),
    "20": lambda folder: beam_against_G(folder, "fig_20", simply_supported, "hinged", 3),
    "21": lambda folder: beam_against_G(folder, "fig_21", simply_supported, "hinged", 5),
    "22": lambda folder: beam_under_load(folder, "fig_22", simply_supported, "hinged"),
    "25": figure_25,
    "26": figure_26,
}


def main():
    unknown = [word for word in words[1:] if word not in FIGURES]
    if unknown:
        sys.exit(f"There is no figure {unknown[0]}; choose from {', '.join(FIGURES)}.")
    folder = study.folder_for(words, "out/figures")
    for name in words[1:] or FIGURES:
        FIGURES[name](folder)


if __name__ == "__main__":
    main()
