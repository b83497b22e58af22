"""Ball pressed by a rigid ball: Hertz's point contact. Any consistent units.

The lower half of an elastic ball of radius 2, E = 1.40625e7, nu = 0.25, is held at its equator. A rigid ball of radius
2 below it moves up by ``load``. A quarter is computed, on nodes of hexahedra that grow away from the contact
(``refined.py``): ``n`` over 0.15 at the contact.

Hertz, for an approach of half spaces by ``load``: ``a = sqrt(R load)``, ``p0 = 2 E* a / (pi R)`` and ``F = 4/3 E* a
load``, with ``1 / R = 1/2 + 1/2`` and ``E* = E / (1 - nu^2)``: 0.1, 9.549e5 and 20,000 for 0.01. The half ball is held
at a distance of 20 a: ``force_over_hertz`` depends on that by an order of a / 2.

Results: ``force``, ``radius`` of the contact, ``peak_pressure``, ``force_over_hertz`` for ``load``;
``radius_over_hertz`` and ``peak_over_hertz`` for the force of the run, and ``pressure_error``, the root mean square of
the difference from Hertz's pressure over p0 on the facets that touch.
"""

import sys
from pathlib import Path

import numpy as np

sys.path.append(str(Path(__file__).parent))
import hertz
import refined

import pdpetsc as pd

E, NU, RADIUS = 1.40625e7, 0.25, 2.0
MODULUS = E / (1.0 - NU**2)
# Of the curvatures of both.
EFFECTIVE = 0.5 * RADIUS
CORE = 0.15


def case(n=8, load=0.01, friction=0.0, scheme="correspondence"):
    points, cells = refined.corner(n, CORE, 2.0 * RADIUS, 3)
    cloud = refined.disc(refined.ball(points, RADIUS), cells, RADIUS)
    known = {"sub_horizons": pd.SubHorizons, "correspondence": pd.Correspondence}
    tool = pd.RigidSphere((0.0, 0.0, -RADIUS), RADIUS, move=(0.0, 0.0, load))
    radius = np.sqrt(EFFECTIVE * load)
    peak, force = 2.0 * MODULUS * radius / (np.pi * EFFECTIVE), 4.0 / 3.0 * MODULUS * radius * load

    def results(h):
        f = 4.0 * h["tool_z"][-1]
        a, p0 = hertz.point(f, EFFECTIVE, MODULUS)
        return {
            "force": f,
            "radius": h["radius"][-1],
            "peak_pressure": h["peak"][-1],
            "force_over_hertz": f / force,
            "radius_over_hertz": h["radius"][-1] / a,
            "peak_over_hertz": h["peak"][-1] / p0,
            "pressure_error": h["error"][-1],
        }

    return pd.Case(
        particles=cloud.particles,
        horizon=2.1 * cloud.size,
        material=pd.LinearElastic(E=E, nu=NU),
        scheme=pd.choose("scheme", scheme, known)(),
        control=None if scheme == "sub_horizons" else pd.Silling(0.5),
        conditions=[
            pd.Displacement(pd.region.Slab("x", high=1e-9), x=0.0),
            pd.Displacement(pd.region.Slab("y", high=1e-9), y=0.0),
            pd.Displacement(pd.region.Slab("z", low=RADIUS - 1e-9), z=0.0),
            cloud.contact(tool, friction, 10.0 * MODULUS, CORE / n, "tool"),
        ],
        history={
            "radius": hertz.HalfWidth(2.5),
            "peak": hertz.Peak("tool"),
            "error": hertz.PointError(EFFECTIVE, MODULUS, 0.25),
        },
        results=results,
        expect={
            "force": pd.Expected(force, relative=0.05, source="Hertz"),
            "radius": pd.Expected(radius, relative=0.05, source="Hertz"),
            "peak_pressure": pd.Expected(peak, relative=0.05, source="Hertz"),
        },
        picture=pd.Picture(pd.stress, "zz"),
    )
