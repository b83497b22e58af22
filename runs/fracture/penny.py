"""Penny-shaped crack in a cylinder, one eighth of it, pulled until it runs: the stress over Griffith's. Units mm, N.

Crack of radius 5 mm in a cylinder of ``wide`` times that radius and length; E = 1000 MPa, nu = 0.2, fracture energy
0.1 N / mm, ``n`` particles along the radius of the crack. Gradient points fail (``pd.PointDamage`` by a softening
``curve``, with a strain without stress of ``ratio`` times that at the onset), with correspondence, ``Silling(G)`` and
standard weights. The path is followed by the opening of the middle, in steps of ``step`` to ``end`` times the opening
``8 (1 - nu^2) s a / (pi E)`` of the exact crack at the stress s at which it runs.
Results: ``peak_stress``; ``griffith``, the stress at which ``K_I = 2 s sqrt(a / pi) F`` is ``sqrt(E Gc / (1 - nu^2))``,
with ``F = (1 - q / 2 + 0.148 q^3) / sqrt(1 - q)``, ``q = 1 / wide`` (Tada, Paris, Irwin); ``over_griffith``;
``cohesive``, the same of a cohesive crack in an infinite solid (``cohesive.py``); ``cohesive_length``, ``E Gc /
strength^2`` over the radius, for which both tend to 1 as it gets small; ``stiffness``, opening over that of the exact
crack in the first step; ``balance``, work over stored and dissipated energy.
"""

import cohesive
import numpy as np
import point_damage

import pdpetsc as pd

RADIUS = 5.0
E, NU, GC = 1000.0, 0.2, 0.1


def case(n=5, horizon=2.015, G=2.0, curve="linear", ratio=2.0, wide=2.6, step=0.1, end=1.3):
    dx = RADIUS / n
    delta = horizon * dx
    side = round(wide * n) * dx
    q = RADIUS / side
    factor = (1.0 - 0.5 * q + 0.148 * q**3) / np.sqrt(1.0 - q)
    griffith = np.sqrt(0.25 * np.pi * E * GC / (1.0 - NU**2) / RADIUS) / factor
    opening = 4.0 * (1.0 - NU**2) * griffith * RADIUS / (np.pi * E)
    top = pd.region.Slab("z", low=side - 1.01 * dx)
    middle = pd.region.Box((0.0, 0.0, 0.0), (1.01 * dx, 1.01 * dx, 1.01 * dx))
    material = pd.LinearElastic(E, NU)
    far = pd.region.Slab("z", low=side - 3.0 * delta)
    damage = point_damage.damage_of_ratio(curve, material, GC, ratio, delta, dx, protected=far, dim=3)
    section = 0.25 * np.pi * side**2

    def results(h):
        stress, length = np.array(h["force"]) / section, E * GC / damage.strength**2 / RADIUS
        return {
            "peak_stress": stress.max(),
            "griffith": griffith,
            "over_griffith": stress.max() / griffith,
            "cohesive": cohesive.over_griffith(cohesive.penny, RADIUS, RADIUS * length / (1.0 - NU**2)),
            "strength": damage.strength,
            "cohesive_length": length,
            "stiffness": h["opening"][1] / opening / (stress[1] / griffith),
            "balance": h["work"][-1] / (h["stored"][-1] + h["control"][-1] + h["dissipated"][-1]),
        }

    return pd.Case(
        particles=pd.Lattice(
            (0.0, 0.0, 0.0), (side, side, side), dx, keep=pd.region.Where(lambda x: np.hypot(x[:, 0], x[:, 1]) < side)
        ),
        horizon=delta,
        symmetry=[pd.Symmetry("x"), pd.Symmetry("y"), pd.Symmetry("z")],
        **point_damage.body(material, damage, G),
        cracks=[pd.Disc((0.0, 0.0, 0.0), (0.0, 0.0, 1.0), RADIUS)],
        conditions=[pd.Displacement(top, z=2.0 * griffith * side / E)],
        solver=pd.PathFollowing(pd.Opening("z", middle, step=step * opening, end=end * opening)),
        history={
            "force": pd.Reaction("z", top),
            "opening": pd.Mean(pd.displacement, "z", middle),
            **point_damage.energies(),
        },
        results=results,
        fields=[pd.displacement, pd.local_damage],
        picture=pd.Picture(pd.local_damage, "", 5.0),
    )
