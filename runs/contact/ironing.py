"""Half cylinder of rubber that is pressed on a block of rubber and drawn along it with friction: ironing. Units mm, N.

A block of 11 x 3, held at its bottom, on nodes, and half a cylinder of radius 1.5 above it, neo-Hookean, E = 1 MPa,
nu = 0.3, plane strain, of unit thickness. The diameter moves down by ``load`` in the first quarter of the steps, and
then along the block by ``slide``. The block has ``n`` cells over 1 mm; those of the cylinder are about as large.

References: the horizontal over the vertical force is ``friction`` while the cylinder slides, up to the slope of the
surface below it and its stretch. The reactions of the diameter and of the bottom are opposite. Work less stored energy
per length is ``friction`` times the force, and over the run 0 without friction.

Results over the last half of the way: ``force``, the mean vertical force; ``variation``, its largest less its least
value over the mean; ``drag_over_normal``; ``lost_over_coulomb``, with friction; ``balance``, the largest difference of
the two reactions over the force. Without friction ``energy_error``, work less stored energy over the work of the run.
"""

import sys
from pathlib import Path

import numpy as np
from scipy.integrate import trapezoid

sys.path.append(str(Path(__file__).parent))
import refined
from rubber_roller import Stored

import pdpetsc as pd

BEFORE, BEYOND, HEIGHT, RADIUS = 3.5, 7.5, 3.0, 1.5
E, NU = 1.0, 0.3
PRESSED = 0.25


def case(n=4, friction=0.3, load=0.3, slide=4.0, steps=40, penetration=0.1):
    points, cells = refined.mirrored(*refined.corner(round(RADIUS * n), 0.5 * RADIUS, 2.0 * RADIUS, 2))
    cylinder = refined.disc(refined.ball(points, RADIUS), cells, RADIUS)
    block = pd.LatticeNodes((-BEFORE, -HEIGHT), (BEYOND, 0.0), 1.0 / n)
    nodes = round((BEFORE + BEYOND) * n + 1) * round(HEIGHT * n + 1)
    diameter = pd.region.Named("cylinder") & pd.region.Slab("y", low=RADIUS - 1e-9)
    presses, slides = pd.Table([0.0, PRESSED, 1.0], [0.0, 1.0, 1.0]), pd.Table([0.0, PRESSED, 1.0], [0.0, 0.0, 1.0])

    def results(h):
        t, down, along = (np.array(h[name]) for name in ("t", "down", "along"))
        lost, way = np.array(h["work"]) - np.array(h["stored"]), slide * (t - PRESSED) / (1.0 - PRESSED)
        late = way > 0.5 * slide - 1e-9
        length = np.ptp(way[late])
        force, drag = (trapezoid(values[late], way[late]) / length for values in (-down, along))
        off = np.hypot(down + np.array(h["bottom_y"]), along + np.array(h["bottom_x"]))
        found = {
            "force": force,
            "variation": np.ptp(down[late]) / force,
            "drag_over_normal": drag / force,
            "balance": off.max() / force,
        }
        if friction:
            return {**found, "lost_over_coulomb": (lost[late][-1] - lost[late][0]) / (length * friction * force)}
        return {**found, "energy_error": lost[-1] / h["work"][-1]}

    expect = {"balance": pd.Expected(0.0, absolute=1e-6, source="equilibrium")}
    if friction:
        expect["drag_over_normal"] = pd.Expected(friction, relative=0.05, source="Coulomb")
        expect["lost_over_coulomb"] = pd.Expected(1.0, relative=0.05, source="Coulomb")
    else:
        expect["drag_over_normal"] = pd.Expected(0.0, absolute=0.01, source="symmetry")
        expect["energy_error"] = pd.Expected(0.0, absolute=0.01, source="energy balance")
    return pd.Case(
        particles=pd.Bodies({"cylinder": cylinder.particles, "block": block}),
        horizon=2.1 * np.concatenate([cylinder.size, np.full(nodes, 1.0 / n)]),
        material=pd.NeoHookean(E=E, nu=NU),
        conditions=[
            pd.Displacement("block -y", x=0.0, y=0.0),
            pd.Displacement(diameter, y=-load, schedule=presses),
            pd.Displacement(diameter, x=slide, schedule=slides),
            pd.BodyContact(
                pd.region.Named("cylinder") & pd.region.Named("contact"), "block +y", friction,
                penetration=penetration, reach=slide + 1.0, name="contact",
            ),
        ],
        steps=pd.Steps(steps),
        history={
            "work": pd.ExternalWork(),
            "stored": Stored(),
            "down": pd.Reaction("y", diameter),
            "along": pd.Reaction("x", diameter),
            "bottom_y": pd.Reaction("y", "block -y"),
            "bottom_x": pd.Reaction("x", "block -y"),
        },
        results=results,
        expect=expect,
        picture=pd.Picture(pd.displacement, "y"),
    )  # fmt: skip
