"""Dispersion of every formulation: speed of waves of the lengths that a lattice carries. Units: spacing, E, density 1.

A periodic line of 120 particles starts with the velocity ``sum_m sin(k_m x)`` of waves of 40, 20, 12, 10, 8, 6, 5, 4
and 3 spacings. Each of them is a mode of the line and oscillates with its frequency ``w(k)``, which is found from the
projections of all time steps, ``q(t + dt) + q(t - dt) = 2 cos(w_h dt) q(t)``, without their error: ``w_h dt = 2 asin(w
dt / 2)``. The phase speed is ``w / k``, 1 in a continuum, the group speed ``dw / dk`` by differences of
neighbouring wave numbers, one wave more in the line.

Bonds: ``w^2 = 2 sum_j c / xi_j (1 - cos k xi_j)`` with ``sum_j c xi_j = E``, correspondence ``w = |sum_j xi_j sin k
xi_j| / sum_j xi_j^2``; the shortest waves of correspondence run backwards: their group speed is negative.

``model``: bonds, correspondence, controlled (Silling's control), sub_horizons. ``horizon`` is in spacings.

Results: ``phase_L`` and ``group_L`` for each wave length L, and ``largest_error`` of the phase speeds of bonds and
correspondence against the sums.
"""

from dataclasses import dataclass

import numpy as np

import pdpetsc as pd

SIZE = 120
WAVES = (3, 6, 10, 12, 15, 20, 24, 30, 40)
# A time step a record, shorter than the stable one.
RECORDS, END = 400, 40.0


@dataclass(frozen=True)
class Projection(pd.Quantity):
    """Share of a wave in the displacement [length]."""

    waves: int

    def evaluate(self, solution):
        shape = np.sin(2.0 * np.pi * self.waves / SIZE * solution.x[:, 0])
        return float(solution.sum(float(shape @ solution.u[:, 0]))) * 2.0 / SIZE


def frequency(q, dt):
    """Return the circular frequency of an oscillation by time steps ``dt``, without their error."""
    cosine = float((q[2:] + q[:-2]) @ q[1:-1] / (2.0 * q[1:-1] @ q[1:-1]))
    return 2.0 / dt * np.sin(0.5 * np.arccos(np.clip(cosine, -1.0, 1.0)))


def exact(model, reach, k):
    """Return the frequency of the sums over a family; None for a model without such a sum here."""
    xi = np.arange(1, int(reach) + 1, dtype=float)
    if model == "bonds":
        return np.sqrt(2.0 * ((1.0 - np.cos(np.outer(k, xi))) / xi).sum(axis=1) * 2.0 / (2.0 * xi.sum()))
    if model == "correspondence":
        return np.abs((xi * np.sin(np.outer(k, xi))).sum(axis=1)) / (xi**2).sum()
    return None


def case(model="correspondence", horizon=3.015):
    bonds = model == "bonds"
    schemes = {
        "bonds": None,
        "correspondence": pd.Correspondence(),
        "controlled": pd.Correspondence(),
        "sub_horizons": pd.SubHorizons(),
    }
    counts = sorted({*WAVES, *(m + 1 for m in WAVES)})

    def start(x, t):
        return np.sin(2.0 * np.pi / SIZE * np.outer(x[:, 0], counts)).sum(axis=1)

    def results(history):
        step = END / RECORDS
        w = {m: frequency(np.array(history[f"q{m}"]), step) for m in counts}
        k = 2.0 * np.pi / SIZE * np.array(WAVES)
        speeds = np.array([w[m] for m in WAVES]) / k
        groups = [(w[m + 1] - w[m]) * SIZE / (2.0 * np.pi) for m in WAVES]
        names = [f"{SIZE / m:g}" for m in WAVES]
        found = {f"phase_{name}": float(speed) for name, speed in zip(names, speeds, strict=True)}
        found |= {f"group_{name}": float(speed) for name, speed in zip(names, groups, strict=True)}
        reference = exact(model, horizon, k)
        if reference is not None:
            found["largest_error"] = float(np.abs(speeds - reference / k).max())
        return found

    return pd.Case(
        particles=pd.Lattice(0.0, float(SIZE), 1.0),
        horizon=horizon,
        cell=pd.Cell(0.0, float(SIZE)),
        material=pd.BondBased(E=1.0, calibration="lattice", density=1.0)
        if bonds
        else pd.LinearElastic(E=1.0, nu=0.0, density=1.0),
        scheme=pd.choose("model", model, schemes),
        control=pd.Silling(1.0) if model == "controlled" else None,
        conditions=[pd.MeanStrain(xx=0.0), pd.InitialVelocity(pd.region.All(), x=start)],
        solver=pd.Explicit(end=END, records=RECORDS),
        history={f"q{m}": Projection(m) for m in counts} | {"energy_error": pd.EnergyError()},
        fields=[],
        checkpoints=0,
        results=results,
    )
