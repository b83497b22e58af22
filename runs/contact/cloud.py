"""Disc of particles without facets between two rigid planes: Hertz's line contact. Any consistent units.

A disc of radius 1, E = 1e6, nu = 0.3, plane strain. Its particles lie on ``n`` rings and have volumes, but no facets:
the planes touch the facets of their outer layer, half a particle outward. Rigid planes approach the centre by ``load``
each. A quarter is computed.

Hertz for the force F of the run: half width ``a = sqrt(4 F R / (pi E*))``, largest pressure ``p0 = sqrt(F E* / (pi
R))``, ``E* = E / (1 - nu^2)``. The force for ``load = 2 F / (pi E*) (ln(4 R / a) - 1 / 2)`` (Johnson, equation 5.57).

Results: ``force``, ``force_over_johnson``, ``half_width_over_hertz``, ``peak_over_hertz``; ``pressure_error``, the root
mean square of the difference from Hertz's pressure over p0 on the facets that touch.
"""

import sys
from pathlib import Path

import numpy as np

sys.path.append(str(Path(__file__).parent))
import hertz

import pdpetsc as pd

E, NU, RADIUS = 1e6, 0.3, 1.0
MODULUS = E / (1.0 - NU**2)


def rings(n):
    """Return the particles of a quarter disc on n rings, equally spaced on each and symmetric to both axes."""
    dx, x, volume = RADIUS / n, [], []
    for k in range(n):
        r = (k + 0.5) * dx
        count = max(1, round(0.5 * np.pi * r / dx))
        angle = 0.5 * np.pi * (np.arange(count) + 0.5) / count
        x.append(r * np.stack([np.cos(angle), np.sin(angle)], axis=1))
        volume.append(np.full(count, 0.5 * np.pi * r * dx / count))
    return pd.Arrays(np.concatenate(x), np.concatenate(volume))


def case(n=60, load=0.02, friction=0.0):
    force = hertz.disc(load, RADIUS, MODULUS)

    def results(h):
        found = -2.0 * h["plane_y"][-1]
        a, peak = hertz.line(found, RADIUS, MODULUS)
        return {
            "force": found,
            "force_over_johnson": found / force,
            "half_width_over_hertz": h["half_width"][-1] / a,
            "peak_over_hertz": h["peak"][-1] / peak,
            "pressure_error": h["error"][-1],
        }

    plane = pd.RigidPlane((0.0, RADIUS), (0.0, -1.0), move=(0.0, -load))
    return pd.Case(
        particles=rings(n),
        material=pd.LinearElastic(E=E, nu=NU),
        symmetry=[pd.Symmetry("x"), pd.Symmetry("y")],
        conditions=[pd.Contact(pd.region.Slab("y", low=0.5 * RADIUS), plane, friction, name="plane")],
        history={
            "half_width": hertz.HalfWidth(),
            "peak": hertz.Peak("plane"),
            "error": hertz.LineError(RADIUS, MODULUS),
        },
        results=results,
        expect={"force": pd.Expected(force, relative=0.05, source="Johnson, equation 5.57")},
        picture=pd.Picture(pd.stress, "yy"),
    )
