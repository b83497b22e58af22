"""Redraw figures 7 and 28 to 34 of Hashim, Coombs, Augarde and Hattori, the plate with a hole: one command.

    python runs/fracture/plate_figures.py [folder] [7 28 29 30 31 32 33 34 deviations ...]

leaves ``fig_7.png``, ... and ``numbers.json`` in the folder (default ``out/plate``). Unless told otherwise all figures
are drawn, by one process, in about three minutes; ``deviations`` runs the plate with each difference between the
published scheme and the default of pdpetsc alone, and takes another.

The end displacement in the text, 1 x 10^4 mm, is a misprint: here each end moves by 0.1 mm (1 x 10^-4 m), with which
damage starts at the hole and crosses both ligaments. G is that of Eq. (38) with the metre as unit of length, which the
text does not say. Two schemes are compared: the published one, ``PresentStretch`` with Newton's method alone, bonds
breaking once a load step after equilibrium, and the load steps of pdpetsc with its default effect of damage.
"""

import dataclasses
import json
import math
import sys
from functools import cache
from pathlib import Path

sys.path.insert(0, str(Path(__file__).parent.parent))
import study

WORDS = study.start("fracture")

import numpy as np
import plate_with_hole

import pdpetsc as pd
from pdpetsc.declare.solvers import Newton
from pdpetsc.discrete.communicator import world
from pdpetsc.petsc.defaults import default_options
from pdpetsc.petsc.jacobian import choose
from pdpetsc.petsc.options import Options
from pdpetsc.problem.assembly import Assembler
from pdpetsc.solvers.newton import StaticSolver

LENGTH, WIDTH, RADIUS = plate_with_hole.LENGTH, plate_with_hole.WIDTH, plate_with_hole.RADIUS
REFERENCE = json.loads(Path(__file__).with_name("finite_elements.json").read_text())
PULL, STEPS, METRE = 0.1, 15, 1000.0
S_MIN, S_CR, BETA = 0.0015, 0.002, 3.0
# A particle that has lost this share of its bonds is part of the damaged band.
DAMAGED = 0.1


@dataclasses.dataclass(frozen=True)
class Found:
    """Positions and last displacement (n, 2), local damage of every step, broken share at the end, force per step."""

    x: np.ndarray
    u: np.ndarray
    damage: list
    lost: np.ndarray
    force: list
    broken: int
    iterations: int
    note: str = ""

    @property
    def inside(self):
        """Return which particles are not in the fictitious layers."""
        return (self.x[:, 0] > 0.0) & (self.x[:, 0] < LENGTH)


def declared(nx, G, **changes):
    words = {"pull": PULL, "steps": STEPS, "G": G, "unit": METRE} | changes
    return plate_with_hole.case(nx=nx, **words)


@cache
def by_newton(nx, G, steps=STEPS, **changes):
    """Return what the published scheme gives: Newton's method, then bonds past the critical stretch break, and on.

    Where Newton fails the run ends there, and the note says so.
    """
    case = declared(nx, G, steps=steps, effect="present", continuous=False, **changes)
    problem = study.build(case)
    cloud, bonds = problem.body.cloud, problem.damage.bonds
    right = problem.supports.fixed[:, 0] & (cloud.x[: cloud.n_owned, 0] > LENGTH)
    u, damage, force, note, most = np.zeros((cloud.n_rows, 2)), [], [], "", 0
    with Options({}).suggest(default_options(problem, Newton(), choose(problem, {}, Newton()))).active():
        solver = StaticSolver(problem, Assembler(problem), lambda: False)
        for step in range(1, steps + 1):
            after, result = solver.solve(u, step / steps)
            if not result.converged:
                note = f"Newton fails in step {step} of {steps}"
                break
            u, most = after, max(most, result.iterations)
            problem.commit(solver.state(u))
            force.append(float(problem.internal_force(solver.state(u), of_solver=False)[right, 0].sum()))
            damage.append(problem.material_term.local_damage())
            problem.break_bonds(solver.state(u))
            bonds.commit()
        solver.destroy()
    found = Found(
        cloud.x[: cloud.n_owned], u, damage, problem.damage.lost_bonds(), force, bonds.count_broken(), most, note
    )
    print(f"{nx} x {nx // 3}, G = {G:g}: Newton alone, {note or f'at most {most} iterations a step'}", flush=True)
    return found


