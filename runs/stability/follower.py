"""Cantilever under a force across its end that turns with it: the elastica of a follower load. Any consistent units.

A strip of length 20 and height 0.5, plane stress, Hencky's law with E = 1000, nu = 0, clamped at its left side. A force
at the rigid right side grows to ``load`` times ``E I / L^2`` and stays across the end, which turns by almost half a
turn under the default. ``n`` cells over the height.

Elastica: with the angle ``a`` from the direction of the end at the distance s from it, ``E I a'' = -P cos a``,
``a = a' = 0`` at the end. These initial values do not depend on the rotation, so that SciPy integrates to the clamp.
The strip has shear, axial strain and large strains beside it, together below 0.5 %.

Results: ``turn``, the rotation of the end [rad]; ``move_x`` and ``move_y`` over the length; ``error``, the largest
difference of the three from the elastica at any load.
"""

import numpy as np
from scipy.integrate import solve_ivp

import pdpetsc as pd

E, LENGTH, HEIGHT = 1000.0, 20.0, 0.5
UNIT = E * HEIGHT**3 / 12.0 / LENGTH**2


def exact(load):
    """Return displacement over length and rotation of the end under a force over E I / L^2 (3,)."""

    def slopes(s, found):
        angle, curvature, _, _ = found
        return curvature, -load * np.cos(angle), -np.cos(angle), -np.sin(angle)

    angle, _, *clamp = solve_ivp(slopes, (0.0, 1.0), np.zeros(4), "DOP853", rtol=1e-11, atol=1e-12).y[:, -1]
    # From the clamp to the end, in the axes of the clamp.
    along, across = np.array([[np.cos(angle), np.sin(angle)], [-np.sin(angle), np.cos(angle)]]) @ -np.array(clamp)
    return np.array([along - 1.0, across, -angle])


def case(n=4, load=10.0, steps=20):
    def results(h):
        # The rotation without jumps by whole turns.
        turn = np.unwrap(
            np.arctan2(np.subtract(h["low_x"], h["high_x"]), np.subtract(h["high_y"], h["low_y"]) + HEIGHT)
        )
        moved = [0.5 * np.add(h[f"low_{axis}"], h[f"high_{axis}"]) / LENGTH for axis in "xy"]
        found = np.stack([*moved, turn], axis=1)
        error = np.abs(found - [exact(t * load) for t in h["t"]]).max()
        return {**dict(zip(("move_x", "move_y", "turn"), found[-1].tolist(), strict=True)), "error": float(error)}

    end = exact(load)
    corners = {"low": -0.5 * HEIGHT, "high": 0.5 * HEIGHT}
    return pd.Case(
        particles=pd.LatticeNodes((0.0, -0.5 * HEIGHT), (LENGTH, 0.5 * HEIGHT), HEIGHT / n),
        material=pd.Hencky(E=E, nu=0.0, plane="stress"),
        conditions=[
            pd.Clamp("-x"),
            pd.RigidRegion("+x", force=(0.0, load * UNIT), moment=0.0, about=(LENGTH, 0.0), follows=True),
        ],
        steps=pd.Steps(steps),
        history={
            f"{name}_{axis}": pd.Mean(pd.displacement, axis, pd.region.Nearest((LENGTH, y)))
            for name, y in corners.items()
            for axis in "xy"
        },
        results=results,
        expect={
            name: pd.Expected(float(value), absolute=0.03, source="elastica, integrated by SciPy")
            for name, value in zip(("move_x", "move_y", "turn"), end, strict=True)
        },
        picture=pd.Picture(pd.stress, "xx"),
    )
