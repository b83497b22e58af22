"""Rigid cylinder pressed on an elastic block: Hertz's line contact. Any consistent units.

A block of 2 x 1, E = 1e6, nu = 0.3, plane strain, on rollers. A rigid cylinder of radius ``radius`` above its middle
moves down by ``load``. Half of the block is computed, on nodes, ``n`` over its depth.

Hertz with the force F of the run, on a half space: half width ``a = sqrt(4 F R / (pi E*))``, largest pressure
``p0 = sqrt(F E* / (pi R))``, ``E* = E / (1 - nu^2)``.

Results: ``force`` of the whole cylinder, ``half_width``, ``peak_pressure``, both over those of Hertz, and
``pressure_error``, the root mean square of the difference from ``p0 sqrt(1 - x^2 / a^2)`` on the facets that touch,
over p0.
"""

import numpy as np

import pdpetsc as pd

E, NU = 1e6, 0.3
MODULUS = E / (1.0 - NU**2)


def touching(solution):
    """Return distances from the middle, pressures and areas of the facets of all ranks that touch."""
    (term,) = (one for one in solution.problem.terms if type(one).__name__ == "ContactForces")
    x, traction, area = term.of_facets(solution.state)
    parts = solution.cloud.comm.allgather((x[:, 0], -traction[:, 1], area))
    return [np.concatenate(arrays) for arrays in zip(*parts, strict=True)]


class Peak(pd.Quantity):
    """Largest pressure."""

    def evaluate(self, solution):
        return float(touching(solution)[1].max(initial=0.0))


class PressureError(pd.Quantity):
    """Root mean square of the difference from Hertz's pressure over its largest."""

    radius = 1.0

    def __init__(self, radius):
        object.__setattr__(self, "radius", radius)

    def evaluate(self, solution):
        x, p, area = touching(solution)
        force = 2.0 * float(p @ area)
        if force == 0.0:
            return 0.0
        a, peak = (
            np.sqrt(4.0 * force * self.radius / (np.pi * MODULUS)),
            np.sqrt(force * MODULUS / (np.pi * self.radius)),
        )
        exact = peak * np.sqrt(np.maximum(1.0 - (x / a) ** 2, 0.0))
        return float(np.sqrt(area @ (p - exact) ** 2 / area.sum()) / peak)


def case(n=40, radius=8.0, load=0.004, friction=0.0):
    def results(h):
        force = -2.0 * h["roller_y"][-1]
        a, peak = np.sqrt(4.0 * force * radius / (np.pi * MODULUS)), np.sqrt(force * MODULUS / (np.pi * radius))
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
        history={"peak": Peak(), "error": PressureError(radius)},
        results=results,
        expect={"peak_over_hertz": pd.Expected(1.0, relative=0.05, source="Hertz")},
        picture=pd.Picture(pd.stress, "yy"),
    )
