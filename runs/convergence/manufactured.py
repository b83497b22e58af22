"""Unit square, plane strain, whose body force and tractions belong to a chosen smooth displacement.

``u = (sin(pi x) sin(pi y), x^2 y) / 10``; body force ``-div sigma``, tractions ``sigma n`` on all four sides. ``n``
cells a side, nodes moved by up to ``shake`` spacings; ``cloud`` is one of ``common.square``. With ``held=k`` the first
k columns of particles have the exact displacement, and the side x = 0 no traction: a clamped side. That displacement is
zero at x = 0, so with ``cloud=nodes held=1`` the side itself is clamped. ``error_surface_stress`` is that at x = 0.
"""

import common
import numpy as np

import pdpetsc as pd

MATERIAL = pd.LinearElastic(E=1.0, nu=0.3)
SIZE = 0.1


def waves(x):
    """Return sines and cosines of both coordinates."""
    return *np.sin(np.pi * x.T), *np.cos(np.pi * x.T)


def displacement(x, t):
    sx, sy, _, _ = waves(x)
    return SIZE * np.stack([sx * sy, x[:, 0] ** 2 * x[:, 1]], axis=1)


def stress(x, t):
    sx, sy, cx, cy = waves(x)
    gradient = np.empty((len(x), 2, 2))
    gradient[:, 0, 0], gradient[:, 0, 1] = np.pi * cx * sy, np.pi * sx * cy
    gradient[:, 1, 0], gradient[:, 1, 1] = 2.0 * x[:, 0] * x[:, 1], x[:, 0] ** 2
    lam, mu = MATERIAL.lame(2)
    trace = np.trace(gradient, axis1=1, axis2=2)[:, None, None]
    return SIZE * (lam * trace * np.eye(2) + mu * (gradient + gradient.transpose(0, 2, 1)))


def body_force(x, t):
    sx, sy, cx, cy = waves(x)
    lam, mu = MATERIAL.lame(2)
    of_divergence = np.stack([2.0 * x[:, 0] - np.pi**2 * sx * sy, np.pi**2 * cx * cy], axis=1)
    laplacian = np.stack([-2.0 * np.pi**2 * sx * sy, 2.0 * x[:, 1]], axis=1)
    return -SIZE * ((lam + mu) * of_divergence + mu * laplacian)


def case(
    n=16, shake=0.0, seed=0, cloud="cells", scheme="correspondence", weights="conforming", horizon=2.015, G=0.5, held=0,
):  # fmt: skip
    region = pd.region
    particles = common.square(n, shake, seed, cloud)
    # Columns of cells are told apart half a spacing behind the last one, however shaken; those of nodes before.
    columns = held if cloud == "cells" else held - 0.5

    def face(axis, at):
        return region.Slab("xy"[axis], at - 1e-9, at + 1e-9)

    def side(axis, sign):
        x, y = (lambda places, t, row=row: sign * stress(places, t)[:, row, axis] for row in (0, 1))
        return pd.Traction(face(axis, max(sign, 0.0)), x=x, y=y)

    if held:
        x, y = (lambda places, t, axis=axis: displacement(places, t)[:, axis] for axis in (0, 1))
        supports = [pd.Displacement(region.Slab("x", high=columns / n), x=x, y=y)]
    else:
        supports = [*common.three_supports([(0.0, 0.0), (1.0, 0.0)], displacement), side(0, -1.0)]
    bx, by = (lambda x, t, axis=axis: body_force(x, t)[:, axis] for axis in (0, 1))
    return pd.Case(
        particles=particles,
        material=MATERIAL,
        conditions=[
            *supports,
            pd.BodyForce(region.All(), x=bx, y=by),
            side(0, 1.0),
            side(1, -1.0),
            side(1, 1.0),
        ],
        **common.common(scheme, weights, horizon, G, 1.0 / n),
        **common.errors(displacement, stress, rigid=not held, surface=face(0, 0.0)),
    )
