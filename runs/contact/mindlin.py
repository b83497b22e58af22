"""Cylinder pressed on an elastic body and then moved sideways: Cattaneo-Mindlin. Any consistent units.

A rigid cylinder of radius 3 below a half disc of radius 4, E = 1e6, plane strain, held along its arc, moves up by
``load``, and then sideways by ``slide`` times ``friction load`` in twelve steps. The particles are nodes of
quadrilaterals that grow away from the contact (``refined.py``): ``n`` over 0.08 at the contact.

With ``bodies=2`` two elastic half cylinders of radius 3 are pressed together, with ``n`` and ``3 n / 2`` over 0.08; the
diameter of the upper one moves.

With the normal force P and the tangential force Q the half width c of the zone that sticks, over that of the contact,
is ``c / a = sqrt(1 - Q / (friction P))``, and the shear traction with Hertz's largest pressure p0 is

    q = friction p0 (sqrt(1 - (x / a)^2) - c / a sqrt(1 - (x / c)^2)),

the second root only within c. That holds if normal and tangential displacements do not depend on each other: for two
bodies of one material, and for a rigid one if nu = 0.5. The default is 0.45, which is near to that and needs no
treatment of bodies that keep their volume.

Results: ``force`` P, ``stick_25``, ``stick_50``, ``stick_75``, the area of the facets that stick over that of all that
touch at ``Q / (friction P)`` = 0.25, 0.5 and 0.75, interpolated between the steps, the second also as
``stick_over_contact``; ``shear_error``, the relative error of the shear traction in the L2 norm at 0.5, which includes
that of the pressing: with one body and nu < 0.5 its two halves are unlike;
``sliding_force``, the largest Q over ``friction P``; and ``half_width_over_hertz`` of the pressed cylinder.
"""

import sys
from pathlib import Path

import numpy as np

sys.path.append(str(Path(__file__).parent))
import hertz
import refined

import pdpetsc as pd

E, RADIUS, OUTER = 1e6, 3.0, 4.0
CORE = 0.08
# Load parameter at which the cylinder is pressed and begins to move sideways.
PRESSED = 0.25
STEPS = 12
SHARES = (0.25, 0.5, 0.75)


class Sticking(pd.Quantity):
    """Area of the facets that stick over the area of all that touch."""

    friction, curvature = 0.0, 0.0

    def __init__(self, friction, curvature):
        object.__setattr__(self, "friction", friction)
        object.__setattr__(self, "curvature", curvature)

    def evaluate(self, solution):
        _, pressure, shear, area = self.of_facets(solution)
        if not len(area):
            return 0.0
        # The surfaces have moved, so that their normals differ from these a little.
        return float(area[np.abs(shear) < 0.99 * self.friction * pressure].sum() / area.sum())

    def of_facets(self, solution):
        """Return positions along the contact, pressures, shear tractions and areas of the facets that touch."""
        x, traction, area = hertz.touching(solution)
        normal = self.curvature * x + (0.0, 1.0)
        normal /= np.linalg.norm(normal, axis=1)[:, None]
        along = np.stack([normal[:, 1], -normal[:, 0]], axis=1)
        return x[:, 0], np.abs((traction * normal).sum(axis=1)), (traction * along).sum(axis=1), area


class ShearError(Sticking):
    """Relative error of the shear traction in the L2 norm, against the closed form for the forces of the contact."""

    radius, modulus = 1.0, 1.0

    def __init__(self, friction, curvature, radius, modulus):
        super().__init__(friction, curvature)
        object.__setattr__(self, "radius", radius)
        object.__setattr__(self, "modulus", modulus)

    def evaluate(self, solution):
        x, pressure, shear, area = self.of_facets(solution)
        P, Q = area @ pressure, abs(area @ shear)
        if not 1e-9 * P < Q < self.friction * P:
            return 0.0
        a, peak = hertz.line(P, self.radius, self.modulus)
        c = a * np.sqrt(1.0 - Q / (self.friction * P))
        x = x - area * pressure @ x / P
        whole, sticking = (np.sqrt(np.maximum(1.0 - (x / half) ** 2, 0.0)) for half in (a, c))
        exact = self.friction * peak * (whole - c / a * sticking)
        return float(np.sqrt(area @ (np.abs(shear) - exact) ** 2 / (area @ exact**2)))


