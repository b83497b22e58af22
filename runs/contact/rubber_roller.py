"""Rubber block that is pressed on a rigid roller and drawn along below it: energy, steady force, drag. Units mm, N.

A block of 50 x 10 and unit thickness, neo-Hookean, E = 2 MPa, nu = 0.4, plane strain, on nodes, ``n`` over its height,
glued to a plate. A roller of radius 8 that does not turn rests on its top, 15 mm from one end. The plate rises by
``load`` in the first fifth of the steps, and then moves by ``slide`` along itself. The roller thus goes over the middle
of the block, and ``friction`` resists. As the roller rests, all work is that of the plate.

References: without friction nothing is lost, and there is no drag far from the ends; the forces only vary with the
position of the roller between the particles. A roller that slides takes ``friction`` times its force for every length
(Coulomb), up to the slope of the surface below it and its stretch along it. With ``rolls=True`` the roller turns freely
about its axle: it rolls by friction, and nothing drags.

The surface penetrates the roller by 1.3 hundredths of a spacing. With a ``penetration`` below that ``pd.Contact`` adds
multipliers, which lag behind a roller that moves: they drag it, and the energy does not balance.

Results over the middle half of the way: ``force``, the mean of the vertical force; ``variation``, its largest less its
least value over the mean; ``drag_over_normal``, of the means of both forces; ``lost_over_coulomb``, with friction, work
less stored energy per length over friction times force; of a roller that rolls ``turned_over_way``, the way of its
surface over that of the plate. Over the whole run ``energy_error``, without friction, work
less stored energy over the work.
"""

import numpy as np
from scipy.integrate import trapezoid

import pdpetsc as pd

LENGTH, HEIGHT, RADIUS, START = 50.0, 10.0, 8.0, 15.0
E, NU = 2.0, 0.4
PRESSED = 0.2


class Stored(pd.Quantity):
    """Stored energy, also that of the springs of the contact."""

    dimension = "energy"

    def evaluate(self, solution):
        return sum(solution.energies.values())


def case(n=8, friction=0.0, load=0.8, slide=20.0, penetration=0.1, steps=100, rolls=False):
    middle = (START, HEIGHT + RADIUS)
    roller = pd.RigidSphere(middle, RADIUS, **({"moment": 0.0, "about": middle} if rolls else {}))
    rises, goes = pd.Table([0.0, PRESSED, 1.0], [0.0, 1.0, 1.0]), pd.Table([0.0, PRESSED, 1.0], [0.0, 0.0, 1.0])

    def results(h):
        t, force, drag = (np.array(h[name]) for name in ("t", "roller_y", "roller_x"))
        lost = np.array(h["work"]) - np.array(h["stored"])
        way = slide * (t - PRESSED) / (1.0 - PRESSED)
        middle = (way > 0.25 * slide - 1e-9) & (way < 0.75 * slide + 1e-9)
        mean = trapezoid(force[middle], way[middle]) / np.ptp(way[middle])
        along = trapezoid(drag[middle], way[middle]) / np.ptp(way[middle])
        found = {
            "force": -mean,
            "variation": np.ptp(force[middle]) / -mean,
            "drag_over_normal": along / -mean,
        }
        if rolls:
            turned = np.ptp(np.array(h["roller_turn"])[middle]) * RADIUS
            return {**found, "turned_over_way": turned / np.ptp(way[middle])}
        if friction:
            per_length = (lost[middle][-1] - lost[middle][0]) / np.ptp(way[middle])
            return {**found, "lost_over_coulomb": per_length / (friction * -mean)}
        return {**found, "energy_error": lost[-1] / h["work"][-1]}

    if rolls:
        expect = {
            "drag_over_normal": pd.Expected(0.0, absolute=5e-3, source="no moment about the axle"),
            "turned_over_way": pd.Expected(1.0, absolute=0.1, source="a rigid surface"),
        }
    elif friction:
        expect = {
            "drag_over_normal": pd.Expected(friction, relative=0.05, source="Coulomb"),
            "lost_over_coulomb": pd.Expected(1.0, relative=0.05, source="Coulomb"),
        }
    else:
        expect = {
            "drag_over_normal": pd.Expected(0.0, absolute=5e-3, source="symmetry"),
            "energy_error": pd.Expected(0.0, absolute=5e-3, source="energy balance"),
        }
    return pd.Case(
        particles=pd.LatticeNodes((0.0, 0.0), (LENGTH, HEIGHT), HEIGHT / n),
        material=pd.NeoHookean(E=E, nu=NU),
        conditions=[
            pd.Displacement("-y", y=load, schedule=rises),
            pd.Displacement("-y", x=-slide, schedule=goes),
            pd.Contact("+y", roller, friction, penetration=penetration, name="roller"),
        ],
        steps=pd.Steps(steps),
        history={"work": pd.ExternalWork(), "stored": Stored()},
        results=results,
        expect={"variation": pd.Expected(0.0, absolute=0.03, source="far from the ends"), **expect},
        picture=pd.Picture(pd.displacement, "y"),
    )
