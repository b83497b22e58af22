"""Deep cantilever under a dead force at the middle of its free end. Units m, N.

10 m by 1 m, E = 12 MPa, nu = 0.2, 100 kN: P L^2 / E I = 10. Result: displacements of the loaded particle over the
length, against the elastica (w / L = 0.81061, u / L = 0.55500). The elastica bends with E I, which is plane stress; the
paper computes in plane strain, which is 4 % stiffer: 0.302, 0.342 and 0.529, which its text calls errors, are w / L
under 10 kN at horizons 1.015, 2.015 and 3.015 in plane strain without control (``plane=strain force=10e3``: 0.301,
0.347, 0.531). ``pinned`` is what has u_y = 0: the particles at mid-height in the whole fictitious layer, or the one
next to the body alone, with which Table 4 is met (``tables.py``).
Reference: Hashim, Coombs, Augarde, Hattori, section 4.4.
"""

import beam
import elastica

import pdpetsc as pd

LENGTH = 10.0
DEPTH = 1.0
E = 12e6
NU = 0.2
FORCE = 100e3
# One unit of length of the paper's G [m], fitted to its Table 4 (tables.py): metres within four per cent.
UNIT = 1.041


def case(
    ny=5, horizon=1.015, G=0.0, scheme="correspondence", steps=10, plane="stress", force=FORCE, control="",
    G_printed=0.0, unit=UNIT, pinned="layer",
):  # fmt: skip
    if ny < 1 or ny % 2 == 0:
        raise pd.CaseError(f"ny must be odd, so that particles lie on the middle of the beam, not {ny}.")
    if pinned not in ("layer", "particle"):
        raise pd.CaseError(f"pinned is layer or particle, not {pinned!r}.")
    dx = DEPTH / ny
    held = pd.region.Named("fictitious -x")
    middle = held & pd.region.Slab("y", -0.1 * dx, 0.1 * dx)
    pin = pd.region.Nearest((-0.5 * dx, 0.0)) if pinned == "particle" else middle
    exact = elastica.tip(force * LENGTH**2 / (E * DEPTH**3 / 12.0))
    tip = pd.region.Nearest((LENGTH, 0.0))

    def results(history):
        w, u = history["w"][-1] / LENGTH, history["u"][-1] / LENGTH
        return {
            "w_over_L": -w,
            "u_over_L": -u,
            "w_error": -w / exact[0] - 1.0,
            "u_error": -u / exact[1] - 1.0,
        }

    return pd.Case(
        particles=pd.Lattice((0.0, -DEPTH / 2), (LENGTH, DEPTH / 2), dx, fictitious={"-x": max(int(horizon), 1) * dx}),
        horizon=horizon * dx,
        material=pd.Hencky(E=E, nu=NU, plane=plane),
        scheme=pd.choose("scheme", scheme, pd.SCHEMES),
        control=beam.control_of(G, control, G_printed, unit),
        conditions=[
            pd.Displacement(held, x=0.0),
            pd.Displacement(pin, y=0.0),
            pd.Force(tip, y=-force),
        ],
        steps=pd.Steps(steps),
        history={"w": pd.Mean(pd.displacement, "y", tip), "u": pd.Mean(pd.displacement, "x", tip)},
        results=results,
        expect={
            "w_over_L": pd.Expected(exact[0], relative=0.03, source="elastica (Bisshopp and Drucker 1945)"),
            "u_over_L": pd.Expected(exact[1], relative=0.03, source="elastica (Bisshopp and Drucker 1945)"),
        }
        if plane == "stress"
        else {},
        picture=pd.Picture(pd.stress, "xx"),
    )
