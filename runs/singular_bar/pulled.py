"""Bar whose modulus vanishes at its middle, one end fixed, the other pulled by a traction. Units m, N.

Results: ``error``, the mean relative error of the displacement; ``sawtooth``, the largest second difference over the
exact end displacement between x = 0.1 and 0.4, where the exact displacement is linear; ``sawtooth_right`` the same of
the displacement minus the exact one between 0.6 and 0.9; ``end``, the displacement of the last particle over the exact
one. The first of n particles is held and the last one carries the traction, whatever the horizon.
Reference: Chowdhury, Roy, Roy, Reddy, section 5.1, Eq. (41)-(43), figures 2 to 6.
"""

from singular import Bar, measures, scheme_of

import pdpetsc as pd

TRACTION = 1e4
E0 = 1e7
# The paper's modulus E0 alpha / (alpha + 0.01 / (2 sqrt(x - L/2))), alpha = 0.001, under a stress of E0 alpha.
BAR = Bar(alpha=TRACTION / E0, beta=0.01, E0=E0)


def case(n=4000, horizon=5.1, scheme="correspondence", order=0, sectors=0, control="none"):
    if n < 20:
        raise pd.CaseError(f"The bar needs n >= 20 particles, not {n}.")
    dx = 1.0 / n
    history, results = measures(BAR)
    last = pd.region.Slab("x", low=1.0 - 0.9 * dx)
    return pd.Case(
        particles=pd.Lattice((0.0,), (1.0,), dx),
        horizon=horizon * dx,
        material=BAR.material(),
        scheme=scheme_of(scheme, order, sectors),
        control=pd.choose("control", control, pd.CONTROLS),
        conditions=[
            pd.Displacement(pd.region.Slab("x", high=0.9 * dx), x=0.0),
            pd.Traction(last, x=TRACTION, normal=(1.0,)),
        ],
        history=history | {"end": pd.At((1.0 - 0.5 * dx,), pd.displacement, "x")},
        results=lambda found: results(found) | {"end": found["end"][-1] / BAR.end},
        fields=[pd.displacement, pd.deformation_gradient],
        picture=pd.Picture(pd.displacement, "x"),
    )
