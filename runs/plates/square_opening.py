"""Plate with a square opening under uniform stretch in both directions, plane stress. Units mm, N.

Particles lie on the edges. Results along the x axis right of the opening, against finite elements with nodes at the
particles of dx = 2: mean relative error (amplitude) and largest second difference of the error (oscillation) of u_x
and sigma_xx, on the whole line and on the part that is 20 mm away from the opening and three particles from the edge;
``error`` is the mean relative error of u_x against elements of 0.5 mm. The paper's text gives no dimensions: 200 x
200 mm with an opening of 40 x 40 mm, 0.4 mm on each edge. ``part=quarter`` takes a quarter before two mirror planes,
which is the whole plate. ``part=quarter_cut`` takes it like the figure, on two symmetry lines that are supports and cut
families: with whole cells stresses there are wrong at every spacing.
With ``cells=clipped`` particles on edges and symmetry lines have the part of their cell that is inside. With
``cells=inside``, as for mirror planes, cells fill the plate: its outermost particles are half a cell inside and move as
much less as that is of the half side, and the line is that of the particles nearest to the x axis.
Reference: Luo, Sundararaghavan, section 5.2, Fig. 8-10.
"""

import dataclasses

import edges
import plate

import pdpetsc as pd

# Halves of the plate's and the opening's sides.
SIZE = 100.0
OPENING = 20.0
STRETCH = 0.4
E = 1000.0
NU = 0.3
# How far from the opening the paper calls its results smooth.
AWAY = 20.0


def case(dx=2.0, horizon=1.015, scheme="correspondence", control="none", part="whole", cells=""):
    if part not in ("whole", "quarter", "quarter_cut"):
        raise pd.CaseError(f"part is whole, quarter or quarter_cut, not {part!r}.")
    cells = cells or ("inside" if part == "quarter" else "whole")
    if cells not in ("whole", "clipped", "inside"):
        raise pd.CaseError(f"cells is whole, clipped or inside, not {cells!r}.")
    if (part == "quarter") != (cells == "inside") and part != "whole":
        raise pd.CaseError(
            f"part={part} does not go with cells={cells}: mirror planes take cells=inside, and they alone."
        )
    edges.refuse_other_sizes(SIZE, OPENING, dx)
    region = pd.region
    # Cells reach this far beyond the particles on the edges.
    more = 0.0 if cells == "inside" else 0.5 * dx
    edge, inside = SIZE + more, OPENING - more
    outermost = edge - 0.5 * dx
    pulled = STRETCH * outermost / SIZE
    first, hole = (-edge, -inside) if part == "whole" else (-more, -dx)
    line = plate.Line("square_opening", 0, {1: 0.5 * dx - more}, dx, low=0.0)
    away = dataclasses.replace(line, low=OPENING + AWAY - 0.1 * dx, high=SIZE - (plate.ENDS - 0.5) * dx)
    history = plate.quantities(line, away, u=plate.displacement_x, stress=plate.stress_xx)
    fine = dataclasses.replace(line, name="square_opening_fine")
    history["error"] = plate.Amplitude(fine, "u", plate.displacement_x)
    ends = [pd.Displacement(region.Slab(axis, low=outermost - 0.1 * dx), **{axis: pulled}) for axis in "xy"]
    if part != "quarter":
        behind = -pulled if part == "whole" else 0.0
        ends += [pd.Displacement(region.Slab(axis, high=first + 0.6 * dx), **{axis: behind}) for axis in "xy"]
    lattice = pd.Lattice((first, first), (edge, edge), dx, cut=region.Box((hole, hole), (inside, inside)))
    return pd.Case(
        particles=edges.clipped(SIZE, OPENING, dx, part) if cells == "clipped" else lattice,
        horizon=horizon * dx,
        material=pd.LinearElastic(E=E, nu=NU, plane="stress"),
        conditions=ends,
        symmetry=[pd.Symmetry("x"), pd.Symmetry("y")] if part == "quarter" else [],
        history=history,
        results=plate.last,
        picture=pd.Picture(pd.stress, "xx"),
        **plate.method(scheme, control),
    )
