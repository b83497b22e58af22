"""Natural frequencies of a tapered membrane: NAFEMS FV32. Units m, N, kg.

A plate of length 10 that tapers from a height of 5, where it is clamped, to 1 at its free end, in plane stress: E =
200e9, nu = 0.3, density 8000. The particles are the nodes of quadrilaterals, ``n`` over the height. The frequencies do
not depend on the thickness, which is 1 here and 0.05 in the source.
"""

import numpy as np
import strips

import pdpetsc as pd

# [Hz]
REFERENCE = (44.623, 130.03, 162.70, 246.05, 379.90, 391.44)
LENGTH, ROOT, TIP = 10.0, 5.0, 1.0


def particles(n):
    """Return the nodes of quadrilaterals that are nearly square: their size follows the height."""
    m = round(n * LENGTH / (ROOT - TIP) * np.log(ROOT / TIP))
    height = ROOT * (TIP / ROOT) ** (np.arange(m + 1) / m)
    x, share = np.meshgrid(LENGTH * (ROOT - height) / (ROOT - TIP), np.linspace(-0.5, 0.5, n + 1), indexing="ij")
    return strips.particles(x, share * height[:, None])


def case(n=12, horizon=2.015, scheme="sub_horizons"):
    known = {"sub_horizons": pd.SubHorizons, "correspondence": pd.Correspondence}
    return pd.Case(
        particles=particles(n),
        # The dual cells of nodes on the surface are halves and quarters, so that the spacing is that of the mesh.
        horizon=lambda x: horizon / n * (ROOT + (TIP - ROOT) / LENGTH * x[:, 0]),
        scheme=pd.choose("scheme", scheme, known)(),
        control=None if scheme == "sub_horizons" else pd.Silling(0.5),
        material=pd.LinearElastic(E=200e9, nu=0.3, plane="stress", density=8000.0),
        conditions=[pd.Displacement(pd.region.Slab("x", high=1e-6), x=0.0, y=0.0)],
        modes=pd.Modes(len(REFERENCE)),
        expect={
            f"frequency_{number}": pd.Expected(f, relative=0.01, source="NAFEMS FV32")
            for number, f in enumerate(REFERENCE, 1)
        },
    )
