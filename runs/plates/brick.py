"""Brick of 80 x 80 x 40 mm pulled on its four sides, top and bottom free. Units mm, N.

The four sides move outward by 0.4 mm. The paper does not say what they do along themselves. Free to slide
(``sides=free``) the elastic body is in a homogeneous state, u_z of the bottom is one number, and everything else that
is seen is of the supports. With ``sides=held`` they have no displacement in the direction of the height, and the
bottom bulges. Results along the line x = 40, z = 0, through the middle of the bottom, against finite elements with
nodes at the particles: mean relative error (amplitude) and largest second difference of the error (oscillation) of
u_z, on the whole line and three particles from its ends. The origin is at a corner, as in the paper; u_z is zero at
half the height.
Reference: Luo, Sundararaghavan, section 5.3, Fig. 11-13.
"""

import dataclasses

import plate

import pdpetsc as pd

SIDE = 80.0
HEIGHT = 40.0
PULL = 0.4
E = 1000.0
NU = 0.3


def case(dx=2.5, horizon=1.015, scheme="correspondence", control="none", sides="held"):
    if sides not in ("held", "free"):
        raise pd.CaseError(f"sides is held or free, not {sides!r}.")
    region = pd.region
    near, far = 0.1 * dx, SIDE - 0.1 * dx
    line = plate.Line(f"brick_{sides}", 1, {0: 0.5 * SIDE, 2: 0.0}, dx)
    margin = (plate.ENDS - 0.5) * dx
    away = dataclasses.replace(line, low=margin, high=SIDE - margin)
    moved = [
        pd.Displacement(end, **{axis: value})
        for axis in "xy"
        for end, value in ((region.Slab(axis, high=near), -PULL), (region.Slab(axis, low=far), PULL))
    ]
    inside = region.Box((near, near, -SIDE), (far, far, SIDE))
    upright = ~inside if sides == "held" else region.Nearest((0.5 * SIDE, 0.5 * SIDE, 0.5 * HEIGHT))
    outer = (SIDE + 0.5 * dx, SIDE + 0.5 * dx, HEIGHT + 0.5 * dx)
    return pd.Case(
        particles=pd.Lattice((-0.5 * dx,) * 3, outer, dx),
        horizon=horizon * dx,
        material=pd.LinearElastic(E=E, nu=NU),
        conditions=[*moved, pd.Displacement(upright, z=0.0)],
        history=plate.quantities(line, away, u=plate.displacement_z),
        results=plate.last,
        picture=pd.Picture(pd.displacement, "z"),
        **plate.method(scheme, control),
    )
