"""Nearly incompressible column of circular section, twisted between plates that keep their distance.

Radius 1 mm, length 2 mm, neo-Hookean with mu = 1 N/mm2; the upper plate turns by ``angle`` degrees. Incompressible,
every section turns as a whole: with the twist per length k the torque is ``mu k pi R^4 / 2`` and the plates press with
``mu k^2 pi R^4 / 4``, at any angle (Rivlin). Particles are the nodes of hexahedra, n x n on a section and n over the
length; the sections are polygons, so errors are those against the polar moment of the polygon. ``method`` as in
``cook_incompressible.py``. Results: ``torque``, ``press`` and their errors, ``J_error``, the largest difference of
det F of a particle from 1, and ``radial``, how far the side has moved outwards half-way up. Units mm, N.
"""

import sys
from dataclasses import dataclass
from pathlib import Path

import numpy as np

import pdpetsc as pd

sys.path.append(str(Path(__file__).parent.parent / "convergence"))
import common
import cook_incompressible as cook

RADIUS, LENGTH, MU = 1.0, 2.0, 1.0
EPS = 1e-6


def disc(points):
    """Return places of a disc of radius 1 for places of a square of edge 1, which its sides become the circle of."""
    a, b = 2.0 * points.T - 1.0
    size, reach = np.maximum(np.abs(a), np.abs(b)), np.hypot(a, b)
    # Squares inside, circles at the edge: cells are nowhere flat but near four points of the circle.
    share = np.where(reach > 0.0, 1.0 + size**2 * (size / np.where(reach > 0.0, reach, 1.0) - 1.0), 1.0)
    return np.stack([a, b], axis=1) * share[:, None]


def polar_moment(n):
    """Return the integral of r^2 over the polygon with the nodes of the edge as corners [length^4]."""
    side = np.linspace(0.0, 1.0, n + 1)[:-1]
    edge = np.concatenate([np.stack([side, 0.0 * side], 1), np.stack([1.0 + 0.0 * side, side], 1)])
    edge = RADIUS * disc(np.concatenate([edge, 1.0 - edge]))
    x, y = edge[:, 0], edge[:, 1]
    x_, y_ = np.roll(x, -1), np.roll(y, -1)
    return float(((x * y_ - x_ * y) * (x * x + x * x_ + x_ * x_ + y * y + y * y_ + y_ * y_)).sum() / 12.0)


def turned(x, angle):
    """Return the displacement of places (n, 3) by the twist (n, 3)."""
    phi = angle * x[:, 2] / LENGTH
    c, s = np.cos(phi), np.sin(phi)
    return np.stack([c * x[:, 0] - s * x[:, 1], s * x[:, 0] + c * x[:, 1], x[:, 2]], axis=1) - x


@dataclass(frozen=True)
class Radial(pd.Quantity):
    """Mean radial displacement of the side, half-way up."""

    def evaluate(self, solution):
        x, u = solution.x, pd.displacement(solution)
        side = (np.hypot(x[:, 0], x[:, 1]) > RADIUS - EPS) & (np.abs(x[:, 2] - 0.5 * LENGTH) < 0.26 * LENGTH)
        moved = np.hypot(*(x + u)[side, :2].T) - RADIUS
        total = solution.sum(np.array([moved.sum(), float(side.sum())]))
        return float(total[0] / total[1])


def dilatation(solution):
    """Return det F of the particles."""
    return np.linalg.det(pd.deformation_gradient(solution))


def case(n=6, nu=0.4999, angle=45.0, method="patches_control", horizon=2.015, steps=8, share=2.0):
    points, block = common.grid(n, 0.0, 0, (1.0, 1.0, 1.0), common.cubes)
    points = np.column_stack([RADIUS * disc(points[:, :2]), LENGTH * points[:, 2]])
    spacing = 2.0 * RADIUS / n
    scheme, control = pd.choose("method", method, cook.METHODS)(2.0 * spacing)
    if isinstance(scheme, pd.MeanDilatation):
        scheme = pd.MeanDilatation(scheme.scheme, scheme.patch, share)
    top, bottom = pd.region.Slab("z", low=LENGTH - EPS), pd.region.Slab("z", high=EPS)
    largest = np.radians(angle)
    k, moment = largest / LENGTH, polar_moment(n)
    exact, press = MU * k * moment, 0.5 * MU * k**2 * moment
    by = {name: lambda x, t, axis=axis: turned(x, largest * t)[:, axis] for axis, name in enumerate("xyz")}

    def results(h):
        found = {name: h[name][-1] for name in ("torque", "press", "J_error", "radial")}
        return found | {"torque_error": found["torque"] / exact - 1.0, "press_error": found["press"] / press - 1.0}

    return pd.Case(
        particles=common.of_nodes(points, block),
        horizon=horizon * spacing,
        material=pd.NeoHookean(E=2.0 * MU * (1.0 + nu), nu=nu),
        scheme=scheme,
        control=control,
        conditions=[pd.Displacement(bottom, x=0.0, y=0.0, z=0.0), pd.Displacement(top, **by)],
        steps=pd.Steps(steps),
        history={
            "torque": pd.ReactionMoment(top, about=(0.0, 0.0, 0.0)),
            "press": pd.Reaction("z", bottom),
            "J_error": pd.LargestError(dilatation, lambda x, t: np.ones(len(x))),
            "radial": Radial(),
        },
        results=results,
        expect={
            "torque": pd.Expected(exact, relative=0.05, source="mu k pi R^4 / 2 (Rivlin), of the polygon"),
            "press": pd.Expected(press, relative=0.1, source="mu k^2 pi R^4 / 4 (Rivlin), of the polygon"),
        },
        picture=pd.Picture(pd.von_mises, ""),
    )
