"""Half-notched concrete beam in three-point bending, followed by the opening of its notch. Units mm, N.

175 x 50 x 50, span 125, notch 25 deep, E = 37 GPa, strength 3.9 MPa, fracture energy 0.1432 N / mm (Gregoire 2013; the
tests peak at 933 to 1114 N with the notch 0.018 to 0.023 mm open, and carry 380 to 644 N at 0.10 mm). Bond-based,
plane stress, bilinear softening.
Results: ``peak_load``, ``opening_at_peak``, ``load_at_0.1``, ``dissipated``, ``last_load``.

With ``damage=point`` gradient points fail (``pd.PointDamage``) by the same curve, strength and fracture energy, with
correspondence and ``Silling(G)``, plane stress, standard weights, and a Poisson ratio of 0.2.
"""

import concrete

SIZE, SPAN, NOTCH = (175.0, 50.0, 50.0), 125.0, 25.0
E, STRENGTH, GF = 37e3, 3.9, 0.1432


def case(n=40, horizon=2.015, step=0.004, end=0.12, strength=STRENGTH, Gf=GF, damage="bonds", G=2.0):
    return concrete.bent_beam(SIZE, SPAN, NOTCH, E, strength, Gf, n, horizon, step, end, at=(0.1,), damage=damage, G=G)
