"""Branching of a crack in glass. Units m, N, kg, s.

A plate of 0.1 by 0.04 with a notch of 0.05 at half of its height (E = 32e9, nu = 0.2, density 2450, Gc = 3, plane
strain) is pulled at both long edges by 1 MPa from the start on (Borden 2012). In the phase field solutions that repeat
it the crack branches at 34 to 36e-6 s and stays below 0.6 of the Rayleigh speed, 1275 m/s.

``n`` particles over the height. ``model``: points (``PointDamage`` with correspondence and Silling's control; its
``strength`` is not part of the problem) or bonds (``Brittle`` bonds with the fracture energy of a plane, nu = 1/4).
With a row of particles in the notch a run is not symmetric: ``n`` is even.

Results: ``branched``, 1 or 0, ``branch_time``, at which the damaged region is first more than four horizons high,
``branch_place`` of the tip then, ``speed``, the largest mean speed over 4e-6 s before, ``speed_over_rayleigh``,
``asymmetry``, the largest difference of the damage of both halves, ``crack_energy`` over Gc times the length of the
crack before it branches, and ``energy_error``.
"""

import sys
from dataclasses import dataclass
from pathlib import Path

import numpy as np

sys.path.append(str(Path(__file__).parent))
import brittle

import pdpetsc as pd

WIDTH, HEIGHT, NOTCH, LOAD, END = 0.1, 0.04, 0.05, 1e6, 80e-6
E, NU, DENSITY, GC = 32e9, 0.2, 2450.0, 3.0
RAYLEIGH = 2125.0


@dataclass(frozen=True)
class Spread(pd.Quantity):
    """Height of the damaged region in a strip ahead of the notch, between the outermost damaged particles [length]."""

    def evaluate(self, solution):
        failed = pd.local_damage(solution) > 0.3
        y = solution.x[failed, 1]
        return solution.largest(float(y.max(initial=0.0))) + solution.largest(float((-y).max(initial=0.0)))


@dataclass(frozen=True)
class Asymmetry(pd.Quantity):
    """Difference of the damage above and below the notch over their sum [-], on one rank or several."""

    def evaluate(self, solution):
        damage = pd.local_damage(solution) * solution.volume
        above = solution.x[:, 1] > 0.0
        up, down = solution.sum([float(damage[above].sum()), float(damage[~above].sum())])
        return abs(up - down) / (up + down) if up + down > 0.0 else 0.0


def case(n=80, model="points", horizon=3.015, strength=4e6, records=80, end=END, load=LOAD):
    h = HEIGHT / n

    def results(history):
        time, tip, spread = (np.array(history[name]) for name in ("time", "tip", "spread"))
        wide = np.flatnonzero(spread > 4.0 * horizon * h)
        at = int(wide[0]) if len(wide) else len(time) - 1
        # The mean over 4e-6 s: the tip moves by whole particles.
        back = max(1, round(4e-6 / (end / records)))
        grown = tip > NOTCH
        speeds = [(tip[k] - tip[k - back]) / (time[k] - time[k - back]) for k in range(back, at + 1) if grown[k - back]]
        speed = max(speeds, default=0.0)
        return {
            "branched": float(len(wide) > 0),
            "branch_time": float(time[at]),
            "branch_place": float(tip[at]),
            "speed": float(speed),
            "speed_over_rayleigh": float(speed) / RAYLEIGH,
            "asymmetry": float(np.max(history["asymmetry"])),
            "crack_energy": float(history["dissipated"][at] / (GC * max(tip[at] - NOTCH, h))),
            "energy_error": float(np.abs(history["energy_error"]).max()),
        }

    held = pd.Hold()
    return pd.Case(
        particles=pd.Lattice((0.0, -0.5 * HEIGHT), (WIDTH, 0.5 * HEIGHT), h),
        horizon=horizon * h,
        cracks=[pd.Segment((-h, 0.0), (NOTCH, 0.0))],
        conditions=[
            pd.Traction("+y", y=load, normal=(0.0, 1.0), schedule=held),
            pd.Traction("-y", y=-load, normal=(0.0, -1.0), schedule=held),
        ],
        solver=pd.Explicit(end=end, records=records),
        history={
            "tip": pd.CrackTip((1.0, 0.0)),
            "speed": pd.CrackSpeed((1.0, 0.0)),
            "spread": Spread(),
            "asymmetry": Asymmetry(),
            "dissipated": pd.DissipatedEnergy(),
            "kinetic": pd.KineticEnergy(),
            "energy_error": pd.EnergyError(),
        },
        fields=[pd.displacement, pd.velocity, pd.local_damage],
        picture=pd.Picture(pd.local_damage, ""),
        checkpoints=0,
        results=results,
        expect={"branch_time": pd.Expected(35e-6, relative=0.06, source="phase field")}
        if (n, model) == (80, "points")
        else {},
        **brittle.parts(model, E, NU, DENSITY, GC, strength),
    )
