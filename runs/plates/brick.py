"""Brick of 80 x 80 x 40 mm pulled on its four sides, top and bottom free. Units mm, N.

The four sides move outward by 0.4 mm, without displacement in the direction of the height: free sides would leave a
homogeneous state. Results along the line x = 0 of the free face,
through its middle, against finite elements with nodes at the particles: mean relative error (amplitude) and largest
second difference of the error (oscillation) of u_z. The origin is the middle of the brick.
Reference: Luo, Sundararaghavan, section 5.3, Fig. 11-13.
"""

import plate

import pdpetsc as pd

SIDE = 40.0
HEIGHT = 20.0
PULL = 0.4
E = 1000.0
NU = 0.3


def case(dx=2.5, horizon=1.015, scheme="correspondence", control="none"):
    region = pd.region
    line = plate.Line("brick", 1, {0: 0.0, 2: HEIGHT}, dx)
    outer = (SIDE + 0.5 * dx, SIDE + 0.5 * dx, HEIGHT + 0.5 * dx)
    sides = [
        pd.Displacement(end, **{axis: sign * PULL})
        for axis in "xy"
        for sign, end in (
            (1.0, region.Slab(axis, low=SIDE - 0.1 * dx)),
            (-1.0, region.Slab(axis, high=0.1 * dx - SIDE)),
        )
    ]
    return pd.Case(
        particles=pd.Lattice([-c for c in outer], outer, dx),
        horizon=horizon * dx,
        material=pd.LinearElastic(E=E, nu=NU),
        conditions=[
            *sides,
            pd.Displacement(~region.Box((0.1 * dx - SIDE,) * 2 + (-SIDE,), (SIDE - 0.1 * dx,) * 2 + (SIDE,)), z=0.0),
        ],
        history=plate.quantities(line, u=plate.displacement_z),
        results=plate.last,
        picture=pd.Picture(pd.displacement, "z"),
        **plate.method(scheme, control),
    )
