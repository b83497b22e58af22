"""Clamped slender beam under uniform pressure. Units m, N.

Half of a beam of 254 mm by 5.08 mm in plane strain, Hencky material, 276 kPa of dead pressure on the outer layer. The
reference is Timoshenko's clamped strip with immovable ends.

Reference: Hashim, Coombs, Augarde, Hattori, section 4.2, Table 1.
"""

import math

from scipy.optimize import brentq

import pdpetsc as pd

LENGTH = 0.254
THICKNESS = 5.08e-3
E = 68.95e9
NU = 0.25
PRESSURE = 276e3


def strip_deflection():
    """Return the midpoint deflection over the thickness of Timoshenko's clamped strip with immovable ends.

    With S the membrane force, D = E t^3 / 12 (1 - nu^2) and v^2 = S L^2 / 4 D, the deflection of a strip under q is
    w(x) = q L^4 / (16 v^3 D tanh v) (cosh(v (1 - 2 x / L)) / cosh v - 1) + q L^2 (L - x) x / (8 v^2 D),
    and S L (1 - nu^2) / E t = 1/2 int w'^2 dx fixes v (Timoshenko and Woinowsky-Krieger, article 3).
    """
    D = E * THICKNESS**3 / (12.0 * (1.0 - NU**2))
    n = 2000
    h = LENGTH / n

    def slope(v, x):
        inner = 1.0 - 2.0 * x / LENGTH
        bending = -PRESSURE * LENGTH**3 / (8.0 * v**2 * D * math.sinh(v)) * math.sinh(v * inner)
        return bending + PRESSURE * LENGTH**2 / (8.0 * v**2 * D) * (LENGTH - 2.0 * x)

    def excess(v):
        squares = [slope(v, i * h) ** 2 * (1.0 if i in (0, n) else 4.0 if i % 2 else 2.0) for i in range(n + 1)]
        stretch = 0.5 * sum(squares) * h / 3.0
        force = 4.0 * v**2 * D / LENGTH**2
        return force * LENGTH * (1.0 - NU**2) / (E * THICKNESS) - stretch

    v = brentq(excess, 0.05, 20.0, xtol=1e-13)
    middle = PRESSURE * LENGTH**4 / (16.0 * v**3 * D * math.tanh(v)) * (1.0 / math.cosh(v) - 1.0)
    return (middle + PRESSURE * LENGTH**4 / (32.0 * v**2 * D)) / THICKNESS


def case(ny=3, horizon=1.015, G=0.0, scheme="correspondence", steps=10):
    dx = THICKNESS / ny
    half = 25 * ny * dx
    held = pd.region.Named("fictitious -x")
    layers = int(horizon)
    middle = pd.region.Slab("y", -0.1 * dx, 0.1 * dx)
    schemes = {"correspondence": pd.Correspondence(), "sub_horizons": pd.SubHorizons()}
    if scheme not in schemes:
        raise pd.CaseError(f"scheme is one of {', '.join(schemes)}, not {scheme!r}.")
    reference = strip_deflection()
    return pd.Case(
        particles=pd.Lattice((0.0, -THICKNESS / 2), (half, THICKNESS / 2), dx, fictitious={"-x": layers * dx}),
        horizon=horizon * dx,
        material=pd.Hencky(E=E, nu=NU, plane="strain"),
        scheme=schemes[scheme],
        stabilisation=pd.Silling(G) if G else None,
        conditions=[
            pd.Displacement(held, x=0.0),
            pd.Displacement(held & middle, y=0.0),
            pd.Displacement(pd.region.Slab("x", low=half - dx), x=0.0),
            pd.Pressure(
                pd.region.Slab("y", low=THICKNESS / 2 - dx) & pd.region.Named("real"), PRESSURE, normal=(0.0, 1.0)
            ),
        ],
        steps=pd.Steps(steps),
        history={"w": pd.At((half, 0.0), pd.displacement, "y"), "energy": pd.StrainEnergy()},
        results=lambda h: {
            "deflection": -h["w"][-1] / THICKNESS,
            "reference": reference,
            "error": -h["w"][-1] / THICKNESS / reference - 1.0,
        },
        picture=pd.Picture(pd.stress, "xx", scale=5.0),
    )
