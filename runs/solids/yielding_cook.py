"""Cook's membrane of a material that yields, with zero-energy controls that yield with it and that do not.

48 mm long, 44 and 16 mm high, clamped on the left, a dead shear traction of 0.3125 kN/mm2 on the right, plane strain,
J2 plasticity with linear hardening. Particles at the nodes of n x n quadrilaterals, weights that conform. ``method`` as
in ``yielding_neck.py``. Results: ``tip``, how far the upper right corner rises, and its error against finite elements
(``yielding_elements.py``). Units mm, kN.
"""

import sys
from pathlib import Path

import yielding_neck as neck

import pdpetsc as pd

sys.path.append(str(Path(__file__).parent.parent / "convergence"))
import common
import cook_elements as membrane

E, NU, YIELD, HARDENING, SHEAR = 206.9, 0.29, 0.45, 2.0, 0.3125


def case(n=16, method="following", horizon=2.015, steps=20, G=0.5, least=0.01):
    scheme, control = pd.choose("method", method, neck.METHODS)
    if method == "elastic":
        control = pd.Silling(G)
    if method == "following":
        control = pd.TangentScaled(pd.Silling(G), least)
    points, block = common.grid(n, 0.0, 0, (1.0, 1.0), common.cubes)
    region = pd.region
    spacing = (0.5 * membrane.LENGTH * (44.0 + 16.0)) ** 0.5 / n
    return pd.Case(
        particles=common.of_nodes(membrane.places(points), block),
        horizon=horizon * spacing,
        material=pd.J2(E=E, nu=NU, yield_stress=YIELD, hardening=HARDENING),
        scheme=scheme,
        control=control,
        weights=pd.Conforming(),
        conditions=[
            pd.Displacement(region.Slab("x", high=1e-6 * membrane.LENGTH), x=0.0, y=0.0),
            pd.Traction(region.Slab("x", low=membrane.LENGTH * (1.0 - 1e-6)), y=SHEAR),
        ],
        steps=pd.Steps(steps),
        history={"tip": pd.At((48.0, 60.0), pd.displacement, "y"), "plastic": pd.Mean(pd.plastic_strain)},
        results=lambda h: {"tip": h["tip"][-1], "error": h["tip"][-1] / neck.reference("cook")["tip"] - 1.0},
        fields=[pd.displacement, pd.stress, pd.plastic_strain],
        picture=pd.Picture(pd.plastic_strain, ""),
    )