@cache
def by_load_steps(nx, G, **changes):
    """Return what the load steps of pdpetsc give."""
    return ran(declared(nx, G, **changes))


@cache
def roughly(nx, G):
    """Return what the load steps of pdpetsc give, with a residual of 1e-6: the same bonds break."""
    return ran(dataclasses.replace(declared(nx, G), options={"snes_rtol": 1e-6}))


def ran(case):
    case = dataclasses.replace(
        case,
        picture=None,
        results=None,
        fields=[pd.displacement, pd.local_damage, pd.lost_bonds],
        history={"force": case.history["force"], "broken": pd.BrokenBonds()},
    )
    done = pd.run(case, output=FOLDER / "last_run")
    after = done.history["t"] > 0.0
    damage = [done.field("local_damage", step) for step in done.fields.steps[-np.count_nonzero(after) :]]
    return Found(
        done.x[:, :2], done.field("displacement")[:, :2], damage, done.field("lost_bonds"),
        done.history["force"][after].tolist(), int(done.history["broken"][-1]),
        max(step["newton_iterations"] for step in done.summary["steps"]),
    )  # fmt: skip


def elastic(nx, G):
    """Return u_x over the pull next to both axes against finite elements, and numbers about it."""
    found = by_load_steps(nx, G, law="none", pull=1e-5 * LENGTH, steps=1)
    dx, lines, numbers = LENGTH / nx, {}, {}
    oscillation, error = 0.0, 0.0
    for name, axis, place in (("along", 0, 0.5 * (WIDTH + dx)), ("across", 1, 0.5 * (LENGTH + dx))):
        on = np.flatnonzero((np.abs(found.x[:, 1 - axis] - place) < 0.1 * dx) & found.inside)
        on = on[np.argsort(found.x[on, axis])]
        s, u = found.x[on, axis], found.u[on, 0] / (1e-5 * LENGTH)
        exact = np.array(REFERENCE[f"{nx} {name}"])
        assert np.allclose(s, exact[0], atol=1e-6 * LENGTH)
        off = u - exact[1]
        neighbours = np.flatnonzero(s[2:] - s[:-2] < 2.5 * dx)
        wave = np.abs(off[neighbours] - 2.0 * off[neighbours + 1] + off[neighbours + 2]) / 4.0
        oscillation, error = max(oscillation, wave.max()), max(error, np.abs(off).max())
        lines[name] = s, u
    numbers["oscillation"] = float(oscillation)
    numbers["error"] = float(error)
    numbers["stiffness"] = found.force[-1] / (1e-5 * LENGTH * REFERENCE["force"])
    return found, lines, numbers


def crack(found):
    """Return where and when damage starts and crosses the ligaments, how wide and how symmetric it is."""
    x, inside = found.x, found.inside
    dx = float(np.diff(np.unique(np.round(x[:, 0], 6))).min())
    first = next((n for n, damage in enumerate(found.damage) if damage.max() > 0.0), None)
    if first is None:
        return {}
    worst = np.flatnonzero(found.damage[first] > found.damage[first].max() * (1.0 - 1e-6))
    rows = np.unique(np.round(x[:, 1], 6))
    ligaments = rows[np.abs(rows - 0.5 * WIDTH) > RADIUS]
    across = [all(damage[np.abs(x[:, 1] - y) < 0.1 * dx].max() > DAMAGED for y in ligaments) for damage in found.damage]
    last = found.damage[-1]
    band, broken = (x[which & inside, 0] for which in (last > DAMAGED, found.lost > 0.0))
    place = {tuple(key): n for n, key in enumerate(np.rint(x / (0.5 * dx)).astype(int).tolist())}
    whole = [round(2.0 * LENGTH / dx), round(2.0 * WIDTH / dx)]
    mirrored = [[place[whole[0] - a, b], place[a, whole[1] - b]] for a, b in place]
    return {
        "start": (first + 1) / len(found.damage),
        "start_from_hole": float(np.hypot(*(x[worst] - [0.5 * LENGTH, 0.5 * WIDTH]).T).min() - RADIUS),
        "start_from_axis": float(np.abs(x[worst, 0] - 0.5 * LENGTH).max()),
        "crossed": (across.index(True) + 1) / len(found.damage) if any(across) else math.nan,
        "band": float(np.ptp(band) + dx) if len(band) else 0.0,
        "broken_band": float(np.ptp(broken) + dx) if len(broken) else 0.0,
        "largest_damage": float(last.max()),
        "largest_lost": float(found.lost.max()),
        "asymmetry": float(np.abs(last[:, None] - last[np.array(mirrored)]).max()),
        "broken": float(found.broken),
        "iterations": float(found.iterations),
        "peak": max(found.force),
        "left": abs(found.force[-1]) / max(found.force),
    }


