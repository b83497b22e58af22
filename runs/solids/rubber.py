"""Rubber pulled along one axis or two, with Ogden's constants for Treloar's tests.

A periodic cell of a block (``dim=3``), a sheet in plane stress (``dim=2``) or a bar (``dim=1``) is stretched along x,
or with ``test=equibiaxial`` along x and y, without stress along the other axes. ``error`` is the largest relative
difference of the nominal stress from that of the incompressible law over all steps,
``sum_p mu_p (l^(alpha_p - 1) - l^(-alpha_p / 2 - 1))``, for two axes ``l^(-2 alpha_p - 1)``; it falls as ``1 / kappa``.
Units mm, N.
"""

import numpy as np

import pdpetsc as pd

# Ogden1972, three terms.
MU, ALPHA = (0.63, 0.0012, -0.01), (1.3, 5.0, -2.0)


def incompressible(stretch, test):
    """Return the nominal stress along the pull."""
    lateral = -2.0 * np.array(ALPHA) - 1.0 if test == "equibiaxial" else -0.5 * np.array(ALPHA) - 1.0
    return float(np.dot(MU, stretch ** (np.array(ALPHA) - 1.0) - stretch**lateral))


def case(dim=2, test="uniaxial", end=5.0, kappa=1000.0, steps=40, n=4, G=0.5):
    if dim not in (1, 2, 3) or test not in ("uniaxial", "equibiaxial") or (dim == 1 and test == "equibiaxial"):
        raise pd.CaseError(
            f"A rubber has dim 1, 2 or 3 and test uniaxial or equibiaxial in 2 or 3, not {dim}, {test!r}."
        )
    cell = pd.Cell([0.0] * dim, [float(n)] * dim)
    pulled = {"xx": end - 1.0} | ({"yy": end - 1.0} if test == "equibiaxial" else {})
    held = pd.Displacement(pd.region.Nearest([0.5] * dim), **dict.fromkeys("xyz"[:dim], 0.0))
    return pd.Case(
        particles=pd.Lattice([0.0] * dim, [float(n)] * dim, 1.0),
        horizon=1.515,
        material=pd.Ogden(MU, ALPHA, kappa, plane="stress"),
        control=pd.Silling(G),
        cell=cell,
        conditions=[held, pd.MeanStrain(**pulled)],
        steps=pd.Steps(steps),
        history={"strain": pd.CellStrain("xx"), "stress": pd.CellStress("xx")},
        results=lambda h: results(h, test),
    )


def results(h, test):
    """Return the largest relative error of the stress after the undeformed state, and the stress at the end."""
    steps = [(1.0 + strain, stress) for strain, stress in zip(h["strain"], h["stress"], strict=True) if strain > 0.0]
    exact = [incompressible(stretch, test) for stretch, _ in steps]
    worst = max(abs(stress / value - 1.0) for (_, stress), value in zip(steps, exact, strict=True))
    return {"stress": steps[-1][1], "incompressible": exact[-1], "error": worst}
