"""Unit square in pure bending, plane strain: a linear traction on two sides, against the exact solution.

``u = (x (y - 1/2), -x^2 / 2 - nu' / 2 (y - 1/2)^2) / E'`` with ``E' = E / (1 - nu^2)``, ``nu' = nu / (1 - nu)``. The
stress is linear, so that the error is that of the gradients near the surface alone. ``n`` particles a side, moved by
up to ``shake`` spacings. ``error_surface`` is that of sigma_xx along the top.
"""

import common
import numpy as np

import pdpetsc as pd

E, NU = 1.0, 0.3


def displacement(x, t):
    stiffness, ratio = E / (1.0 - NU**2), NU / (1.0 - NU)
    y = x[:, 1] - 0.5
    return np.stack([x[:, 0] * y, -0.5 * x[:, 0] ** 2 - 0.5 * ratio * y**2], axis=1) / stiffness


def stress(x, t):
    sigma = np.zeros((len(x), 2, 2))
    sigma[:, 0, 0] = x[:, 1] - 0.5
    return sigma


def case(n=16, shake=0.0, seed=0, scheme="correspondence", weights="conforming", horizon=2.015, G=0.5):
    region = pd.region
    s = (np.arange(n) + 0.5) / n
    top = np.stack([s, np.ones(n)], axis=1)
    surface = common.SurfaceStressError(top, np.tile([1.0, 0.0], (n, 1)), stress(top, 1.0)[:, 0, 0], 1.0 / n)
    return pd.Case(
        particles=common.square(n, shake, seed),
        material=pd.LinearElastic(E=E, nu=NU),
        conditions=[
            *common.three_supports([(0.0, 0.0), (1.0, 0.0)], displacement),
            pd.Traction(region.Named("+x"), x=lambda x, t: x[:, 1] - 0.5),
            pd.Traction(region.Named("-x"), x=lambda x, t: 0.5 - x[:, 1]),
        ],
        **common.common(scheme, weights, horizon, G, 1.0 / n),
        **common.errors(displacement, stress, surface=surface),
    )
