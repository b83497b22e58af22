"""Block with random particle positions, sheared and pulled: what a method does away from lattices. Units m, N.

Positions are moved by up to ``shake`` spacings, the same on any rank count. Results: ``energy`` of the body and share
of it that the control holds.
"""

import numpy as np

import pdpetsc as pd


def case(dim=2, n=8, horizon=2.015, shake=0.2, scheme="correspondence", control="silling", seed=1, pull=0.1, steps=1):
    if dim not in (2, 3):
        raise pd.CaseError(f"dim is 2 or 3, not {dim}.")
    x = np.stack(np.meshgrid(*[np.arange(float(n))] * dim, indexing="ij"), axis=-1).reshape(-1, dim)
    inside = np.all((x > 0.5) & (x < n - 1.5), axis=1)
    x[inside] += shake * np.random.default_rng(seed).uniform(-1.0, 1.0, (int(inside.sum()), dim))
    last = n - 1.0
    return pd.Case(
        particles=pd.Arrays(x, np.ones(len(x))),
        horizon=horizon,
        material=pd.Hencky(E=1.0e3, nu=0.3),
        scheme=pd.choose("scheme", scheme, pd.SCHEMES),
        control=pd.choose("control", control, pd.CONTROLS),
        conditions=[
            pd.Displacement(pd.region.Slab("x", high=0.1), **dict.fromkeys("xyz"[:dim], 0.0)),
            pd.Displacement(pd.region.Slab("x", low=last - 0.1), x=pull * last, y=0.5 * pull * last),
        ],
        steps=pd.Steps(steps),
        history={"energy": pd.StrainEnergy(), "control_energy": pd.ControlEnergy()},
        results=lambda h: {
            "energy": h["energy"][-1],
            "control_share": h["control_energy"][-1] / (h["energy"][-1] + h["control_energy"][-1]),
        },
        picture=pd.Picture(pd.stress, "xx"),
    )
