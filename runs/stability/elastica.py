"""Column far beyond the load at which it buckles: the elastica. Any consistent units.

A column of length 40 and height 1, plane stress, E = 1000, nu = 0.3, clamped at one end, under a dead load that presses
its free end and grows to ``load`` times Euler's, ``P_E = pi^2 E I / (2 L)^2``. A transverse dead load of
``imperfection`` times it decides to which side it bends. Without it, ``imperfection=0``, the solver switches from the
straight to the bent column (``pd.Steps(unstable="switch")``). ``n`` cells over the height.

Elastica (Euler 1744; Timoshenko and Gere, section 2.7): with the rotation a of the free end
``P / P_E = (2 K(sin(a / 2)) / pi)^2``: 1.015, 1.063 and 1.152 at 20, 40 and 60 degrees.

Results: ``load_20``, ``load_40`` and ``load_60``, loads over Euler's at these rotations; ``error``, the largest
difference from the elastica, relative.
"""

import numpy as np
from scipy.special import ellipk

import pdpetsc as pd

E, NU, LENGTH, HEIGHT = 1000.0, 0.3, 40.0, 1.0
EULER = np.pi**2 * E * HEIGHT**3 / 12.0 / (2.0 * LENGTH) ** 2
ANGLES = (20, 40, 60)


def exact(degrees):
    """Return the load over Euler's at a rotation of the free end."""
    return float((2.0 / np.pi * ellipk(np.sin(0.5 * np.radians(degrees)) ** 2)) ** 2)


def case(n=6, load=1.17, imperfection=2e-4, steps=20, horizon=2.015):
    # Coarse steps up to 0.95 of Euler's load, then equal ones.
    times = np.array([0.6, 0.85, *np.linspace(0.95, load, steps)]) / load
    times[-1] = 1.0
    force = load * EULER / HEIGHT

    def results(h):
        across = [HEIGHT + np.array(h["high_y"]) - np.array(h["low_y"]), np.array(h["low_x"]) - np.array(h["high_x"])]
        angle, factor = np.abs(np.arctan2(across[1], across[0])), load * np.array(h["t"])
        # The load is nearly linear in the square of the rotation.
        found = {at: float(np.interp(np.radians(at) ** 2, angle**2, factor)) for at in ANGLES}
        return {
            **{f"load_{at}": found[at] for at in ANGLES},
            "error": max(abs(found[at] / exact(at) - 1.0) for at in ANGLES),
        }

    high, low = pd.region.Nearest((LENGTH, HEIGHT)), pd.region.Nearest((LENGTH, 0.0))
    return pd.Case(
        particles=pd.LatticeNodes((0.0, 0.0), (LENGTH, HEIGHT), HEIGHT / n),
        horizon=horizon * HEIGHT / n,
        material=pd.NeoHookean(E=E, nu=NU, plane="stress"),
        conditions=[pd.Clamp("-x"), pd.Traction("+x", x=-force, y=imperfection * force)],
        steps=pd.Steps(times=tuple(times), unstable="warn" if imperfection else "switch"),
        history={
            f"{name}_{axis}": pd.Mean(pd.displacement, axis, region)
            for name, region in (("high", high), ("low", low))
            for axis in "xy"
        },
        results=results,
        expect={
            f"load_{at}": pd.Expected(exact(at), relative=0.01, source="Timoshenko and Gere, elastica") for at in ANGLES
        },
        picture=pd.Picture(pd.stress, "xx"),
    )
