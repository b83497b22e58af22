"""Rigid flat punch pressed into a plastic block: Prandtl's limit pressure. Any consistent units.

A block of 5 x 2, plane strain, E = 1000, nu = 0.3, yield stress 1 without hardening (``pd.J2``). A rigid punch of half
width 0.5 with sharp corners moves down by ``load`` in the middle of its top. The sides and the bottom are on rollers.
Half of the block is computed, on nodes, ``n`` over the half width of the punch.

Prandtl (1920): a punch sinks into a half plane at a mean pressure of ``(2 + pi) k``, ``k = yield stress / sqrt(3)``,
with and without friction. His slip lines end 1.5 from the middle.

Plastic flow keeps the volume: ``scheme`` is ``correspondence`` with ``TangentScaled(Silling(G))``, ``patches``
(``MeanDilatation``, the control by shear), or ``sub_horizons`` without control.

Results: ``pressure_over_prandtl``, mean pressure on the undeformed width of the punch over Prandtl's; ``rise``, the
share of it that the last tenth of ``load`` adds.
"""

import numpy as np

import pdpetsc as pd

WIDTH, DEPTH, HALF = 2.5, 2.0, 0.5
E, NU, YIELD = 1000.0, 0.3, 1.0
PRANDTL = (2.0 + np.pi) * YIELD / np.sqrt(3.0)


def case(n=16, friction=0.0, load=0.02, scheme="correspondence", G=0.05, horizon=1.515, steps=10):
    dx = HALF / n
    punch = pd.RigidBox((-HALF, DEPTH), (HALF, DEPTH + 1.0), move=(0.0, -load))
    models = {
        "correspondence": (pd.Correspondence(), pd.TangentScaled(pd.Silling(G))),
        "patches": (pd.MeanDilatation(pd.Correspondence(), 2.0 * dx), pd.TangentScaled(pd.ByShear(pd.Silling(G)))),
        "sub_horizons": (pd.SubHorizons(), None),
    }
    chosen, control = pd.choose("scheme", scheme, models)

    def results(h):
        t, force = np.array(h["t"]), -2.0 * np.array(h["punch_y"])
        pressure = force / (2.0 * HALF) / PRANDTL
        return {
            "force": force[-1],
            "pressure_over_prandtl": pressure[-1],
            "rise": 1.0 - np.interp(0.9, t, pressure) / pressure[-1],
        }

    return pd.Case(
        particles=pd.LatticeNodes((0.0, 0.0), (WIDTH, DEPTH), dx),
        horizon=horizon * dx,
        material=pd.J2(E=E, nu=NU, yield_stress=YIELD),
        scheme=chosen,
        control=control,
        conditions=[
            pd.Roller("-x"), pd.Roller("+x"), pd.Roller("-y"),
            pd.Contact("+y", punch, friction, name="punch"),
        ],
        steps=pd.Steps(steps),
        results=results,
        expect={"pressure_over_prandtl": pd.Expected(1.0, relative=0.1, source="Prandtl 1920")},
        fields=[pd.displacement, pd.stress, pd.plastic_strain],
        picture=pd.Picture(pd.plastic_strain, "", scale=5.0),
    )  # fmt: skip
