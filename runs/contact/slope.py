"""Block on a rigid slope: it sticks until the tangent of the angle is the friction. Any consistent units.

A block of 2 x 1, E = 1e4, nu = 0, plane stress, weight 1 per volume, on a rigid plane. In the axes of the plane the
weight turns: it acts along the normal until a quarter of the load, and then turns linearly to ``load`` degrees. An
elastic foundation, ``soft`` per volume of the block, holds it, because a case refuses a body that only contact holds.
It also bounds the sliding: a block that slides moves until the foundation carries ``W (sin - friction cos)``.

Results: ``drag_over_normal``, the forces of the plane at the end, against the least of friction and tangent of the
angle; ``slip_angle`` [degrees], the middle of the step in which the drag reaches the friction, or ``load``, against
``atan(friction)``; ``carried`` by the foundation over W, against ``max(sin - friction cos, 0)``.
"""

import numpy as np

import pdpetsc as pd

E, WIDTH, HEIGHT = 1e4, 2.0, 1.0
NORMAL = 0.25
STEPS = 15


def angle(t, load):
    """Return the angle of the slope [rad] at a load parameter."""
    return np.radians(load) * max((t - NORMAL) / (1.0 - NORMAL), 0.0)


def case(n=10, friction=0.3, load=25.0, soft=0.1):
    def weight(x, t):
        return np.full(len(x), min(t / NORMAL, 1.0) * np.sin(angle(t, load)))

    def pressed(x, t):
        return np.full(len(x), -min(t / NORMAL, 1.0) * np.cos(angle(t, load)))

    plane = pd.RigidPlane((0.0, 0.0), (0.0, 1.0))
    end = np.radians(load)

    def results(h):
        t, drag, normal = (np.asarray(h[name]) for name in ("t", "plane_x", "plane_y"))
        ratio = -drag[1:] / normal[1:]
        angles = np.degrees([angle(one, load) for one in t[1:]])
        slips = ratio >= friction * (1.0 - 1e-6)
        k = int(np.argmax(slips))
        slip = 0.5 * (angles[k - 1] + angles[k]) if slips.any() else load
        return {
            "drag_over_normal": float(ratio[-1]),
            "slip_angle": float(slip),
            "carried": soft * h["moved"][-1],
        }

    return pd.Case(
        particles=pd.LatticeNodes((0.0, 0.0), (WIDTH, HEIGHT), HEIGHT / n),
        material=pd.LinearElastic(E=E, nu=0.0, plane="stress"),
        conditions=[
            pd.BodyForce(pd.region.All(), x=weight, y=pressed),
            pd.Contact("-y", plane, friction, name="plane"),
            pd.Foundation("-y", normal=soft * HEIGHT, tangential=soft * HEIGHT),
        ],
        steps=pd.Steps(times=(NORMAL, *(NORMAL + (1.0 - NORMAL) * k / STEPS for k in range(1, STEPS)), 1.0)),
        history={"moved": pd.Mean(pd.displacement, "x")},
        results=results,
        expect={
            "drag_over_normal": pd.Expected(min(friction, np.tan(end)), relative=1e-3, source="Coulomb"),
            "slip_angle": pd.Expected(min(np.degrees(np.arctan(friction)), load), absolute=1.0, source="Coulomb"),
            "carried": pd.Expected(max(np.sin(end) - friction * np.cos(end), 0.0), absolute=1e-3, source="Coulomb"),
        },
        picture=pd.Picture(pd.stress, "yy"),
    )
