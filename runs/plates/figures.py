"""Redraw figures 9, 10, 12, 13, 14 of Luo and Sundararaghavan and 8, 9 of Chowdhury, Roy, Roy and Reddy.

    python runs/plates/figures.py [folder] [luo_9 | luo_10 | luo_12 | luo_13 | luo_14 | chowdhury_8 | chowdhury_9 ...]

leaves pictures and, of curves, tables in the folder (default ``out/plate_figures``), under mpirun too; ``numbers.json``
has the numbers that belong to the figures of one call. Names of numbers end in ``plain`` (no control), ``points``
(stress points) and ``sectors`` (sub-horizons).
"""

import dataclasses
import sys
from pathlib import Path

sys.path.insert(0, str(Path(__file__).parent.parent))
import study

words = study.start("singular_bar", "plates")

import bar
import brick
import diamond_hole
import matplotlib
import numpy as np
import plate
import square_opening
from matplotlib.figure import Figure

import pdpetsc as pd
from pdpetsc.discrete.communicator import is_root, world

LABELS = {
    "plain": ("no control", {"scheme": "correspondence"}),
    "points": ("stress points", {"scheme": "stress_points"}),
    "sectors": ("sub-horizons", {"scheme": "sub_horizons"}),
}
LUO = ("plain", "points")
CHOWDHURY = ("plain", "sectors")
# Each problem of figure 14 of Luo and Sundararaghavan at three sizes.
COSTS = {
    "bar": (bar.case, "n", (100, 200, 500)),
    "plate": (square_opening.case, "dx", (5.0, 4.0, 2.0)),
    "brick": (brick.case, "dx", (8.0, 5.0, 4.0)),
}
# In bands, as contours are, a sawtooth shows as a serrated border.
BANDS = matplotlib.colormaps["turbo"].resampled(20)


def solve(folder, case, **more):
    """Run a case, ``more`` quantities added; return its last results."""
    case = dataclasses.replace(case, history={**case.history, **more})
    done = study.run(folder, case)
    if done is None:
        sys.exit(f"A case of the figures in {folder} did not converge; run it by itself to see why.")
    return {name: values[-1] for name, values in done[0].items()}


def save(folder, name, figure):
    if is_root(world()):
        figure.savefig(folder / f"{name}.png", dpi=130)
        print(f"{folder / name}.png", flush=True)


def spread(values):
    """Return root mean square and largest size of what is not NaN."""
    known = values[np.isfinite(values)]
    return float(np.sqrt((known**2).mean())), float(np.abs(known).max())


def luo_9(folder):
    """Contours of u_x around the square opening, the quarter of the whole plate that the paper shows."""
    figure = Figure(figsize=(10.5, 4.6), layout="constrained")
    numbers = {}
    for plot, key in zip(figure.subplots(1, 2), LUO, strict=True):
        label, words_of = LABELS[key]
        case = square_opening.case(**words_of)
        dx = case.particles.spacing
        whole = plate.Whole(plate.displacement_x)
        solve(folder, case, whole=whole)
        x, u = whole.x, whole.v
        waves = plate.sawtooth(x, u, dx) / square_opening.STRETCH
        reach = np.abs(x).max(axis=1)
        # Around the opening, away from its corners, which are singular.
        corners = np.abs(np.abs(x) - square_opening.OPENING).max(axis=1) < (plate.ENDS + 0.5) * dx
        around = (reach < square_opening.OPENING + square_opening.AWAY) & ~corners
        numbers[f"luo_9_sawtooth_{key}"], numbers[f"luo_9_largest_sawtooth_{key}"] = spread(waves[around])
        shown = (x > -0.1 * dx).all(axis=1)
        drawn = plot.scatter(*x[shown].T, c=u[shown], s=11, marker="s", cmap=BANDS, vmin=0.0, vmax=0.4)
        plot.set(title=f"{label}, u_x / mm", aspect="equal", xlabel="x / mm", ylabel="y / mm")
        figure.colorbar(drawn, ax=plot)
    save(folder, "luo_9", figure)
    return numbers


