"""Square plate under hydrostatic extension to 1.61334 times its size, plane strain. Units m, N.

The exact solution is homogeneous: P = 2 (lambda + mu) ln(L) / L for the stretch L. ``loading`` is ``displacement`` (the
layer of two horizons follows the exact solution: every scheme then has F exact), ``layer`` or ``consistent`` (that P on
all four sides). The load of 5000 kN/m^2 in the paper lies above the largest P of the material, 613 kN/m^2; the stretch
that it states needs 494.1 kN/m^2. ``G_printed`` is the paper's G, for which one ``unit`` of length is a metre here.
Reference: Hashim, Coombs, Augarde, Hattori, section 4.1.
"""

import math

import numpy as np

import pdpetsc as pd

STRETCH = 1.61334
E = 1.2e6
NU = 0.2


def case(n=25, horizon=1.015, G=0.0, loading="displacement", steps=4, scheme="correspondence", G_printed=0.0, unit=1.0):
    if G and G_printed:
        raise pd.CaseError("Give one of G and G_printed; each is a control of zero-energy modes.")
    if n < 5 or n % 2 == 0:
        raise pd.CaseError(f"n must be odd and at least 5, so that particles lie on the symmetry lines, not {n}.")
    dx = 1.0 / n
    lam, mu = E * NU / ((1.0 + NU) * (1.0 - 2.0 * NU)), 0.5 * E / (1.0 + NU)
    P = 2.0 * (lam + mu) * math.log(STRETCH) / STRETCH
    region = pd.region
    if loading == "displacement":
        inside = 0.5 - 2 * int(horizon) * dx
        edge = ~region.Box((-inside, -inside), (inside, inside))
        conditions = [
            pd.Displacement(
                edge, x=lambda x, t: t * (STRETCH - 1.0) * x[:, 0], y=lambda x, t: t * (STRETCH - 1.0) * x[:, 1]
            )
        ]
    elif loading in ("layer", "consistent"):
        conditions = [
            pd.Displacement(region.Slab("x", -0.1 * dx, 0.1 * dx), x=0.0),
            pd.Displacement(region.Slab("y", -0.1 * dx, 0.1 * dx), y=0.0),
        ]
        for axis, normal in (("x", (1.0, 0.0)), ("y", (0.0, 1.0))):
            for sign in (-1.0, 1.0):
                side = region.Slab(axis, low=0.5 - dx) if sign > 0.0 else region.Slab(axis, high=dx - 0.5)
                conditions.append(pd.Pressure(side, -P, [sign * c for c in normal], loading))
    else:
        raise pd.CaseError(f"loading is displacement, layer or consistent, not {loading!r}.")
    exact_F = np.eye(2) * STRETCH
    control = pd.SillingMicromodulus(G_printed, unit) if G_printed else pd.Silling(G) if G else None

    return pd.Case(
        particles=pd.Lattice((-0.5, -0.5), (0.5, 0.5), dx),
        horizon=horizon * dx,
        material=pd.Hencky(E=E, nu=NU, plane="strain"),
        scheme=pd.choose("scheme", scheme, pd.SCHEMES),
        control=control,
        conditions=conditions,
        steps=pd.Steps(steps),
        history={
            "error": pd.RelativeError(pd.displacement, lambda x, t: (STRETCH - 1.0) * x),
            "max_F_error": pd.LargestError(pd.deformation_gradient, lambda x, t: exact_F),
            "max_P_error": pd.LargestError(pd.first_piola_stress, lambda x, t: P * np.eye(2)),
        },
        results=lambda h: {
            "error": h["error"][-1],
            "max_F_error": h["max_F_error"][-1],
            "max_P_error": h["max_P_error"][-1] / P,
        },
        picture=pd.Picture(pd.stress, "xx"),
    )
