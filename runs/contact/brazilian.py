"""Disc between two rigid planes: the tension at its centre, as in the Brazilian test. Units mm, N.

A disc of diameter D = 50, E = 50,000, nu = 0.2, plane strain, of unit thickness. Rigid planes approach its centre by
``load`` each. A quarter is computed, on nodes of quadrilaterals that grow away from the contact (``refined.py``): ``n``
over 0.4 mm at the contact, and about 50 / n mm wide at the centre.

Under two opposite forces P the centre has ``s_x = 2 P / (pi D)`` and ``s_y = -6 P / (pi D)`` per thickness (Hondros
1959): 0.8488 and -2.5465 MPa for 1 kN on 15 mm, which is near to the force here. The contact is a hundredth of the
radius wide. For the force ``load = 2 P / (pi E*) (ln(4 R / a) - 1 / 2)`` (Johnson, equation 5.57).

Results: ``force`` P per thickness, ``tension`` and ``compression`` of the centre, ``tension_over_closed_form`` and
``compression_over_closed_form`` for P, and ``force_over_johnson``.
"""

import sys
from pathlib import Path

import numpy as np

sys.path.append(str(Path(__file__).parent))
import hertz
import refined

import pdpetsc as pd

E, NU, RADIUS = 50e3, 0.2, 25.0
MODULUS = E / (1.0 - NU**2)
CORE = 0.4


def case(n=16, friction=0.0, load=0.00465):
    points, cells = refined.corner(n, CORE, 2.0 * RADIUS, 2)
    cloud = refined.disc(refined.ball(points, RADIUS), cells, RADIUS)
    plane = pd.RigidPlane((0.0, 0.0), (0.0, 1.0), move=(0.0, load))
    centre = (0.0, RADIUS)

    def results(h):
        force = 2.0 * h["plane_y"][-1]
        unit = 2.0 * force / (np.pi * 2.0 * RADIUS)
        return {
            "force": force,
            "tension": h["s_x"][-1],
            "compression": -h["s_y"][-1],
            "tension_over_closed_form": h["s_x"][-1] / unit,
            "compression_over_closed_form": -h["s_y"][-1] / (3.0 * unit),
            "force_over_johnson": force / hertz.disc(load, RADIUS, MODULUS),
        }

    return pd.Case(
        particles=cloud.particles,
        horizon=2.1 * cloud.size,
        material=pd.LinearElastic(E=E, nu=NU),
        conditions=[
            pd.Displacement(pd.region.Slab("x", high=1e-9), x=0.0),
            pd.Displacement(pd.region.Slab("y", low=RADIUS - 1e-9), y=0.0),
            cloud.contact(plane, friction, 10.0 * MODULUS, CORE / n, "plane"),
        ],
        history={
            "s_x": pd.At(centre, pd.stress, "xx"),
            "s_y": pd.At(centre, pd.stress, "yy"),
        },
        results=results,
        expect={
            "tension_over_closed_form": pd.Expected(1.0, relative=0.03, source="Hondros 1959"),
            "compression_over_closed_form": pd.Expected(1.0, relative=0.03, source="Hondros 1959"),
            "force_over_johnson": pd.Expected(1.0, relative=0.02, source="Johnson 1985, equation 5.57"),
        },
        picture=pd.Picture(pd.stress, "xx"),
    )
