"""Crack that runs along a stretched strip: J of the moving tip against the energy that it takes. Units m, N, kg, s.

A strip of 0.08 by 0.02 with a notch of 0.02 at half of its height (E = 32e9, nu = 0.2, density 2450, plane strain, Gc =
3). Its long edges are held along the strip and drawn apart until the strip ahead of the notch holds ``energy`` times Gc
per length: half of their way in statics, the rest in a fifth of the run. The crack accelerates while it runs. At any
speed the energy that it dissipates per length is the dynamic J, with inertia and kinetic energy in its domain, on every
contour.

``n`` particles over the height, damage at points with correspondence and Silling's control.

Results, means over the way of the tip without its first fifth and its last third: ``J_over_energy``, J over the energy
dissipated per length, ``paths``, J on the inner over that on the outer contour, ``energy_over_Gc``,
``speed_over_rayleigh``, and ``energy_error``; ``runs`` is 0 if the crack does not get there.
"""

import dataclasses
import sys
from pathlib import Path

import numpy as np

sys.path.append(str(Path(__file__).parent))
import brittle

import pdpetsc as pd

LENGTH, HEIGHT, NOTCH, END, RECORDS = 0.08, 0.02, 0.02, 80e-6, 160
E, NU, DENSITY, GC, STRENGTH = 32e9, 0.2, 2450.0, 3.0, 6e6
RAYLEIGH = 2125.0


def case(n=40, energy=1.5, horizon=3.015, strength=STRENGTH, end=END):
    h = HEIGHT / n
    modulus = E * (1.0 - NU) / ((1.0 + NU) * (1.0 - 2.0 * NU))
    opening = np.sqrt(energy * GC * HEIGHT / (2.0 * modulus))
    tip = pd.CrackTip((1.0, 0.0))
    inner, outer = 1.5 * horizon * h, 0.45 * HEIGHT
    middle = 0.5 * (inner + outer)

    def results(history):
        time, at = np.array(history["time"]), np.array(history["tip"])
        begins = np.searchsorted(at, NOTCH + 0.2 * (LENGTH - NOTCH))
        ends = np.searchsorted(at, LENGTH - 0.3 * (LENGTH - NOTCH)) - 1
        if ends <= begins + 2:
            return {"runs": 0.0}
        part = slice(begins, ends + 1)
        grown = at[ends] - at[begins]
        spent = (history["dissipated"][ends] - history["dissipated"][begins]) / grown
        # Means over the way of the tip, not over time.
        way = np.diff(at[part])
        J, inside, outside = (
            float((0.5 * (np.array(history[name])[part][1:] + np.array(history[name])[part][:-1]) @ way) / grown)
            for name in ("J", "J_inner", "J_outer")
        )
        return {
            "runs": 1.0,
            "J_over_energy": J / spent,
            "paths": inside / outside,
            "energy_over_Gc": float(spent / GC),
            "speed_over_rayleigh": float(grown / (time[ends] - time[begins])) / RAYLEIGH,
            "energy_error": float(np.abs(history["energy_error"]).max()),
        }

    parts = brittle.parts("points", E, NU, DENSITY, GC, strength)
    # The corners of the strip, where the stress is singular, are spared.
    near = pd.region.Slab("y", low=-0.2 * HEIGHT, high=0.2 * HEIGHT)
    parts["damage"] = dataclasses.replace(parts["damage"], protected=~near)
    drawn = pd.Table([0.0, 0.2, 1.0], [0.5, 1.0, 1.0])
    ahead, start = (1.0, 0.0), (NOTCH, 0.0)
    return pd.Case(
        particles=pd.Lattice((0.0, -0.5 * HEIGHT), (LENGTH, 0.5 * HEIGHT), h),
        horizon=horizon * h,
        cracks=[pd.Segment((-h, 0.0), (NOTCH, 0.0))],
        conditions=[
            pd.Displacement(pd.region.Slab("y", low=0.5 * HEIGHT - h), x=0.0, y=opening, schedule=drawn),
            pd.Displacement(pd.region.Slab("y", high=h - 0.5 * HEIGHT), x=0.0, y=-opening, schedule=drawn),
        ],
        solver=pd.Explicit(end=end, records=RECORDS, preload=True),
        history={
            "tip": tip,
            "J": pd.JIntegral(start, ahead, inner, outer, follows=tip),
            "J_inner": pd.JIntegral(start, ahead, inner, middle, follows=tip),
            "J_outer": pd.JIntegral(start, ahead, middle, outer, follows=tip),
            "dissipated": pd.DissipatedEnergy(),
            "energy_error": pd.EnergyError(),
        },
        fields=[pd.displacement, pd.velocity, pd.local_damage],
        picture=pd.Picture(pd.local_damage, ""),
        checkpoints=0,
        results=results,
        **parts,
    )
