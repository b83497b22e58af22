"""Thick neo-Hookean sphere inflated by a follower pressure, against the radial equilibrium of the same law.

Radii 1 and ``outer``, mu = 1. The pressure on the deformed inner surface (``pd.FollowerPressure``) is that which opens
it to the radius ``to``. One octant is computed, on nodes of hexahedra in shells that grow with the radius, ``n``
through the wall.

The reference solves ``d P_r / dR + 2 (P_r - P_t) / R = 0`` with ``r(1) = to`` and ``P_r(outer) = 0`` by collocation.
For nu = 0.5 it is ``p = mu / 2 (4 / s + 1 / s^4)``, the value of the outer stretch ``s`` less that of the inner one
(Green and Zerna). That has a maximum, where load steps end: at the inner radius 1.8 with ``outer=2``. With ``outer=3
to=2``, twice the radius, the maximum is only 1.7 % higher than the load, and ``n=8`` and ``16`` converge, ``12`` does
not.

Results: ``error_u`` of the displacements in the L2 norm, and ``error_surface_stress`` of the Cauchy stress on the inner
surface. Any consistent units.
"""

import sys
from functools import lru_cache
from pathlib import Path

import common
import numpy as np
from scipy.integrate import solve_bvp

import pdpetsc as pd

sys.path.append(str(Path(__file__).parent.parent / "contact"))
import refined

INNER, MU = 1.0, 1.0


def principal(nu, radial, around):
    """Return the principal first Piola-Kirchhoff stresses of the stretches along and around a radius."""
    log_J = np.log(radial * around**2)
    return tuple(MU * (s - 1.0 / s) + 2.0 * MU * nu / (1.0 - 2.0 * nu) * log_J / s for s in (radial, around))


def radial_stretch(nu, P, around):
    """Return the radial stretch that has the radial stress P."""
    lam, s = 2.0 * MU * nu / (1.0 - 2.0 * nu), around**-2.0
    for _ in range(50):
        slope = MU * (1.0 + 1.0 / s**2) + lam * (1.0 - np.log(s * around**2)) / s**2
        s = np.maximum(s - (principal(nu, s, around)[0] - P) / slope, 0.3 * s)
    return s


@lru_cache
def reference(nu, to, outer):
    """Return the radial position and stress of a particle as a function of its radius R."""

    def slopes(R, y):
        around = y[0] / R
        radial = radial_stretch(nu, y[1], around)
        return np.stack([radial, 2.0 * (principal(nu, radial, around)[1] - y[1]) / R])

    R = np.linspace(INNER, outer, 81)
    y = np.stack([R, np.zeros_like(R)])
    for a in np.linspace(INNER, to, 6)[1:]:
        found = solve_bvp(
            slopes, lambda low, high, a=a: np.array([low[0] - a, high[1]]), R, y, tol=1e-9, max_nodes=100_000
        )
        assert found.success, found.message
        R, y = found.x, found.y
    return found.sol


def pressure(nu, to, outer):
    """Return the pressure on the deformed surface that opens the inner surface to a radius."""
    return -float(reference(nu, to, outer)(INNER)[1]) * (INNER / to) ** 2


def exact(nu, to, outer):
    """Return displacements and Cauchy stresses, functions of positions and load parameter."""

    def radius(x):
        # The middles of facets lie within the sphere.
        return np.maximum(np.linalg.norm(x, axis=1), INNER)

    def displacement(x, t):
        R = radius(x)
        return (reference(nu, to, outer)(R)[0] / R - 1.0)[:, None] * x

    def stress(x, t):
        R = radius(x)
        place, P = reference(nu, to, outer)(R)
        around = place / R
        radial = radial_stretch(nu, P, around)
        tangential = principal(nu, radial, around)[1] / (radial * around)
        e = x / np.linalg.norm(x, axis=1)[:, None]
        rr = np.einsum("ni,nj->nij", e, e)
        return (P / around**2)[:, None, None] * rr + tangential[:, None, None] * (np.eye(3) - rr)

    return displacement, stress


def octant(n, outer):
    """Return nodes and hexahedra of one octant, ``n`` through the wall and about as wide as they are thick."""
    around = round(0.25 * np.pi / np.log(outer / INNER) * n)
    index = np.stack(np.meshgrid(*[np.arange(around + 1)] * 3, indexing="ij"), axis=-1).reshape(-1, 3)
    index = index[index.max(axis=1) == around]
    direction = np.tan(0.25 * np.pi * index / around)
    direction /= np.linalg.norm(direction, axis=1)[:, None]
    points = np.concatenate([radius * direction for radius in np.geomspace(INNER, outer, n + 1)])
    row = {tuple(at): k for k, at in enumerate(index.tolist())}
    cells = []
    for axis in range(3):
        for low in np.ndindex(around, around):
            face = [
                row[tuple(np.insert(np.add(low, way), axis, around).tolist())]
                for way in ((0, 0), (1, 0), (1, 1), (0, 1))
            ]
            cells += [[*(k * len(index) + np.array(face)), *((k + 1) * len(index) + np.array(face))] for k in range(n)]
    return points, np.array(cells)


def case(n=6, outer=2.0, to=1.4, nu=0.3, horizon=2.1, scheme="sub_horizons", G=0.0, steps=4):
    points, cells = octant(n, outer)
    cloud = refined.cloud(points, cells, np.linalg.norm(points, axis=1) < INNER * (1.0 + 1e-9))
    displacement, stress = exact(nu, to, outer)

    def results(h):
        return {
            "error_u": h["error_u"][-1],
            "error_surface_stress": h["error_surface_stress"][-1],
        }

    return pd.Case(
        particles=cloud.particles,
        horizon=horizon * cloud.size,
        scheme=pd.choose("scheme", scheme, pd.SCHEMES),
        control=pd.Silling(G) if G else None,
        material=pd.NeoHookean(E=2.0 * (1.0 + nu) * MU, nu=nu),
        conditions=[
            *(pd.Displacement(pd.region.Slab(axis, high=1e-9), **{axis: 0.0}) for axis in "xyz"),
            pd.FollowerPressure("contact", pressure(nu, to, outer)),
        ],
        steps=pd.Steps(steps),
        history={
            "error_u": common.ErrorL2(pd.displacement, displacement),
            "error_surface_stress": common.SurfaceStressError(
                stress, pd.region.Sphere((0.0, 0.0, 0.0), 0.5 * (INNER + outer))
            ),
        },
        results=results,
        expect={
            "error_u": pd.Expected(0.0, absolute=0.1, source="radial equilibrium"),
        },
        picture=pd.Picture(pd.displacement, "x"),
    )