def cylinder(n, side):
    """Return the nodes of half a cylinder above (side 1) or below (-1) the origin."""
    points, cells = refined.mirrored(*refined.corner(n, CORE, 2.0 * RADIUS, 2))
    return refined.disc(refined.ball(points, RADIUS) * (1.0, side), cells, side * RADIUS)


def case(n=24, friction=0.3, load=0.002, slide=1.2, nu=0.45, bodies=1):
    pressing, sliding = pd.Table([0.0, PRESSED, 1.0], [0.0, 1.0, 1.0]), pd.Table([0.0, PRESSED, 1.0], [0.0, 0.0, 1.0])
    modulus = E / (1.0 - nu**2)
    if bodies == 1:
        points, cells = refined.mirrored(*refined.corner(n, CORE, OUTER, 2))
        cloud = refined.cloud(points, cells, points[:, 1] < 1e-9)
        particles, size, radius, curvature = cloud.particles, cloud.size, RADIUS, 1.0 / RADIUS
        tool = pd.RigidSphere(
            (0.0, -RADIUS), RADIUS, move=(slide * friction * load, load), schedule=(sliding, pressing)
        )
        arc = ~pd.region.Sphere((0.0, 0.0), OUTER * (1.0 - 1e-9))
        conditions = [
            pd.Displacement(arc, x=0.0, y=0.0),
            cloud.contact(tool, friction, 10.0 * modulus, CORE / n, "contact"),
        ]
    else:
        upper, lower = cylinder(n, 1.0), cylinder(3 * n // 2, -1.0)
        particles = pd.Bodies({"upper": upper.particles, "lower": lower.particles})
        size, radius, curvature, modulus = np.concatenate([upper.size, lower.size]), 0.5 * RADIUS, 0.0, 0.5 * modulus
        near = pd.region.Named("contact") & pd.region.Sphere((0.0, 0.0), 1.5 * CORE)
        diameter = pd.region.Slab("y", low=RADIUS * (1.0 - 1e-9))
        conditions = [
            pd.Displacement(pd.region.Slab("y", high=-RADIUS * (1.0 - 1e-9)), x=0.0, y=0.0),
            pd.Displacement(diameter, x=slide * friction * load, schedule=sliding),
            pd.Displacement(diameter, y=-load, schedule=pressing),
            pd.BodyContact(
                pd.region.Named("upper") & near, pd.region.Named("lower") & near, friction, penetration=1e-3,
                stiffness=10.0 * modulus / (CORE / n), name="contact",
            ),
        ]  # fmt: skip

    def results(h):
        x, y = np.abs(h["contact_x"]), np.abs(h["contact_y"])
        pressed = np.asarray(h["t"]) > PRESSED - 1e-9
        share = (x / np.where(y > 0.0, friction * y, 1.0))[pressed]
        stick = np.asarray(h["stick"])[pressed]
        first = int(np.argmax(pressed))
        a, _ = hertz.line(y[first], radius, modulus)
        found = {f"stick_{round(100 * at)}": float(np.interp(at, share, stick)) for at in SHARES}
        return {
            "force": y[-1],
            **found,
            "stick_over_contact": found["stick_50"],
            "shear_error": float(np.interp(0.5, share, np.asarray(h["shear_error"])[pressed])),
            "sliding_force": share.max(),
            "half_width_over_hertz": h["half_width"][first] / a,
        }

    return pd.Case(
        particles=particles,
        horizon=2.1 * size,
        material=pd.LinearElastic(E=E, nu=nu),
        conditions=conditions,
        steps=pd.Steps(times=(PRESSED, *(PRESSED + (1.0 - PRESSED) * k / STEPS for k in range(1, STEPS)), 1.0)),
        history={
            "stick": Sticking(friction, curvature),
            "shear_error": ShearError(friction, curvature, radius, modulus),
            "half_width": hertz.HalfWidth(),
        },
        results=results,
        expect={
            f"stick_{round(100 * at)}": pd.Expected(np.sqrt(1.0 - at), absolute=0.05, source="Cattaneo, Mindlin")
            for at in SHARES
        },
        # Iterative solvers need a hundred iterations for each of the many Newton iterations.
        options={"pc_type": "lu"},
        picture=pd.Picture(pd.stress, "xy"),
    )
