"""Half cylinder pressed on a rigid plane: Hertz's line contact. Units m, N.

"""

import sys
from pathlib import Path

import numpy as np

sys.path.append(str(Path(__file__).parent))
import graded

import pdpetsc as pd

E, NU, RADIUS = 1e6, 0.3, 3.0
MODULUS = E / (1.0 - NU**2)
AT = (0.0117, 0.0211, 0.0286, 0.0346, 0.0394, 0.0433, 0.0464)
PRESSURES = (8991.5, 8441.5, 7692.6, 6833.9, 5909.6, 4945.6, 3737.9)


def on_circle(x):
    return np.abs(np.hypot(x[:, 0], x[:, 1] - RADIUS) - RADIUS) < 1e-9


def case(n=24, load=0.002, friction=0.0, core=0.08, horizon=2.015, scheme="sub_horizons", weights="conforming", G=0.0, stiff=10.0,
    penetration=1e-3, top_x=False):
    cloud = graded.cloud(*graded_half(n, core), on_circle)
    plane = pd.RigidPlane((0.0, 0.0), (0.0, 1.0), move=(0.0, load))
    fine = core / n
    spacing = np.sqrt(np.mean(np.asarray(cloud.particles.volume)))
    top = pd.region.Slab("y", low=RADIUS - 1e-9)
    return pd.Case(
        particles=cloud.particles,
        horizon=horizon * cloud.size,
        material=pd.LinearElastic(E=E, nu=NU),
        scheme=pd.choose("scheme", scheme, pd.SCHEMES),
        weights=pd.choose("weights", weights, pd.WEIGHTS),
        control=pd.Silling(G) if G else None,
        conditions=[
            pd.Displacement(pd.region.Slab("x", high=1e-9), x=0.0),
            pd.Displacement(top, x=0.0 if top_x else None, y=0.0),
            pd.Contact("contact", plane, friction, stiffness=stiff * MODULUS / fine, penetration=penetration * fine / spacing, name="plane"),
        ],
        history={"peak": Peak(), "reaction": pd.Reaction("y", top),
                 **{f"p_{i}": PressureAt(x) for i, x in enumerate(AT)}},
        results=lambda h: {
            "force": 2.0 * h["plane_y"][-1], "reaction": h["reaction"][-1],
            "half_width": h["plane_area"][-1],
            "peak_pressure": h["peak"][-1],
            "depth": h["plane_depth"][-1]*spacing/load,
            **{f"p_{i}": h[f"p_{i}"][-1]/p for i, p in enumerate(PRESSURES)},
        },
        picture=pd.Picture(pd.stress, "yy"),
    )


def graded_half(n, core):
    points, cells = graded.corner(n, core, 2.0 * RADIUS, 2)
    return graded.ball(points, RADIUS), cells


def touching(solution):
    """Return distances from the middle, pressures and areas of the facets of all ranks that touch."""
    (term,) = (one for one in solution.problem.terms if type(one).__name__ == "ContactForces")
    x, traction, area = term.of_facets(solution.state)
    parts = solution.cloud.comm.allgather((x[:, 0], traction[:, 1], area))
    return [np.concatenate(arrays) for arrays in zip(*parts, strict=True)]


class Peak(pd.Quantity):
    """Largest pressure."""

    def evaluate(self, solution):
        return float(touching(solution)[1].max(initial=0.0))


class PressureAt(pd.Quantity):
    """Pressure at a distance from the middle."""

    def __init__(self, at):
        self.at = at

    def evaluate(self, solution):
        x, p, _ = touching(solution)
        order = np.argsort(x)
        return float(np.interp(self.at, x[order], p[order], right=0.0)) if len(x) else 0.0
