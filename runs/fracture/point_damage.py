"""What the cases with damage at gradient points share: softening curves, and a strength where only Gc is declared.

A strength is chosen by ``ratio``, the strain without stress over that at the onset of damage.
"""

import numpy as np

import pdpetsc as pd

CURVES = {
    "linear": pd.softening.Linear(),
    "exponential": pd.softening.Exponential(),
    "bilinear": pd.softening.Bilinear(),
    "cornelissen": pd.softening.Cornelissen(),
}


def damage_of_ratio(curve, E, Gc, ratio, horizon, dx, protected=None):
    """Return damage by a curve whose strain without stress is ``ratio`` times that at the onset.

    For a crack along an axis of a square lattice of spacing ``dx``, whose families are ``w = 2 int(horizon / dx) dx``
    wide: ``strength = sqrt(2 E Gc / w / (1 + 2 a (ratio - 1)))`` with the area a under the curve.
    """
    shape = pd.choose("curve", curve, CURVES)
    width = 2.0 * int(horizon / dx) * dx
    strength = np.sqrt(2.0 * E * Gc / width / (1.0 + 2.0 * shape.area * (ratio - 1.0)))
    return pd.PointDamage(shape, Gc=Gc, strength=strength, protected=protected)
