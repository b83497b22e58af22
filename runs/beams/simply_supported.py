"""Simply supported slender beam under uniform pressure, one half of it. Units m, N.

The pin holds the one fictitious particle at mid-height next to the body. Result: midpoint deflection over the
thickness, against Timoshenko's hinged strip with immovable ends. A pin on one particle is a point support: its
indentation grows with the logarithm of ny, so the result does not converge to the strip, which has none.
Reference: Hashim, Coombs, Augarde, Hattori, section 4.3.
"""

import beam

import pdpetsc as pd


def case(ny=3, horizon=1.015, G=0.0, scheme="correspondence", steps=10, control="", G_printed=0.0, unit=beam.UNIT):
    def supports(dx):
        return [pd.Displacement(pd.region.Nearest((-0.5 * dx, 0.0)), x=0.0, y=0.0)]

    control = beam.control_of(G, control, G_printed, unit)
    return beam.half_beam("hinged", ny, horizon, scheme, steps, supports, control)
