"""Rigid cylinder pressed on an elastic block: Hertz's line contact. Any consistent units.

A block of 2 x 1, E = 1e6, nu = 0.3, plane strain, on rollers. A rigid cylinder of radius ``radius`` above its middle
moves down by ``load``. Half of the block is computed, on nodes, ``n`` over its depth.

Hertz with the force F of the run, on a half space: half width ``a = sqrt(4 F R / (pi E*))``, largest pressure
``p0 = sqrt(F E* / (pi R))``, ``E* = E / (1 - nu^2)``.

Results: ``force`` of the whole cylinder, ``half_width``, ``peak_pressure``, both over those of Hertz, and
``pressure_error``, the root mean square of the difference from ``p0 sqrt(1 - x^2 / a^2)`` on the facets that touch,
over p0.
"""

import hertz

import pdpetsc as pd

E, NU = 1e6, 0.3
MODULUS = E / (1.0 - NU**2)


def case(n=40, radius=8.0, load=0.004, friction=0.0):
    def results(h):
        force = -2.0 * h["roller_y"][-1]
        a, peak = hertz.line(force, radius, MODULUS)
        return {
            "force": force,
            "half_width": h["roller_area"][-1],
            "peak_pressure": h["peak"][-1],
            "half_width_over_hertz": h["roller_area"][-1] / a,
            "peak_over_hertz": h["peak"][-1] / peak,
            "pressure_error": h["error"][-1],
        }

    roller = pd.RigidSphere((0.0, 1.0 + radius), radius, move=(0.0, -load))
    return pd.Case(
        particles=pd.LatticeNodes((0.0, 0.0), (1.0, 1.0), 1.0 / n),
        material=pd.LinearElastic(E=E, nu=NU),
        conditions=[pd.Roller("-x"), pd.Roller("-y"), pd.Contact("+y", roller, friction, name="roller")],
        history={"peak": hertz.Peak("roller"), "error": hertz.LineError(radius, MODULUS)},
        results=results,
        expect={"peak_over_hertz": pd.Expected(1.0, relative=0.05, source="Hertz")},
        picture=pd.Picture(pd.stress, "yy"),
    )
