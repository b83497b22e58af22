"""Strip with a crack in its middle, pulled at its ends until it breaks: peak load against Griffith. Units mm, N.

Width 20, length 40, bond-based, plane stress, E = 1000 MPa, fracture energy 0.1 N / mm, a crack of length 2 ``a``
across the middle; the event-driven solver finds the peak exactly, ``solver=path`` follows the crack with Newton's
method. Bonds snap, or with ``law=linear`` soften to three times their critical stretch.
Results: ``peak_stress``; ``griffith``, the stress ``sqrt(E Gc / (pi a sec(pi a / W)))`` at which the crack grows in a
strip (Feddersen); ``ratio`` of both; ``broken_bonds``.
"""

import numpy as np

import pdpetsc as pd

WIDTH, LENGTH = 20.0, 40.0
E, GC = 1000.0, 0.1


def case(n=20, horizon=3.015, a=5.0, pull=1.0, calibration="family", law="brittle", solver="events"):
    dx = WIDTH / n
    layer = 1.5 * dx
    low, high = pd.region.Slab("y", high=layer), pd.region.Slab("y", low=LENGTH - layer)
    ends = pd.region.Slab("y", high=2.0 * horizon * dx) | pd.region.Slab("y", low=LENGTH - 2.0 * horizon * dx)
    griffith = np.sqrt(E * GC / (np.pi * a / np.cos(np.pi * a / WIDTH)))
    crack = pd.Segment((0.5 * WIDTH - a, 0.5 * LENGTH), (0.5 * WIDTH + a, 0.5 * LENGTH))

    energy = pd.FractureEnergy(GC)
    laws = {"brittle": pd.Brittle(energy, protected=ends), "linear": pd.LinearSoftening(energy, 3.0, protected=ends)}

    def results(h):
        peak = max(h["force"]) / WIDTH
        return {"peak_stress": peak, "griffith": griffith, "ratio": peak / griffith, "broken_bonds": h["broken"][-1]}

    return pd.Case(
        particles=pd.Lattice((0.0, 0.0), (WIDTH, LENGTH), dx),
        horizon=horizon * dx,
        material=pd.BondBased(E=E, plane="stress", calibration=calibration),
        cracks=[crack],
        damage=pd.choose("law", law, laws),
        conditions=[pd.Displacement(low, x=0.0, y=0.0), pd.Displacement(high, x=0.0, y=pull)],
        solver=pd.choose("solver", solver, pd.SOLVERS),
        history={
            "force": pd.Reaction("y", high),
            "displacement": pd.Mean(pd.displacement, "y", high),
            "broken": pd.BrokenBonds(),
            "dissipated": pd.DissipatedEnergy(),
            "stored": pd.StrainEnergy(),
            "work": pd.ExternalWork(),
            "tip": pd.CrackTip((1.0, 0.0)),
        },
        results=results,
        fields=[pd.displacement, pd.local_damage],
        picture=pd.Picture(pd.local_damage, "", 5.0),
    )
