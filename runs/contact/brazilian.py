"""Disc between two rigid planes: the tension at its centre, as in the Brazilian test. Units mm, N.

A disc of diameter D = 50, E = 50,000, nu = 0.2, plane strain, of unit thickness. Rigid planes approach its centre by
``load`` each. A quarter is computed, on nodes of quadrilaterals that grow away from the contact (``refined.py``): ``n``
over 0.4 mm at the contact, and about 50 / n mm wide at the centre.

Under two opposite forces P the centre has ``s_x = 2 P / (pi D)`` and ``s_y = -6 P / (pi D)`` per thickness (Hondros
1959): 0.8488 and -2.5465 MPa for 1 kN on 15 mm, which is near to the force here. The contact is a hundredth of the
radius wide. For the force ``load = 2 P / (pi E*) (ln(4 R / a) - 1 / 2)`` (Johnson, equation 5.57).

Results: ``force`` P per thickness, ``tension`` and ``compression`` of the centre, ``tension_over_closed_form`` and
``compression_over_closed_form`` for P, and ``force_over_johnson``.

With ``damage=point`` the disc splits: gradient points fail (``pd.PointDamage``) by a linear curve of strength f = 10
MPa and fracture energy ``Gc``, with correspondence and ``Silling(G)``. The whole disc is computed, with 20 degrees flat
on each side (Wang 2004), ``n`` cells over 0.3 D in the middle, and its cloud turned by ``angle`` degrees. Points within
D / 8 of the planes do not fail. The planes follow the path on which two points beside the loaded diameter, 0.3 D apart,
move apart, up to ``opening`` in ``steps`` steps; the load factor multiplies ``load``.

Under a uniform pressure on a width b the centre has ``s_x = 2 P / (pi D) (1 - (b / D)^2)^(3 / 2)`` (Tang 1994). A
brittle disc splits when s_x is f. A softening one carries more, the more the larger ``E Gc / (D f^2)`` is. Its halves
still carry a load.

Results: ``tension_over_closed_form`` of the first step; ``peak_load``, the largest force before it first falls, and
``peak_over_closed_form``; ``peak_over_elastic``, over the load at which an elastic disc on this cloud has the tension
f; ``lowest_over_peak``, the least force afterwards; ``centre_over_strength``, the largest tension of the centre over f;
``path_off_diameter``, the largest distance over the radius between the loaded diameter and the line that fits the
failed particles best; ``dissipated_over_Gc``, over Gc times the diameter between the planes; ``balance``, work over
stored and dissipated energy.
"""

import sys
from dataclasses import dataclass
from pathlib import Path

import numpy as np

sys.path.append(str(Path(__file__).parent))
sys.path.append(str(Path(__file__).parent.parent / "fracture"))
import hertz
import point_damage
import refined

import pdpetsc as pd

E, NU, RADIUS = 50e3, 0.2, 25.0
MODULUS = E / (1.0 - NU**2)
CORE = 0.4
STRENGTH = 10.0
# Half of the angle of a flat side, and the distance of a flat side from the centre.
FLAT = np.radians(10.0)
HEIGHT = RADIUS * np.cos(FLAT)


def case(
    n=16, friction=0.0, load=0.00465, damage="none", Gc=0.045, G=0.5, horizon=3.015, angle=0.0, opening=0.012, steps=40
):
    if pd.choose("damage", damage, {"none": False, "point": True}):
        return splitting(n, friction, load, Gc, G, horizon, angle, opening, steps)
    points, cells = refined.corner(n, CORE, 2.0 * RADIUS, 2)
    cloud = refined.disc(refined.ball(points, RADIUS), cells, RADIUS)
    plane = pd.RigidPlane((0.0, 0.0), (0.0, 1.0), move=(0.0, load))
    centre = (0.0, RADIUS)

    def results(h):
        force = 2.0 * h["plane_y"][-1]
        unit = 2.0 * force / (np.pi * 2.0 * RADIUS)
        return {
            "force": force,
            "tension": h["s_x"][-1],
            "compression": -h["s_y"][-1],
            "tension_over_closed_form": h["s_x"][-1] / unit,
            "compression_over_closed_form": -h["s_y"][-1] / (3.0 * unit),
            "force_over_johnson": force / hertz.disc(load, RADIUS, MODULUS),
        }

    return pd.Case(
        particles=cloud.particles,
        horizon=2.1 * cloud.size,
        material=pd.LinearElastic(E=E, nu=NU),
        conditions=[
            pd.Displacement(pd.region.Slab("x", high=1e-9), x=0.0),
            pd.Displacement(pd.region.Slab("y", low=RADIUS - 1e-9), y=0.0),
            cloud.contact(plane, friction, 10.0 * MODULUS, CORE / n, "plane"),
        ],
        history={
            "s_x": pd.At(centre, pd.stress, "xx"),
            "s_y": pd.At(centre, pd.stress, "yy"),
        },
        results=results,
        expect={
            "tension_over_closed_form": pd.Expected(1.0, relative=0.03, source="Hondros 1959"),
            "compression_over_closed_form": pd.Expected(1.0, relative=0.03, source="Hondros 1959"),
            "force_over_johnson": pd.Expected(1.0, relative=0.02, source="Johnson 1985, equation 5.57"),
        },
        picture=pd.Picture(pd.stress, "xx"),
    )


