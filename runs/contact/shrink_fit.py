"""Shrink fit: a ring grows within another one. Any consistent units.

Rings of radii 1, 1.5 and 2, E = 1e6, nu = 0.3, plane stress; a quarter is computed. The inner ring has the eigenstrain
``load`` in all directions, and would grow by ``d = 1.5 load`` at its outer radius. ``n`` cells across the inner
ring, on nodes of quadrilaterals, and twice as many across and around the outer one. Closed form (Lame), with the radii
a, b, c:

    p = E d (b^2 - a^2) (c^2 - b^2) / (2 b^3 (c^2 - a^2)).

Results: ``pressure`` of the mean contact and ``pressure_over_exact``.
"""

import sys
from pathlib import Path

import numpy as np

sys.path.append(str(Path(__file__).parent.parent / "convergence"))
import common

import pdpetsc as pd
from pdpetsc.declare.cells import edge_lengths

E, NU = 1e6, 0.3
A, B, C = 1.0, 1.5, 2.0


def quarter(inner, outer, n, m):
    """Return nodes of n x m quadrilaterals of a quarter of a ring, and the mean length of the edges at each node."""
    radius, angle = np.meshgrid(np.linspace(inner, outer, n + 1), np.linspace(0.0, 0.5 * np.pi, m + 1), indexing="ij")
    points = np.stack([(radius * np.cos(angle)).ravel(), (radius * np.sin(angle)).ravel()], axis=1)
    points[np.abs(points) < 1e-12] = 0.0
    cells = common.grid_cells(n, m)
    return common.of_nodes(points, cells), edge_lengths(points, [cells])


def exact(load):
    """Return the pressure between the rings."""
    return E * B * load * (B**2 - A**2) * (C**2 - B**2) / (2.0 * B**3 * (C**2 - A**2))


class Pressure(pd.Quantity):
    """Force between the rings along the radius over the area of the contact."""

    def evaluate(self, solution):
        (term,) = (one for one in solution.problem.terms if hasattr(one, "of_facets"))
        x, traction, area = term.of_facets(solution.state)
        e = x / np.linalg.norm(x, axis=1)[:, None]
        sums = np.array([-(traction * e).sum(axis=1) @ area, area.sum()])
        force, whole = np.sum(solution.cloud.comm.allgather(sums), axis=0)
        return float(force / whole) if whole > 0.0 else 0.0


def case(n=6, friction=0.0, load=1e-2):
    inner, size = quarter(A, B, n, 4 * n)
    outer, size_outside = quarter(B, C, 2 * n, 8 * n)
    return pd.Case(
        particles=pd.Bodies({"inner": inner, "outer": outer}),
        horizon=2.1 * np.concatenate([size, size_outside]),
        material=pd.LinearElastic(E=E, nu=NU, plane="stress"),
        conditions=[
            pd.Displacement(pd.region.Slab("x", high=1e-9), x=0.0),
            pd.Displacement(pd.region.Slab("y", high=1e-9), y=0.0),
            pd.Eigenstrain("inner", xx=load, yy=load, zz=load),
            pd.BodyContact("inner", "outer", friction, penetration=1e-4, name="fit"),
        ],
        steps=pd.Steps(4),
        history={"pressure": Pressure()},
        results=lambda h: {
            "pressure": h["pressure"][-1],
            "pressure_over_exact": h["pressure"][-1] / exact(load),
        },
        expect={"pressure_over_exact": pd.Expected(1.0, relative=0.03, source="Lame")},
        picture=pd.Picture(pd.von_mises, ""),
    )
