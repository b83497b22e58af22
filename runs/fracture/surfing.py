"""Strip along which the field of a crack tip moves, so that its crack runs: J against the energy it takes. Units mm, N.

Length 36, height 20, plane stress, E = 1000 MPa, fracture energy 0.1 N / mm, a crack of length 10 from the left side;
bond-based, or with ``model=`` bonds with a dilatation or deformation gradients, Poisson's ratio 0.25, whose bonds are
given a ``share``: with the one for which ``taken_over_Gc`` is 1 a running crack takes the fracture energy. On the rim,
one horizon deep, the displacements of the field with ``K = surplus sqrt(E Gc)`` are prescribed about a tip that moves
from 10 to ``end``, after a tenth of the load in which the field rises. Bonds soften linearly to ``final`` times their
critical stretch, or by another ``law``. J is taken on two contours that follow the tip. Means are over the steps in
which the tip goes from 13 to two before ``end``.
With ``damage=point`` gradient points fail with the energy and the law as declared (``pd.PointDamage``), ``final`` times
their strain at onset in the largest family. ``cloud=lattice`` may be turned by ``angle`` and shaken by a share of the
spacing. With ``cloud=triangles`` or ``quads`` particles sit in the cells of a mesh, whose nodes are turned and shaken
instead; weights are conforming there, and the crack of length 10 is a band of points that fail under a small load.
Results: ``taken_over_Gc``, work less what is stored over the last third of the way of the field, by whole spacings,
and ``steady``, by how much this differs between its halves; ``J_over_Gc``, ``J_far_over_Gc``, which miss what long
tails of softening bonds behind the contours have yet to take; ``spread``, the standard deviation of J over its mean;
``dissipated_over_Gc``, what the laws of the bonds dissipate per length of crack; ``J_over_dissipated``; ``length``, of
the crack that has grown; ``lead``, by which the tip of the crack is ahead of that of the field.
"""

import sys
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
from scipy.spatial import Delaunay

import pdpetsc as pd
from pdpetsc.declare.cells import Block

sys.path.append(str(Path(__file__).parent.parent))
from convergence import common

LENGTH, HEIGHT = 36.0, 20.0
E, GC = 1000.0, 0.1
# Materials, schemes and controls; bonds in plane stress have a Poisson ratio of 1/3, whatever is asked for.
MODELS = ("bonds", "linear_solid", "correspondence", "sub_horizons", "stress_points", "bond_associated")
START, RISE = 10.0, 0.1
CLOUDS = ("lattice", "triangles", "quads")


@dataclass(frozen=True)
class PathAngle(pd.Quantity):
    """Angle between the crack and the x axis [degrees], of the line that fits the failed particles beyond x best."""

    beyond: float
    dimension = "1"

    def evaluate(self, solution):
        """Return the angle, 0 where no particle has failed."""
        failed = (pd.local_damage(solution) > 0.5) & (solution.x[:, 0] > self.beyond)
        x, y = (solution.x[failed] - [self.beyond, 0.5 * HEIGHT]).T
        n, sx, sy, sxx, sxy = (solution.sum(float(np.sum(v))) for v in (np.ones_like(x), x, y, x * x, x * y))
        spread = n * sxx - sx**2
        return float(np.degrees(np.arctan((n * sxy - sx * sy) / spread))) if spread > 0.0 else 0.0


def parts(model, nu, G):
    """Return Poisson's ratio, material, scheme and control."""
    if model == "bonds":
        return 1.0 / 3.0, pd.BondBased(E, plane="stress", calibration="family"), None, None
    if model == "linear_solid":
        return nu, pd.LinearSolid(E, nu, plane="stress"), None, None
    schemes = {
        "correspondence": pd.Correspondence(), "sub_horizons": pd.SubHorizons(), "stress_points": pd.StressPoints(),
        "bond_associated": pd.BondAssociated(),
    }  # fmt: skip
    control = pd.Silling(0.5 if G is None else G) if model == "correspondence" else None
    return nu, pd.LinearElastic(E, nu, plane="stress"), schemes[model], control


def laws(energy, protected, final=3.0):
    """Return how bonds may fail."""
    return {
        "brittle": pd.Brittle(energy, protected=protected),
        "linear": pd.LinearSoftening(energy, final, protected=protected),
        "short": pd.LinearSoftening(energy, 2.0, protected=protected),
        "exponential": pd.ExponentialSoftening(energy, protected=protected),
        "bilinear": pd.BilinearSoftening(energy, protected=protected),
        "smooth": pd.SmoothDegradation(energy, protected=protected),
    }


