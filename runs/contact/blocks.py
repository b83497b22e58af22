"""Patch test of contact: two blocks of unlike spacings are pressed together. Any consistent units.

Two blocks of 2 x 1, E = 2e6, nu = 0, one on the other (El-Abbasi and Bathe 2001). The top moves down by ``load``.
Closed form at small strain: the pressure is ``E load / 2`` everywhere, and the interface moves by ``load / 2``. The
lower block has ``n`` cells over its height, the upper one ``n + 1``; ``lower`` and ``upper`` declare other numbers.
Particles are nodes (``cloud=nodes``) or middles of cells (``cloud=cells``), which the layers outside of the interface
hold.

Results: ``pressure_error``, the largest difference of a stress near the interface from the closed form, and
``interface_error``, both relative.
"""

from dataclasses import dataclass

import numpy as np

import pdpetsc as pd

E = 2e6


@dataclass(frozen=True)
class StressError(pd.Quantity):
    """Largest relative difference of the vertical stress from the closed form at particles near the interface."""

    load: float
    dimension = "1"

    def evaluate(self, solution):
        own = solution.cloud.x[: solution.cloud.n_owned]
        near = np.abs(own[:, 1] - 1.0) < 0.5
        off = np.abs(pd.stress(solution)[near, 1, 1] / (-0.5 * self.load * E) - 1.0)
        return max(solution.cloud.comm.allgather(float(off.max(initial=0.0))))


def case(n=4, friction=0.0, load=0.1, lower=0, upper=0, cloud="nodes", penetration=1e-8):
    lower, upper = lower or n, upper or n + 1
    kind = pd.choose("cloud", cloud, {"nodes": pd.LatticeNodes, "cells": pd.Lattice})

    def down(x, t):
        return -0.5 * load * t * x[:, 1]

    # The linear field, in layers that are deeper than the horizon.
    ends = pd.region.Slab("y", high=0.0) | pd.region.Slab("y", low=2.0)
    if kind is pd.Lattice:
        ends = pd.region.Slab("y", high=2.5 / lower) | pd.region.Slab("y", low=2.0 - 2.5 / upper)
    return pd.Case(
        particles=pd.Bodies(
            {
                "lower": kind((0.0, 0.0), (2.0, 1.0), 1.0 / lower),
                "upper": kind((0.0, 1.0), (2.0, 2.0), 1.0 / upper),
            }
        ),
        material=pd.LinearElastic(E=E, nu=0.0),
        weights=pd.Conforming(),
        conditions=[
            pd.Displacement(ends, x=0.0, y=down),
            pd.Traction("lower -y", y=0.5 * load * E),
            pd.Traction("upper +y", y=-0.5 * load * E),
            pd.BodyContact("lower +y", "upper -y", friction, penetration=penetration, name="pair"),
        ],
        history={"interface": pd.Mean(pd.displacement, "y", "lower +y"), "stress": StressError(load)},
        results=lambda h: {
            "pressure_error": h["stress"][-1],
            "interface_error": abs(h["interface"][-1] / (-0.5 * load) - 1.0) if cloud == "nodes" else 0.0,
            "force": h["pair_y"][-1],
        },
        expect={"pressure_error": pd.Expected(0.0, absolute=1e-6, source="closed form")},
    )
