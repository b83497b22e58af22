"""What the cases with damage at gradient points share: model, softening curves, a strength where only Gc is declared.

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


def damage_of_ratio(curve, material, Gc, ratio, horizon, dx, protected=None, dim=2):
    """Return damage by a curve whose strain without stress is ``ratio`` times that at the onset.

    For a crack along an axis of a square lattice of spacing ``dx``, whose families are ``w = 2 int(horizon / dx) dx``
    wide: ``strength = sqrt(2 E Gc / (w q (1 + 2 a (ratio - 1))))``, with the area a under the curve and the share q of
    its energy that a body in uniaxial tension loses with a crack.
    """
    shape, split = pd.choose("curve", curve, CURVES), pd.split.NoTension()
    lost = 2.0 * int(horizon / dx) * dx * split.closed_part(material).open_share(dim)
    strength = np.sqrt(2.0 * material.E * Gc / (lost * (1.0 + 2.0 * shape.area * (ratio - 1.0))))
    return pd.PointDamage(shape, Gc=Gc, strength=strength, split=split, protected=protected)


def body(material, damage, G):
    """Return what a case needs for a body whose gradient points fail: correspondence, control and standard weights."""
    return {
        "material": material,
        "scheme": pd.Correspondence(),
        "control": pd.Silling(G) if G else None,
        "weights": pd.Standard(),
        "damage": damage,
    }


def energies():
    """Return what the history of such a body has of energy."""
    return {
        "work": pd.ExternalWork(),
        "stored": pd.StrainEnergy(),
        "control": pd.ControlEnergy(),
        "dissipated": pd.DissipatedEnergy(),
    }