def point_damage(law, final, delta, protected, cut):
    """Return how points fail, so that the widest families have no stress at ``final`` times the strain at onset.

    Those for which ``cut(x)`` holds fail at a millionth of the energy.
    """
    curves = {"linear": pd.softening.Linear(), "exponential": pd.softening.Exponential()}
    curve = pd.choose("law", law, curves)
    onset_energy = 0.5 * GC / delta / (1.0 + 2.0 * curve.area * (final - 1.0))
    onset = float(np.sqrt(2.0 * onset_energy / E))
    return pd.PointDamage(
        curve, Gc=lambda x, normal: GC * np.where(cut(x), 1e-6, 1.0),
        onset=lambda x: onset * np.where(cut(x), 1e-3, 1.0),
        split=pd.split.Whole(), protected=protected & ~pd.region.Where(cut),
    )  # fmt: skip


def particles(cloud, dx, angle, shake):
    """Return a square lattice, or the cells of a mesh, turned by an angle [degrees] and shaken by a share of ``dx``.

    Triangles are those of Delaunay between nodes in rows, half a distance apart from one row to the next.
    """
    lattice, triangles = (pd.choose("cloud", cloud, dict.fromkeys(CLOUDS, cloud)) == name for name in CLOUDS[:2])
    if lattice and angle == shake == 0.0:
        return pd.Lattice((0.0, 0.0), (LENGTH, HEIGHT), dx)
    c, s = np.cos(np.radians(angle)), np.sin(np.radians(angle))
    size = np.sqrt(2.0) * dx if triangles else dx
    far = int((LENGTH + HEIGHT) / size)
    # Rows of particles lie half a distance of rows off the crack, as those of the lattice that is not turned.
    i, j = np.meshgrid(np.arange(-far, far) + 0.5 * lattice, np.arange(-far, far) + 0.5 * (not lattice))
    i += 0.5 * (np.floor(j) % 2.0) * triangles
    x = size * (np.stack([i.ravel(), j.ravel()], axis=1) @ np.array([[c, s], [-s, c]])) + [0.0, 0.5 * HEIGHT]
    x += np.random.default_rng(1).uniform(-shake, shake, x.shape) * dx

    def inside(x, by=0.0):
        return ((x > by) & (x < np.subtract([LENGTH, HEIGHT], by))).all(axis=1)

    if lattice:
        return pd.Arrays(x[inside(x)], np.full(np.count_nonzero(inside(x)), dx**2))
    if triangles:
        grid = np.meshgrid(*(np.linspace(0.0, side, round(side / size) + 1) for side in (LENGTH, HEIGHT)))
        grid = np.stack(grid, axis=-1).reshape(-1, 2)
        x = np.concatenate([x[inside(x, 0.5 * size)], grid[~inside(grid)]])
        return common.of_cells(x, Block("triangle", Delaunay(x).simplices.astype(np.int64)))
    cells = Block("quad", common.cubes((2 * far - 1, 2 * far - 1)).nodes[:, ::-1])
    return common.of_cells(x, Block("quad", cells.nodes[inside(common.centres(x, cells)[1])]))


def field_tip(t, end):
    """Return where the tip of the field is [mm]."""
    return START + (end - START) * np.maximum(t - RISE, 0.0) / (1.0 - RISE)


def displacement(x, t, surplus, nu, end):
    """Return the displacements (n, 2) of the field at step time t [mm]."""
    K = surplus * np.sqrt(E * GC) * min(t / RISE, 1.0)
    at = x - np.array([field_tip(t, end), 0.5 * HEIGHT])
    r, angle = np.hypot(*at.T), np.arctan2(at[:, 1], at[:, 0])
    kappa, mu = (3.0 - nu) / (1.0 + nu), 0.5 * E / (1.0 + nu)
    of_angle = (kappa - np.cos(angle)) * np.array([np.cos(0.5 * angle), np.sin(0.5 * angle)])
    return (0.5 * K / mu * np.sqrt(r / (2.0 * np.pi)) * of_angle).T


def taken(h, end, dx):
    """Return what the crack takes for each length that the field moves in the last third of its way, and in its halves.

    Once the crack runs steadily everything repeats with every spacing but the energy that is gone [N / mm].
    """
    gone, at = np.array(h["work"]) - np.array(h["stored"]), field_tip(np.array(h["t"]), end)
    half = max(round((end - START) / 6.0 / dx), 1) * dx
    one, two, three = np.interp([end - 2.0 * half, end - half, end], at, gone)
    return (three - one) / (2.0 * half), (two - one) / half, (three - two) / half


