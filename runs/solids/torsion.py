"""Square bar twisted, of as many particles as there is patience for, against Saint-Venant's torsion.

A bar of 1 x 1 x 2 on a lattice of ``n`` particles across, 2 n^3 in all, whose ends turn against each other and are free
to warp. Beyond the size of a direct solver nothing is assembled: on a lattice all families have the same bonds, and a
grid one horizon wide preconditions conjugate gradients. ``n=80`` is a million particles.

Result: ``torque`` over that of the closed form, ``mu k a^4 (1/3 - 64/pi^5 sum tanh((2 i + 1) pi / 2) / (2 i + 1)^5)``
for the twist per length k (Timoshenko and Goodier, article 109). Any consistent units.
"""

import numpy as np

import pdpetsc as pd

SIDE, LENGTH, E, NU, TWIST = 1.0, 2.0, 1.0, 0.3, 1e-3


def constant(terms=50):
    """Return torque over ``mu k a^4``, 0.1406."""
    odd = 2.0 * np.arange(terms) + 1.0
    return float(1.0 / 3.0 - 64.0 / np.pi**5 * (np.tanh(0.5 * np.pi * odd) / odd**5).sum())


def case(n=32, horizon=1.515, scheme="sub_horizons", G=0.0, layers=2):
    dx = SIDE / n
    depth = layers * dx
    low, high = pd.region.Slab("z", high=depth), pd.region.Slab("z", low=LENGTH - depth)

    def turned(axis):
        sign = (-1.0, 1.0)[axis]
        return lambda x, t: sign * t * TWIST * (x[:, 2] - 0.5 * LENGTH) * x[:, 1 - axis]

    exact = 0.5 * E / (1.0 + NU) * TWIST * SIDE**4 * constant()
    half = 0.5 * SIDE
    return pd.Case(
        particles=pd.Lattice((-half, -half, 0.0), (half, half, LENGTH), dx),
        horizon=horizon * dx,
        material=pd.LinearElastic(E=E, nu=NU),
        scheme=pd.choose("scheme", scheme, pd.SCHEMES),
        control=pd.Silling(G) if G else None,
        conditions=[
            pd.Displacement(low | high, x=turned(0), y=turned(1)),
            pd.Displacement(pd.region.Nearest((0.5 * dx, 0.5 * dx, 0.5 * LENGTH + 0.5 * dx)), z=0.0),
        ],
        history={"torque": pd.ReactionMoment(high, about=(0.0, 0.0, 0.0))},
        results=lambda h: {"torque": h["torque"][-1] / exact},
        fields=[pd.displacement, pd.stress],
        expect={"torque": pd.Expected(1.0, relative=0.05, source="Saint-Venant's torsion")},
        picture=pd.Picture(pd.stress, "yz", scale=100.0),
    )
