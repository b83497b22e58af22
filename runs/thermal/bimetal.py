"""Bimetal strip that is heated, against Timoshenko's curvature. Units mm, N, K.

Two layers with different moduli and coefficients of expansion, in plane stress and free at their ends. The curvature is
that of the parabola through the rows beside the middle half of the interface; ``law`` is linear or at finite strain.
"""

import numpy as np

import pdpetsc as pd

LOWER, UPPER = (200e3, 12e-6), (70e3, 24e-6)
NU = 0.3
LAWS = {"linear": pd.LinearElastic, "neo_hookean": pd.NeoHookean, "hencky": pd.Hencky}


def curvature(height, share, rise):
    """Return Timoshenko's curvature of two layers, the lower one ``share`` of the height [1 / mm]."""
    (E1, a1), (E2, a2) = LOWER, UPPER
    m, n = share / (1.0 - share), E1 / E2
    bracket = 3.0 * (1.0 + m) ** 2 + (1.0 + m * n) * (m**2 + 1.0 / (m * n))
    return 6.0 * (a2 - a1) * rise * (1.0 + m) ** 2 / (height * bracket)


def case(
    length=40.0, height=2.0, share=0.5, ny=16, horizon=2.015, rise=100.0, law="linear", scheme="sub_horizons", G=0.0,
    steps=1,
):  # fmt: skip
    dx = height / ny
    middle = share * height
    lower = pd.region.Slab("y", high=middle)
    thermal = [(lower, LOWER), (~lower, UPPER)]
    materials = [
        (region, pd.Thermal(LAWS[law](E=E, nu=NU, plane="stress"), expansion=alpha, reference=20.0))
        for region, (E, alpha) in thermal
    ]
    half = 0.5 * length
    held = (0.5 * dx * (round(length / dx) % 2), middle - 0.5 * dx)
    along = (held[0] + round(0.25 * length / dx) * dx, held[1])
    expected = curvature(height, share, rise)

    def along_interface(solution, of):
        x, u = solution.x, solution.u
        mine = (np.abs(x[:, 1] - middle) < 0.75 * dx) & (np.abs(x[:, 0]) < 0.25 * length)
        y = u[mine, 1]
        s = x[mine, 0] + u[mine, 0]
        return of(s, y)

    class Curvature(pd.Quantity):
        """The curvature of the middle half of the interface [1 / mm]."""

        def evaluate(self, solution):
            powers = along_interface(solution, lambda s, y: [
                len(s), s.sum(), (s**2).sum(), (s**3).sum(), (s**4).sum(), y.sum(), (s * y).sum(), (s**2 * y).sum(),
            ])  # fmt: skip
            n, s1, s2, s3, s4, y0, y1, y2 = solution.sum(powers)
            _, slope, second = np.linalg.solve([[n, s1, s2], [s1, s2, s3], [s2, s3, s4]], [y0, y1, y2])
            return float(2.0 * second / (1.0 + slope**2) ** 1.5)

    return pd.Case(
        particles=pd.Lattice((-half, 0.0), (half, height), dx),
        horizon=horizon * dx,
        material=materials,
        scheme={"sub_horizons": pd.SubHorizons(), "correspondence": pd.Correspondence()}[scheme],
        control=pd.Silling(G) if G else None,
        conditions=[
            pd.Displacement(pd.region.Nearest(held), x=0.0, y=0.0),
            pd.Displacement(pd.region.Nearest(along), y=0.0),
            pd.Temperature(pd.region.All(), 20.0 + rise),
        ],
        steps=pd.Steps(steps),
        history={"curvature": Curvature(), "control": pd.ControlEnergy(), "strain": pd.StrainEnergy()},
        results=lambda history: {
            "curvature": history["curvature"][-1],
            "curvature_exact": -expected,
            "curvature_over_exact": -history["curvature"][-1] / expected,
            "control_share": history["control"][-1] / history["strain"][-1],
        },
        expect={"curvature": pd.Expected(-expected, relative=0.03, source="Timoshenko 1925, bimetal strips")},
        fields=[pd.displacement, pd.stress, pd.temperature],
        picture=pd.Picture(pd.stress, "xx", scale=10.0),
    )
