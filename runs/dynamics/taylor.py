"""Taylor bar: a copper cylinder that hits a rigid wall. Units m, N, kg, s.

A cylinder of length 0.0324 and radius 0.0032 (E = 117e9, nu = 0.35, density 8930, yield stress 400e6, linear hardening
100e6) hits a frictionless wall at 227 m/s and comes to rest after 80e-6 s. Its length is then 0.0214 to 0.0217, the
radius of its foot 0.0069 to 0.0072, in codes of impact (Kamoulakos 1990, and the manuals that repeat it).

A quarter is computed, on nodes of hexahedra, ``n`` over the half side of the square in the middle; J2 flow with
logarithmic strains. ``horizon`` is in sizes of the cells around a node.

Results: ``length``, ``foot_radius``, ``plastic_strain``, the largest, ``kinetic_left`` over the initial energy, and
``energy_error``.
"""

import sys
from pathlib import Path

import numpy as np

sys.path.append(str(Path(__file__).parent.parent / "contact"))
import refined

import pdpetsc as pd

LENGTH, RADIUS, SPEED, END = 0.0324, 0.0032, 227.0, 80e-6
E, NU, DENSITY, YIELD, HARDENING = 117e9, 0.35, 8930.0, 400e6, 100e6


def particles(n):
    """Return nodes of hexahedra of a quarter of the cylinder, and their sizes."""
    flat, cells = refined.corner(n, 0.55 * RADIUS, RADIUS, 2)
    m = round(LENGTH * n / (0.55 * RADIUS))
    z = np.linspace(0.0, LENGTH, m + 1)
    points = np.concatenate([np.column_stack([flat, np.full(len(flat), height)]) for height in z])
    layers = [np.concatenate([cells + k * len(flat), cells + (k + 1) * len(flat)], axis=1) for k in range(m)]
    return refined.cloud(points, np.concatenate(layers), points[:, 2] < 1e-12)


def case(n=3, scheme="sub_horizons", horizon=2.1, safety=0.8):
    cloud = particles(n)
    known = {"sub_horizons": pd.SubHorizons, "correspondence": pd.Correspondence}
    foot = pd.region.Slab("z", high=1e-9)
    edge = foot & pd.region.Slab("y", high=1e-9) & pd.region.Slab("x", low=RADIUS * (1.0 - 1e-9))

    def results(h):
        return {
            "length": LENGTH + h["top"][-1],
            "foot_radius": RADIUS + h["edge"][-1],
            "plastic_strain": h["plastic"][-1],
            "kinetic_left": h["kinetic"][-1] / h["kinetic"][0],
            "energy_error": float(np.abs(h["energy_error"]).max()),
        }

    return pd.Case(
        particles=cloud.particles,
        horizon=horizon * cloud.size,
        material=pd.J2(E=E, nu=NU, yield_stress=YIELD, hardening=HARDENING, density=DENSITY),
        scheme=pd.choose("scheme", scheme, known)(),
        control=None if scheme == "sub_horizons" else pd.TangentScaled(pd.Silling(0.5)),
        conditions=[
            pd.Displacement(pd.region.Slab("x", high=1e-9), x=0.0),
            pd.Displacement(pd.region.Slab("y", high=1e-9), y=0.0),
            pd.Displacement(foot, z=0.0),
            pd.InitialVelocity(pd.region.All(), z=-SPEED),
        ],
        solver=pd.Explicit(end=END, safety=safety, records=80),
        history={
            "top": pd.Mean(pd.displacement, "z", pd.region.Slab("z", low=LENGTH - 1e-9)),
            "edge": pd.Mean(pd.displacement, "x", edge),
            "plastic": pd.Largest(pd.plastic_strain),
            "kinetic": pd.KineticEnergy(),
            "energy_error": pd.EnergyError(),
        },
        fields=[pd.displacement, pd.velocity, pd.plastic_strain],
        picture=pd.Picture(pd.plastic_strain, ""),
        results=results,
    )
