"""Plate with a round hole from a Gmsh mesh, pulled at its ends: how many times the stress at the hole is that far away.

A plate of 30 x 20 mm with a hole of 4 mm diameter in plane stress, of which a quarter is computed before two mirror
planes. The mesh (``gmsh_hole.msh``, Gmsh 4.1, of ``gmsh_hole.geo``) has a particle in each triangle, small ones at the
hole, and horizons that follow them; its physical groups name the loaded side and the hole.

Result: ``concentration``, the largest stress at the hole along the pull over that at the ends. In an infinite plate it
is Kirsch's 3, in one five times as wide as its hole 3.14 (Howland 1930). Units mm, N.
"""

from pathlib import Path

import pdpetsc as pd

PULL, RADIUS, HALF_WIDTH = 100.0, 2.0, 10.0


def howland(share):
    """Return the stress at a hole that takes a share of the width of a plate, over that far away (a fit to Howland)."""
    left = 1.0 - share
    return 0.284 + 2.0 / left - 0.600 * left + 1.32 * left**2


def case(mesh="", horizon=2.5, E=200e3, nu=0.3):
    hole, right = pd.region.Named("hole"), pd.region.Named("right")
    exact = howland(RADIUS / HALF_WIDTH)
    # Another mesh may be a plate of another shape.
    expect = {} if mesh else {"concentration": pd.Expected(exact, relative=0.03, source="Howland 1930, finite width")}
    return pd.Case(
        particles=pd.Mesh(mesh or Path(__file__).with_name("gmsh_hole.msh")),
        horizon=pd.Horizon(horizon),
        material=pd.LinearElastic(E=E, nu=nu, plane="stress"),
        symmetry=[pd.Symmetry("x"), pd.Symmetry("y")],
        conditions=[pd.Traction(right, x=PULL)],
        history={"largest": pd.OnSurface(pd.stress, "xx", hole, take="largest")},
        results=lambda h: {"concentration": h["largest"][-1] / PULL},
        expect=expect,
        picture=pd.Picture(pd.stress, "xx"),
    )
