"""Square bar in space, bent by moments at both ends, against Saint-Venant's exact solution.

A bar of 6 x 1 x 1 on a lattice of ``n`` particles across, whose ends carry a traction that is linear over the height:
a moment without force. It bends to a circle, its sections stay plane and curve across. Three particles are held so that
it cannot move as a whole.
Results: ``deflection`` of the end, against ``M L^2 / 2 E I``; ``stress``, the largest of the axial stress on the
surface, against ``M h / 2 I``; ``energy``, against ``M^2 L / 2 E I``. Any consistent units.
"""

import numpy as np

import pdpetsc as pd

LENGTH, E, NU = 6.0, 1000.0, 0.3
# The largest axial stress; M = SIGMA / 6 for a section of 1 x 1.
SIGMA = 1.0


def displacement(x, t):
    """Return the exact displacement (n, 3), measured from the middle of the left end."""
    a, y, z = x[:, 0], x[:, 1], x[:, 2]
    k = 2.0 * SIGMA / E
    return k * np.stack([a * y, -0.5 * (a**2 + NU * (y**2 - z**2)), -NU * y * z], axis=1)


def case(n=8, horizon=1.515, scheme="sub_horizons", weights="conforming", G=0.0):
    dx = 1.0 / n
    low, high = (0.0, -0.5, -0.5), (LENGTH, 0.5, 0.5)
    near, far = 0.5 * dx - 0.5, 0.5 - 0.5 * dx
    of = {name: lambda x, t, axis=axis: t * displacement(x, t)[:, axis] for axis, name in enumerate("xyz")}
    # Corners of the left end, held where they belong: six numbers, so that nothing is strained by it.
    held = [("xyz", (0.5 * dx, near, near)), ("xy", (0.5 * dx, near, far)), ("x", (0.5 * dx, far, near))]

    def bent(x, t):
        return 2.0 * SIGMA * t * x[:, 1]

    history = {
        "deflection": pd.At((LENGTH, 0.0, 0.0), pd.displacement, "y"),
        "stress": pd.OnSurface(pd.stress, "xx", pd.region.Named("+y"), take="largest"),
        "energy": pd.StrainEnergy(),
    }
    exact = SIGMA * LENGTH**2 / E, SIGMA, SIGMA**2 * LENGTH / (6.0 * E)
    return pd.Case(
        particles=pd.Lattice(low, high, dx),
        horizon=horizon * dx,
        material=pd.LinearElastic(E=E, nu=NU),
        scheme=pd.choose("scheme", scheme, pd.SCHEMES),
        weights=pd.choose("weights", weights, pd.WEIGHTS),
        control=pd.Silling(G) if G else None,
        conditions=[
            *(pd.Displacement(pd.region.Nearest(at), **{name: of[name] for name in names}) for names, at in held),
            pd.Traction(pd.region.Named("+x"), x=bent),
            pd.Traction(pd.region.Named("-x"), x=lambda x, t: -bent(x, t)),
        ],
        history=history,
        results=lambda h: {"deflection": -h["deflection"][-1], "stress": h["stress"][-1], "energy": h["energy"][-1]},
        expect={
            "deflection": pd.Expected(exact[0], relative=0.03, source="M L^2 / 2 E I"),
            "stress": pd.Expected(exact[1], relative=0.03, source="M h / 2 I"),
            "energy": pd.Expected(exact[2], relative=0.03, source="M^2 L / 2 E I"),
        },
        picture=pd.Picture(pd.stress, "xx"),
    )
