"""Quarter of a plate with a square opening under uniform stretch in both directions, plane stress. Units mm, N.

Particles lie on the symmetry lines and on the edges. Results along the x axis, against finite elements with nodes at
the particles of dx = 2: mean relative error (amplitude) and largest second difference of the error (oscillation) of u_x
and sigma_xx; ``error`` is the mean relative error of u_x against elements of 0.5 mm. The paper gives no dimensions:
100 x 100 mm with an opening of 20 x 20 mm, 0.4 mm on both outer edges.
Reference: Luo, Sundararaghavan, section 5.2, Fig. 8-10.
"""

import plate

import pdpetsc as pd

SIZE = 100.0
OPENING = 20.0
STRETCH = 0.4
E = 1000.0
NU = 0.3


def case(dx=2.0, horizon=1.015, scheme="correspondence", control="none"):
    region = pd.region
    edge = SIZE + 0.5 * dx
    line = plate.Line("square_opening", 0, {1: 0.0}, dx)
    inside = OPENING - 0.5 * dx
    history = plate.quantities(line, u=plate.displacement_x, stress=plate.stress_xx)
    fine = plate.Line("square_opening_fine", 0, {1: 0.0}, dx)
    history["error"] = plate.Amplitude(fine, "u", plate.displacement_x)
    return pd.Case(
        particles=pd.Lattice((-0.5 * dx, -0.5 * dx), (edge, edge), dx, cut=region.Box((-dx, -dx), (inside, inside))),
        horizon=horizon * dx,
        material=pd.LinearElastic(E=E, nu=NU, plane="stress"),
        conditions=[
            pd.Displacement(region.Slab("x", high=0.1 * dx), x=0.0),
            pd.Displacement(region.Slab("y", high=0.1 * dx), y=0.0),
            pd.Displacement(region.Slab("x", low=SIZE - 0.1 * dx), x=STRETCH),
            pd.Displacement(region.Slab("y", low=SIZE - 0.1 * dx), y=STRETCH),
        ],
        history=history,
        results=plate.last,
        picture=pd.Picture(pd.stress, "xx"),
        **plate.method(scheme, control),
    )
