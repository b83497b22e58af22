"""Thick ring under internal pressure, plane strain, against the solution of Lame.

Radii 1 and 2, ``n`` particles across. ``mesh`` is ``quads`` (polar), ``triangles`` (irregular, their nodes moved by up
to ``shake``), the nodes of either, ``quad_nodes`` and ``nodes``, or ``lattice``, whose round surfaces are staircases:
loads and boundary have corners of one spacing. ``error_surface_stress`` is that at the inner surface,
``hoop`` the stress around the hole. Any consistent units.
"""

import common
import numpy as np
import rings

import pdpetsc as pd

E, NU, PRESSURE = 1.0, 0.3, 0.1
A = PRESSURE * rings.INNER**2 / (rings.OUTER**2 - rings.INNER**2)
B = A * rings.OUTER**2


def displacement(x, t):
    r = np.linalg.norm(x, axis=1)
    return (1.0 + NU) / E * ((1.0 - 2.0 * NU) * A + B / r**2)[:, None] * x


def stress(x, t):
    r = np.linalg.norm(x, axis=1)
    return rings.radial(x, A - B / r**2, A + B / r**2)


def case(
    n=12, mesh="quads", shake=0.2, seed=0, scheme="correspondence", weights="conforming", horizon=2.015, G=0.5,
):  # fmt: skip
    particles = rings.cloud(mesh, n, shake, seed)
    spacing = common.spacing_of(particles)
    of_errors = common.errors(displacement, stress, surface=rings.HOLE)
    # Highest and lowest point of the hole, where the stress along x is the one around it.
    of_errors["history"]["hoop"] = pd.OnSurface(pd.stress, "xx", rings.HOLE, take="largest")
    return pd.Case(
        particles=particles,
        material=pd.LinearElastic(E=E, nu=NU),
        conditions=[*rings.supports(displacement), pd.Pressure(rings.HOLE, PRESSURE)],
        **common.common(scheme, weights, horizon, G, spacing),
        **of_errors,
        expect={
            "error_u": pd.Expected(0.0, absolute=0.01, source="Lame's solution"),
            "hoop": pd.Expected(A + B, relative=0.05, source="Lame's solution at the hole"),
        },
        picture=pd.Picture(pd.von_mises, ""),
    )
