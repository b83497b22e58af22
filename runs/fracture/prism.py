"""Notched prism pulled apart across its ligament, in space: the work it takes over Gc. Units mm, N.

Half of a prism of 20 x 8 x 8 mm, beside the mirror plane z = 0, with a notch across its middle through half its depth;
E = 1000 MPa, nu = 0.2, fracture energy 0.1 N / mm, ``n`` particles over the depth. Gradient points fail
(``pd.PointDamage`` by a softening ``curve``), with correspondence, ``Silling(G)`` and standard weights. The ends are
moved apart by ``pull`` and do not turn.
Results, over the fracture energy of the ligament: ``work``, ``dissipated``, ``left``, what is stored at the end;
``peak_stress``, in the ligament, over the strength; ``last_load`` over the peak.
"""

import point_damage

import pdpetsc as pd

LENGTH, DEPTH = 20.0, 8.0
E, NU, GC = 1000.0, 0.2, 0.1


def case(n=8, horizon=2.015, G=2.0, curve="linear", strength=2.5, pull=0.2, steps=30):
    dx = DEPTH / n
    area = 0.25 * DEPTH**2
    grips = horizon * dx
    low, high = pd.region.Slab("x", high=1.01 * dx), pd.region.Slab("x", low=LENGTH - 1.01 * dx)
    held = pd.region.Slab("x", high=grips) | pd.region.Slab("x", low=LENGTH - grips)
    curves = pd.choose("curve", curve, point_damage.CURVES)

    def results(h):
        peak, taken = max(h["force"]), area * GC
        return {
            "work": h["work"][-1] / taken,
            "dissipated": h["dissipated"][-1] / taken,
            "left": (h["stored"][-1] + h["control"][-1]) / taken,
            "peak_stress": peak / area / strength,
            "last_load": h["force"][-1] / peak,
        }

    return pd.Case(
        particles=pd.Lattice((0.0, 0.0, 0.0), (LENGTH, DEPTH, 0.5 * DEPTH), dx),
        horizon=horizon * dx,
        symmetry=[pd.Symmetry("z")],
        **point_damage.body(
            pd.LinearElastic(E, NU), pd.PointDamage(curves, Gc=GC, strength=strength, protected=held), G
        ),
        cracks=[
            pd.PolygonCrack(
                [
                    (0.5 * LENGTH, y, z)
                    for y, z in ((-DEPTH, -DEPTH), (0.5 * DEPTH, -DEPTH), (0.5 * DEPTH, DEPTH), (-DEPTH, DEPTH))
                ]
            )
        ],
        conditions=[pd.Displacement(low, x=0.0, y=0.0), pd.Displacement(high, x=pull, y=0.0)],
        steps=pd.Steps(steps),
        history={"force": pd.Reaction("x", high), **point_damage.energies()},
        results=results,
        expect={"work": pd.Expected(1.0, relative=0.2, source="the declared Gc times the area of the ligament")},
        fields=[pd.displacement, pd.local_damage],
        picture=pd.Picture(pd.local_damage, "", 10.0),
    )
