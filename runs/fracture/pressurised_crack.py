"""A crack in a wide plate that a fluid presses open, against Sneddon's solution. Any consistent units.

Square of side 10, E = 1, plane strain, with a crack of length 2 ``half`` in its middle (``cracks`` of
``pd.PointDamage``) under the pressure ``p`` (``pd.CrackPressure``), turned by ``angle`` degrees.

Result: ``volume_over_exact``, twice the work over the pressure, against ``2 pi (1 - nu^2) p half^2 / E`` in an infinite
plate.
"""

import numpy as np

import pdpetsc as pd

SIDE, E = 10.0, 1.0


def case(n=120, p=1e-3, nu=0.25, horizon=2.015, G=2.0, angle=0.0, half=0.5):
    dx, end = SIDE / n, 0.5 * SIDE
    tip = half * np.array([np.cos(np.radians(angle)), np.sin(np.radians(angle))])
    left = pd.region.Box((-end, -0.3 * end), (-0.8 * end, 0.3 * end))
    right = pd.region.Box((0.8 * end, -0.3 * end), (end, 0.3 * end))

    def results(h):
        return {"volume_over_exact": 2.0 * h["work"][-1] / p / (2.0 * np.pi * (1.0 - nu**2) * p * half**2 / E)}

    return pd.Case(
        particles=pd.Lattice((-end, -end), (end, end), dx),
        horizon=horizon * dx,
        material=pd.LinearElastic(E=E, nu=nu),
        scheme=pd.Correspondence(),
        control=pd.Silling(G),
        # Nothing fails further.
        damage=pd.PointDamage(
            pd.softening.Linear(), Gc=1.0, strength=0.1, cracks=[pd.Segment(tuple(-tip), tuple(tip))]
        ),
        conditions=[
            pd.CrackPressure(pd.region.All(), p),
            pd.PointSupport(left, x=0.0, y=0.0),
            pd.PointSupport(right, y=0.0),
        ],
        steps=pd.Steps(1),
        history={"work": pd.ExternalWork()},
        results=results,
    )
