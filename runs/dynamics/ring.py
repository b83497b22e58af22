"""Fragments of a ring that expands. Units m, N, kg, s.

A ring of circumference 0.05 (E = 275e9, density 2750, Gc = 100, strength 300e6) expands with the strain rate ``rate``.
It is computed as a periodic line whose mean strain grows at that rate, with the velocity of that strain at the start.
The strength has a scatter, uniform within ``scatter``, so that not all points fail at once. Grady's balance of the
local kinetic energy with Gc gives fragments of ``(24 Gc / (rho rate^2))^(1/3)``, 0.444 mm for 1e5 / s (Grady 1982).
Fragments here are smaller, as in other computations at this rate: the strain energy that the ring stores until it fails
is not in that balance.

``n`` particles; ``PointDamage`` with correspondence and Silling's control.

Results: ``fragments``, ``size``, their mean length, ``size_over_grady`` and ``energy_error``.
"""

from dataclasses import dataclass

import numpy as np

import pdpetsc as pd

LENGTH, E, DENSITY, GC, STRENGTH = 0.05, 275e9, 2750.0, 100.0, 300e6


@dataclass(frozen=True)
class Fragments(pd.Quantity):
    """Number of pieces between failed zones of a periodic line; 0 as long as nothing has failed."""

    def evaluate(self, solution):
        here = np.column_stack([solution.x[:, 0], pd.local_damage(solution)])
        x, damage = np.concatenate(solution.cloud.comm.allgather(here)).T
        failed = damage[np.argsort(x)] > 0.99
        return float(np.count_nonzero(failed & ~np.roll(failed, 1)))


def case(n=6000, rate=1e5, scatter=0.05, seed=1, horizon=3.015, end=0.0, records=50):
    h = LENGTH / n
    grady = (24.0 * GC / (DENSITY * rate**2)) ** (1.0 / 3.0)
    # The number of fragments settles within 1e-7 s after the strength is reached.
    end = end or STRENGTH / (E * rate) + 2e-7
    factors = 1.0 + scatter * np.random.default_rng(seed).uniform(-1.0, 1.0, n)

    def strength(x):
        return STRENGTH * factors[np.clip((x[:, 0] / h).astype(int), 0, n - 1)]

    def results(history):
        count = history["fragments"][-1]
        size = LENGTH / max(count, 1.0)
        return {
            "fragments": float(count),
            "size": float(size),
            "size_over_grady": float(size / grady),
            "energy_error": float(np.abs(history["energy_error"]).max()),
        }

    return pd.Case(
        particles=pd.Lattice(0.0, LENGTH, h),
        horizon=horizon * h,
        cell=pd.Cell(0.0, LENGTH),
        material=pd.LinearElastic(E=E, nu=0.0, density=DENSITY),
        scheme=pd.Correspondence(),
        control=pd.Silling(1.0),
        damage=pd.PointDamage(pd.softening.Linear(), Gc=GC, strength=strength),
        conditions=[
            pd.MeanStrain(xx=rate * end),
            pd.InitialVelocity(pd.region.All(), x=lambda x, t: rate * (x[:, 0] - 0.5 * LENGTH)),
        ],
        solver=pd.Explicit(end=end, records=records),
        history={"fragments": Fragments(), "kinetic": pd.KineticEnergy(), "energy_error": pd.EnergyError()},
        fields=[pd.displacement, pd.velocity, pd.local_damage],
        checkpoints=0,
        results=results,
    )