def case(
    n=20, horizon=3.015, steps=40, surplus=1.1, law="linear", final=3.0, model="bonds", share=1.0, nu=0.25,
    G=None, angle=0.0, end=22.0, damage="bonds", shake=0.0, scheme="correspondence",
    cloud="lattice", weights="",
):  # fmt: skip
    at_points = pd.choose("damage", damage, {"bonds": False, "point": True})
    model = scheme if at_points else model
    dx = HEIGHT / n
    delta = horizon * dx
    rim = ~pd.region.Box((delta, delta), (LENGTH - delta, HEIGHT - delta))
    near = pd.region.Slab("y", low=0.5 * HEIGHT - delta, high=0.5 * HEIGHT + delta)
    energy, protected = pd.FractureEnergy(GC, share), rim | ~near
    nu, material, gradients, control = parts(pd.choose("model", model, {name: name for name in MODELS}), nu, G)
    if at_points:  # its energy ends the tail of what has nearly failed
        control = pd.Silling(2.0 if G is None else G)
    tip, ahead = (START, 0.5 * HEIGHT), (1.0, 0.0)
    follows = pd.CrackTip(ahead, 0.8 if at_points else 0.3, near)
    room = 0.5 * HEIGHT - delta

    def prescribed(component):
        return lambda x, t: displacement(x, t, surplus, nu, end)[:, component]

    def results(h):
        found = {name: np.array(values) for name, values in h.items()}
        runs = (found["tip"] > 13.0) & (found["tip"] < end - 2.0)
        # The domain of a tip that runs ahead of its field has left the body.
        J, far = (values[np.isfinite(values)] for values in (found["J"][runs], found["J far"][runs]))
        # The length grows by whole spacings: the slope of the line that fits best is not of two of its steps.
        if np.count_nonzero(runs) < 3:
            raise pd.CaseError(f"The tip goes from 13 to {end - 2.0:g} in fewer than three steps; take a longer way.")
        per_length = np.polyfit(found["length"][runs], found["dissipated"][runs], 1)[0]
        whole, first, last = taken(h, end, dx)
        return {
            "taken_over_Gc": whole / GC,
            "steady": abs(last - first) / whole,
            **({"J_over_Gc": J.mean() / GC, "spread": J.std() / J.mean()} if len(J) else {}),
            **({"J_far_over_Gc": far.mean() / GC} if len(far) else {}),
            "dissipated_over_Gc": per_length / GC,
            **({"J_over_dissipated": J.mean() / per_length} if len(J) else {}),
            "length": found["length"][-1],
            "lead": float(np.mean((found["tip"] - field_tip(found["t"], end))[runs])),
            "broken_bonds": found["broken"][-1],
        }

    def results_of_points(h):
        found = {name: np.array(values) for name, values in h.items()}
        at = field_tip(found["t"], end)
        runs = at > end - (end - START) / 3.0
        found["gone"] = found["work"] - found["stored"] - found["control"]
        energy, gone = (np.polyfit(at[runs], found[name][runs], 1)[0] / GC for name in ("dissipated", "gone"))
        J = {f"{name}_over_Gc".replace(" ", "_"): found[name][runs] / GC for name in ("J", "J far")}
        return {
            "energy_over_Gc": energy, "taken_over_Gc": gone,
            **{name: values[np.isfinite(values)].mean() for name, values in J.items() if np.isfinite(values).any()},
            "path_angle": found["angle"][-1], "lead": float(np.mean((found["tip"] - at)[runs])),
        }  # fmt: skip

    declared = pd.Case(
        particles=particles(cloud, dx, angle, shake),
        horizon=delta,
        material=material,
        scheme=gradients,
        control=control,
        weights=None if gradients is None else pd.Standard(),
        cracks=[pd.Segment((-1.0, 0.5 * HEIGHT), tip)],
        damage=None if at_points else pd.choose("law", law, laws(energy, protected, final)),
        conditions=[pd.Displacement(rim, x=prescribed(0), y=prescribed(1))],
        steps=pd.Steps(steps),
        history={
            "J": pd.JIntegral(tip, ahead, 0.5 * room, 0.9 * room, follows),
            "J far": pd.JIntegral(tip, ahead, 0.7 * room, room, follows),
            "tip": follows,
            "length": pd.CrackLength(),
            "broken": pd.BrokenBonds(),
            "dissipated": pd.DissipatedEnergy(),
            "stored": pd.StrainEnergy(),
            "work": pd.ExternalWork(),
        },
        results=results,
        fields=[pd.displacement, pd.local_damage, pd.von_mises],
        picture=pd.Picture(pd.local_damage, "", 5.0),
    )
    if not at_points:
        return declared
    history = {name: declared.history[name] for name in ("J", "J far", "tip", "dissipated", "stored", "work")}
    weights = weights or ("standard" if cloud == "lattice" else "conforming")

    def cut(x):
        return (np.abs(x[:, 1] - 0.5 * HEIGHT) < delta) & (x[:, 0] < START) & (cloud != "lattice")

    return replace(
        declared,
        cracks=declared.cracks if cloud == "lattice" else [],
        weights=pd.choose("weights", weights, pd.WEIGHTS),
        damage=point_damage(law, final, delta, rim, cut),
        history={**history, "control": pd.ControlEnergy(), "angle": PathAngle(START + delta)},
        results=results_of_points,
    )