def along_line(case, **fields):
    """Return a profile for each field of a case along its line."""
    line = case.history["u_amplitude"].line
    return {name: plate.Profile(line, field) for name, field in fields.items()}


def local_amplitude(found, exact):
    """Return |a - b| / |b| at every particle (Luo, Sundararaghavan, Eq. 22), NaN where b is zero or a is prescribed."""
    size, error = np.abs(exact), np.abs(found - exact)
    counts = (size > plate.SMALL * size.max()) & (error > 1e-9 * size)
    return np.where(counts, error / np.where(counts, size, 1.0), np.nan)


def curves(folder, name, title, cases, **fields):
    """Draw each field along the line and its amplitude, ``cases`` by label; return the results of each case."""
    figure = Figure(figsize=(6.5 * len(fields), 7.0), layout="constrained")
    plots = np.reshape(figure.subplots(2, len(fields)), (2, len(fields)))
    rows, results = [], {}
    for label, case in cases.items():
        profiles = along_line(case, **{key: field for key, (field, _) in fields.items()})
        results[label] = solve(folder, case, **{f"profile_{key}": profile for key, profile in profiles.items()})
        for column, (key, profile) in enumerate(profiles.items()):
            exact = profile.line.reference(key, profile.s)
            amplitude = local_amplitude(profile.v, exact)
            plots[0, column].plot(profile.s, profile.v, ".-", markersize=3, linewidth=0.8, label=label)
            plots[1, column].semilogy(profile.s, amplitude, ".-", markersize=3, linewidth=0.8, label=label)
            rows += [(label, key, *row) for row in zip(profile.s, profile.v, exact, amplitude, strict=True)]
    for column, (key, (_, text)) in enumerate(fields.items()):
        plots[0, column].plot(profile.s, profiles[key].line.reference(key, profile.s), "k--", label="finite elements")
        plots[0, column].set(ylabel=text, title=title)
        plots[1, column].set(xlabel="along the line", ylabel=f"amplitude of {text.split(' / ')[0]}")
        for plot in plots[:, column]:
            plot.grid(alpha=0.3)
            plot.legend(fontsize=8)
    study.write_table(folder, name, ("curve", "field", "s", "value", "finite elements", "amplitude"), rows)
    save(folder, name, figure)
    return results


def numbers_of(prefix, results):
    """Return the numbers of each case under names that end in its key."""
    keep = ("amplitude", "oscillation")
    return {
        f"{prefix}_{name}_{key}": value
        for key, found in results.items()
        for name, value in found.items()
        if any(word in name for word in keep)
    }


def luo_10(folder):
    """Displacement, stress and their amplitudes along the x axis of the plate with a square opening.

    Of the whole plate and of a quarter on its symmetry lines, with whole cells and with cells clipped at the edges, and
    of a quarter before mirror planes.
    """
    fields = {"u": (plate.displacement_x, "u_x / mm"), "stress": (plate.stress_xx, "sigma_xx / MPa")}
    numbers = {}
    kinds = {"whole": {}, "quarter": {"part": "quarter_cut"}, "clipped": {"cells": "clipped"}}
    kinds["clipped_quarter"] = {"part": "quarter_cut", "cells": "clipped"}
    kinds["mirrored_quarter"] = {"part": "quarter"}
    for kind, more in kinds.items():
        cases = {LABELS[key][0]: square_opening.case(**more, **LABELS[key][1]) for key in LUO}
        found = curves(folder, f"luo_10_{kind}", f"{kind.replace('_', ' ')} plate, y = 0", cases, **fields)
        numbers |= numbers_of(f"luo_10_{kind}", dict(zip(LUO, found.values(), strict=True)))
    return numbers


