"""Concrete beam with a notch beside its middle in three-point bending: mixed mode. Units mm, N.

250 x 80 x 50, span 200, notch 20 deep and 50 from the middle, E = 33.8 GPa, strength 3.5 MPa, fracture energy 0.1252
N / mm (Garcia-Alvarez 2012; the tests peak at 4894 to 5405 N). Bond-based, plane stress, bilinear softening, followed
by the opening of the notch. Results: ``peak_load``, ``opening_at_peak``, ``dissipated``, ``last_load``.

With ``damage=point`` gradient points fail (``pd.PointDamage``) by the same curve, strength and fracture energy, with
correspondence and ``Silling(G)``, plane stress, standard weights, and a Poisson ratio of 0.2.
"""

import concrete

SIZE, SPAN, NOTCH, OFFSET = (250.0, 80.0, 50.0), 200.0, 20.0, 50.0
E, STRENGTH, GF = 33.8e3, 3.5, 0.1252


def case(n=32, horizon=2.015, step=0.004, end=0.12, strength=STRENGTH, Gf=GF, damage="bonds", G=2.0):
    return concrete.bent_beam(
        SIZE, SPAN, NOTCH, E, strength, Gf, n, horizon, step, end, OFFSET, load=5000.0, damage=damage, G=G
    )
