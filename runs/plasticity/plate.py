"""Quarter of an elastic-plastic plate with a square opening, pulled in one direction, plane strain. Units mm, N.

100 x 100 mm, opening 20 x 20 mm, pulled by 1 % at the top. Results: ``force`` on the pulled edge, largest
``plastic_strain``, and ``oscillation``, the largest second difference of sigma_yy along the x axis over its largest
value, three particles from the ends. The plate of Yaghoobi and Chorzepa's abstract, whose dimensions are not at hand.
"""

from dataclasses import dataclass

import numpy as np

import pdpetsc as pd

SIZE = 100.0
OPENING = 20.0
PULL = 0.01 * SIZE
ENDS = 3


@dataclass(frozen=True)
class Roughness(pd.Quantity):
    """Largest second difference of sigma_yy along the x axis over its largest value [-]."""

    spacing: float

    def evaluate(self, solution):
        on_axis = np.abs(solution.x[:, 1]) < 0.1 * self.spacing
        stress = pd.stress(solution)[on_axis, 1, 1]
        parts = solution.cloud.comm.allgather((solution.x[on_axis, 0], stress))
        x, stress = (np.concatenate(column) for column in zip(*parts, strict=True))
        stress = stress[np.argsort(x)]
        size = np.abs(stress).max()
        return float(np.abs(np.diff(stress, 2))[ENDS:-ENDS].max() / size) if size > 0.0 else 0.0


@dataclass(frozen=True)
class Largest(pd.Quantity):
    """Largest plastic strain of all particles [-]."""

    def evaluate(self, solution):
        return solution.largest(float(pd.plastic_strain(solution).max(initial=0.0)))


def case(dx=4.0, horizon=1.015, scheme="sub_horizons", control="none", steps=10):
    region = pd.region
    edge = SIZE + 0.5 * dx
    inside = OPENING - 0.5 * dx
    top = region.Slab("y", low=SIZE - 0.1 * dx)
    return pd.Case(
        particles=pd.Lattice((-0.5 * dx, -0.5 * dx), (edge, edge), dx, cut=region.Box((-dx, -dx), (inside, inside))),
        horizon=horizon * dx,
        material=pd.J2(E=200e3, nu=0.3, yield_stress=400.0, hardening=2e3),
        scheme=pd.choose("scheme", scheme, pd.SCHEMES),
        stabilisation=pd.choose("control", control, pd.CONTROLS),
        conditions=[
            pd.Displacement(region.Slab("x", high=0.1 * dx), x=0.0),
            pd.Displacement(region.Slab("y", high=0.1 * dx), y=0.0),
            pd.Displacement(top, y=PULL),
        ],
        steps=pd.Steps(steps),
        history={"force": pd.Reaction("y", top), "plastic_strain": Largest(), "oscillation": Roughness(dx)},
        results=lambda h: {name: h[name][-1] for name in ("force", "plastic_strain", "oscillation")},
        fields=[pd.displacement, pd.stress, pd.plastic_strain],
        picture=pd.Picture(pd.plastic_strain, ""),
    )
