"""Beam on two rigid rollers that a third one bends: Timoshenko's beam. Any consistent units.

A beam of depth 1, E = 1e4, nu = 0.3, plane stress, with a span of 8 and ends 0.5 beyond the rollers, of radius 0.5. The
upper roller moves down by ``load``. Half of the beam is computed, on nodes, ``n`` over the depth. A very soft
foundation holds it, because a case refuses a body that only contact holds. With ``supports=points`` the means of the
displacements of small patches are prescribed instead of rollers.

Timoshenko: ``w / F = S^3 / (48 E I) + S / (4 k G A)``, k = 5/6, with w the difference of the deflections of the axis
above the support and below the load, which leaves the indentations out.

Results: ``force`` of the upper roller on the whole beam, ``deflection`` w, ``stiffness_over_timoshenko``, and
``support_over_force``, twice the reaction of a support over the force.

With ``damage=point`` the beam has a notch to half of its depth in the middle, and is bent until it is in two pieces:
gradient points fail (``pd.PointDamage``) by a softening ``curve`` of strength 1 and fracture energy 3e-4, with
correspondence and ``Silling(G)``, on a lattice beside a mirror plane. The upper roller moves down by ``load`` in
``steps`` load steps that grow. Results: ``peak_load``, ``final_over_peak``, ``dissipated_over_Gc``, of the points that
fail, and ``work_over_Gc``, of the upper roller by the trapezoidal rule, both over the fracture energy of the ligament;
``balance``, the latter over stored and dissipated energy; ``support_over_force`` at the peak. With an ``opening`` of
half of the mouth of the notch the upper roller follows the path on which the mouth opens, by at most
``opening / steps`` a step.
"""

import sys
from pathlib import Path

import numpy as np

sys.path.append(str(Path(__file__).parent.parent / "fracture"))
import point_damage

import pdpetsc as pd

E, NU = 1e4, 0.3
STRENGTH, GC, NOTCH = 1.0, 3e-4, 0.5
SPAN, END, DEPTH, RADIUS = 8.0, 0.5, 1.0, 0.5


def timoshenko():
    """Return the force over the deflection."""
    inertia, shear = DEPTH**3 / 12.0, 5.0 / 6.0 * 0.5 * E / (1.0 + NU) * DEPTH
    return 1.0 / (SPAN**3 / (48.0 * E * inertia) + SPAN / (4.0 * shear))


def held(supports, friction, load, dx, nearer=0.0):
    """Return conditions by rollers or points, and what the history has of points.

    Rollers begin ``nearer`` to the beam than in touch with its straight sides.
    """
    if pd.choose("supports", supports, {"rollers": True, "points": False}):
        below = pd.RigidSphere((0.5 * SPAN, nearer - RADIUS), RADIUS)
        above = pd.RigidSphere((0.0, DEPTH + RADIUS - nearer), RADIUS, move=(0.0, -load))
        soft = pd.Foundation("-y", normal=1e-8 * E, tangential=1e-8 * E)
        return [
            pd.Contact("-y", below, friction, name="below"), pd.Contact("+y", above, friction, name="above"), soft
        ], {}  # fmt: skip
    feet, head = pd.region.Sphere((0.5 * SPAN, 0.0), 1.1 * dx), pd.region.Sphere((0.0, DEPTH), 1.1 * dx)
    return [pd.PointSupport(feet, y=0.0), pd.PointSupport(head, y=-load)], {
        "below_y": pd.Reaction("y", feet), "above_y": pd.Reaction("y", head)
    }  # fmt: skip


