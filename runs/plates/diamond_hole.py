"""Plate with a diamond-shaped hole pulled at both ends, plane strain. Units m, N.

Results along the middle line right of the hole (AB in the paper), against finite elements with nodes at the
particles: mean relative error (amplitude) and largest second difference of the error (oscillation) of u_x and
sigma_xx, on the whole line and on the part that is 10 mm away from the hole, whose corner is singular, and three
particles from the end. ``horizon`` is in diagonals of the lattice, as in the paper; the hole has diagonals of 0.0375
m.
Reference: Chowdhury, Roy, Roy, Reddy, section 5.2, Fig. 7-9.
"""

import dataclasses

import numpy as np
import plate

import pdpetsc as pd

LENGTH = 0.15
WIDTH = 0.075
HALF_DIAGONAL = 0.5 * 0.0375
PULL = 1e-8
E = 200e9
NU = 0.25
# How far from the corner of the hole the fields are regular enough to compare.
AWAY = 0.01


def in_hole(x):
    """Return whether positions relative to the middle of the plate lie in the hole."""
    return np.abs(x).sum(axis=1) < HALF_DIAGONAL * (1.0 - 1e-9)


def case(nx=160, horizon=1.1, scheme="correspondence", control="none"):
    if nx < 20 or nx % 2:
        raise pd.CaseError(f"nx must be even and at least 20, so that particles lie on the middle lines, not {nx}.")
    dx = LENGTH / nx
    region = pd.region
    half = np.array([LENGTH / 2, WIDTH / 2])
    line = plate.Line("diamond_hole", 0, {1: 0.0}, dx, low=0.0)
    away = dataclasses.replace(line, low=HALF_DIAGONAL + AWAY - 0.1 * dx, high=LENGTH / 2 - (plate.ENDS - 0.5) * dx)
    return pd.Case(
        particles=pd.Lattice(-half - 0.5 * dx, half + 0.5 * dx, dx, cut=region.Where(in_hole)),
        horizon=horizon * np.sqrt(2.0) * dx,
        material=pd.LinearElastic(E=E, nu=NU, plane="strain"),
        conditions=[
            pd.Displacement(region.Slab("x", high=-half[0] + 0.1 * dx), x=-PULL),
            pd.Displacement(region.Slab("x", low=half[0] - 0.1 * dx), x=PULL),
            pd.Displacement(region.Nearest((half[0], 0.0)), y=0.0),
        ],
        history=plate.quantities(line, away, u=plate.displacement_x, stress=plate.stress_xx),
        results=plate.last,
        picture=pd.Picture(pd.displacement, "x"),
        **plate.method(scheme, control),
    )
