"""Notched strip of bond-based material in plane stress, pulled at its ends. Units mm, N, MPa.

The notch reaches from the left side to ``notch`` of the width: bonds across it are so weak that they break at once. As
it stands every row of the history is an event; with ``--solver newton`` the displacement grows in ``steps`` equal
steps, and bonds beyond their critical stretch break at each until none is left. Results: ``max_force``, ``dissipated``.
"""

import numpy as np

import pdpetsc as pd

E = 1000.0
STRETCH = 0.01
WEAK = 1e-6


def critical(width, height, notch):
    """Return the critical stretch of bonds: next to nothing where they cross the notch."""

    def function(length, middle):
        in_notch = (np.abs(middle[:, 1] - 0.5 * height) < 1e-6 * height) & (middle[:, 0] < notch * width)
        return np.where(in_notch, WEAK, STRETCH)

    return function


def case(nx=8, ny=12, horizon=1.5, notch=0.3, pull=0.03, steps=20, perturbation=1e-2, seed=1):
    width, height = float(nx), float(ny)
    rng = np.random.default_rng(seed)
    grid = np.stack(np.meshgrid(np.arange(nx) + 0.5, np.arange(ny) + 0.5, indexing="ij"), axis=-1).reshape(-1, 2)
    x = grid + perturbation * rng.uniform(-1.0, 1.0, grid.shape)
    low, high = pd.region.Slab("y", high=horizon), pd.region.Slab("y", low=height - horizon)
    return pd.Case(
        particles=pd.Arrays(x, 1.0),
        horizon=horizon,
        material=pd.BondBased(E=E, plane="stress", calibration="lattice"),
        damage=pd.Brittle(pd.CriticalFunction(critical(width, height, notch))),
        conditions=[pd.Displacement(low, x=0.0, y=0.0), pd.Displacement(high, x=0.0, y=pull * height)],
        steps=pd.Steps(steps),
        solver=pd.EventDriven(),
        history={
            "displacement": pd.Mean(pd.displacement, "y", high),
            "force": pd.Reaction("y", high),
            "dissipated": pd.DissipatedEnergy(),
        },
        results=lambda h: {"max_force": max(h["force"]), "dissipated": h["dissipated"][-1]},
        fields=[pd.displacement, pd.local_damage],
        picture=pd.Picture(pd.local_damage, ""),
    )
