"""Periodic cell under a mean stress or the mean strain that belongs to it: the patch test of periodicity. Units m, N.

``axes`` are the periodic directions; in the others the body has free sides. Whatever method, horizon and axes, the
deformation gradient is uniform and exact. ``prescribed=stress`` prescribes the mean stress along x, ``strain`` the mean
strain along x; what else the cell can do it does freely.
"""

from tension import NU, E, exact_gradient

import pdpetsc as pd


def case(dim=2, n=4, axes="", horizon=2.015, stress=100.0, scheme="sub_horizons", prescribed="stress", G=0.0, steps=1):
    if dim not in (1, 2, 3):
        raise pd.CaseError(f"dim is 1, 2 or 3, not {dim}.")
    high = [1.0] * dim
    F = exact_gradient(dim, stress)
    load = {"stress": pd.MeanStress(xx=stress), "strain": pd.MeanStrain(xx=F[0, 0] - 1.0)}
    corner = pd.region.Nearest([0.5 / n] * dim)
    cell = pd.Cell([0.0] * dim, high, axes or None)
    if 0 not in cell.periodic:
        raise pd.CaseError(f"The cell is pulled along x, which must be one of its axes, not {axes!r}.")
    held = [pd.Displacement(corner, **dict.fromkeys("xyz"[:dim], 0.0))]
    if dim == 3 and len(cell.periodic) == 1:
        held.append(pd.Displacement(pd.region.Nearest([0.5 / n, 1.0 - 0.5 / n, 0.5 / n]), z=0.0))
    return pd.Case(
        particles=pd.Lattice([0.0] * dim, high, 1.0 / n),
        horizon=horizon / n,
        material=pd.Hencky(E=E, nu=NU),
        scheme=pd.choose("scheme", scheme, pd.SCHEMES),
        control=pd.Silling(G) if G else None,
        cell=cell,
        conditions=[*held, pd.choose("prescribed", prescribed, load)],
        steps=pd.Steps(steps),
        history={
            "max_F_error": pd.LargestError(pd.deformation_gradient, lambda x, t: F),
            "strain": pd.CellStrain("xx"),
            "stress": pd.CellStress("xx"),
        },
        results=lambda h: {
            "max_F_error": h["max_F_error"][-1],
            "strain_error": abs(h["strain"][-1] - F[0, 0] + 1.0),
            "stress_error": abs(h["stress"][-1] / stress - 1.0),
        },
        fields=[pd.displacement, pd.deformation_gradient],
    )
