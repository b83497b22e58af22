"""Figures 2 and 4 to 7 of the localisation paper, and what its outlook asks for.

    python runs/localisation/figures.py [folder] [figure ...]        # default out/localisation and all of them

Figure 2: the laws of the critical strain. Figure 4: n = 10, 20, 50, 100, 200 with constant critical strain. Figures 5
to 7: n = 100 with constant, decreasing and increasing critical strain, ten realisations each: damage of every section
by Eq. (8), middle and length of every broken bond, force against inelastic displacement of the first realisation; a
table of all; and what differs between them. ``laws``: final mechanism and differences between realisations against
where the increasing law starts. ``outlook``: bonds that soften, other micromoduli. ``ends`` and ``further`` are those
parts of ``laws`` and ``outlook`` whose numbers the table of the papers has, and are drawn only where they are named.
Curves are left as CSV and pictures, and ``numbers.json`` has the numbers that belong to the figures of one call.
"""

import sys
from pathlib import Path

sys.path.insert(0, str(Path(__file__).parent.parent))
import study

words = study.start("localisation")

import numpy as np
from periodic_cell import LAWS, MICROMODULI, E, case

import pdpetsc as pd
from pdpetsc.discrete.communicator import is_root, world
from pdpetsc.output.reading import read_table

SIZES = (10, 20, 50, 100, 200)
N = 100
REALISATIONS = 10
# Where the increasing law starts, and to how many times their critical strain bonds soften.
STARTS = (0.0, 0.001, 0.002, 0.004, 0.006)
RATIOS = {name: (1.0, 1.5, 3.0) for name in LAWS}
NAMES = ("max_force", "final_displacement", "max_damage", "opened", "closed", "dissipated", "broken", "events")
COLUMNS = ["inelastic displacement / l [1e-2]", "force / E A [1e-2]"]


def run(folder, **parameters):
    """Return results, inelastic displacement and force over E A of all events, middle and length of broken bonds."""
    found = pd.run(case(**parameters), output=folder / "last_run")
    u, force = found.history["displacement"], found.history["force"]
    broken = read_table(found.folder / "broken_bonds.csv")
    bonds = np.stack([broken["x"] % 1.0, broken["length"]], axis=1)
    # After the last bond the displacement grows without force.
    return found, (u - force * u[1] / force[1])[:-1], force[:-1] / E, bonds


def damage(bonds, n):
    """Return the sections between particles and the share of broken bonds among those that cross each, Eq. (8)."""
    m = round(0.1 * n)
    section = (np.arange(n) + 1.0) / n
    apart = np.abs((bonds[:, 0, None] - section + 0.5) % 1.0 - 0.5)
    return section, (apart < 0.5 * bonds[:, 1, None]).sum(axis=0) / (0.5 * m * (m + 1))


def layers(bonds, n):
    """Return how many bonds of one spacing, two spacings, ... are broken."""
    return np.bincount(np.rint(bonds[:, 1] * n).astype(int), minlength=round(0.1 * n) + 1)[1:]


def pattern(bonds, n):
    """Return what is the same for broken bonds that are translated or mirrored."""
    occupied = np.zeros((round(0.1 * n) + 1, 2 * n), dtype=bool)
    occupied[np.rint(bonds[:, 1] * n).astype(int), np.rint(2.0 * n * bonds[:, 0]).astype(int) % (2 * n)] = True
    both = occupied, np.roll(occupied[:, ::-1], 1, axis=1)
    return min(np.packbits(np.roll(one, shift, axis=1)).tobytes() for one in both for shift in range(0, 2 * n, 2))


def largest_rise(force):
    """Return how far the force recovers at most after its peak, over the peak."""
    after = force[force.argmax() :]
    return float((after - np.minimum.accumulate(after)).max() / force.max())


def spread(values):
    """Return the range of numbers over their mean."""
    return float(np.ptp(values) / np.mean(values))


