"""A force of one's own: a beam on an elastic bed under a load at its middle, against Timoshenko's beam.

The bed pulls every particle back by a force that is proportional to its displacement up or down. The class ``Bed`` says
so in three methods: the force on each particle, its derivative, its energy; ``Bedding`` is what the case declares. The
closed form is that of an infinitely long beam with bending and shear stiffness on a bed of stiffness k per length: with
``a = k / S`` and ``b = sqrt(k / E I)``, ``w = P (1 / b + E I / S) / (2 E I sqrt(a + 2 b))`` below the load (Hetenyi
1946, who has no shear).

Results: ``deflection`` below the load, ``share``, the part of the load that the bed carries. Any consistent units.
"""

from dataclasses import dataclass

import numpy as np

import pdpetsc as pd

LENGTH, HEIGHT, E = 60.0, 2.0, 1000.0
LOAD = 1.0


class Bed(pd.Term):
    """What a rank computes: springs ``k`` (n,) [force / length] on its particles."""

    energy_of = "bed"

    def __init__(self, k):
        self.k = k

    @property
    def grounded(self):
        """Which displacements (n, 2) it holds, so that nothing else has to."""
        return np.stack([np.zeros(len(self.k), dtype=bool), self.k > 0.0], axis=1)

    def add_row_force(self, state, r):
        r[: len(self.k), 1] += self.k * state.own[:, 1]

    def linearise(self, state):
        return [pd.PointBlocks(self.k[:, None, None] * np.diag([0.0, 1.0]))]

    def energy(self, state):
        return 0.5 * float(self.k @ state.own[:, 1] ** 2)


@dataclass(frozen=True)
class Bedding(pd.ExtraTerm):
    """What a case declares: a stiffness per volume [force / length^4]."""

    stiffness: float

    def build(self, body):
        return Bed(self.stiffness * body.cloud.volume[: body.cloud.n_owned])


def deflection(k, nu=0.0):
    """Return the deflection below the load for a bed of stiffness k per length."""
    bending, shear = E * HEIGHT**3 / 12.0, 5.0 / 6.0 * 0.5 * E / (1.0 + nu) * HEIGHT
    a, b = k / shear, np.sqrt(k / bending)
    return LOAD * (1.0 / b + bending / shear) / (2.0 * bending * np.sqrt(a + 2.0 * b))


def case(n=8, bed=0.7, horizon=1.515, scheme="sub_horizons"):
    dx = HEIGHT / n
    middle = pd.region.Slab("x", 0.5 * LENGTH - 1.01 * dx, 0.5 * LENGTH + 1.01 * dx)

    def sunk(solution):
        """Return what the bed pushes back with, per particle."""
        return -bed * solution.volume * pd.displacement(solution)[:, 1]

    class Carried(pd.Quantity):
        """Sum of the forces of the bed."""

        def evaluate(self, solution):
            return float(solution.sum(float(sunk(solution).sum())))

    return pd.Case(
        particles=pd.Lattice((0.0, 0.0), (LENGTH, HEIGHT), dx),
        horizon=horizon * dx,
        material=pd.LinearElastic(E=E, nu=0.0, plane="stress"),
        scheme=pd.choose("scheme", scheme, pd.SCHEMES),
        conditions=[
            pd.Displacement(pd.region.Nearest((0.5 * dx, 0.5 * dx)), x=0.0),
            pd.Force(middle, y=-LOAD),
        ],
        terms=[Bedding(bed)],
        history={"w": pd.Mean(pd.displacement, "y", middle), "carried": Carried()},
        results=lambda h: {"deflection": -h["w"][-1], "share": h["carried"][-1] / LOAD},
        expect={
            "deflection": pd.Expected(deflection(bed * HEIGHT), relative=0.02, source="Timoshenko beam on a bed"),
            "share": pd.Expected(1.0, absolute=1e-9, source="nothing else holds the beam up"),
        },
        picture=pd.Picture(pd.stress, "xx", scale=20.0),
    )