@dataclass(frozen=True)
class OffDiameter(pd.Quantity):
    """Largest distance over the radius of the line that fits the failed particles best from the y axis [-]."""

    dimension = "1"

    def evaluate(self, solution):
        """Return the distance, 0 where fewer than two particles have failed."""
        x, y = solution.x[pd.local_damage(solution) > 0.5].T / RADIUS
        n, sx, sy, syy, sxy = (solution.sum(float(np.sum(v))) for v in (np.ones_like(x), x, y, y * y, x * y))
        spread = n * syy - sy**2
        if spread <= 0.0:
            return 0.0
        slope = (n * sxy - sx * sy) / spread
        return abs(slope) + abs(sx - slope * sy) / n


def flattened(n, angle):
    """Return the cloud of the whole disc about the origin, turned by an angle [degrees], with flat sides."""
    points, cells = refined.mirrored(*refined.corner(n, 0.6 * RADIUS, RADIUS, 2))
    points, cells = refined.mirrored(points[:, ::-1], cells)
    c, s = np.cos(np.radians(angle)), np.sin(np.radians(angle))
    x, y = np.array([[c, -s], [s, c]]) @ points.T
    on = np.hypot(x, y) > (1.0 - 1e-9) * RADIUS
    round_height = np.sqrt(np.maximum(RADIUS**2 - x**2, 0.0))
    return refined.cloud(np.column_stack([x, y * HEIGHT / np.maximum(round_height, HEIGHT)]), cells, on)


def splitting(n, friction, load, Gc, G, horizon, angle, opening, steps):
    """Return the disc whose gradient points fail."""
    cloud = flattened(n, angle)
    sides = {"below": -1.0, "above": 1.0}
    far = pd.region.Slab("y", low=HEIGHT - 0.25 * RADIUS) | pd.region.Slab("y", high=0.25 * RADIUS - HEIGHT)
    right, left = (pd.region.Nearest((x, 0.0)) for x in (0.3 * RADIUS, -0.3 * RADIUS))
    # Uniform pressure on the flat sides, over two forces.
    share = np.cos(FLAT) ** 3

    def results(h):
        force, tension = -np.array(h["above_y"]), np.array(h["s_x"])
        peak = int(np.argmax(np.diff(force, append=0.0) < 0.0))
        brittle = np.pi * RADIUS * STRENGTH / share
        taken = sum(h[name][-1] for name in ("stored", "control", "dissipated"))
        return {
            "tension_over_closed_form": tension[1] / (share * force[1] / (np.pi * RADIUS)),
            "peak_load": force[peak],
            "peak_over_closed_form": force[peak] / brittle,
            "peak_over_elastic": force[peak] * tension[1] / force[1] / STRENGTH,
            "lowest_over_peak": force[peak:].min() / force[peak],
            "centre_over_strength": tension.max() / STRENGTH,
            "path_off_diameter": h["path"][-1],
            "dissipated_over_Gc": h["dissipated"][-1] / (2.0 * HEIGHT * Gc),
            "balance": h["work"][-1] / taken,
        }

    return pd.Case(
        particles=cloud.particles,
        horizon=horizon * cloud.size,
        material=pd.LinearElastic(E=E, nu=NU),
        scheme=pd.Correspondence(),
        control=pd.Silling(G),
        damage=pd.PointDamage(pd.softening.Linear(), Gc=Gc, strength=STRENGTH, protected=far),
        conditions=[
            *(
                pd.Contact(
                    pd.region.Slab("y", low=0.0) if side > 0.0 else pd.region.Slab("y", high=0.0),
                    # Just not in touch, whatever the round-off.
                    pd.RigidPlane((0.0, side * (1.0 + 1e-9) * HEIGHT), (0.0, -side), move=(0.0, -side * load)),
                    friction,
                    stiffness=100.0 * MODULUS * n / RADIUS,
                    name=name,
                )
                for name, side in sides.items()
            ),
            # A case refuses a body that only contact holds.
            pd.Foundation("contact", normal=1e-7 * E / RADIUS, tangential=1e-7 * E / RADIUS),
        ],
        solver=pd.PathFollowing(pd.Opening("x", right, against=left, step=opening / steps, end=opening), first=1.0),
        history={
            **point_damage.energies(),
            "s_x": pd.At((0.0, 0.0), pd.stress, "xx"),
            "path": OffDiameter(),
        },
        results=results,
        expect={
            "tension_over_closed_form": pd.Expected(1.0, relative=0.05, source="Tang 1994"),
            "peak_over_closed_form": pd.Expected(1.0, relative=0.05, source="Tang 1994, brittle"),
            "centre_over_strength": pd.Expected(1.0, relative=0.05, source="the declared strength"),
            "path_off_diameter": pd.Expected(0.0, absolute=0.05, source="symmetry"),
            "balance": pd.Expected(1.0, relative=0.02, source="energy balance"),
        },
        fields=[pd.displacement, pd.local_damage, pd.stress],
        picture=pd.Picture(pd.local_damage, "", scale=20.0),
    )