def panels(name, title, drawn, label, unit=""):
    """Draw values of particles as cells of their lattice, one panel each: ``{text: (x, values)}``."""
    from matplotlib.figure import Figure

    figure = Figure(figsize=(8.0, 0.6 + 2.7 * len(drawn)), layout="constrained")
    for plot, (text, (x, values)) in zip(
        figure.subplots(len(drawn), squeeze=False).ravel(), drawn.items(), strict=True
    ):
        dx = float(np.diff(np.unique(np.round(x[:, 0], 6))).min())
        low, high = x.min(axis=0), x.max(axis=0)
        cells = np.rint((x - low) / dx).astype(int)
        table = np.full(np.rint((high - low) / dx).astype(int)[::-1] + 1, np.nan)
        table[cells[:, 1], cells[:, 0]] = values
        extent = (low[0] - dx / 2, high[0] + dx / 2, low[1] - dx / 2, high[1] + dx / 2)
        image = plot.imshow(table, origin="lower", extent=extent, cmap="viridis")
        figure.colorbar(image, ax=plot, label=f"{label}{unit}", shrink=0.8)
        plot.set(title=text, xlabel="x [mm]", ylabel="y [mm]")
    figure.suptitle(title)
    figure.savefig(FOLDER / f"{name}.png", dpi=130)
    print(f"{FOLDER / name}.png: {title}", flush=True)


def figure_7():
    """T_s from s_min to s_cr, and what Eq. (54) gives for its slope."""
    critical = pd.ConstantCritical(S_CR)
    s = np.linspace(S_MIN, S_CR, 201)
    curves = {}
    for beta in (1.0, BETA, 10.0):
        law = pd.SmoothDegradation(critical, S_MIN / S_CR, beta, continuous=False)
        inside = [float(value) for value in law.phi(s / S_CR)]
        curves[f"beta = {beta:g}"] = ([0.001, S_MIN, *s.tolist(), S_CR, 0.0022], [1.0, 1.0, *inside, 0.0, 0.0])
    study.write_curves(FOLDER, "fig_7", "Degradation of the bond force", ("stretch", "T_s"), curves)
    law = pd.SmoothDegradation(critical, S_MIN / S_CR, BETA, continuous=False)
    ends = law.phi(np.array([S_MIN, 0.5 * (S_MIN + S_CR), S_CR]) / S_CR)
    step = 1e-8
    n = lambda s: BETA * (S_MIN + S_CR - 2.0 * s) / (S_MIN - S_CR)  # noqa: E731
    T = lambda s: 0.5 * (1.0 - np.tanh(n(s)))  # noqa: E731
    middle = 0.5 * (S_MIN + S_CR)
    differences = (T(middle + step) - T(middle - step)) / (2.0 * step)
    dn = -2.0 * BETA / (S_MIN - S_CR)
    return {
        "T_at_s_min": float(ends[0]),
        "T_in_the_middle": float(ends[1]),
        "T_at_s_cr": float(ends[2]),
        "slope_over_differences": float(law.slope(np.array([middle / S_CR]))[0] / S_CR / differences),
        "printed_slope_over_differences": float(0.5 * np.tanh(n(middle) - 1.0) ** 2 * dn / differences),
    }


