"""Clamped slender beam under uniform pressure, one half of it. Units m, N.

Result: midpoint deflection over the thickness, against Timoshenko's clamped strip with immovable ends (0.586082).
Reference: Hashim, Coombs, Augarde, Hattori, section 4.2, Table 1.
"""

import beam

import pdpetsc as pd


def case(
    ny=3, horizon=1.015, G=0.0, scheme="correspondence", steps=10, control="", G_printed=0.0, unit=beam.UNIT,
    weights="standard",
):  # fmt: skip
    held = pd.region.Named("fictitious -x")

    def supports(dx):
        middle = held & pd.region.Slab("y", -0.1 * dx, 0.1 * dx)
        return [pd.Displacement(held, x=0.0), pd.Displacement(middle, y=0.0)]

    control = beam.control_of(G, control, G_printed, unit)
    return beam.half_beam("clamped", ny, horizon, scheme, steps, supports, control, weights)
