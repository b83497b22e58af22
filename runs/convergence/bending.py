"""Unit square or cube in pure bending: a linear traction on two sides, against the exact solution.

In plane strain ``u = (x (y - 1/2), -x^2 / 2 - nu' / 2 (y - 1/2)^2) / E'`` with ``E' = E / (1 - nu^2)``,
``nu' = nu / (1 - nu)``; in space that of Saint-Venant with E and nu, and ``u_z = -nu (y - 1/2) (z - 1/2) / E``. The
stress is linear, so that the error is that of the gradients near the surface alone. ``n`` cells a side, nodes moved by
up to ``shake`` spacings; ``cloud`` is one of ``common.square``. ``error_surface_stress`` is that along the top.
"""

import common
import numpy as np

import pdpetsc as pd

E, NU = 1.0, 0.3


def displacement(x, t):
    dim = x.shape[1]
    stiffness, ratio = (E / (1.0 - NU**2), NU / (1.0 - NU)) if dim == 2 else (E, NU)
    y, z = x[:, 1] - 0.5, x[:, 2] - 0.5 if dim == 3 else 0.0
    u = [x[:, 0] * y, -0.5 * x[:, 0] ** 2 - 0.5 * ratio * (y**2 - z**2), -ratio * y * z]
    return np.stack(u[:dim], axis=1) / stiffness


def stress(x, t):
    sigma = np.zeros((len(x), x.shape[1], x.shape[1]))
    sigma[:, 0, 0] = x[:, 1] - 0.5
    return sigma


def case(
    n=16, shake=0.0, seed=0, cloud="cells", dim=2, scheme="correspondence", weights="conforming", horizon=2.015, G=0.5,
):  # fmt: skip
    if dim not in (2, 3):
        raise pd.CaseError(f"dim is 2 or 3, not {dim}.")
    region = pd.region
    face = lambda axis, at: region.Slab("xyz"[axis], at - 1e-9, at + 1e-9)  # noqa: E731
    corners = [np.zeros(dim), np.eye(dim)[0], *np.eye(dim)[2:]]
    particles = common.square(n, shake, seed, cloud, dim)
    return pd.Case(
        particles=particles,
        material=pd.LinearElastic(E=E, nu=NU),
        conditions=[
            *common.three_supports([tuple(corner) for corner in corners], displacement),
            pd.Traction(face(0, 1.0), x=lambda x, t: x[:, 1] - 0.5),
            pd.Traction(face(0, 0.0), x=lambda x, t: 0.5 - x[:, 1]),
        ],
        **common.common(scheme, weights, horizon, G, common.spacing_of(particles)),
        **common.errors(displacement, stress, surface=face(1, 1.0)),
    )
