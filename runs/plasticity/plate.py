"""Elastic-plastic plate with a square opening, pulled at two ends, plane strain. Units mm, N.

200 x 200 mm, opening 40 x 40 mm, each end moved by 1 mm and free to slide, whole: symmetry lines would cut families.
The plate of Yaghoobi and Chorzepa's text, whose dimensions are not at hand. Particles lie on the edges and have the
part of their cell that lies in the plate; with ``cells=whole`` all have the same volume, and the sections beside the
opening are one spacing too wide together with their forces.

Results, against finite elements with the same law (``finite_elements.py``): error of the force at the end, largest
error of the force on the way over its largest value, error of the mean plastic strain, and along the x axis right of
the opening mean error of sigma_yy and of the plastic strain over their means (``stress_error``, ``plastic_error``)
and largest second difference of the error of sigma_yy over its largest value, three particles from the ends
(``oscillation``).
"""

import json
import math
import sys
from dataclasses import dataclass
from functools import lru_cache
from pathlib import Path

import numpy as np

import pdpetsc as pd

sys.path.append(str(Path(__file__).parent.parent / "plates"))
import edges

# Halves of the plate's and the opening's sides.
SIZE = 100.0
OPENING = 20.0
PULL = 0.01 * SIZE
E, NU, YIELD, HARDENING = 200e3, 0.3, 400.0, 2e3
ENDS = 3


@lru_cache
def reference():
    """Return what finite_elements.py stored."""
    return json.loads(Path(__file__).with_name("finite_elements.json").read_text())["plate"]


def at_time(name, t):
    """Return a number of the finite elements at a step time."""
    return float(np.interp(t, reference()["t"], reference()[name]))


@dataclass(frozen=True)
class Error(pd.Quantity):
    """A number less that of the finite elements, over the largest of theirs [-]."""

    quantity: pd.Quantity
    name: str

    def evaluate(self, solution):
        exact = at_time(self.name, solution.t)
        return (self.quantity.evaluate(solution) - exact) / max(reference()[self.name])


@dataclass(frozen=True)
class AlongAxis(pd.Quantity):
    """What becomes of the error of a field along the x axis, right of the opening, at the end of the path [-]."""

    spacing: float
    name: str

    def field(self, solution):
        return pd.plastic_strain(solution) if self.name == "plastic" else pd.stress(solution)[:, 1, 1]

    def values(self, solution):
        """Return places, values and those of the finite elements, in order along the axis (collective)."""
        here = (np.abs(solution.x[:, 1]) < 0.1 * self.spacing) & (solution.x[:, 0] > 0.0)
        parts = solution.cloud.comm.allgather((solution.x[here, 0], self.field(solution)[here]))
        x, v = (np.concatenate(column) for column in zip(*parts, strict=True))
        order = np.argsort(x)
        x, v = x[order], v[order]
        return x, v, np.interp(x, reference()["x"], reference()[self.name])


class MeanError(AlongAxis):
    """Mean of the error over the mean of the reference [-]."""

    def evaluate(self, solution):
        _, v, exact = self.values(solution)
        return float(np.abs(v - exact).mean() / np.abs(exact).mean()) if solution.t == 1.0 else 0.0


class Roughness(AlongAxis):
    """Largest second difference of the error over the largest value, away from the ends [-]; NaN of short lines."""

    def evaluate(self, solution):
        _, v, exact = self.values(solution)
        second = np.abs(np.diff(v - exact, 2))[ENDS:-ENDS]
        if not len(second):
            return math.nan
        return float(second.max() / np.abs(exact).max()) if solution.t == 1.0 else 0.0


def case(dx=4.0, horizon=1.015, scheme="sub_horizons", control="none", steps=10, cells="clipped", order=3):
    if cells not in ("clipped", "whole"):
        raise pd.CaseError(f"cells is clipped or whole, not {cells!r}.")
    edges.refuse_other_sizes(SIZE, OPENING, dx)
    region = pd.region
    edge, inside = SIZE + 0.5 * dx, OPENING - 0.5 * dx
    opening = region.Box((-inside, -inside), (inside, inside))
    top = region.Slab("y", low=SIZE - 0.1 * dx)
    force, plastic = pd.Reaction("y", top), pd.Mean(pd.plastic_strain)

    def results(history):
        found = {name: history[name][-1] for name in history if name not in ("step", "t")}
        found = {name: value for name, value in found.items() if math.isfinite(value)}
        return found | {"curve_error": max(abs(value) for value in history["force_error"])}

    lattice = pd.Lattice((-edge, -edge), (edge, edge), dx, cut=opening)
    return pd.Case(
        particles=edges.clipped(SIZE, OPENING, dx) if cells == "clipped" else lattice,
        horizon=horizon * dx,
        material=pd.J2(E=E, nu=NU, yield_stress=YIELD, hardening=HARDENING),
        scheme=pd.HigherOrder(order) if scheme == "higher_order" else pd.choose("scheme", scheme, pd.SCHEMES),
        control=pd.choose("control", control, pd.CONTROLS | {"following": pd.TangentScaled(pd.Silling())}),
        conditions=[
            pd.Displacement(top, y=PULL),
            pd.Displacement(region.Slab("y", high=0.1 * dx - SIZE), y=-PULL),
            pd.Displacement(region.Nearest((0.0, SIZE)), x=0.0),
        ],
        steps=pd.Steps(steps),
        history={
            "force": force,
            "mean_plastic": plastic,
            "force_error": Error(force, "force"),
            "mean_plastic_error": Error(plastic, "mean_plastic"),
            "stress_error": MeanError(dx, "stress"),
            "plastic_error": MeanError(dx, "plastic"),
            "oscillation": Roughness(dx, "stress"),
        },
        results=results,
        expect={
            "force": pd.Expected(at_time("force", 1.0), relative=0.05, source="finite elements with the same law"),
            "mean_plastic": pd.Expected(at_time("mean_plastic", 1.0), relative=0.02, source="the same finite elements"),
        },
        fields=[pd.displacement, pd.stress, pd.plastic_strain],
        picture=pd.Picture(pd.plastic_strain, ""),
    )