def figure_28():
    """Geometry: particles of the plate, and the fictitious layers that are moved."""
    found = by_load_steps(30, 0.01, law="none", pull=1e-5 * LENGTH, steps=1)
    kind = np.where(found.inside, 0.0, np.sign(found.x[:, 0] - 0.5 * LENGTH))
    panels("fig_28", "Plate with a hole, 30 x 10 particles", {"particles": (found.x, kind)}, "moved to")
    return {
        "particles": float(np.count_nonzero(found.inside)),
        "layer": float(-found.x[:, 0].min() + 0.5 * LENGTH / 30),
        "end_displacement": PULL,
    }


def elastic_figure(name, nx, G):
    found, _, numbers = elastic(nx, G)
    u = found.u[:, 0] / (1e-5 * LENGTH)
    panels(name, f"No failure, {nx} x {nx // 3}, G = {G:g}", {"": (found.x, u)}, "u_x over that of an end")
    return numbers


def figure_29():
    return elastic_figure("fig_29", 30, 0.0)


def figure_30():
    # Of the powers of the root of ten 3e-5 comes closest to finite elements, 3e-6 with 150 x 50 particles.
    best = {f"best_{key}": value for key, value in elastic(30, 3e-5)[2].items()}
    return elastic_figure("fig_30", 30, 0.01) | best


def figure_31():
    """Damage at the end, 30 x 10, G = 0.01: both schemes, and with G = 0.5 of pd.Silling."""
    found = {
        "published": by_newton(30, 0.01),
        "load_steps": by_load_steps(30, 0.01, effect="present", continuous=False),
        "default": by_load_steps(30, 0.01),
        "silling": by_load_steps(30, 0.5, unit=0.0),
        "silling_published": by_load_steps(30, 0.5, unit=0.0, effect="present", continuous=False),
    }
    titles = {
        "published": "published scheme, G = 0.01 (metre)",
        "default": "default scheme, G = 0.01 (metre)",
        "silling": "default scheme, pd.Silling(0.5)",
    }
    drawn = {titles[name]: (found[name].x, found[name].damage[-1]) for name in titles}
    drawn |= {"published scheme, broken bonds alone: Eq. (46)": (found["published"].x, found["published"].lost)}
    panels("fig_31", f"Damage, 30 x 10, ends moved by {PULL} mm", drawn, "lost share of the bonds")
    numbers = {f"{name}_{key}": value for name, one in found.items() for key, value in crack(one).items()}
    both = found["published"], found["load_steps"]
    numbers["force_of_load_steps_over_newton"] = both[1].force[-1] / both[0].force[-1]
    # With a control of ordinary strength Newton alone jumps to another branch where the plate snaps back.
    for steps in (STEPS, 4 * STEPS):
        alone = by_newton(30, 0.5, steps=steps, unit=0.0)
        numbers[f"silling_newton_ends_of_{steps}"] = len(alone.damage) / steps
        numbers[f"silling_newton_broken_of_{steps}"] = float(alone.broken)
    return numbers


def figure_32():
    """u_x next to both axes, 150 x 50, no failure."""
    along, across, numbers = {}, {}, {}
    for G in (0.0, 1e-7, 1e-6, 3e-6, 1e-5, 1e-4, 1e-3):
        _, lines, these = elastic(150, G)
        along[f"G = {G:g}"], across[f"G = {G:g}"] = lines["along"], lines["across"]
        numbers |= {f"{key}_{G:g}": value for key, value in these.items()}
    for name, curves in (("along", along), ("across", across)):
        curves["finite elements"] = REFERENCE[f"150 {name}"]
        text = f"u_x next to the axis {name} the plate, 150 x 50, no failure"
        columns = ("x [mm]" if name == "along" else "y [mm]", "u_x over that of an end")
        study.write_curves(FOLDER, f"fig_32_{name}", text, columns, curves, ["finite elements"])
    return numbers


def both_schemes():
    """Return 150 x 50 particles with G = 0.001 by the published scheme and by the default."""
    return {"published": by_newton(150, 0.001), "default": roughly(150, 0.001)}


