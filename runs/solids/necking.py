"""Simo's bar that necks, of steel that hardens and saturates, against finite elements. Units mm, N.

A round bar, radius 6.413 and length 53.334 mm, is pulled by 14 mm; its ends may contract, and its radius is smaller by
up to ``1 - waist`` towards the middle, so that it necks there. An eighth of the bar is computed, ``n`` cells across the
radius, between three mirror planes. Without a waist it is strained uniformly and its force has a maximum of 79.6 kN at
7.1 mm, Considere's.

Results, ``_error`` against finite elements (``necking_elements.py``): ``peak_force`` of the whole bar, its
``elongation_at_peak``, at the end ``end_force`` and ``neck_radius``, and ``force_10`` and ``radius_10`` at an
elongation of 10 mm, up to which the finite elements are sure.
"""

import json
import math
import sys
from dataclasses import dataclass
from functools import lru_cache
from pathlib import Path

import numpy as np

import pdpetsc as pd

sys.path.append(str(Path(__file__).parent.parent / "convergence"))
import common

from pdpetsc.declare.cells import volumes_and_moments

RADIUS, LENGTH, END = 6.413, 53.334, 14.0
E, NU = 206.9e3, 0.29
YIELD, LINEAR, SATURATION, RATE = 450.0, 129.24, 265.0, 16.93
WAIST = 0.982
# Elongation up to which the finite elements change by less than 1 % with their mesh; at 14 mm it is 10 %.
COMPARED = 10.0


def radius(z, waist=WAIST):
    """Return the radius of the bar at a distance from its middle."""
    return RADIUS * (waist + (1.0 - waist) * np.asarray(z) / (0.5 * LENGTH))


def steel():
    law = pd.hardening.Linear(LINEAR) + pd.hardening.Voce(SATURATION, RATE)
    return pd.J2(E=E, nu=NU, yield_stress=YIELD, hardening=law)


@lru_cache
def reference(name="waist"):
    """Return what necking_elements.py stored."""
    return json.loads(Path(__file__).with_name("necking_elements.json").read_text())[name]


def in_disc(square):
    """Return points of the quarter of the unit disc for those of the unit square: rays to rays, areas to areas."""
    a, b = square[:, 0], square[:, 1]
    outer = np.maximum(a, b)
    angle = 0.25 * math.pi * np.divide(np.minimum(a, b), outer, out=np.zeros(len(a)), where=outer > 0.0)
    angle = np.where(a >= b, angle, 0.5 * math.pi - angle)
    return outer[:, None] * np.stack([np.cos(angle), np.sin(angle)], axis=1)


def particles(n, waist):
    """Return the cells of an eighth of the bar, n across the radius and as long as wide, and their length.

    The particles of the last layer, of half cells, lie on the end itself, where the bar is pulled.
    """
    layers = max(round(0.5 * LENGTH / (RADIUS / n) - 0.5), 2)
    cell = 0.5 * LENGTH / (layers + 0.5)
    axes = [np.linspace(0.0, 1.0, n + 1)] * 2 + [np.append(np.arange(layers + 1) * cell, 0.5 * LENGTH)]
    points = np.stack(np.meshgrid(*axes, indexing="ij"), axis=-1).reshape(-1, 3)
    # Straight sides of the cells cut the circle: the polygon has its area.
    angle = 0.25 * math.pi / n
    points[:, :2] = in_disc(points[:, :2]) * radius(points[:, 2], waist)[:, None] * math.sqrt(angle / math.sin(angle))
    block = common.cubes((n, n, layers + 1))
    volume, moment = volumes_and_moments(points, block)
    x = moment / volume[:, None]
    end = points.reshape(n + 1, n + 1, -1, 3)[:, :, -1, :2].reshape(-1, 2)
    _, middles = common.centres(end, common.cubes((n, n)))
    x.reshape(n, n, -1, 3)[:, :, -1] = np.insert(middles, 2, 0.5 * LENGTH, axis=1).reshape(n, n, 3)
    return common.of_cells(points, block, x), cell


