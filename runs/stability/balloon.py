"""Balloon inflated beyond its largest pressure: its path of equilibria by arc length. Any consistent units.

A ring with radii 1 and 1.2, of Hencky's law with E = 1 and nu = 0, under a pressure on its deformed inner surface. The
pressure rises to a limit and falls while the ring grows. The radial equilibrium ``d(R P_r) / dR = P_t`` with the
stresses ``E ln(s) / s`` of both stretches is exact; for a thin ring of stretch s the pressure is proportional to
``ln(s) / s^2``, with its limit at ``s = sqrt(e)``. ``n`` cells over the thickness.

Results: ``limit``, the largest pressure over the exact one, ``furthest``, the error of the whole path over it, and
``last``, the last pressure over the largest one.
"""

from functools import lru_cache

import numpy as np
import strips
from scipy.integrate import solve_ivp
from scipy.optimize import brentq
from scipy.special import lambertw

import pdpetsc as pd

E, INNER, OUTER = 1.0, 1.0, 1.2


def stretch_of(P):
    """Return the stretch below e of a radial stress."""
    return np.exp(-lambertw(-P / E).real)


@lru_cache
def exact(a):
    """Return the pressure at the stretch of the inner surface, by shooting from it to the outer one."""

    def slopes(R, y):
        around, P = y[0] / R, y[1]
        return [stretch_of(P), (E * np.log(around) / around - P) / R]

    def outside(p):
        found = solve_ivp(slopes, (INNER, OUTER), [a * INNER, -p * a], rtol=1e-10, atol=1e-12)
        return found.y[1, -1]

    return brentq(outside, 0.0, 0.5 * E, xtol=1e-12)


def particles(n):
    """Return the nodes of n rings of quadrilaterals, about as long as they are thick."""
    m = 4 * round(0.25 * np.pi * (INNER + OUTER) / (OUTER - INNER) * n)
    # Clockwise, so that the radius points to the left of the way around.
    angle, radius = np.meshgrid(-2.0 * np.pi / m * np.arange(m), np.linspace(INNER, OUTER, n + 1), indexing="ij")
    return strips.particles(radius * np.cos(angle), radius * np.sin(angle), closed=True)


def case(n=2, step=0.05, horizon=2.015, end=1.5, solver="path", pressure=1.0, steps=4):
    largest = max(exact(float(a)) for a in np.linspace(1.4, 2.0, 61))

    def results(h):
        p, a = pressure * largest * np.array(h["t"]), 1.0 + np.array(h["grown"])
        off = [p - exact(float(a)) for p, a in zip(p, a, strict=True)]
        return {"limit": p.max() / largest, "furthest": np.abs(off).max() / largest, "last": p[-1] / p.max()}

    of_path = pd.PathFollowing(pd.ArcLength(step=step, end=end), first=0.05, until=0.0)
    return pd.Case(
        particles=particles(n),
        horizon=horizon * (OUTER - INNER) / n,
        material=pd.Hencky(E=E, nu=0.0),
        conditions=[
            pd.Displacement(pd.region.Nearest((INNER, 0.0)) | pd.region.Nearest((-INNER, 0.0)), y=0.0),
            pd.Displacement(pd.region.Nearest((0.0, INNER)) | pd.region.Nearest((0.0, -INNER)), x=0.0),
            pd.FollowerPressure(pd.region.Sphere((0.0, 0.0), 0.5 * (INNER + OUTER)), pressure * largest),
        ],
        solver=pd.choose("solver", solver, {"path": of_path, "steps": pd.Newton()}),
        steps=pd.Steps(steps),
        history={"grown": pd.Mean(pd.displacement, "x", pd.region.Nearest((INNER, 0.0)))},
        results=results,
        expect={"limit": pd.Expected(1.0, absolute=0.02, source="radial equilibrium")},
        picture=pd.Picture(pd.displacement, "x"),
    )