def case(
    n=16, friction=0.0, load=0.02, supports="rollers", damage="none", curve="bilinear", G=0.5, horizon=2.015, steps=40,
    opening=0.0,
):  # fmt: skip
    if pd.choose("damage", damage, {"none": False, "point": True}):
        return of_points(n, friction, load, supports, curve, G, horizon, steps, opening)
    dx = DEPTH / n
    conditions, reactions = held(supports, friction, load, dx)

    def results(h):
        force, w = -2.0 * h["above_y"][-1], h["support"][-1] - h["middle"][-1]
        return {
            "force": force,
            "deflection": w,
            "stiffness_over_timoshenko": force / w / timoshenko(),
            "support_over_force": 2.0 * h["below_y"][-1] / force,
        }

    return pd.Case(
        particles=pd.LatticeNodes((0.0, 0.0), (0.5 * SPAN + END, DEPTH), dx),
        material=pd.LinearElastic(E=E, nu=NU, plane="stress"),
        conditions=[pd.Roller("-x"), *conditions],
        steps=pd.Steps(2),
        history={
            **reactions,
            "support": pd.At((0.5 * SPAN, 0.5 * DEPTH), pd.displacement, "y"),
            "middle": pd.At((0.0, 0.5 * DEPTH), pd.displacement, "y"),
        },
        results=results,
        expect={
            "stiffness_over_timoshenko": pd.Expected(1.0, relative=0.03, source="Timoshenko"),
            "support_over_force": pd.Expected(1.0, relative=0.01, source="equilibrium"),
        },
        picture=pd.Picture(pd.stress, "xx", scale=10.0),
    )


def of_points(n, friction, load, supports, curve, G, horizon, steps, opening):
    """Return the notched beam whose gradient points fail."""
    dx = DEPTH / n
    # The middles of facets touch, half a spacing beside the rollers.
    conditions, reactions = held(supports, friction, load, dx, RADIUS - np.sqrt(RADIUS**2 - 0.25 * dx**2))
    shape = pd.choose("curve", curve, point_damage.CURVES)
    away = pd.region.Slab("x", low=0.5 * DEPTH)
    mouth = pd.region.Nearest((0.5 * dx, 0.5 * dx))
    path = pd.PathFollowing(pd.Opening("x", mouth, step=opening / steps, end=opening), until=0.02) if opening else None

    def results(h):
        force = -2.0 * np.array(h["above_y"])
        peak, whole = int(np.argmax(force)), GC * (DEPTH - NOTCH)
        work = 2.0 * h["work"][-1]
        taken = 2.0 * sum(h[name][-1] for name in ("stored", "control", "dissipated"))
        return {
            "peak_load": force[peak],
            "final_over_peak": force[-1] / force[peak],
            "dissipated_over_Gc": 2.0 * h["dissipated"][-1] / whole,
            "work_over_Gc": work / whole,
            "balance": work / taken,
            "support_over_force": 2.0 * h["below_y"][peak] / force[peak],
        }

    return pd.Case(
        particles=pd.Lattice((0.0, 0.0), (0.5 * SPAN + END, DEPTH), dx),
        symmetry=[pd.Symmetry("x")],
        horizon=horizon * dx,
        **point_damage.body(
            pd.LinearElastic(E, NU, plane="stress"),
            pd.PointDamage(shape, Gc=GC, strength=STRENGTH, protected=away), G,
        ),
        cracks=[pd.Segment((0.0, 0.0), (0.0, NOTCH))],
        conditions=conditions,
        steps=pd.Steps(times=[(k / steps) ** 2 for k in range(1, steps + 1)]),
        solver=path or pd.Newton(),
        history={
            **reactions,
            "stored": pd.StrainEnergy(),
            "control": pd.ControlEnergy(),
            "dissipated": pd.DissipatedEnergy(),
            "work": pd.ExternalWork(),
        },
        results=results,
        expect={
            "dissipated_over_Gc": pd.Expected(1.0, relative=0.1, source="the declared Gc"),
            "balance": pd.Expected(1.0, relative=0.02, source="energy balance"),
            "support_over_force": pd.Expected(1.0, relative=0.01, source="equilibrium"),
        },
        fields=[pd.displacement, pd.local_damage],
        picture=pd.Picture(pd.local_damage, "", scale=10.0),
    )  # fmt: skip