@dataclass(frozen=True)
class Neck(pd.Quantity):
    """Radius of the bar in its middle, from the outer particles of the first layer of cells [length]."""

    n: int
    cell: float
    waist: float

    def evaluate(self, solution):
        x = solution.x
        first = x[:, 2] < self.cell
        distance = np.linalg.norm(x[:, :2], axis=1)
        outer = first & (distance > RADIUS * (1.0 - 1.0 / self.n) * 0.95)
        now = np.linalg.norm((x + pd.displacement(solution))[:, :2], axis=1)
        ratios = solution.cloud.comm.allgather((now[outer] / distance[outer]).tolist())
        ratio = float(np.mean([value for part in ratios for value in part]))
        return ratio * float(radius(0.0, self.waist))


def case(
    n=4, waist=WAIST, scheme="correspondence", weights="conforming", horizon=1.515, G=0.001, steps=56,
    growth=0.0, end=END,
):  # fmt: skip
    cloud, cell = particles(n, waist)
    pulled = pd.region.Slab("z", low=0.5 * LENGTH * (1.0 - 1e-6))
    return pd.Case(
        particles=cloud,
        material=steel(),
        symmetry=[pd.Symmetry(axis) for axis in "xyz"],
        conditions=[pd.Displacement(pulled, z=0.5 * end)],
        steps=pd.Steps(steps, plastic_growth=growth or None),
        history={
            "quarter_force": pd.Reaction("z", pulled),
            "radius": Neck(n, cell, waist),
            "plastic": pd.Largest(pd.plastic_strain),
        },
        results=lambda history: results(history, waist, end),
        expect=expected(waist, end),
        fields=[pd.displacement, pd.stress, pd.plastic_strain],
        picture=pd.Picture(pd.plastic_strain, ""),
        **common.common(scheme, weights, horizon, G, RADIUS / n),
    )


def expected(waist, end):
    """Return what finite elements give, of the bars that they were computed for and pulled beyond the peak."""
    if waist not in (WAIST, 1.0) or end < 7.5:
        return {}
    force = max(reference("waist" if waist < 1.0 else "perfect")["force"])
    return {
        "peak_force": pd.Expected(force, relative=0.005, source="axisymmetric finite elements (necking_elements.py)")
    }


def results(history, waist, end):
    """Return the numbers of the curve of force over elongation, with the peak on a parabola through three points."""
    x, force = end * np.array(history["t"]), 4.0 * np.abs(history["quarter_force"])
    top = int(np.argmax(force))
    found = {"peak_force": float(force[top]), "elongation_at_peak": float(x[top])}
    if 0 < top < len(x) - 1:
        a, b, c = np.polyfit(x[top - 1 : top + 2], force[top - 1 : top + 2], 2)
        found = {"peak_force": float(c - 0.25 * b * b / a), "elongation_at_peak": float(-0.5 * b / a)}
    found |= {"end_force": float(force[-1]), "neck_radius": history["radius"][-1]}
    known = reference("waist" if waist < 1.0 else "perfect")

    def exact(name, at):
        return float(np.interp(at, known["elongation"], known[name]))

    peak = int(np.argmax(known["force"]))
    errors = {
        "peak_force": known["force"][peak],
        "elongation_at_peak": known["elongation"][peak],
        "end_force": exact("force", x[-1]),
        "neck_radius": exact("radius", x[-1]),
    }
    if end > COMPARED:
        found |= {"force_10": float(np.interp(COMPARED, x, force))}
        found |= {"radius_10": float(np.interp(COMPARED, x, history["radius"]))}
        errors |= {"force_10": exact("force", COMPARED), "radius_10": exact("radius", COMPARED)}
    return found | {f"{name}_error": found[name] / value - 1.0 for name, value in errors.items()}
