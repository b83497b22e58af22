"""Concrete plate with a groove and a notch that a rigid wedge splits: the energy of the ligament. Units mm, N.

The wedge splitting test (Bruehwiler and Wittmann 1990): a plate of 200 x 200 and unit thickness, plane stress, with a
groove of 60 x 40 in its top and a notch from there to half of the height. E = 30,000 MPa, nu = 0.2, strength 3 MPa,
fracture energy 0.1 N / mm. Gradient points fail (``pd.PointDamage``) by a softening ``curve``, with correspondence and
``Silling(G)``. A wedge whose faces have ``slope`` degrees with the vertical moves down by ``load`` between the
upper edges of the groove. One half is computed, beside a mirror plane, on a lattice with ``n`` particles over the
height. It rests on a support 50 mm from the middle. Of ``steps`` load steps three fifths are in the first fifth of the
way.

References: the points that fail dissipate the fracture energy times the ligament. The edge of the groove slides on the
wedge, so that the vertical force is ``tan(slope + atan(friction))`` times the horizontal one (Coulomb). The halves turn
about the lower end of the ligament and about their supports, so that the edge rises by r = 20 over its height times
what it moves aside, and the wedge works ``q (1 / tan(slope) - r) / (1 - q r)`` times what the body takes, with
``q = tan(slope + atan(friction))``: 1 without friction.

Results of the whole plate: ``peak_load``, the largest vertical force, ``peak_splitting``, the largest horizontal one,
``final_over_peak`` of the vertical force; ``dissipated_over_Gc``, of the points that fail, and ``work_over_Gc``, of the
wedge by the trapezoidal rule, both over the fracture energy of the ligament; ``work_over_closed_form``, the latter over
stored and dissipated energy times the factor above; ``force_over_coulomb``, the ratio of both forces at the peak.
"""

import sys
from pathlib import Path

import numpy as np

sys.path.append(str(Path(__file__).parent.parent / "fracture"))
import point_damage

import pdpetsc as pd

SIDE, GROOVE, DEPTH, LIGAMENT, REST = 200.0, 30.0, 40.0, 100.0, 50.0
E, NU, STRENGTH, GC = 30e3, 0.2, 3.0, 0.1


def case(n=40, horizon=2.015, slope=15.0, friction=0.0, load=4.0, curve="bilinear", G=2.0, steps=50):
    dx = SIDE / n
    alpha = np.radians(slope)
    # The middle of the uppermost facet of the wall of the groove, which the wedge touches.
    x, y = GROOVE, SIDE - 0.5 * dx
    # A wedge without its tip, which does not reach the bottom of the groove.
    ends = [(x + (at - y) * np.tan(alpha), at) for at in (y - 10.0, SIDE + 10.0 + load)]
    wedge = pd.RigidSurface([*ends, *[(-a, b) for a, b in ends[::-1]]], move=(0.0, -load))
    wall = pd.region.Box((x - 0.1 * dx, SIDE - DEPTH), (x + 0.1 * dx, SIDE))
    foot = pd.region.Box((REST - dx, 0.0), (REST + dx, dx))
    fails = pd.region.Box((0.0, 0.0), (GROOVE, SIDE - DEPTH))
    shape = pd.choose("curve", curve, point_damage.CURVES)
    early = round(0.6 * steps)
    times = (*np.linspace(0.0, 0.2, early + 1)[1:], *np.linspace(0.2, 1.0, steps - early + 1)[1:])

    def results(h):
        down, apart = -2.0 * np.array(h["wedge_y"]), np.array(h["wedge_x"])
        peak, whole = int(np.argmax(down)), GC * LIGAMENT
        work = 2.0 * h["work"][-1]
        taken = 2.0 * sum(h[name][-1] for name in ("stored", "control", "dissipated"))
        q, r = np.tan(alpha + np.arctan(friction)), (REST - GROOVE) / y
        factor = q * (1.0 / np.tan(alpha) - r) / (1.0 - q * r)
        return {
            "peak_load": down[peak],
            "peak_splitting": apart.max(),
            "final_over_peak": down[-1] / down[peak],
            "dissipated_over_Gc": 2.0 * h["dissipated"][-1] / whole,
            "work_over_Gc": work / whole,
            "work_over_closed_form": work / (factor * taken),
            "force_over_coulomb": down[peak] / (2.0 * apart[peak]) / q,
        }

    return pd.Case(
        particles=pd.Lattice((0.0, 0.0), (0.5 * SIDE, SIDE), dx, cut=pd.region.Box((0.0, SIDE - DEPTH), (x, SIDE))),
        symmetry=[pd.Symmetry("x")],
        horizon=horizon * dx,
        **point_damage.body(
            pd.LinearElastic(E, NU, plane="stress"),
            pd.PointDamage(shape, Gc=GC, strength=STRENGTH, protected=~fails), G,
        ),
        cracks=[pd.Segment((0.0, LIGAMENT), (0.0, SIDE))],
        conditions=[pd.PointSupport(foot, y=0.0), pd.Contact(wall, wedge, friction, name="wedge")],
        steps=pd.Steps(times=times),
        history={
            "stored": pd.StrainEnergy(),
            "control": pd.ControlEnergy(),
            "dissipated": pd.DissipatedEnergy(),
            "work": pd.ExternalWork(),
            "opening": pd.Mean(pd.displacement, "x", pd.region.Nearest((x + 0.5 * dx, y))),
        },
        results=results,
        expect={
            "dissipated_over_Gc": pd.Expected(1.0, relative=0.1, source="the declared Gc"),
            "work_over_closed_form": pd.Expected(1.0, relative=0.02, source="Coulomb, halves that turn"),
            "force_over_coulomb": pd.Expected(1.0, relative=1e-3, source="Coulomb"),
        },
        fields=[pd.displacement, pd.local_damage],
        picture=pd.Picture(pd.local_damage, "", 20.0),
    )  # fmt: skip
