"""Elastic-plastic Cook's membrane in plane strain, clamped on the left, sheared on the right. Units mm, GPa.

``n`` x ``n`` cells in the quadrilateral of 48, 44 and 16 mm, of steel whose yield stress saturates from 0.45 to 0.715;
a dead shear traction of 0.3125 per undeformed area. ``tip`` is the rise of the upper right corner, which tends to
7.4 mm in the literature; ``tip_error`` is that against finite elements of the same law
(``cook_plastic_elements.py``). Particles sit at the nodes, those of the left side are held.
"""

import json
import sys
from dataclasses import dataclass
from functools import lru_cache
from pathlib import Path

import numpy as np

import pdpetsc as pd

sys.path.append(str(Path(__file__).parent.parent / "convergence"))
import common
import cook_elements as membrane

E, NU, SHEAR = 206.9, 0.29, 0.3125
YIELD, SATURATED, RATE, LINEAR = 0.45, 0.715, 16.93, 0.12924


def steel():
    law = pd.hardening.Linear(LINEAR) + pd.hardening.Voce(SATURATED - YIELD, RATE)
    return pd.J2(E=E, nu=NU, yield_stress=YIELD, hardening=law)


@lru_cache
def reference():
    """Return what cook_plastic_elements.py stored."""
    return json.loads(Path(__file__).with_name("cook_plastic_elements.json").read_text())


@dataclass(frozen=True)
class TipError(pd.Quantity):
    """Rise of the upper right corner less that of the finite elements, over theirs at the end [-]."""

    tip: pd.Quantity

    def evaluate(self, solution):
        known = reference()
        exact = float(np.interp(solution.t, known["t"], known["tip"]))
        return (self.tip.evaluate(solution) - exact) / known["tip"][-1]


def case(
    n=16, cloud="nodes", scheme="correspondence", weights="conforming", horizon=2.015, G=0.001, steps=20, growth=0.0,
):  # fmt: skip
    known = {"nodes": common.cubes, "simplices": common.simplices}
    points, block = common.grid(n, 0.0, 0, (1.0, 1.0), pd.choose("cloud", cloud, known))
    particles = common.of_nodes(membrane.places(points), block)
    spacing = float(np.sqrt(0.5 * membrane.LENGTH * (44.0 + 16.0)) / n)
    region, side = pd.region, membrane.LENGTH
    tip = pd.At((48.0, 60.0), pd.displacement, "y")
    return pd.Case(
        particles=particles,
        material=steel(),
        conditions=[
            pd.Displacement(region.Slab("x", high=1e-6 * side), x=0.0, y=0.0),
            pd.Traction(region.Slab("x", low=side * (1.0 - 1e-6)), y=SHEAR),
        ],
        steps=pd.Steps(steps, plastic_growth=growth or None),
        history={"tip": tip, "tip_error": TipError(tip), "plastic": pd.Largest(pd.plastic_strain)},
        results=lambda h: {name: h[name][-1] for name in ("tip", "tip_error", "plastic")},
        fields=[pd.displacement, pd.stress, pd.plastic_strain],
        picture=pd.Picture(pd.plastic_strain, ""),
        **common.common(scheme, weights, horizon, G, spacing),
    )
