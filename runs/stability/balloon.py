"""Balloon inflated beyond its largest pressure: its path of equilibria by arc length. Any consistent units.

Radii 1 and 1.2, E = 1, and a pressure on the deformed inner surface, which rises to a limit and falls while the balloon
grows. ``dim=2`` is a ring of Hencky's law with nu = 0. ``dim=3`` is an eighth of a sphere, neo-Hookean with nu = 0.3,
with ``around`` cells over half a right angle. ``n`` cells over the thickness. The reference is the radial equilibrium
``dP_r / dR = (dim - 1) (P_t - P_r) / R`` of the same law.

Results: ``limit``, the largest pressure over the exact one, ``furthest``, the error of the whole path over it, and
``last``, the last pressure over the largest one.
"""

from functools import lru_cache

import numpy as np
import strips
from scipy.integrate import solve_ivp
from scipy.optimize import brentq

import pdpetsc as pd

E, INNER, OUTER = 1.0, 1.0, 1.2
LAWS = {2: pd.Hencky(E=E, nu=0.0), 3: pd.NeoHookean(E=E, nu=0.3)}
# Stretches of the inner surface around the limit.
AT_LIMIT = np.linspace(1.3, 2.0, 57)


def stresses(radial, around, dim):
    """Return the first Piola-Kirchhoff stresses along and around a radius."""
    if dim == 2:
        return E * np.log(radial) / radial, E * np.log(around) / around
    lam, mu = LAWS[3].lame(3)
    log_J = np.log(radial * around**2)
    return tuple(mu * (s - 1.0 / s) + lam * log_J / s for s in (radial, around))


@lru_cache
def exact(a, dim):
    """Return the pressure at the stretch of the inner surface, by shooting from it to the outer one."""

    def slopes(R, y):
        around, P = y[0] / R, y[1]
        radial = brentq(lambda s: stresses(s, around, dim)[0] - P, 1e-2, 1.5, xtol=1e-14)
        return [radial, (dim - 1) * (stresses(radial, around, dim)[1] - P) / R]

    def outside(p):
        return solve_ivp(slopes, (INNER, OUTER), [a * INNER, -p * a ** (dim - 1)], rtol=1e-8, atol=1e-10).y[1, -1]

    return brentq(outside, 0.0, 0.2 * E, xtol=1e-9)


def ring(n):
    """Return the nodes of n rings of quadrilaterals, about as long as they are thick."""
    m = 4 * round(0.25 * np.pi * (INNER + OUTER) / (OUTER - INNER) * n)
    # Clockwise, so that the radius points to the left of the way around.
    angle, radius = np.meshgrid(-2.0 * np.pi / m * np.arange(m), np.linspace(INNER, OUTER, n + 1), indexing="ij")
    return strips.particles(radius * np.cos(angle), radius * np.sin(angle), closed=True)


def eighth(n, k):
    """Return the nodes of n layers of hexahedra between the planes x = 0, y = 0 and z = 0, on three sides of a cube."""
    side = np.tan(np.linspace(0.0, 0.25 * np.pi, k + 1))
    a, b, radius = np.meshgrid(side, side, np.linspace(INNER, OUTER, n + 1), indexing="ij")
    sides = []
    for axis in range(3):
        way = np.stack(np.roll([np.ones_like(a), a, b], axis, axis=0), axis=-1)
        sides.append(radius[..., None] * way / np.linalg.norm(way, axis=-1)[..., None])
    return strips.blocks(sides)


def case(n=2, around=6, step=0.05, end=1.5, dim=2, horizon=2.015, solver="path", pressure=1.0, steps=4):
    largest = max(exact(float(a), dim) for a in AT_LIMIT)
    spacing = (OUTER - INNER) / n if dim == 2 else max((OUTER - INNER) / n, 0.25 * np.pi * INNER / around)

    def results(h):
        p, a = pressure * largest * np.array(h["t"]), 1.0 + np.array(h["grown"])
        off = [found - exact(float(at), dim) for found, at in zip(p, a, strict=True)]
        return {"limit": p.max() / largest, "furthest": np.abs(off).max() / largest, "last": p[-1] / p.max()}

    def inside(x):
        # The facets of the planes of an eighth are none of them.
        return (np.linalg.norm(x, axis=1) < 0.5 * (INNER + OUTER)) & ((dim == 2) | (x.min(axis=1) > 1e-6 * INNER))

    if dim == 2:
        ends = {
            c: [pd.region.Nearest(side * INNER * np.eye(2)[1 - i]) for side in (1.0, -1.0)] for i, c in enumerate("xy")
        }
        supports = [pd.Displacement(one | other, **{c: 0.0}) for c, (one, other) in ends.items()]
    else:
        supports = [pd.Displacement(pd.region.Slab(c, high=1e-6 * INNER), **{c: 0.0}) for c in "xyz"]
    of_path = pd.PathFollowing(pd.ArcLength(step=step, end=end), first=0.05, until=0.0)
    return pd.Case(
        particles=ring(n) if dim == 2 else eighth(n, around),
        horizon=horizon * spacing,
        material=LAWS[dim],
        conditions=[*supports, pd.FollowerPressure(pd.region.Where(inside), pressure * largest)],
        solver=pd.choose("solver", solver, {"path": of_path, "steps": pd.Newton()}),
        steps=pd.Steps(steps),
        history={"grown": pd.Mean(pd.displacement, "x", pd.region.Nearest(INNER * np.eye(dim)[0]))},
        results=results,
        expect={"limit": pd.Expected(1.0, absolute=0.02, source="radial equilibrium")},
        picture=pd.Picture(pd.displacement, "x"),
    )
