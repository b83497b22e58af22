"""Steel cylinder pressed on an aluminium block: Hertz's line contact of two elastic bodies. Units mm, N.

NAFEMS benchmark CGS-1: a cylinder of radius 50, E = 210,000, on a block of 200 x 200, E = 70,000, nu = 0.3, plane
strain, without friction, with 35 kN per mm. Half of it is computed, on nodes of quadrilaterals that grow away from the
contact (``refined.py``), ``n`` over 8 mm at the contact in the cylinder and ``m`` in the block. The upper half of the
cylinder is left out; its diameter moves down by ``load``.

Hertz: half width ``a = sqrt(4 F R / (pi E*))``, largest pressure ``p0 = sqrt(F E* / (pi R))`` with ``1 / E* = (1 -
nu^2) (1 / E1 + 1 / E2)``: 6.2146 mm and 3585.4 MPa at 35 kN per mm.

Results: ``force`` of the whole width, ``half_width`` and ``peak_pressure``, both over those of Hertz for the force of
the run, and ``pressure_error``, the root mean square of the difference from Hertz over p0 on the facets that touch.
"""

import sys
from pathlib import Path

import numpy as np

sys.path.append(str(Path(__file__).parent))
import hertz
import refined

import pdpetsc as pd

RADIUS, SIDE, CORE = 50.0, 100.0, 8.0
STEEL, ALUMINIUM, NU = 210e3, 70e3, 0.3
MODULUS = 1.0 / ((1.0 - NU**2) * (1.0 / STEEL + 1.0 / ALUMINIUM))


def block(n):
    """Return nodes and cells of half of the block below y = 0: a square that is refined at a corner, and one below."""
    points, cells = refined.corner(n, CORE, SIDE, 2, ball=False)
    low = np.flatnonzero(np.abs(points[:, 1] - SIDE) < 1e-9)
    low = low[np.argsort(points[low, 0])]
    rows, more = [low], []
    for k in range(1, n + 1):
        rows.append(len(points) + np.arange(len(low)))
        points = np.concatenate([points, points[low] + (0.0, SIDE * k / n)])
        above, below = rows[-2:]
        more.append(np.stack([above[:-1], above[1:], below[1:], below[:-1]], axis=1))
    points = points * (1.0, -1.0)
    return refined.cloud(points, np.concatenate([cells, *more]), np.abs(points[:, 1]) < 1e-9)


def case(n=12, m=16, load=1.567, friction=0.0):
    points, cells = refined.corner(n, CORE, 2.0 * RADIUS, 2)
    cylinder = refined.disc(refined.ball(points, RADIUS), cells, RADIUS)
    below = block(m)
    near = pd.region.Sphere((0.0, 0.0), 1.5 * CORE)

    def results(h):
        force = 2.0 * h["contact_y"][-1]
        a, peak = hertz.line(force, RADIUS, MODULUS)
        return {
            "force": force,
            "half_width": h["half_width"][-1],
            "peak_pressure": h["peak"][-1],
            "half_width_over_hertz": h["half_width"][-1] / a,
            "peak_over_hertz": h["peak"][-1] / peak,
            "pressure_error": h["error"][-1],
        }

    contact, middle = pd.region.Named("contact") & near, pd.region.Slab("x", high=1e-9)
    return pd.Case(
        particles=pd.Bodies({"cylinder": cylinder.particles, "block": below.particles}),
        horizon=2.1 * np.concatenate([cylinder.size, below.size]),
        material=[
            (pd.region.Named("cylinder"), pd.LinearElastic(E=STEEL, nu=NU)),
            (pd.region.Named("block"), pd.LinearElastic(E=ALUMINIUM, nu=NU)),
        ],
        conditions=[
            pd.Displacement(middle, x=0.0),
            pd.Displacement(pd.region.Slab("y", low=RADIUS - 1e-9), y=-load),
            pd.Displacement(pd.region.Slab("y", high=-2.0 * SIDE + 1e-9), y=0.0),
            pd.BodyContact(
                pd.region.Named("cylinder") & contact, pd.region.Named("block") & contact, friction, penetration=1e-3,
                name="contact",
            ),
        ],
        steps=pd.Steps(4),
        history={
            "half_width": hertz.HalfWidth(),
            "peak": hertz.Peak("contact"),
            "error": hertz.LineError(RADIUS, MODULUS),
        },
        results=results,
        expect={
            "half_width_over_hertz": pd.Expected(1.0, relative=0.02, source="NAFEMS CGS-1, Hertz"),
            "peak_over_hertz": pd.Expected(1.0, relative=0.03, source="NAFEMS CGS-1, Hertz"),
        },
        picture=pd.Picture(pd.stress, "yy"),
    )  # fmt: skip
