"""Bar whose modulus vanishes at its middle, both ends displaced: what each method does to the zero-energy mode.

On the left half the exact displacement is linear, so every second difference there is an oscillation. Results:
``error``, the mean relative error of the displacement; ``sawtooth``, the largest second difference over the end
displacement between x = 0.1 and 0.4; ``sawtooth_right`` the same of the displacement minus the exact one between 0.6
and 0.9. The first particle is held and the last one displaced, whatever the horizon. ``spring``, ``average`` and
``penalty`` are constants as the papers print them, for sums without the volume of the neighbours: 0.8, 1.28, 2, 3 (C1)
and 60, 150, 500, 1750 (C2) for n = 100, 200, 500, 1000 at horizon dx.
Reference: Luo, Sundararaghavan, section 5.1, Eq. (18)-(20), Table 1, figure 7.
"""

from singular import Bar, measures, scheme_of

import pdpetsc as pd

BAR = Bar(alpha=0.001, beta=0.004 * 2.0**0.5, E0=1.0)


def case(
    n=500,
    horizon=1.015,
    scheme="correspondence",
    order=0,
    sectors=0,
    control="none",
    spring=0.0,
    average=0.0,
    penalty=0.0,
):
    if n < 20:
        raise pd.CaseError(f"The bar needs n >= 20 particles, not {n}.")
    dx = 1.0 / (n - 1)
    printed = {pd.Springs: spring, pd.AveragedDisplacement: average, pd.Penalty: penalty}
    chosen = [kind(constant / dx) for kind, constant in printed.items() if constant]
    if len(chosen) + (control != "none") > 1:
        raise pd.CaseError("The bar takes one of control, spring, average and penalty.")
    history, results = measures(BAR)
    return pd.Case(
        particles=pd.Lattice((-0.5 * dx,), (1.0 + 0.5 * dx,), dx),
        horizon=horizon * dx,
        material=BAR.material(),
        scheme=scheme_of(scheme, order, sectors),
        control=chosen[0] if chosen else pd.choose("control", control, pd.CONTROLS),
        conditions=[
            pd.Displacement(pd.region.Slab("x", high=0.5 * dx), x=0.0),
            pd.Displacement(pd.region.Slab("x", low=1.0 - 0.5 * dx), x=BAR.end),
        ],
        history=history,
        results=results,
        fields=[pd.displacement, pd.deformation_gradient],
        picture=pd.Picture(pd.displacement, "x"),
    )