def luo_12(folder):
    """Contours of u_z: the brick from below, its bottom, and the section x = 40 mm."""
    figure = Figure(figsize=(15.0, 8.5), layout="constrained")
    numbers = {}
    for row, key in enumerate(LUO):
        label, words_of = LABELS[key]
        case = brick.case(**words_of)
        dx = case.particles.spacing
        whole = plate.Whole(plate.displacement_z)
        solve(folder, case, whole=whole)
        x, u = whole.x, whole.v
        size = np.abs(plate.references()["brick_held"]["u"]).max()
        away = np.abs(x[:, :2] - 0.5 * brick.SIDE).max(axis=1) < 0.5 * brick.SIDE - (plate.ENDS - 0.5) * dx
        bottom, middle = x[:, 2] < 0.1 * dx, np.abs(x[:, 0] - 0.5 * brick.SIDE) < 0.1 * dx
        on_bottom = plate.sawtooth(x[bottom][:, :2], u[bottom], dx)[away[bottom]]
        inside = plate.sawtooth(x, u, dx)[away]
        numbers[f"luo_12_bottom_{key}"], numbers[f"luo_12_inside_{key}"] = (
            spread(values)[0] / size for values in (on_bottom, inside)
        )
        limits = {"vmin": -size, "vmax": size, "cmap": BANDS}
        outside = (np.abs(x[:, :2] - 0.5 * brick.SIDE).max(axis=1) > 0.5 * brick.SIDE - 0.1 * dx) | bottom
        solid = figure.add_subplot(2, 3, 3 * row + 1, projection="3d", title=f"{label}, u_z / mm, seen from below")
        solid.scatter(*x[outside].T, c=u[outside], s=14, marker="s", depthshade=False, **limits)
        solid.view_init(elev=-25.0, azim=-55.0)
        solid.set_aspect("equal")
        for column, chosen, axes, name in ((2, bottom, (0, 1), "bottom"), (3, middle, (1, 2), "section x = 40 mm")):
            plot = figure.add_subplot(2, 3, 3 * row + column, title=f"{label}, {name}", aspect="equal")
            a, b = axes
            values = u[chosen]
            levels = np.linspace(values.min(), values.max(), 25)
            drawn = plot.tricontourf(x[chosen][:, a], x[chosen][:, b], values, levels=levels, cmap="turbo")
            plot.set(xlabel=f"{'xyz'[a]} / mm", ylabel=f"{'xyz'[b]} / mm")
            figure.colorbar(drawn, ax=plot)
    save(folder, "luo_12", figure)
    return numbers


def luo_13(folder):
    """u_z of the bottom of the brick along y, with both readings of what the sides do."""
    numbers = {}
    for sides in ("held", "free"):
        cases = {LABELS[key][0]: brick.case(sides=sides, **LABELS[key][1]) for key in LUO}
        title = f"brick, x = 40 mm, z = 0, sides {sides}"
        found = curves(folder, f"luo_13_{sides}", title, cases, u=(plate.displacement_z, "u_z / mm"))
        numbers |= numbers_of(f"luo_13_{sides}", dict(zip(LUO, found.values(), strict=True)))
    return numbers


def critical_step(case, inside=False):
    """Return the largest stable time step of a case at unit density, 2 / omega_max of M^-1 K with its supports.

    ``inside`` holds everything within three spacings of the outer faces, where families are cut.
    """
    problem = study.build(case)
    cloud, free = problem.body.cloud, ~problem.supports.fixed
    if inside:
        x = cloud.x[: cloud.n_owned]
        depth = np.minimum(x - x.min(axis=0), x.max(axis=0) - x).min(axis=1)
        free &= (depth > (plate.ENDS - 0.5) * case.particles.spacing)[:, None]
    mass = cloud.volume[: cloud.n_owned, None]
    times = problem.linearised(problem.state(np.zeros(free.shape)))
    v = np.where(free, np.random.default_rng(1).standard_normal(free.shape), 0.0)
    square = 0.0
    for _ in range(20000):
        old, v = square, np.where(free, times(v) / mass, 0.0)
        square = np.linalg.norm(v)
        v = v / square
        if abs(square - old) < 1e-8 * square:
            break
    return 2.0 / np.sqrt(square)


