"""Concrete beam with a notch in three-point bending: softening, followed by the opening of the notch. Units mm, N.

Span 2000, depth 200, width 50, notch 100 deep, E = 30 GPa, strength 3.33 MPa, fracture energy 0.124 N / mm (Petersson
1981; the tests reach about 0.8 kN). Bond-based, plane stress, bilinear softening.
Results: ``peak_load``, ``peak_deflection``, ``dissipated`` over the fracture energy of the ligament, ``last_load`` over
the peak.

With ``damage=point`` gradient points fail (``pd.PointDamage``) by the same curve, strength and fracture energy, also
those under the load, with correspondence and ``Silling(G)``, standard weights and a Poisson ratio of 0.2. ``work`` is
that until the end over the fracture energy of the ligament.
"""

import concrete

import pdpetsc as pd

SPAN, DEPTH, WIDTH, NOTCH = 2000.0, 200.0, 50.0, 100.0
E, STRENGTH, GF = 30e3, 3.33, 0.124


def case(n=20, horizon=3.015, step=0.02, end=0.6, damage="bonds", G=0.5):
    dx = DEPTH / n
    delta = horizon * dx
    half = 0.5 * SPAN
    low = pd.region.Slab("y", high=dx)
    left, right = pd.region.Nearest((0.0, 0.0)), pd.region.Nearest((SPAN, 0.0))
    loaded = pd.region.Box((half - 2.0 * dx, DEPTH - dx), (half + 2.0 * dx, DEPTH))
    lips = [low & pd.region.Slab("x", half - 2.0 * dx, half), low & pd.region.Slab("x", half, half + 2.0 * dx)]
    away = pd.region.Slab("x", high=half - 0.5 * DEPTH) | pd.region.Slab("x", low=half + 0.5 * DEPTH)
    under = pd.region.Box((half - 2.0 * delta, DEPTH - dx), (half + 2.0 * delta, DEPTH))
    load = 1000.0
    area = GF * WIDTH * (DEPTH - NOTCH)
    points = pd.choose("damage", damage, {"bonds": False, "point": True})

    def results(h):
        found, peak = concrete.at_peak(h["t"], load)
        return {
            **found,
            "peak_deflection": -h["deflection"][peak],
            "dissipated": h["dissipated"][-1] / area,
            **({"work": h["work"][-1] / area} if points else {"broken_bonds": h["broken"][-1]}),
        }

    if points:
        model = concrete.of_points(E, 0.2, STRENGTH, GF, G, pd.softening.Bilinear(), away)
    else:
        model = {
            "material": pd.BondBased(E=E, plane="stress", calibration="family"),
            "damage": concrete.bilinear(E, STRENGTH, GF, delta, protected=away | under),
        }
    return pd.Case(
        particles=pd.Lattice((0.0, 0.0), (SPAN, DEPTH), dx, thickness=WIDTH),
        horizon=delta,
        **model,
        cracks=[pd.Segment((half, -1.0), (half, NOTCH))],
        conditions=[
            pd.Displacement(left, x=0.0, y=0.0),
            pd.Displacement(right, y=0.0),
            pd.Force(loaded, y=-load),
        ],
        solver=pd.PathFollowing(pd.Opening("x", lips[1], against=lips[0], step=step, end=end), until=0.02),
        history={
            "deflection": pd.Mean(pd.displacement, "y", loaded),
            "opening": pd.Mean(pd.displacement, "x", lips[1]),
            **({"control": pd.ControlEnergy()} if points else {"broken": pd.BrokenBonds()}),
            "tip": pd.CrackTip((0.0, 1.0), 0.25, pd.region.Slab("y", high=DEPTH - dx)),
            "dissipated": pd.DissipatedEnergy(),
            "stored": pd.StrainEnergy(),
            "work": pd.ExternalWork(),
        },
        results=results,
        expect={"peak_load": pd.Expected(800.0, relative=0.15, source="tests (Petersson 1981), about 0.8 kN")},
        fields=[pd.displacement, pd.local_damage],
        picture=pd.Picture(pd.local_damage, "", 50.0),
    )