def picture(folder, name, title, curve, bonds, n):
    """Draw final damage, broken bonds and force against inelastic displacement as the paper does."""
    if not is_root(world()):
        return
    from matplotlib.figure import Figure

    figure = Figure(figsize=(10.0, 5.0), layout="constrained")
    figure.suptitle(title)
    plots = figure.subplot_mosaic([["profile", "path"], ["places", "path"]])
    profile, places, path = (plots[key] for key in ("profile", "places", "path"))
    profile.set(ylabel="damage [-]", xlim=(0, 1), ylim=(0, 1.05))
    section, share = damage(bonds, n)
    profile.step(section, share, where="mid")
    places.set(xlabel="x / l", ylabel="length / l", xlim=(0, 1), ylim=(0, 0.11))
    places.plot(*bonds.T, ".", markersize=3)
    path.set(xlabel=COLUMNS[0], ylabel=COLUMNS[1])
    path.plot(100.0 * curve[0], 100.0 * curve[1], linewidth=0.8)
    path.grid(alpha=0.3)
    figure.savefig(folder / f"{name}.png", dpi=130)
    print(f"{folder / name}.png", flush=True)


def draw(folder, name, title, u, force, bonds, n):
    """Write the three parts of a figure as tables and one picture."""
    study.write_table(folder, f"{name}_curve", COLUMNS, zip(100.0 * u, 100.0 * force, strict=True))
    study.write_table(folder, f"{name}_broken", ["x / l", "length / l"], bonds)
    study.write_table(folder, f"{name}_damage", ["x / l", "damage"], zip(*damage(bonds, n), strict=True))
    picture(folder, name, title, (u, force), bonds, n)


def realisations(folder, name, title, **parameters):
    """Draw the first realisation; return its force and bonds, and what differs between all of them."""
    table, patterns, first = [], set(), None
    for seed in range(1, REALISATIONS + 1):
        found, u, force, bonds = run(folder, n=N, seed=seed, **parameters)
        table.append([found[key] for key in NAMES])
        patterns.add(pattern(bonds, N))
        if seed == 1:
            first = found, force, bonds
            draw(folder, name, title, u, force, bonds, N)
    study.write_table(folder, f"{name}_realisations", NAMES, table)
    columns = dict(zip(NAMES, np.array(table).T, strict=True))
    numbers = {f"spread_{key}": spread(columns[key]) for key in ("max_force", "final_displacement", "dissipated")}
    numbers |= {"fewest_broken": columns["broken"].min(), "most_broken": columns["broken"].max()}
    numbers |= {"most_damage": columns["max_damage"].max(), "patterns": len(patterns)}
    segments = columns["opened"] + columns["closed"]
    numbers |= {"of_one_segment": np.count_nonzero(segments == 1), "of_three": np.count_nonzero(segments == 3)}
    found, force, bonds = first
    numbers |= {key: found[key] for key in NAMES} | {"largest_rise": largest_rise(force)}
    return {f"{name}_{key}": value for key, value in numbers.items()}, force, bonds


def figure_2(folder):
    length = np.linspace(0.0, 0.1, 11)
    curves = {name: (length, ends[0] + (ends[1] - ends[0]) * length / 0.1) for name, ends in LAWS.items()}
    study.write_curves(folder, "figure_2", "Critical strain", ["length / l", "critical strain [-]"], curves)
    return {f"{end}_{name}": f(ends) for name, ends in LAWS.items() for end, f in (("largest", max), ("least", min))}


def figure_4(folder):
    numbers, curves = {}, {}
    for n in SIZES:
        found, u, force, _ = run(folder, n=n)
        curves[f"n = {n}"] = (100.0 * u, 100.0 * force)
        numbers |= {f"{key}_{n}": found[key] for key in ("max_force", "final_displacement", "events")}
        numbers[f"largest_rise_{n}"] = largest_rise(force)
    study.write_curves(folder, "figure_4", "Constant critical strain", COLUMNS, curves)
    return numbers


def figure_5(folder):
    numbers, _, bonds = realisations(folder, "figure_5", "Critical strain constant", critical="constant")
    length = np.rint(bonds[:, 1] * N).astype(int)
    # The bonds break in runs from short to long.
    return numbers | {"figure_5_first_run_ends_at": length[np.flatnonzero(np.diff(length) < 0)[0]]}