def figure_33():
    """u_x with failure, 150 x 50, G = 0.001: both schemes."""
    found = both_schemes()
    drawn = {f"{name} scheme": (one.x, one.u[:, 0]) for name, one in found.items()}
    panels("fig_33", f"Failure allowed, 150 x 50, G = 0.001, ends moved by {PULL} mm", drawn, "u_x", " [mm]")
    numbers = {}
    for name, one in found.items():
        # The largest jump between neighbours in the outermost row over that of the ends: how far it is open there.
        dx = LENGTH / 150
        row = np.flatnonzero((np.abs(one.x[:, 1] - (WIDTH - 0.5 * dx)) < 0.1 * dx) & one.inside)
        row = row[np.argsort(one.x[row, 0])]
        numbers[f"{name}_jump"] = float(np.diff(one.u[row, 0]).max() / (2.0 * PULL))
    return numbers


def figure_34():
    """Damage, 150 x 50, G = 0.001: both schemes."""
    found = both_schemes()
    drawn = {f"{name} scheme": (one.x, one.damage[-1]) for name, one in found.items()}
    drawn |= {f"{name} scheme, broken bonds alone: Eq. (46)": (one.x, one.lost) for name, one in found.items()}
    panels("fig_34", f"Damage, 150 x 50, G = 0.001, ends moved by {PULL} mm", drawn, "lost share of the bonds")
    return {f"{name}_{key}": value for name, one in found.items() for key, value in crack(one).items()}


class ControlFollows(pd.LargestStretch):
    """The default, but the control fades at once."""

    def of_control(self, kept):
        return pd.PresentStretch().of_control(kept)

    def fading(self, phi):
        return phi


class VolumeStays(pd.LargestStretch):
    """The default, but particles keep their volume."""

    def volume_left(self, share):
        return np.ones_like(share)


class StretchAlone(pd.LargestStretch):
    """The default, but no bond breaks with the strain of a gradient."""

    breaks_by_family_strain = False


class Heals(pd.LargestStretch):
    """The default, but the integrity is that of the present stretch."""

    reversible = True

    def follows(self, present, kept):
        return np.ones(len(present), dtype=bool)

    def reached(self, x, worst):
        return x


def deviations():
    """Change one difference between the published scheme and the default at a time (page of published damage)."""
    effects = {
        "default": pd.LargestStretch(),
        "control follows": ControlFollows(),
        "volume stays": VolumeStays(),
        "stretch alone": StretchAlone(),
        "heals": Heals(),
        "all four": pd.PresentStretch(),
    }
    bodies = {
        "Silling(0.5)": declared(30, 0.5, unit=0.0),
        "G = 0.01 m": declared(30, 0.01),
        "sub-horizons, bonds that snap": declared(36, 0.0, scheme="sub_horizons", law="brittle", horizon=2.015),
    }
    rows, numbers = [], {}
    for body, case in bodies.items():
        kinds = {name: dataclasses.replace(case.damage, effect=effect) for name, effect in effects.items()}
        if isinstance(case.damage, pd.SmoothDegradation):
            kinds["T_s as printed"] = dataclasses.replace(case.damage, continuous=False)
        for kind, damage in kinds.items():
            try:
                found = crack(ran(dataclasses.replace(case, damage=damage)))
            except pd.SolveError as error:
                print(f"{body}, {kind}: {error}", flush=True)
                continue
            rows.append((body, kind, *(found[key] for key in ("peak", "left", "broken", "band", "largest_damage"))))
            numbers |= {f"{body}_{kind}_{key}": value for key, value in found.items()}
            print(rows[-1], flush=True)
    header = ("body", "what differs", "peak [N]", "left of it [-]", "broken bonds", "band [mm]", "largest damage [-]")
    study.write_table(FOLDER, "deviations", header, rows)
    return numbers


FIGURES = {
    "7": figure_7, "28": figure_28, "29": figure_29, "30": figure_30, "31": figure_31, "32": figure_32,
    "33": figure_33, "34": figure_34, "deviations": deviations,
}  # fmt: skip

if __name__ == "__main__":
    names = study.chosen(WORDS, FIGURES)
    if world().size > 1:
        sys.exit("The figures of the plate are drawn by one process; start it without mpirun.")
    FOLDER = study.folder_for(WORDS, "out/plate")
    found = {}
    for name in names if WORDS[1:] else [name for name in names if name != "deviations"]:
        found |= {f"{name}_{key}": value for key, value in FIGURES[name]().items()}
    study.write_numbers(FOLDER, found)
