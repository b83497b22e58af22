"""Wave in a bar: speed of its front. Units m, N, kg, s.

A bar of 0.2 by 0.002 by 0.002 (E = 210e9, nu = 0.25, density 7850), ``n`` particles over its width, horizon 3.015
spacings. The particles within 1.2 spacings of its end move with ``v = 2 sin(2 pi t / 1e-5)`` for 1e-5 s. The front is
the furthest particle that has moved by 2 % of the largest displacement; its speed between 1.5e-5 and 3e-5 s is that of
a straight line, against ``sqrt(E / rho) = 5172``. The case is the test wave_in_bar of Peridynamics.jl, whose band is
25 %. The pulse is as long as 25 widths of the bar, so that the bar bends its waves little.

Results: ``speed``, ``speed_over_exact``, ``energy_error``.
"""

from dataclasses import dataclass

import numpy as np

import pdpetsc as pd

LENGTH, SIDE, E, NU, DENSITY = 0.2, 0.002, 210e9, 0.25, 7850.0
PULSE, PEAK, END = 1e-5, 2.0, 4e-5
EXACT = np.sqrt(E / DENSITY)


@dataclass(frozen=True)
class Front(pd.Quantity):
    """Position of the furthest particle that has moved by 2 % of the largest displacement [length]."""

    def evaluate(self, solution):
        size = np.abs(solution.u[:, 0])
        most = solution.largest(float(size.max(initial=0.0)))
        return solution.largest(float(solution.x[size > 0.02 * most, 0].max(initial=0.0))) if most > 0.0 else 0.0


def moved(x, t):
    """Return the displacement of the driven end at step time t."""
    time = min(t * END, PULSE)
    return np.full(len(x), PEAK * PULSE / (2.0 * np.pi) * (1.0 - np.cos(2.0 * np.pi * time / PULSE)))


def case(n=5, material="solid", records=80):
    h = SIDE / n
    bonds = pd.choose("material", material, {"bonds": True, "solid": False})
    law = pd.BondBased(E=E, density=DENSITY) if bonds else pd.LinearElastic(E=E, nu=NU, density=DENSITY)

    def results(history):
        time, front = np.array(history["time"]), np.array(history["front"])
        within = (time > 1.5e-5) & (time < 3e-5)
        speed = float(np.polyfit(time[within], front[within], 1)[0])
        return {
            "speed": speed,
            "speed_over_exact": speed / EXACT,
            "energy_error": float(np.abs(history["energy_error"]).max()),
        }

    return pd.Case(
        particles=pd.Lattice((0.0, 0.0, 0.0), (LENGTH, SIDE, SIDE), h),
        horizon=3.015 * h,
        material=law,
        scheme=None if bonds else pd.Correspondence(),
        control=None if bonds else pd.Silling(1.0),
        conditions=[pd.Displacement(pd.region.Slab("x", high=1.2 * h), x=moved)],
        solver=pd.Explicit(end=END, records=records),
        history={"front": Front(), "energy_error": pd.EnergyError()},
        fields=[pd.displacement, pd.velocity],
        checkpoints=0,
        results=results,
    )
