"""Thick neo-Hookean ring inflated at finite strain, plane strain, against the radial equilibrium of the same law.

Radii 1 and 2, a pressure p on the inner surface, dead or on the deformed surface (``follower=yes``). The reference
solves ``d P_r / dR + (P_r - P_t) / R = 0`` with ``P_r(1) = -p``, times the stretch of the hole if it follows, and
``P_r(2) = 0`` by collocation. ``mesh``, ``shake`` and ``n`` are those of ``ring.py``. The hole grows by 43 %; with
``follower=yes pressure=0.23`` to twice its radius.
"""

from functools import lru_cache

import common
import numpy as np
import rings
from scipy.integrate import solve_bvp

import pdpetsc as pd

MATERIAL = pd.NeoHookean(E=1.0, nu=0.3)
PRESSURE = 0.2


def principal(of_radius, around):
    """Return both principal first Piola-Kirchhoff stresses of the stretches along and around a radius."""
    lam, mu = MATERIAL.lame(3)
    log_J = np.log(of_radius * around)
    return tuple(mu * (s - 1.0 / s) + lam * log_J / s for s in (of_radius, around))


def stretch_of(P, around):
    """Return the radial stretch that has the radial stress P."""
    lam, mu = MATERIAL.lame(3)
    s = np.ones_like(P)
    for _ in range(50):
        value = principal(s, around)[0] - P
        slope = mu * (1.0 + 1.0 / s**2) + lam * (1.0 - np.log(s * around)) / s**2
        s = np.maximum(s - value / slope, 0.3 * s)
    return s


@lru_cache
def reference(pressure, follower):
    """Return the radial place and stress of a particle as a function of its radius R."""

    def slopes(R, y):
        place, P = y
        around = place / R
        of_radius = stretch_of(P, around)
        return np.stack([of_radius, (principal(of_radius, around)[1] - P) / R])

    R, y = np.linspace(rings.INNER, rings.OUTER, 41), None
    for load in np.linspace(0.0, pressure, 5):
        found = solve_bvp(
            slopes, lambda a, b, load=load: np.array([a[1] + load * (a[0] / rings.INNER) ** follower, b[1]]), R,
            np.stack([R, np.zeros_like(R)]) if y is None else y, tol=1e-10, max_nodes=100_000,
        )  # fmt: skip
        assert found.success, found.message
        R, y = found.x, found.y
    return found.sol


def exact(pressure, follower=False):
    """Return displacements and Cauchy stresses, functions of places and step time."""

    def radius(x):
        # The middles of facets lie within the ring's.
        return np.maximum(np.linalg.norm(x, axis=1), rings.INNER)

    def displacement(x, t):
        R = radius(x)
        return (reference(pressure, follower)(R)[0] / R - 1.0)[:, None] * x

    def stresses(R):
        place, P = reference(pressure, follower)(R)
        around = place / R
        of_radius = stretch_of(P, around)
        return P / around, principal(of_radius, around)[1] / of_radius

    def stress(x, t):
        return rings.radial(x, *stresses(radius(x)))

    return displacement, stress


def case(
    n=12, mesh="quads", shake=0.2, seed=0, scheme="correspondence", weights="conforming", horizon=2.015, G=0.5,
    pressure=PRESSURE, steps=2, follower=False,
):  # fmt: skip
    particles = rings.cloud(mesh, n, shake, seed)
    spacing = common.spacing_of(particles)
    displacement, stress = exact(pressure, follower)

    def held(x, t):
        return t * displacement(x, t)

    load = (pd.FollowerPressure if follower else pd.Pressure)(rings.HOLE, pressure)
    return pd.Case(
        particles=particles,
        material=MATERIAL,
        conditions=[*rings.supports(held), load],
        steps=pd.Steps(steps),
        **common.common(scheme, weights, horizon, G, spacing),
        **common.errors(displacement, stress, surface=rings.HOLE),
    )
