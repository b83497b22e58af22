"""Euler's columns with four kinds of supports: the load at which they buckle. Any consistent units.

A column of length 40 and height 1, plane stress, E = 1000, nu = 0.3, is pressed by the share ``load`` of the load at
which it buckles, so that the buckling factor should be ``1 / load``. That load is Engesser's, ``P = P_E / (1 + P_E / (k
G A))`` with Euler's ``P_E = pi^2 E I / (K L)^2`` and ``k = 5 / 6``. ``supports`` is ``free`` (clamped and free, K = 2),
``pinned`` (K = 1), ``clamped_pinned`` (K = 0.6992) or ``clamped`` (K = 1/2); ``n`` cells over the height.
"""

import numpy as np

import pdpetsc as pd

E, NU, LENGTH, HEIGHT = 1000.0, 0.3, 40.0, 1.0
# Length of the half wave over that of the column.
K = {"free": 2.0, "pinned": 1.0, "clamped_pinned": 0.69916, "clamped": 0.5}


def critical(supports):
    """Return the load at which the column buckles."""
    euler = np.pi**2 * E * HEIGHT**3 / 12.0 / (pd.choose("supports", supports, K) * LENGTH) ** 2
    return euler / (1.0 + euler / (5.0 / 6.0 * E / (2.0 + 2.0 * NU) * HEIGHT))


def case(n=8, supports="free", horizon=2.015, load=1e-3):
    stress = load * critical(supports) / HEIGHT
    left = [pd.PointSupport("-x", x=0.0, y=0.0)] if supports == "pinned" else [pd.Clamp("-x")]
    right = {
        "free": [pd.Traction("+x", x=-stress)],
        "pinned": [pd.PointSupport("+x", y=0.0), pd.Traction("+x", x=-stress)],
        "clamped_pinned": [pd.PointSupport("+x", y=0.0), pd.Traction("+x", x=-stress)],
        "clamped": [pd.Displacement("+x", x=-stress * LENGTH / E, y=0.0)],
    }[supports]
    pressed = [pd.Traction("-x", x=stress)] if supports == "pinned" else []
    return pd.Case(
        particles=pd.LatticeNodes((0.0, 0.0), (LENGTH, HEIGHT), HEIGHT / n),
        horizon=horizon * HEIGHT / n,
        material=pd.NeoHookean(E=E, nu=NU, plane="stress"),
        conditions=[*left, *pressed, *right],
        modes=pd.Modes(2, of="buckling"),
        expect={"buckling_1": pd.Expected(1.0 / load, relative=0.01, source="Engesser")},
    )
