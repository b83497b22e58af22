"""Double cantilever beam opened at its end: the crack grows stably, against beam theory. Units mm, N.

Two arms of depth ``h`` = 10 over a length of 90, a crack of length 30 between them, bond-based, plane stress,
E = 1000 MPa, fracture energy 0.1 N / mm, followed event by event. Bonds far from the plane of the crack do not fail.
Beam theory with the turning of the root as a longer crack, ``a' = a + 0.64 h``: opening ``d = 8 P a'^3 / (E h^3)`` and
growth at ``P = sqrt(E Gc h^3 / 12) / a'`` (Williams).
Results, all over beam theory: ``stiffness``, P / d before growth; ``first_load``, at which the first bond breaks;
``load``, the mean while the tip of the crack goes from 35 to 60 and the opening, given, would grow: where the path of
events turns back a test under given opening jumps ahead.
"""

import numpy as np

import pdpetsc as pd

LENGTH, H, E, GC = 90.0, 10.0, 1000.0, 0.1
CRACK = 30.0
ROOT = 0.64


def case(n=20, horizon=3.015, opening=6.0, solver="events"):
    dx = H / n
    delta = horizon * dx
    near = pd.region.Slab("y", low=H - delta, high=H + delta)
    up = pd.region.Box((0.0, 1.5 * H), (dx, 2.0 * H))
    down = pd.region.Box((0.0, 0.0), (dx, 0.5 * H))
    far = pd.region.Nearest((LENGTH, H))

    def results(h):
        load, gap = np.array(h["load"]), 2.0 * np.array(h["deflection"])
        tip = np.array(h["tip"])
        grown = tip + ROOT * H
        exact = np.sqrt(E * GC * H**3 / 12.0) / grown
        first = next(i for i, broken in enumerate(h["broken"]) if broken > 0.0)
        theory = E * H**3 / (8.0 * (CRACK + ROOT * H) ** 3)
        growing = (tip > 35.0) & (tip < 60.0) & (gap >= np.maximum.accumulate(gap))
        return {
            "stiffness": load[first] / gap[first] / theory,
            "first_load": load[first] / (np.sqrt(E * GC * H**3 / 12.0) / (CRACK + ROOT * H)),
            **({"load": float(np.mean((load / exact)[growing]))} if growing.any() else {}),
            "tip": tip[-1],
            "broken_bonds": h["broken"][-1],
        }

    return pd.Case(
        particles=pd.Lattice((0.0, 0.0), (LENGTH, 2.0 * H), dx),
        horizon=delta,
        material=pd.BondBased(E=E, plane="stress", calibration="family"),
        cracks=[pd.Segment((-1.0, H), (CRACK, H))],
        damage=pd.Brittle(pd.FractureEnergy(GC), protected=~near),
        conditions=[
            pd.Displacement(far, x=0.0),
            pd.Displacement(up, y=0.5 * opening),
            pd.Displacement(down, y=-0.5 * opening),
        ],
        solver=pd.choose("solver", solver, pd.SOLVERS),
        history={
            "load": pd.Reaction("y", up),
            "deflection": pd.Mean(pd.displacement, "y", up),
            "broken": pd.BrokenBonds(),
            "tip": pd.CrackTip((1.0, 0.0), 0.25),
            "dissipated": pd.DissipatedEnergy(),
            "work": pd.ExternalWork(),
        },
        results=results,
        fields=[pd.displacement, pd.local_damage],
        picture=pd.Picture(pd.local_damage, "", 1.0),
    )
