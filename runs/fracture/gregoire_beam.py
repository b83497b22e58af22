"""Notched concrete beam in three-point bending, followed by the opening of its notch. Units mm, N.

As it stands 175 x 50 x 50, span 125, notch 25 deep, E = 37 GPa, strength 3.9 MPa, fracture energy 0.1432 N / mm
(Gregoire 2013; the tests peak at 933 to 1114 N with the notch 0.018 to 0.023 mm open, and carry 380 to 644 N at 0.10
mm). Bond-based, plane stress, bilinear softening.
Results: ``peak_load``, ``opening_at_peak``, ``load_at_0.1``, ``dissipated``, ``last_load``.

Beams of another ``depth`` have the same width and 3.5 times their depth as length, 2.5 times as span (tests: 50, 100,
200 and 400 mm); ``notch`` is the depth of the notch over that of the beam (tests: 0.5, 0.2 and none).

With ``damage=point`` gradient points fail (``pd.PointDamage``) by the same curve, strength and fracture energy, with
correspondence and ``Silling(G)``, plane stress, standard weights, and a Poisson ratio of 0.2. ``work`` is that
until the end over the fracture energy of the ligament: 1 when nothing is left of the load (``end=2``).
"""

import concrete

WIDTH = 50.0
E, STRENGTH, GF = 37e3, 3.9, 0.1432


def case(
    n=40, horizon=2.015, step=0.004, end=0.12, strength=STRENGTH, Gf=GF, damage="bonds", G=2.0, depth=50.0, notch=0.5
):
    size, span = (3.5 * depth, depth, WIDTH), 2.5 * depth
    return concrete.bent_beam(
        size, span, notch * depth, E, strength, Gf, n, horizon, step, end, at=(0.1,), damage=damage, G=G
    )
