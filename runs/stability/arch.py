"""Shallow arch that snaps through: its path of equilibria by arc length. Any consistent units.

A sinusoidal arch of span 20, rise 0.6 and height 0.5, plane stress, E = 1000, nu = 0, with both ends pinned. A load
``q sin(k x)`` per length acts downwards, ``k = pi / 20``. The arch keeps its shape ``a sin(k x)``. With the thrust
``N = E A k^2 (a_0^2 - a^2) / 4`` of a shallow arch, ``q = k^2 (N a + E I k^2 (a_0 - a))``: a maximum and a minimum,
between which the load falls. It is too flat to give way to one side. ``n`` cells over the height. The load factor
of the path multiplies ``load`` times the exact limit.

Results: ``upper``, the largest load over the exact one, ``lower``, the error of the least load, and ``furthest``, that
of the whole path, both over the largest load.

With ``solver=snap`` the load grows to ``load`` times the exact limit in load steps. At the limit the arch, of density
1, snaps through as a motion and rests on the other side; its ends are held at their middle node. Results: ``limit``,
the load of the last equilibrium before the snap over the exact limit; ``landing``, the rise after the snap over the
exact one at its load.
"""

import numpy as np
import strips

import pdpetsc as pd

E, SPAN, RISE, HEIGHT = 1000.0, 20.0, 0.6, 0.5
K = np.pi / SPAN


def exact(a):
    """Return the load per length at a rise."""
    thrust = E * HEIGHT * K**2 * (RISE**2 - a**2) / 4.0
    return K**2 * (thrust * a + E * HEIGHT**3 / 12.0 * K**2 * (RISE - a))


# Rise at the limits of the load.
LIMIT = np.sqrt((RISE**2 - HEIGHT**2 / 3.0) / 3.0)


def particles(n):
    """Return the nodes of quadrilaterals along the arch."""
    m = round(SPAN / HEIGHT * n)
    x, across = np.meshgrid(np.linspace(0.0, SPAN, m + 1), np.linspace(-0.5, 0.5, n + 1) * HEIGHT, indexing="ij")
    return strips.particles(x, RISE * np.sin(K * x) + across)


def beyond(load):
    """Return the rise on the far side at a load per length."""
    bending = E * HEIGHT**3 / 12.0 * K**2
    roots = np.roots(
        [-0.25 * E * HEIGHT * K**2, 0.0, 0.25 * E * HEIGHT * K**2 * RISE**2 - bending, bending * RISE - load / K**2]
    )
    return float(roots.real.min())


def case(n=8, step=0.02, horizon=2.015, solver="path", load=1.3):
    if pd.choose("solver", solver, {"path": False, "snap": True}):
        return snapping(n, horizon, load)
    whole = load * exact(LIMIT)

    def results(h):
        q, a = whole * np.array(h["t"]), RISE + np.array(h["top"])
        near = np.abs(a) < 1.2 * LIMIT
        return {
            "upper": q[near & (a > 0.0)].max() / exact(LIMIT),
            "lower": (q[near & (a < 0.0)].min() - exact(-LIMIT)) / exact(LIMIT),
            "furthest": np.abs(q - exact(a)).max() / exact(LIMIT),
        }

    return arch(
        n, horizon, whole,
        conditions=[pd.PointSupport("-x", x=0.0, y=0.0), pd.PointSupport("+x", x=0.0, y=0.0)],
        solver=pd.PathFollowing(pd.ArcLength(step=step, end=0.9), first=0.05 / load, until=0.0),
        results=results,
        expect={
            "upper": pd.Expected(1.0, absolute=0.03, source="shallow arch"),
            "lower": pd.Expected(0.0, absolute=0.1, source="shallow arch"),
        },
        picture=pd.Picture(pd.stress, "xx"),
    )  # fmt: skip


def arch(n, horizon, whole, conditions, **of_case):
    """Return the arch under the load ``whole`` per length."""
    return pd.Case(
        particles=particles(n),
        horizon=horizon * HEIGHT / n,
        material=pd.NeoHookean(E=E, nu=0.0, plane="stress", density=1.0),
        conditions=[
            *conditions,
            pd.BodyForce(pd.region.All(), y=lambda x, t: -t * whole / HEIGHT * np.sin(K * x[:, 0])),
        ],
        history={"top": pd.Mean(pd.displacement, "y", pd.region.Nearest((0.5 * SPAN, RISE)))},
        **of_case,
    )


def snapping(n, horizon, load):
    """Return the arch under a load beyond its limit."""
    whole = load * exact(LIMIT)

    def results(h):
        q, a = whole * np.array(h["t"]), RISE + np.array(h["top"])
        k = int(np.argmin(np.diff(a))) + 1
        return {"limit": q[k - 1] / exact(LIMIT), "landing": a[k] / beyond(q[k])}

    ends = pd.region.Nearest((0.0, 0.0)) | pd.region.Nearest((SPAN, 0.0))
    return arch(
        n, horizon, whole,
        conditions=[pd.Displacement(ends, x=0.0, y=0.0)],
        solver=pd.SnapThrough(dt=2.0, end=5000.0),
        steps=pd.Steps(round(10.0 * load), smallest=0.002),
        results=results,
        expect={
            "limit": pd.Expected(1.0, absolute=0.08, source="shallow arch"),
            "landing": pd.Expected(1.0, absolute=0.04, source="shallow arch"),
        },
        picture=pd.Picture(pd.displacement, "y"),
    )  # fmt: skip
