"""Thick cylinder whose inner surface is hotter, plane strain, against the closed form. Units m, N, K.

Radii 1 and 2, ``n`` particles across, the steady temperature ``T = T_i ln(b / r) / ln(b / a)``, Hooke's law. ``mesh``
is one of the clouds of ``convergence/ring.py``. ``error_axial`` is that of the stress along the axis. With
``field=conducted`` the temperature is that of heat conduction between surfaces that convect ten thousand times as well
as the cylinder conducts, and ``error_T`` that against the closed form.
"""

import sys
from pathlib import Path

import numpy as np

import pdpetsc as pd

sys.path.insert(0, str(Path(__file__).parent.parent / "convergence"))
import common
import rings

E, NU, ALPHA, RISE = 1.0, 0.3, 1e-3, 100.0
WELL = 1e4
INNER, OUTER = rings.INNER, rings.OUTER


def temperature(x, t=1.0):
    """Return the steady temperature (n,)."""
    return RISE * np.log(OUTER / np.linalg.norm(x, axis=1)) / np.log(OUTER / INNER)


def moment(r):
    """Return the integral of ``T r`` from the inner radius to ``r``."""

    def primitive(s):
        return 0.5 * s**2 * np.log(OUTER / s) + 0.25 * s**2

    return RISE / np.log(OUTER / INNER) * (primitive(r) - primitive(INNER))


def displacement(x, t):
    r = np.linalg.norm(x, axis=1)
    whole = moment(OUTER) / (OUTER**2 - INNER**2)
    u = (1.0 + NU) / (1.0 - NU) * ALPHA * (moment(r) / r + ((1.0 - 2.0 * NU) * r**2 + INNER**2) / r * whole)
    return (u / r)[:, None] * x


def stress(x, t):
    r = np.linalg.norm(x, axis=1)
    whole = moment(OUTER) / (OUTER**2 - INNER**2)
    unit = ALPHA * E / (1.0 - NU) / r**2
    return rings.radial(
        x,
        unit * ((r**2 - INNER**2) * whole - moment(r)),
        unit * ((r**2 + INNER**2) * whole + moment(r) - temperature(x) * r**2),
    )


class Axial(pd.Quantity):
    """Relative error of the stress along the axis in the L2 norm [-]."""

    def evaluate(self, solution):
        exact = NU * np.einsum("pii->p", stress(solution.x, solution.t)) - E * ALPHA * temperature(solution.x)
        difference = solution.out_of_plane[2] - exact
        above, below = solution.sum([solution.volume @ difference**2, solution.volume @ exact**2])
        return float(np.sqrt(above / below))


def case(
    n=12, mesh="quads", shake=0.2, seed=0, scheme="correspondence", weights="conforming", horizon=2.015, G=0.5,
    field="prescribed",
):  # fmt: skip
    particles = rings.cloud(mesh, n, shake, seed)
    spacing = common.spacing_of(particles)
    errors = common.errors(displacement, stress, surface=rings.HOLE)
    history = {**errors["history"], "error_axial": Axial(), "error_T": common.ErrorL2(pd.temperature, temperature)}
    heated = {
        "prescribed": [pd.Temperature(pd.region.All(), temperature)],
        "conducted": [pd.Convection(rings.HOLE, WELL, RISE), pd.Convection(~rings.HOLE, WELL, 0.0)],
    }
    return pd.Case(
        particles=particles,
        material=pd.Thermal(pd.LinearElastic(E=E, nu=NU), expansion=ALPHA, conductivity=1.0),
        conditions=[*rings.supports(displacement), *pd.choose("field", field, heated)],
        heat=pd.HeatConduction() if field == "conducted" else None,
        **{
            **common.common(scheme, weights, horizon, G, spacing),
            "fields": [pd.displacement, pd.stress, pd.temperature],
        },
        history=history,
        results=lambda h: {name: h[name][-1] for name in history},
    )
