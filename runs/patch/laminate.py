"""Periodic cell of a laminate: effective moduli along and across the layers, against the closed forms.

Half of the cell is stiff, half is soft, in layers across y, in plane stress. Pulled along x both layers have the same
strain, pulled along y the same stress, so that the moduli are those of Voigt and of Reuss, each with what the layers do
to each other across the pull; sheared they are as in a row. ``load`` is along, across or shear, the mean strain of the
cell given; ``n`` particles over its height. A family that reaches into the other layer sees a strain of neither, so
that the modulus across has an error that falls with the horizon.

Result: ``modulus``, mean stress over mean strain of the cell. Any consistent units.
"""

import numpy as np

import pdpetsc as pd

STIFF, SOFT, NU = 10.0, 1.0, 0.3


def plane_stress(E):
    """Return the stiffness (3, 3) of strains xx, yy and 2 xy."""
    k = E / (1.0 - NU**2)
    return k * np.array([[1.0, NU, 0.0], [NU, 1.0, 0.0], [0.0, 0.0, 0.5 * (1.0 - NU)]])


def laminate():
    """Return the effective stiffness (3, 3) of two layers of the same height across y.

    The layers share the strain xx and the stresses yy and xy; the other three components are means.
    """
    layers = [plane_stress(E) for E in (STIFF, SOFT)]
    shared, mixed = [0], [1, 2]
    parts = []
    for C in layers:
        A, B, D = C[np.ix_(shared, shared)], C[np.ix_(shared, mixed)], C[np.ix_(mixed, mixed)]
        inverse = np.linalg.inv(D)
        parts.append((A - B @ inverse @ B.T, B @ inverse, inverse))
    a, b, d = (np.mean([part[i] for part in parts], axis=0) for i in range(3))
    stiffness = np.linalg.inv(d)
    found = np.zeros((3, 3))
    found[np.ix_(shared, shared)] = a + b @ stiffness @ b.T
    found[np.ix_(shared, mixed)] = b @ stiffness
    found[np.ix_(mixed, shared)] = (b @ stiffness).T
    found[np.ix_(mixed, mixed)] = stiffness
    return found


def case(n=40, load="across", horizon=1.515, strain=1e-3, scheme="sub_horizons"):
    dx = 1.0 / n
    row = pd.choose("load", load, {"along": 0, "across": 1, "shear": 2})
    component = ("xx", "yy", "xy")[row]
    given = {"xx": 0.0, "yy": 0.0, "xy": 0.0} | {component: strain}
    stiff = pd.region.Slab("y", low=0.25, high=0.75)
    # The mean shear strain is the component of the tensor, half the angle.
    exact = float(laminate()[row, row]) * (2.0 if load == "shear" else 1.0)
    return pd.Case(
        particles=pd.Lattice((0.0, 0.0), (1.0, 1.0), dx),
        horizon=horizon * dx,
        material=[
            (stiff, pd.LinearElastic(E=STIFF, nu=NU, plane="stress")),
            (~stiff, pd.LinearElastic(E=SOFT, nu=NU, plane="stress")),
        ],
        scheme=pd.choose("scheme", scheme, pd.SCHEMES),
        cell=pd.Cell((0.0, 0.0), (1.0, 1.0)),
        conditions=[
            pd.Displacement(pd.region.Nearest((0.5 * dx, 0.5 * dx)), x=0.0, y=0.0),
            pd.MeanStrain(**given),
        ],
        history={"stress": pd.CellStress(component)},
        results=lambda h: {"modulus": h["stress"][-1] / strain},
        expect={"modulus": pd.Expected(exact, relative=0.05, source="laminate theory")},
        picture=pd.Picture(*((pd.stress, "xx") if load == "along" else (pd.deformation_gradient, component))),
    )
