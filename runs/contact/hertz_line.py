"""Half cylinder pressed on a rigid plane: Hertz's line contact. Units m, N.

A half cylinder of radius 3, E = 1e6, nu = 0.3, plane strain, lies on a rigid plane, which moves up by ``load``. Half of
it is computed, on nodes of quadrilaterals that grow away from the contact (``refined.py``): ``n`` over 0.08 m at the
contact. ``top=clamped`` holds the flat side in both directions, as in the test hertz_cyl of MOOSE, whose force is 721.2
and 721.5 for two kinds of contact. With ``top=sliding`` it is free along x, as in a disc between two planes: the
closed form is ``load = 2 F / (pi E*) (ln(4 R / a) - 1 / 2)``, F = 690.30 (Johnson, equation 5.57).

Hertz with the force F: half width ``a = sqrt(4 F R / (pi E*))``, largest pressure ``p0 = sqrt(F E* / (pi R))``, ``E* =
E / (1 - nu^2)``. The half width of the run is twice the root mean square distance of its pressure. On its coarse mesh
MOOSE has pressures that exceed those of Hertz for F = 721.2 by 1 to 8 % from the middle to the edge.

Results: ``force`` of the whole width, ``half_width``, ``peak_pressure``, ``force_error``, relative to MOOSE or the
closed form, ``half_width_over_hertz``, ``peak_over_hertz``, ``pressure_error``, the root mean square of the difference
from Hertz over p0 on the facets that touch, and, with the clamped side, ``moose_pressure_error``, the largest relative
difference from MOOSE's pressures at seven places.
"""

import sys
from pathlib import Path

sys.path.append(str(Path(__file__).parent))
import hertz
import refined

import pdpetsc as pd

E, NU, RADIUS = 1e6, 0.3, 3.0
MODULUS = E / (1.0 - NU**2)
CORE = 0.08
# MOOSE, modules/contact, hertz_cyl/half_symm_q4: force with a penalty, pressures over the distance from the middle.
MOOSE = 721.209
PLACES = (0.0117, 0.0211, 0.0286, 0.0346, 0.0394, 0.0433, 0.0464)
PRESSURES = (8991.5, 8441.5, 7692.6, 6833.9, 5909.6, 4945.6, 3737.9)


def case(n=24, load=0.002, friction=0.0, top="clamped", scheme="sub_horizons"):
    points, cells = refined.corner(n, CORE, 2.0 * RADIUS, 2)
    cloud = refined.disc(refined.ball(points, RADIUS), cells, RADIUS)
    clamped = pd.choose("top", top, {"clamped": True, "sliding": False})
    known = {"sub_horizons": pd.SubHorizons, "correspondence": pd.Correspondence}
    plane = pd.RigidPlane((0.0, 0.0), (0.0, 1.0), move=(0.0, load))
    reference = MOOSE if clamped else hertz.disc(load, RADIUS, MODULUS)

    def results(h):
        force = 2.0 * h["plane_y"][-1]
        a, peak = hertz.line(force, RADIUS, MODULUS)
        off = [abs(h[f"p_{x}"][-1] / p - 1.0) for x, p in zip(PLACES, PRESSURES, strict=True)]
        compared = {"moose_pressure_error": max(off)} if clamped else {}
        return {
            "force": force,
            "half_width": h["half_width"][-1],
            "peak_pressure": h["peak"][-1],
            "force_error": force / reference - 1.0,
            "half_width_over_hertz": h["half_width"][-1] / a,
            "peak_over_hertz": h["peak"][-1] / peak,
            "pressure_error": h["error"][-1],
            **compared,
        }

    expect = {
        "half_width_over_hertz": pd.Expected(1.0, relative=0.02, source="Hertz"),
        "peak_over_hertz": pd.Expected(1.0, relative=0.02, source="Hertz"),
        "pressure_error": pd.Expected(0.0, absolute=0.05, source="Hertz"),
    }
    if load == 0.002 and friction == 0.0:
        source = "MOOSE, hertz_cyl/half_symm_q4" if clamped else "Johnson 1985, equation 5.57"
        expect["force"] = pd.Expected(reference, relative=0.01, source=source)
    return pd.Case(
        particles=cloud.particles,
        horizon=2.1 * cloud.size,
        material=pd.LinearElastic(E=E, nu=NU),
        scheme=pd.choose("scheme", scheme, known)(),
        control=None if scheme == "sub_horizons" else pd.Silling(0.5),
        conditions=[
            pd.Displacement(pd.region.Slab("x", high=1e-9), x=0.0),
            pd.Displacement(pd.region.Slab("y", low=RADIUS - 1e-9), x=0.0 if clamped else None, y=0.0),
            cloud.contact(plane, friction, 10.0 * MODULUS, CORE / n, "plane"),
        ],
        history={
            "half_width": hertz.HalfWidth(),
            "peak": hertz.Peak("plane"),
            "error": hertz.LineError(RADIUS, MODULUS),
            **{f"p_{x}": hertz.PressureAt(x) for x in PLACES},
        },
        results=results,
        expect=expect,
        picture=pd.Picture(pd.stress, "yy"),
    )
