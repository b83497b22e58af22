"""What the concrete cases share: bonds that soften as concrete does, and their results."""

import numpy as np

import pdpetsc as pd


def bilinear(E, strength, Gf, horizon, protected=None):
    """Return bonds that begin to soften at the strength under uniaxial stress and take ``Gf`` over a unit area.

    The force falls to a third at 0.8 / 3.6 of the last stretch, as the stress does with the opening of a crack
    (Petersson). With constant influence in plane stress bonds that snap at the stretch s take 9 E s^2 horizon / (4 pi).
    """
    critical = strength / E
    energy = Gf / (9.0 * E * critical**2 * horizon / (4.0 * np.pi))
    share, kink = 1.0 / 3.0, 0.8 / 3.6
    ratio = 1.0 + (energy - 1.0) / (kink + share)
    return pd.BilinearSoftening(
        pd.ConstantCritical(critical), 1.0 + kink * (ratio - 1.0), share, ratio, protected=protected
    )


def at_peak(factors, load):
    """Return results of a run whose conditions hold ``load`` at factor 1, and the step of its peak."""
    peak = int(np.argmax(factors))
    return {"peak_load": factors[peak] * load, "last_load": factors[-1] / factors[peak]}, peak
