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


def damage_of_ratio(curve, material, Gc, ratio, horizon, dx, protected=None):
    """Return damage by a curve whose strain without stress is ``ratio`` times that at the onset.

    For a crack along an axis of a square lattice of spacing ``dx``, whose families are ``w = 2 int(horizon / dx) dx``
    wide: ``strength = sqrt(2 E Gc / (w q (1 + 2 a (ratio - 1))))``, with the area a under the curve and the share q of
    its energy that a body in uniaxial tension loses with a crack.
    """
    shape, split = pd.choose("curve", curve, CURVES), pd.split.NoTension()
    lost = 2.0 * int(horizon / dx) * dx * split.closed_part(material).open_share(2)
    strength = np.sqrt(2.0 * material.E * Gc / (lost * (1.0 + 2.0 * shape.area * (ratio - 1.0))))
    return pd.PointDamage(shape, Gc=Gc, strength=strength, split=split, protected=protected)
