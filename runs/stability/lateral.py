"""Lateral buckling of a deep, narrow cantilever under an end load. Any consistent units.

A cantilever of length 60, depth 6 and width 1, E = 1000, nu = 0.3, is loaded at its free end along its depth. At the
critical load the end moves sideways and twists. ``n`` cells over the width. The load grows to ``load`` times the closed
form (Timoshenko and Gere, section 6.3) for a load at the centroid of the end:

    ``P = 4.013 sqrt(E I G J) / L^2``,  ``I = h b^3 / 12``,  ``J = h b^3 / 3 (1 - 0.63 b / h)``.

The result ``buckling_1`` is the critical load over the applied one. The closed form neglects the deflection before
buckling, which raises the load by about ``1 / sqrt((1 - I / I_z) (1 - G J / (E I_z)))``, 1.034 here. At ``n`` of 2 to
4, bending about the weak axis is 6 to 9 % too soft and torsion 7 to 12 %, which lowers it.

The last step is short and ends near the critical load, since the beam deflects before it buckles (``pd.Modes``).
``load=1.1 unstable=switch`` follows the beam sideways.
"""

import numpy as np

import pdpetsc as pd

E, NU, LENGTH, DEPTH, WIDTH = 1000.0, 0.3, 60.0, 6.0, 1.0
G = E / (2.0 + 2.0 * NU)
WEAK = DEPTH * WIDTH**3 / 12.0
J = DEPTH * WIDTH**3 / 3.0 * (1.0 - 0.63 * WIDTH / DEPTH)
CLOSED = 4.013 * np.sqrt(E * WEAK * G * J) / LENGTH**2


def case(n=2, load=1.0, unstable="warn", steps=8, horizon=2.015):
    modes = unstable == "warn"
    end = pd.region.Slab("x", low=LENGTH - 1e-6 * LENGTH)
    return pd.Case(
        particles=pd.LatticeNodes((0.0, 0.0, 0.0), (LENGTH, DEPTH, WIDTH), WIDTH / n),
        horizon=horizon * WIDTH / n,
        material=pd.NeoHookean(E=E, nu=NU),
        conditions=[pd.Clamp("-x"), pd.Traction("+x", y=-load * CLOSED / (DEPTH * WIDTH))],
        steps=pd.Steps(times=(0.5, 0.98, 1.0)) if modes else pd.Steps(steps, unstable=unstable),
        modes=pd.Modes(2, of="buckling") if modes else None,
        history={"sideways": pd.Mean(pd.displacement, "z", end), "down": pd.Mean(pd.displacement, "y", end)},
        expect={"buckling_1": pd.Expected(1.0 / load, relative=0.03, source="Timoshenko and Gere")} if modes else {},
    )
