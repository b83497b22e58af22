"""Cantilever rolled to a full circle by its end: the end moment. Any consistent units.

A strip of length 20 and height 0.5, plane stress, Hencky's law with E = 1000, nu = 0, clamped at its left side. Its
right side moves as the end of a beam of constant curvature ``k = 2 pi t / L``: it turns by ``k L``, its middle lies at
``(sin(k L), 1 - cos(k L)) / k``. The exact moment is ``int E log(1 + k y) / (1 + k y) y dy``, 0.7 % above ``E I k``.
``n`` cells over the height.

Results: ``moment_over_exact`` and ``force``, the end force over ``M / L``.
"""

import numpy as np
from scipy.integrate import quad

import pdpetsc as pd

E, LENGTH, HEIGHT = 1000.0, 20.0, 0.5
CURVATURE = 2.0 * np.pi / LENGTH
EXACT = quad(lambda y: E * np.log1p(CURVATURE * y) / (1.0 + CURVATURE * y) * y, -0.5 * HEIGHT, 0.5 * HEIGHT)[0]


class Rolled(pd.RigidRegion):
    """Moves a side as the end of a beam that is bent to a circle at t = 1."""

    def motion(self, t, dim):
        angle = 2.0 * np.pi * t
        R = np.array([[np.cos(angle), -np.sin(angle)], [np.sin(angle), np.cos(angle)]])
        end = np.array([np.sin(angle), 1.0 - np.cos(angle)]) * LENGTH / angle if angle else np.array([LENGTH, 0.0])
        return R, end - (LENGTH, 0.0)


def case(n=4, steps=20):
    def results(h):
        force = np.hypot(h["x"][-1], h["y"][-1])
        return {"moment_over_exact": h["moment"][-1] / EXACT, "force": force * LENGTH / EXACT}

    return pd.Case(
        particles=pd.LatticeNodes((0.0, -0.5 * HEIGHT), (LENGTH, 0.5 * HEIGHT), HEIGHT / n),
        material=pd.Hencky(E=E, nu=0.0, plane="stress"),
        conditions=[pd.Clamp("-x"), Rolled("+x", turn=2.0 * np.pi, about=(LENGTH, 0.0))],
        steps=pd.Steps(steps),
        history={
            "moment": pd.ReactionMoment("+x", about=(0.0, 0.0)),
            "x": pd.Reaction("x", "+x"),
            "y": pd.Reaction("y", "+x"),
        },
        results=results,
        expect={"moment_over_exact": pd.Expected(1.0, absolute=0.02, source="integral over the height")},
        picture=pd.Picture(pd.stress, "xx"),
    )
