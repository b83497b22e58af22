"""Bar or strip of bonds, ten times as long as wide, pulled at its ends: what cut families cost. Units m, N.

``dim`` is 1 or 2 (plane stress). Material ``bond_based`` or ``linear_solid`` (``nu`` = 0.2). ``calibration`` of the
bonds is continuum, lattice or family, which corrects the surface. Results: ``stiffness_error``, of the force against
the elongation of the middle half; ``end_error``, the same for the whole bar.
"""

import pdpetsc as pd

E = 100.0
STRAIN = 0.01


def case(dim=1, n=10, horizon=3.015, material="bond_based", calibration="continuum", influence="constant"):
    if dim not in (1, 2):
        raise pd.CaseError(f"dim is 1 or 2, not {dim}.")
    length, dx = 10.0, 1.0 / n
    high = [length, 1.0][:dim]
    laws = {
        "bond_based": pd.BondBased(E=E, plane="stress", calibration=calibration),
        "linear_solid": pd.LinearSolid(E=E, nu=0.2, plane="stress"),
    }
    slab = pd.region.Slab
    left, right = slab("x", high=dx), slab("x", low=length - dx)
    held = [pd.Displacement(left, x=0.0)]
    if dim == 2:
        held.append(pd.Displacement(pd.region.Nearest((0.5 * dx, 0.5)), y=0.0))
    quarter = 0.25 * length
    gauge = [slab("x", middle - 0.5 * dx, middle + 0.5 * dx) for middle in (quarter, length - quarter)]
    span = length - 2.0 * quarter

    def results(h):
        strain = (h["right"][-1] - h["left"][-1]) / span
        return {
            "stiffness_error": h["force"][-1] / (E * strain) - 1.0,
            "end_error": h["force"][-1] / (E * h["end"][-1] / (length - dx)) - 1.0,
        }

    return pd.Case(
        particles=pd.Lattice([0.0] * dim, high, dx),
        horizon=horizon * dx,
        material=pd.choose("material", material, laws),
        influence=pd.choose("influence", influence, INFLUENCES),
        conditions=[*held, pd.Displacement(right, x=STRAIN * (length - dx))],
        history={
            "force": pd.Reaction("x", right),
            "end": pd.Mean(pd.displacement, "x", right),
            "left": pd.Mean(pd.displacement, "x", gauge[0]),
            "right": pd.Mean(pd.displacement, "x", gauge[1]),
        },
        results=results,
        picture=pd.Picture(pd.stress, "xx"),
    )


INFLUENCES = {
    "constant": pd.influence.Constant(),
    "linear": pd.influence.Linear(),
    "cubic": pd.influence.Cubic(),
    "gaussian": pd.influence.Gaussian(),
}
