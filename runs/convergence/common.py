"""What the convergence cases share: clouds that know their surface, errors in the L2 norm, stresses at the surface."""

import sys
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from scipy.spatial import cKDTree

import pdpetsc as pd

sys.path.append(str(Path(__file__).parent.parent))
from patch.tension import shaken

# Particles within this many spacings of a place at the surface give the stress there.
REACH = 2.6


def square(n, shake, seed=0):
    """Return n x n particles of the unit square, moved by up to ``shake`` spacings."""
    lattice = pd.Lattice((0.0, 0.0), (1.0, 1.0), 1.0 / n)
    return shaken(lattice, shake, seed) if shake else lattice


def centres(corners):
    """Return areas (n,) and centroids (n, 2) of plane cells with corners (n, m, 2) counterclockwise."""
    first = corners[:, :1]
    one, other = corners[:, 1:-1] - first, corners[:, 2:] - first
    part = 0.5 * (one[..., 0] * other[..., 1] - one[..., 1] * other[..., 0])
    area = part.sum(axis=1)
    return area, first[:, 0] + (part[..., None] * (one + other)).sum(axis=1) / (3.0 * area[:, None])


def of_cells(points, cells, x=None):
    """Return one particle per plane cell (n, m) of ``points`` (k, 2), at the centroids or ``x``, with their facets."""
    area, centroid = centres(points[cells])
    edges = np.stack([cells, np.roll(cells, -1, axis=1)], axis=2).reshape(-1, 2)
    _, inverse, count = np.unique(np.sort(edges, axis=1), axis=0, return_inverse=True, return_counts=True)
    free = np.flatnonzero(count[np.ravel(inverse)] == 1)
    start, end = points[edges[free, 0]], points[edges[free, 1]]
    along = end - start
    facets = pd.Facets(0.5 * (start + end), np.stack([along[:, 1], -along[:, 0]], axis=1), free // cells.shape[1])
    return pd.Arrays(centroid if x is None else x, area, facets=facets)


def grid_cells(n, m, closed=False):
    """Return the quadrilaterals (n m, 4) of a grid of nodes, m + 1 to a row, or m where its ends are joined."""
    i, j = (index.ravel() for index in np.indices((n, m)))
    columns = m if closed else m + 1

    def node(a, b):
        return a * columns + b % columns

    return np.stack([node(i, j), node(i + 1, j), node(i + 1, j + 1), node(i, j + 1)], axis=1)


def spacing_of(particles):
    """Return the mean spacing of plane particles [length]."""
    volume = particles.chunk(0, 1).volume
    return float(np.sqrt(volume.mean()))


def common(scheme, weights, horizon, G, spacing):
    """Return what all cases say in the same words: scheme, weights, control, horizon in spacings."""
    return {
        "scheme": pd.choose("scheme", scheme, pd.SCHEMES),
        "weights": pd.choose("weights", weights, pd.WEIGHTS),
        "control": pd.Silling(G) if G else None,
        "horizon": horizon * spacing,
    }


def three_supports(points, exact):
    """Return exact displacements, statically determinate, of the particles next to two points, the second in y only."""
    x, y = (lambda places, t, axis=axis: exact(places, t)[:, axis] for axis in (0, 1))
    return [
        pd.Displacement(pd.region.Nearest(points[0]), x=x, y=y),
        pd.Displacement(pd.region.Nearest(points[1]), y=y),
    ]


@dataclass(frozen=True)
class ErrorL2(pd.Quantity):
    """Relative error of a field in the L2 norm, ``sqrt(sum V |a - b|^2 / sum V |b|^2)`` over the particles [-].

    With ``rigid`` the rigid motion, linearised, that fits a displacement best is taken out of the difference: where
    few particles hold a body it stands for the error of these alone.
    """

    field: Callable[[Any], Any]
    exact: Callable[[Any, float], Any]
    rigid: bool = False

    def evaluate(self, solution):
        exact = np.asarray(self.exact(solution.x, solution.t))
        difference = np.asarray(self.field(solution)) - exact
        V = solution.volume
        if self.rigid:
            difference = difference - self._rigid_part(solution, difference)
        width = tuple(range(1, exact.ndim))
        above, below = solution.sum([V @ (difference**2).sum(axis=width), V @ (exact**2).sum(axis=width)])
        return float(np.sqrt(above / below))

    @staticmethod
    def _rigid_part(solution, difference):
        x = solution.x
        motions = np.zeros((3, *x.shape))
        motions[0, :, 0] = motions[1, :, 1] = 1.0
        motions[2] = np.stack([-x[:, 1], x[:, 0]], axis=1)
        weighted = motions * solution.volume[:, None]
        gram = solution.sum(np.einsum("anc,bnc->ab", weighted, motions))
        moments = solution.sum(np.einsum("anc,nc->a", weighted, difference))
        return np.einsum("a,anc->nc", np.linalg.solve(gram, moments), motions)


@dataclass(frozen=True)
class SurfaceStressError(pd.Quantity):
    """Relative error of the stress along the surface, root of the mean square over places on it [-].

    The stress at a place is that of the linear function that fits the mean Cauchy stress of the particles within
    ``REACH`` spacings best. ``places`` are reference positions (n, 2), ``along`` the tangents there (n, 2).
    """

    places: Any
    along: Any
    exact: Any
    spacing: float

    def evaluate(self, solution):
        parts = solution.cloud.comm.allgather((solution.x, pd.stress(solution)))
        x, sigma = (np.concatenate(column) for column in zip(*parts, strict=True))
        found = np.array([
            self._fitted(x[near] - place, np.einsum("i,nij,j->n", t, sigma[near], t))
            for place, t, near in zip(
                self.places, self.along, cKDTree(x).query_ball_point(self.places, REACH * self.spacing), strict=True
            )
        ])  # fmt: skip
        return float(np.sqrt(np.mean((found - self.exact) ** 2) / np.mean(np.square(self.exact))))

    @staticmethod
    def _fitted(apart, values):
        phi = np.concatenate([np.ones((len(apart), 1)), apart], axis=1)
        return np.linalg.lstsq(phi, values, rcond=None)[0][0]


def errors(u, stress, rigid=True, surface=None):
    """Return the ``history`` and ``results`` of a case with exact displacements and Cauchy stresses ``(x, t)``."""
    history = {
        "error_u": ErrorL2(pd.displacement, u, rigid),
        "error_stress": ErrorL2(pd.stress, stress),
    }
    if surface is not None:
        history["error_surface"] = surface
    return {"history": history, "results": lambda h: {name: h[name][-1] for name in history}}
