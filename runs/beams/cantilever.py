"""Deep cantilever under a dead force at the middle of its free end. Units m, N.

10 m by 1 m, E = 12 MPa, nu = 0.2, 100 kN: P L^2 / E I = 10. Result: displacements of the loaded particle over the
length, against the elastica (Mattiasson 1981): w / L = 0.81061, u / L = 0.55500. The elastica bends with E I, which is
plane stress; the paper computes in plane strain, which is 4 % stiffer.
Reference: Hashim, Coombs, Augarde, Hattori, section 4.4.
"""

import beam

import pdpetsc as pd

LENGTH = 10.0
DEPTH = 1.0
ELASTICA = {"w": 0.81061, "u": 0.55500}


def case(ny=5, horizon=1.015, G=0.0, scheme="correspondence", steps=10, plane="stress", force=100e3):
    if ny < 1 or ny % 2 == 0:
        raise pd.CaseError(f"ny must be odd, so that particles lie on the middle of the beam, not {ny}.")
    dx = DEPTH / ny
    held = pd.region.Named("fictitious -x")
    tip = pd.region.Nearest((LENGTH, 0.0))

    def results(history):
        w, u = history["w"][-1] / LENGTH, history["u"][-1] / LENGTH
        return {
            "w_over_L": -w,
            "u_over_L": -u,
            "w_error": -w / ELASTICA["w"] - 1.0,
            "u_error": -u / ELASTICA["u"] - 1.0,
        }

    return pd.Case(
        particles=pd.Lattice((0.0, -DEPTH / 2), (LENGTH, DEPTH / 2), dx, fictitious={"-x": max(int(horizon), 1) * dx}),
        horizon=horizon * dx,
        material=pd.Hencky(E=12e6, nu=0.2, plane=plane),
        scheme=beam.scheme_named(scheme),
        stabilisation=pd.Silling(G) if G else None,
        conditions=[
            pd.Displacement(held, x=0.0),
            pd.Displacement(held & pd.region.Slab("y", -0.1 * dx, 0.1 * dx), y=0.0),
            pd.Force(tip, y=-force),
        ],
        steps=pd.Steps(steps),
        history={"w": pd.Mean(pd.displacement, "y", tip), "u": pd.Mean(pd.displacement, "x", tip)},
        results=results,
        picture=pd.Picture(pd.stress, "xx"),
    )
