"""Plate with a hole pulled until it is apart, bond by bond: load and pull both fall where a ligament snaps.

A plate of 60 x 24 mm with a hole of 8 mm, of bonds that snap, in plane stress. The event-driven solver finds the load
factor at which the next bond breaks, without iterations; the pull may fall from one event to the next (snap-back): a
test under given displacement would jump there. Bonds near the ends do not fail.

Results: ``peak_load``; ``turned_back``, the smallest pull after the peak over that at the peak; ``lost``, what the
broken bonds have taken, over the work of the supports; ``force_left`` at the end, over the peak; ``over_ligaments``,
what was taken over fracture energy times ligaments. Units mm, N.
"""

import numpy as np

import pdpetsc as pd

LENGTH, WIDTH, RADIUS = 60.0, 24.0, 4.0
E, GC = 1000.0, 0.1


def case(n=24, horizon=2.015, pull=1.0, calibration="family"):
    dx = WIDTH / n
    delta = horizon * dx
    left, right = pd.region.Slab("x", high=delta), pd.region.Slab("x", low=LENGTH - delta)
    ends = pd.region.Slab("x", high=2.0 * delta) | pd.region.Slab("x", low=LENGTH - 2.0 * delta)
    hole = pd.region.Sphere((0.5 * LENGTH, 0.5 * WIDTH), RADIUS)

    def results(h):
        force, moved = np.array(h["force"]), np.array(h["displacement"])
        peak = int(np.argmax(force))
        return {
            "peak_load": force[peak],
            "turned_back": float((moved[peak:] / moved[peak]).min()),
            "lost": h["dissipated"][-1] / h["work"][-1],
            "force_left": force[-1] / force[peak],
            "over_ligaments": h["dissipated"][-1] / (GC * (WIDTH - 2.0 * RADIUS)),
        }

    return pd.Case(
        particles=pd.Lattice((0.0, 0.0), (LENGTH, WIDTH), dx, cut=hole),
        horizon=delta,
        material=pd.BondBased(E=E, plane="stress", calibration=calibration),
        damage=pd.Brittle(pd.FractureEnergy(GC, share=1.0), protected=ends),
        conditions=[pd.Displacement(left, x=0.0, y=0.0), pd.Displacement(right, x=pull, y=0.0)],
        solver=pd.EventDriven(),
        history={
            "displacement": pd.Mean(pd.displacement, "x", right),
            "force": pd.Reaction("x", right),
            "dissipated": pd.DissipatedEnergy(),
            "work": pd.ExternalWork(),
            "broken": pd.BrokenBonds(),
        },
        results=results,
        expect={
            "lost": pd.Expected(1.0, relative=1e-6, source="nothing is stored in a plate that is apart"),
            "force_left": pd.Expected(0.0, absolute=1e-9, source="both ligaments are broken"),
        },
        fields=[pd.displacement, pd.local_damage],
        picture=pd.Picture(pd.local_damage, ""),
    )
