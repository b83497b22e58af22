"""Strip of two materials pulled across their interface: the stress is uniform, the displacement is linear in each.

Two squares of side 1/2 with nu = 0 and moduli 1 and ``ratio``, held at x = 0 and pulled by a traction of 1 at x = 1.
``end_error`` is the relative error of the displacement of the end, ``near`` and ``far`` are the largest errors of the
stress within one horizon of the interface and further than two from it. Any consistent units.
"""

import common
import numpy as np

import pdpetsc as pd

INTERFACE = 0.5


def stress_error(solution):
    """Return the size of the error of the stress across the interface (n,) [-]."""
    return np.abs(pd.stress(solution)[:, 0, 0] - solution.t)


def case(n=16, ratio=2.0, scheme="sub_horizons", horizon=2.015, G=0.0):
    dx, region = 1.0 / n, pd.region
    left = region.Slab("x", high=INTERFACE)
    soft, stiff = (pd.LinearElastic(E=E, nu=0.0, plane="stress") for E in (1.0, ratio))
    reach = horizon * dx
    near = region.Slab("x", low=INTERFACE - reach, high=INTERFACE + reach)
    far = region.Slab("x", high=INTERFACE - 2.0 * reach) | region.Slab("x", low=INTERFACE + 2.0 * reach)
    exact = INTERFACE + (1.0 - INTERFACE) / ratio
    return pd.Case(
        particles=pd.LatticeNodes((0.0, 0.0), (1.0, 0.5), dx),
        material=[(left, soft), (~left, stiff)],
        conditions=[
            pd.Displacement(region.Slab("x", high=1e-6), x=0.0),
            pd.Displacement(region.Nearest((0.0, 0.25)), y=0.0),
            pd.Traction(region.Named("+x"), x=1.0),
        ],
        history={
            "end": pd.Mean(pd.displacement, "x", region.Slab("x", low=1.0 - 1e-6)),
            "near": pd.Largest(stress_error, "", near),
            "far": pd.Largest(stress_error, "", far),
        },
        results=lambda h: {"end_error": h["end"][-1] / exact - 1.0, "near": h["near"][-1], "far": h["far"][-1]},
        **common.common(scheme, "conforming", horizon, G, dx),
    )
