"""Square plate under an affine displacement whose cells are half as large on the right. Units m, N.

Layers around it follow a stretch along x; inside, families at the jump of the spacing reach across it with another
horizon than they are reached. ``error`` is the largest error of the deformation gradient over the strain. ``body`` is
``points`` (deformation gradients with ``weights``), ``bonds`` (bond-based) or ``solid`` (ordinary state-based).
"""

import sys
from pathlib import Path

import numpy as np

import pdpetsc as pd

sys.path.append(str(Path(__file__).parent.parent))
from patch.tension import refined

E, NU, STRAIN = 1.0, 0.3, 1e-3
BODIES = {
    "points": {"material": pd.LinearElastic(E=E, nu=NU), "scheme": pd.Correspondence(), "control": pd.Silling(0.5)},
    "bonds": {"material": pd.BondBased(E=E)},
    "solid": {"material": pd.LinearSolid(E=E, nu=0.1)},
}


def case(n=16, horizon=3.015, body="points", weights="standard", fine=2, shake=0.0):
    made = pd.choose("body", body, BODIES)
    if body == "points":
        made = made | {"weights": pd.choose("weights", weights, pd.WEIGHTS)}
    # Beyond it no family, nor the interpolation of a facet, reaches the surface.
    depth = (horizon + 1.0) / n
    left, right = pd.region.Slab("x", high=depth), pd.region.Slab("x", low=2.0 - depth)
    below, above = pd.region.Slab("y", high=depth), pd.region.Slab("y", low=1.0 - depth)
    exact = np.diag([1.0 + STRAIN, 1.0])
    return pd.Case(
        particles=refined(2, 1.0 / n, fine, shake),
        horizon=pd.Horizon(horizon),
        conditions=[pd.Displacement(left | right | below | above, x=lambda x, t: t * STRAIN * x[:, 0], y=0.0)],
        history={"error": pd.LargestError(pd.deformation_gradient, lambda x, t: exact)},
        results=lambda h: {"error": h["error"][-1] / STRAIN},
        **made,
    )