def figure_6(folder):
    """Beside what all have: the force at which a layer begins to fail, and that of its horizontal part [1e-2 E A]."""
    title = "Critical strain decreasing"
    numbers, force, bonds = realisations(folder, "figure_6", title, critical="decreasing")
    count = layers(bonds, N)
    whole = [k for k in range(10, 0, -1) if count[k - 1] == N]
    numbers["figure_6_whole_layers"] = len(whole)
    length = np.rint(bonds[:, 1] * N).astype(int)
    for k in whole:
        # A bond begins to fail and is broken in two events; the middle of a layer is where both forces repeat.
        events = 1 + 2 * np.flatnonzero(length == k)
        middle = events[N // 4 : -N // 4]
        numbers[f"figure_6_onset_{k}"] = 100.0 * force[events[0]]
        numbers[f"figure_6_level_{k}"] = 50.0 * (np.median(force[middle]) + np.median(force[middle + 1]))
    return numbers


def figure_7(folder):
    numbers, _, bonds = realisations(folder, "figure_7", "Critical strain increasing", critical="increasing")
    count = layers(bonds, N)
    numbers |= {
        "figure_7_whole_layers": np.count_nonzero(count == N),
        "figure_7_share_of_weaker_half": count[:5].sum() / count.sum(),
    }
    more = "figure_7_moved_more"
    title = "Critical strain increasing, particles moved by up to 1e-4 l"
    return numbers | realisations(folder, more, title, critical="increasing", perturbation=1e-4)[0]


def laws(folder, starts=STARTS):
    """Where the law starts decides about the mechanism; mostly ten realisations are one, translated or mirrored."""
    rows, numbers = [], {}
    for start in starts:
        runs = [run(folder, n=N, critical="increasing", start=start, seed=s) for s in range(1, REALISATIONS + 1)]
        patterns = len({pattern(bonds, N) for _, _, _, bonds in runs})
        segments = [found["opened"] + found["closed"] for found, _, _, _ in runs]
        broken = [found["broken"] for found, _, _, _ in runs]
        force = [found["max_force"] for found, _, _, _ in runs]
        rows.append((start, patterns, min(segments), max(segments), min(broken), max(broken), min(force), max(force)))
        numbers |= {f"patterns_{start:g}": patterns, f"most_segments_{start:g}": max(segments)}
    header = ["start", "patterns", "fewest segments", "most", "fewest broken", "most", "least max force", "largest"]
    study.write_table(folder, "laws", header, rows)
    return numbers


def outlook(folder, ratios=RATIOS, micromoduli=tuple(MICROMODULI)):
    numbers = {}
    for critical, softening in ratios.items():
        curves = {}
        for ratio in softening:
            found, u, force, _ = run(folder, n=N, critical=critical, ratio=ratio)
            curves[f"to {ratio:g} times" if ratio > 1.0 else "snap"] = (100.0 * u, 100.0 * force)
            for key in ("final_displacement", "dissipated", "max_force", "broken"):
                numbers[f"{critical}_{ratio:g}_{key}"] = found[key]
            numbers[f"{critical}_{ratio:g}_largest_rise"] = largest_rise(force)
        title = f"Bonds that soften, critical strain {critical}"
        study.write_curves(folder, f"softening_{critical}", title, COLUMNS, curves)
    curves = {}
    for micromodulus in micromoduli:
        found, u, force, _ = run(folder, n=N, micromodulus=micromodulus)
        curves[micromodulus] = (100.0 * u, 100.0 * force)
        numbers |= {f"{micromodulus}_{key}": found[key] for key in ("max_force", "final_displacement", "dissipated")}
    study.write_curves(folder, "micromoduli", "Micromoduli, critical strain constant", COLUMNS, curves)
    return numbers


FIGURES = {
    "2": figure_2,
    "4": figure_4,
    "5": figure_5,
    "6": figure_6,
    "7": figure_7,
    "laws": laws,
    "outlook": outlook,
}
# Of what others draw too.
PARTS = {
    "ends": lambda folder: laws(folder, (STARTS[0], STARTS[-1])),
    "further": lambda folder: outlook(folder, {"constant": (3.0,), "increasing": (1.5, 3.0)}, ("linear",)),
}


if __name__ == "__main__":
    study.draw_chosen(words, FIGURES, "out/localisation", parts=PARTS)
