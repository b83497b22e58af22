"""Rubber block pulled to twice its length, its strain energy a line of text, against the closed form.

A block of 2 x 1 x 1 of Mooney's and Rivlin's rubber that hardly changes its volume, free at its sides: every point has
the same stretches ``l`` along the pull and ``b`` across, where ``b`` makes the stress across vanish. The text of the
energy is differentiated and compiled.

Results: ``force`` at the end and ``across``, the stretch across the pull, against the closed form. Units mm, N.
"""

from scipy.optimize import brentq

import pdpetsc as pd

ENERGY = "c10*(I1bar - 3) + c01*(I2bar - 3) + kappa/2*(J - 1)**2"
C10, C01, KAPPA = 0.4, 0.1, 20.0


def uniaxial(stretch):
    """Return the nominal stress along the pull and the stretch across it of a bar with free sides.

    Both are derivatives of the energy by its stretches, here by central differences of a function of two numbers.
    """

    def energy(a, b):
        J = a * b * b
        i1, i2 = a * a + 2.0 * b * b, 2.0 * (a * b) ** 2 + b**4
        return C10 * (i1 * J ** (-2 / 3) - 3.0) + C01 * (i2 * J ** (-4 / 3) - 3.0) + 0.5 * KAPPA * (J - 1.0) ** 2

    def slope(function, x, h=1e-5):
        return (function(x + h) - function(x - h)) / (2.0 * h)

    across = brentq(lambda b: slope(lambda w: energy(stretch, w), b), 0.5, 1.2, xtol=1e-14)
    return slope(lambda a: energy(a, across), stretch), across


def case(n=6, stretch=2.0, horizon=1.515, steps=8):
    dx = 1.0 / n
    # Facets act on the particles within a horizon: so deep are the layers that are pulled.
    left, right = pd.region.Slab("x", high=2.0 * dx), pd.region.Slab("x", low=2.0 - 2.0 * dx)
    near, far = 0.5 * dx, 1.0 - 0.5 * dx
    side = pd.region.Nearest((near, far, near))
    stress, across = uniaxial(stretch)
    return pd.Case(
        particles=pd.Lattice((0.0, 0.0, 0.0), (2.0, 1.0, 1.0), dx),
        horizon=horizon * dx,
        material=pd.Hyperelastic(ENERGY, c10=C10, c01=C01, kappa=KAPPA),
        # Gradients that conform to the surface leave the ends uniform, which may contract.
        scheme=pd.Correspondence(),
        control=pd.Silling(0.5),
        weights=pd.Conforming(),
        conditions=[
            pd.Displacement(left | right, x=lambda x, t: (stretch - 1.0) * t * x[:, 0]),
            pd.Displacement(pd.region.Nearest((near, near, near)), y=0.0, z=0.0),
            pd.Displacement(side, z=0.0),
        ],
        steps=pd.Steps(steps),
        history={
            "stretch": pd.Mean(pd.deformation_gradient, "xx"),
            "force": pd.Reaction("x", right),
            "across": pd.Mean(pd.displacement, "y", side),
        },
        results=lambda h: {"force": h["force"][-1], "across": 1.0 + h["across"][-1] / (far - near)},
        expect={
            "force": pd.Expected(stress, relative=1e-6, source="uniaxial stress of the same energy"),
            "across": pd.Expected(across, relative=1e-6, source="sides without stress"),
        },
        picture=pd.Picture(pd.displacement, "x"),
    )
