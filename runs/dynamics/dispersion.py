"""Dispersion of every formulation: speed of waves of the lengths that a lattice carries. Units: spacing, E, density 1.

A periodic line of 120 particles starts with the velocity ``sum_m sin(k_m x)`` of waves of 40, 20, 12, 10, 8, 6, 5, 4
and 3 spacings. Each of them is a mode of the line and oscillates with its frequency ``w(k)``, which is found from the
projections of all time steps, ``q(t + dt) + q(t - dt) = 2 cos(w_h dt) q(t)``, without their error: ``w_h dt = 2 asin(w
dt / 2)``. The phase speed is ``w / k`` over that of a continuum, the group speed ``dw / dk`` by differences of
neighbouring wave numbers, one wave more in the line, over the same speed.

With ``dim=2`` and ``dim=3`` the line is a lattice that repeats across the waves, with nu = 0.25, in plane strain for
``dim=2``. ``wave`` is P for a wave of compression, S for one of shear.

For the component x of bonds along the wave and n_a along its motion, bonds have ``w^2 = 2 sum_j c / |xi_j| n_a^2 (1 -
cos k x_j)`` and correspondence ``w = v |sum_j x_j sin k x_j| / sum_j x_j^2`` with the speed v of the continuum. The
shortest waves of correspondence run backwards: their group speed is negative.

``model``: bonds, correspondence, controlled (Silling's control), sub_horizons. ``horizon`` is in spacings.

Results: ``phase_L`` and ``group_L`` for each wave length L, and ``largest_error`` of the phase speeds of bonds, over
that of the longest wave, and of correspondence against the sums.
"""

import itertools
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
    axis: int

    def evaluate(self, solution):
        shape = np.sin(2.0 * np.pi * self.waves / SIZE * solution.x[:, 0])
        amount, size = (solution.sum(float(shape @ other)) for other in (solution.u[:, self.axis], shape))
        return float(amount) / float(size)


def frequency(q, dt):
    """Return the circular frequency of an oscillation by time steps ``dt``, without their error."""
    cosine = float((q[2:] + q[:-2]) @ q[1:-1] / (2.0 * q[1:-1] @ q[1:-1]))
    return 2.0 / dt * np.sin(0.5 * np.arccos(np.clip(cosine, -1.0, 1.0)))


def exact(model, reach, k, dim, wave):
    """Return the phase speed of the sums over a family, over that of waves as long as possible; None without a sum.

    Long waves of bonds have the speed of the sum of ``c |xi| n_a^2 n_x^2``.
    """
    steps = range(-int(reach), int(reach) + 1)
    xi = np.array(
        [one for one in itertools.product(steps, repeat=dim) if 0 < np.hypot.reduce(one) <= reach], dtype=float
    )
    length, phases = np.linalg.norm(xi, axis=1), np.outer(k, xi[:, 0])
    if model == "bonds":
        each = (xi[:, 0 if wave == "P" else 1] / length) ** 2 / length
        return np.sqrt(2.0 * ((1.0 - np.cos(phases)) @ each) / (k**2 * (xi[:, 0] ** 2 @ each)))
    if model == "correspondence":
        return np.abs(np.sin(phases) @ xi[:, 0]) / (xi[:, 0] ** 2).sum() / k
    return None


def case(model="correspondence", horizon=3.015, dim=1, wave="P"):
    bonds = model == "bonds"
    schemes = {
        "bonds": None,
        "correspondence": pd.Correspondence(),
        "controlled": pd.Correspondence(),
        "sub_horizons": pd.SubHorizons(),
    }
    counts = sorted({*WAVES, *(m + 1 for m in WAVES)})

    wide = 2.0 * np.ceil(horizon)
    box = (SIZE, *[wide] * (dim - 1))
    nu = 0.25 if dim > 1 else 0.0
    moved = pd.choose("wave", wave, {"P": "x", "S": "y"})
    speed = np.sqrt((1.0 - nu) / ((1.0 + nu) * (1.0 - 2.0 * nu)) if wave == "P" else 0.5 / (1.0 + nu))

    def start(x, t):
        return np.sin(2.0 * np.pi / SIZE * np.outer(x[:, 0], counts)).sum(axis=1)

    def results(history):
        step = END / RECORDS
        w = {m: frequency(np.array(history[f"q{m}"]), step) for m in counts}
        k = 2.0 * np.pi / SIZE * np.array(WAVES)
        speeds = np.array([w[m] for m in WAVES]) / (k * speed)
        groups = [(w[m + 1] - w[m]) * SIZE / (2.0 * np.pi * speed) for m in WAVES]
        names = [f"{SIZE / m:g}" for m in WAVES]
        found = {f"phase_{name}": float(speed) for name, speed in zip(names, speeds, strict=True)}
        found |= {f"group_{name}": float(speed) for name, speed in zip(names, groups, strict=True)}
        reference = exact(model, horizon, k, dim, wave)
        if reference is not None:
            # The modulus of bonds is right in the mean over directions: compare speeds with that of the longest wave.
            ratio = speeds[0] / reference[0] if model == "bonds" else 1.0
            found["largest_error"] = float(np.abs(speeds - ratio * reference).max())
        return found

    strains = {a + b: 0.0 for a, b in itertools.combinations_with_replacement("xyz"[:dim], 2)}
    return pd.Case(
        particles=pd.Lattice((0.0,) * dim, box, 1.0),
        horizon=horizon,
        cell=pd.Cell((0.0,) * dim, box),
        material=pd.BondBased(E=1.0, calibration="lattice", density=1.0)
        if bonds
        else pd.LinearElastic(E=1.0, nu=nu, density=1.0),
        scheme=pd.choose("model", model, schemes),
        control=pd.Silling(1.0) if model == "controlled" else None,
        conditions=[pd.MeanStrain(**strains), pd.InitialVelocity(pd.region.All(), **{moved: start})],
        solver=pd.Explicit(end=END, records=RECORDS),
        history={f"q{m}": Projection(m, "xyz".index(moved)) for m in counts} | {"energy_error": pd.EnergyError()},
        fields=[],
        checkpoints=0,
        results=results,
    )