def luo_14(folder):
    """Cost of stress points over no control under dynamic relaxation: time steps, gradient points, seconds."""
    if world().size > 1:
        sys.exit("Figure 14 is drawn on one rank: it is about the cost of one.")
    rows, numbers, drawn = [], {}, {}
    for name, (make, size, sizes) in COSTS.items():
        counts = {}
        for key in LUO:
            label, words_of = LABELS[key]
            for value in sizes:
                case = dataclasses.replace(make(**{size: value}, **words_of), solver=pd.DynamicRelaxation())
                done = study.run(folder, case)
                if done is None:
                    sys.exit(f"The {name} with {size} = {value}, {label}, did not come to rest.")
                summary = done[1]
                steps, seconds = summary["steps"][0]["relaxation_iterations"], summary["timings"]["solve"]
                particles, points = summary["particles"], summary["gradient_points"]
                rows.append((name, particles, label, points, steps, critical_step(case), seconds))
                counts.setdefault(key, []).append((particles, points, steps, rows[-1][-2], seconds))
        first = counts["points"][0][-1]
        for key in LUO:
            particles, *_, seconds = zip(*counts[key], strict=True)
            drawn[f"{name}, {LABELS[key][0]}"] = (particles, [s / first for s in seconds])
        plain, points = (np.array(counts[key][-1]) for key in LUO)
        numbers[f"luo_14_points_{name}"] = points[1] / plain[1]
        numbers[f"luo_14_time_steps_{name}"] = points[2] / plain[2]
        numbers[f"luo_14_critical_step_{name}"] = plain[3] / points[3]
    # The analysis of the paper's appendix is of the bar away from its ends.
    inside = [critical_step(bar.case(n=100, **LABELS[key][1]), inside=True) for key in LUO]
    numbers["luo_14_critical_step_inside_bar"] = inside[0] / inside[1]
    header = ("problem", "particles", "control", "gradient points", "time steps", "critical time step", "seconds")
    study.write_table(folder, "luo_14_table", header, rows)
    axes = {"xscale": "log", "yscale": "log"}
    study.write_curves(folder, "luo_14", "Dynamic relaxation", ("particles", "seconds / smallest"), drawn, **axes)
    return numbers


def chowdhury_8(folder):
    """Contours of u_x of the plate with a diamond hole at 3.1 diagonals."""
    figure = Figure(figsize=(9.0, 9.0), layout="constrained")
    numbers = {}
    for plot, key in zip(figure.subplots(2, 1), CHOWDHURY, strict=True):
        label, words_of = LABELS[key]
        case = diamond_hole.case(horizon=3.1, **words_of)
        dx = case.particles.spacing
        whole = plate.Whole(plate.displacement_x)
        solve(folder, case, whole=whole)
        x, u = whole.x, whole.v / diamond_hole.PULL
        corners = np.minimum(*(np.abs(np.abs(x) - tip).max(axis=1) for tip in diamond_hole.HALF_DIAGONAL * np.eye(2)))
        waves = plate.sawtooth(x, u, dx)[corners > (plate.ENDS + 0.5) * dx]
        numbers[f"chowdhury_8_sawtooth_{key}"] = spread(waves)[0]
        numbers[f"chowdhury_8_largest_u_{key}"] = float(np.abs(u).max())
        drawn = plot.scatter(*x.T, c=u, s=7, marker="s", cmap=BANDS, vmin=-1.0, vmax=1.0)
        plot.set(title=f"{label}, u_x / 1e-8 m", aspect="equal", xlabel="x / m", ylabel="y / m")
        figure.colorbar(drawn, ax=plot)
    save(folder, "chowdhury_8", figure)
    return numbers


def chowdhury_9(folder):
    """u_x along AB of the plate with a diamond hole at the three horizons."""
    numbers = {}
    for key in CHOWDHURY:
        label, words_of = LABELS[key]
        horizons = ("1.1", "2.1", "3.1")
        cases = {f"horizon {h} diagonals": diamond_hole.case(horizon=float(h), **words_of) for h in horizons}
        field = {"u": (plate.displacement_x, "u_x / m")}
        found = curves(folder, f"chowdhury_9_{key}", f"{label}, line AB", cases, **field)
        for h, results in zip(horizons, found.values(), strict=True):
            numbers |= numbers_of(f"chowdhury_9_{h}", {key: results})
    return numbers


FIGURES = {f.__name__: f for f in (luo_9, luo_10, luo_12, luo_13, luo_14, chowdhury_8, chowdhury_9)}


if __name__ == "__main__":
    study.draw_chosen(words, FIGURES, "out/plate_figures")
