"""What the convergence cases share: clouds that know their surface, errors in the L2 norm, in the body and on it."""

import sys
from collections.abc import Callable
from dataclasses import dataclass
from itertools import combinations
from pathlib import Path
from typing import Any, ClassVar

import numpy as np

import pdpetsc as pd
from pdpetsc.declare.cells import SIMPLICES, Block, facets, parts_of_facets, shares_of_nodes, volumes_and_moments

sys.path.append(str(Path(__file__).parent.parent))
from patch.tension import shaken

EVERYWHERE = pd.region.All()


def square(n, shake, seed=0, cloud="cells", dim=2, sides=None):
    """Return particles of the unit square or cube, or of a box, n cells to a unit, moved by up to ``shake`` cells.

    ``cells``: in the middle of the cells of a lattice, whose facets stay where they are. ``nodes``: at the nodes of
    quadrilaterals or hexahedra, ``simplices``: of triangles or tetrahedra, ``centroids``: in these. Of nodes on the
    surface those of the faces move along them, those of edges and corners do not.
    """
    sides = (1.0,) * dim if sides is None else sides
    known = {
        "cells": lambda: _lattice(n, shake, seed, sides),
        "nodes": lambda: of_nodes(*grid(n, shake, seed, sides, cubes)),
        "simplices": lambda: of_nodes(*grid(n, shake, seed, sides, simplices)),
        "centroids": lambda: of_cells(*grid(n, shake, seed, sides, simplices)),
    }
    return pd.choose("cloud", cloud, known)()


def _lattice(n, shake, seed, sides):
    lattice = pd.Lattice((0.0,) * len(sides), sides, 1.0 / n)
    return shaken(lattice, shake, seed) if shake else lattice


def grid(n, shake, seed, sides, cells):
    """Return the nodes of a box with n cells to a unit, those on no edge moved, and its block of cells."""
    counts = tuple(round(n * side) for side in sides)
    axes = [np.linspace(0.0, side, count + 1) for side, count in zip(sides, counts, strict=True)]
    points = np.stack(np.meshgrid(*axes, indexing="ij"), axis=-1).reshape(-1, len(sides))
    free = (points > 0.25 / n) & (points < np.asarray(sides) - 0.25 / n)
    # What lies on two faces stays.
    free &= (free.sum(axis=1) >= len(sides) - 1)[:, None]
    return points + shake / n * free * np.random.default_rng(seed).uniform(-1.0, 1.0, points.shape), cells(counts)


def cubes(counts):
    """Return the quadrilaterals or hexahedra of a grid of so many cells each way, the last one fastest."""
    dim, index = len(counts), np.arange(np.prod(np.add(counts, 1))).reshape(np.add(counts, 1))
    ways = [(0, 0), (1, 0), (1, 1), (0, 1)]
    ways = ways if dim == 2 else [(*way, z) for z in (0, 1) for way in ways]
    cut = lambda axis, far: slice(far, counts[axis] + far)  # noqa: E731
    corners = [index[tuple(cut(axis, far) for axis, far in enumerate(way))].ravel() for way in ways]
    return Block("quad" if dim == 2 else "hexahedron", np.stack(corners, axis=1))


def simplices(counts):
    """Return the triangles of a grid, two to a square, their diagonals alternate, or its tetrahedra, six to a cube."""
    block = cubes(counts)
    if block.kind == "hexahedron":
        found = np.concatenate([block.nodes[:, list(one)] for one in SIMPLICES["hexahedron"]])
        return Block("tetra", found)
    odd = np.indices(counts).sum(axis=0).ravel() % 2 == 1
    ways = [[(0, 1, 2), (0, 2, 3)], [(0, 1, 3), (1, 2, 3)]]
    found = [block.nodes[which][:, list(one)] for way, which in zip(ways, (~odd, odd), strict=True) for one in way]
    return Block("triangle", np.concatenate(found))


def of_cells(points, block, x=None):
    """Return one particle per cell of ``points`` (k, dim), at the centroids or at ``x``, with their facets."""
    volume, moment = volumes_and_moments(points, block)
    found = facets(points, [block])
    surface = pd.Facets(found.centre[found.free], found.area[found.free], found.cell[found.free])
    return pd.Arrays(moment / volume[:, None] if x is None else x, volume, facets=surface)


def of_nodes(points, block):
    """Return one particle per node, with the volume of its dual cell and the facets of that: as ``pd.MeshNodes``."""
    nodes, volume = shares_of_nodes(points, [block])
    found = facets(points, [block])
    node, x, area, _, outline = parts_of_facets(points, found.corners[found.free], found.area[found.free])
    corners = outline if points.shape[1] == 3 else None
    return pd.Arrays(points[nodes], volume, facets=pd.Facets(x, area, np.searchsorted(nodes, node), corners=corners))


def centres(points, block):
    """Return areas (n,) and centroids (n, 2) of plane cells."""
    area, moment = volumes_and_moments(points, block)
    return area, moment / area[:, None]


def grid_cells(n, m, closed=False):
    """Return the quadrilaterals of a grid of nodes, m + 1 to a row, or m where its ends are joined."""
    i, j = (index.ravel() for index in np.indices((n, m)))
    columns = m if closed else m + 1

    def node(a, b):
        return a * columns + b % columns

    return Block("quad", np.stack([node(i, j), node(i + 1, j), node(i + 1, j + 1), node(i, j + 1)], axis=1))


def spacing_of(particles):
    """Return the mean spacing of particles [length]."""
    part = particles.chunk(0, 1)
    return float(part.volume.mean() ** (1.0 / part.x.shape[1]))


def common(scheme, weights, horizon, G, spacing):
    """Return what all cases say in the same words: scheme, weights, control, horizon in spacings."""
    return {
        "scheme": pd.choose("scheme", scheme, pd.SCHEMES),
        "weights": pd.choose("weights", weights, pd.WEIGHTS),
        "control": pd.Silling(G) if G else None,
        "horizon": horizon * spacing,
    }


def three_supports(points, exact):
    """Return exact displacements, statically determinate, of the particles next to some points.

    Two points in the plane, the second held in y only; in space three, the second along x, held in y and z, and the
    third along z, held in y.
    """
    dim = len(points[0])
    held = ["xyz"[:dim], "yz"[: dim - 1], "y"][:dim]
    values = {name: lambda x, t, axis=axis: exact(x, t)[:, axis] for axis, name in enumerate("xyz"[:dim])}
    return [
        pd.Displacement(pd.region.Nearest(point), **{name: values[name] for name in names})
        for point, names in zip(points, held, strict=True)
    ]


@dataclass(frozen=True)
class ErrorL2(pd.Quantity):
    """Relative error of a field in the L2 norm, ``sqrt(sum V |a - b|^2 / sum V |b|^2)`` over the particles [-].

    With ``rigid`` the rigid motion, linearised, that fits a displacement best is taken out of the difference: where
    few particles hold a body it stands for the error of these alone. Only particles in the region count.
    """

    field: Callable[[Any], Any]
    exact: Callable[[Any, float], Any]
    rigid: bool = False
    region: pd.region.Region = EVERYWHERE

    def evaluate(self, solution):
        exact = np.asarray(self.exact(solution.x, solution.t))
        difference = np.asarray(self.field(solution)) - exact
        V = solution.volume * solution.select(self.region)
        if self.rigid:
            difference = difference - self._rigid_part(solution, difference)
        width = tuple(range(1, exact.ndim))
        above, below = solution.sum([V @ (difference**2).sum(axis=width), V @ (exact**2).sum(axis=width)])
        return float(np.sqrt(above / below)) if below > 0.0 else np.nan

    @staticmethod
    def _rigid_part(solution, difference):
        x = solution.x
        motions = [np.broadcast_to(one, x.shape) for one in np.eye(x.shape[1])]
        for a, b in combinations(range(x.shape[1]), 2):
            turn = np.zeros_like(x)
            turn[:, a], turn[:, b] = -x[:, b], x[:, a]
            motions.append(turn)
        motions = np.array(motions)
        weighted = motions * solution.volume[:, None]
        gram = solution.sum(np.einsum("anc,bnc->ab", weighted, motions))
        moments = solution.sum(np.einsum("anc,nc->a", weighted, difference))
        return np.einsum("a,anc->nc", np.linalg.solve(gram, moments), motions)


@dataclass(frozen=True)
class SurfaceStressError(pd.Quantity):
    """Relative error of the Cauchy stress on facets of the surface, in the L2 norm [-].

    ``sqrt(sum a |s - b|^2 / sum a |b|^2)`` over all components, with the stress that ``pd.OnSurface`` gives.
    """

    exact: Callable[[Any, float], Any]
    region: pd.region.Region
    on_surface: ClassVar[bool] = True

    def evaluate(self, solution):
        letters = "xyz"[: solution.x.shape[1]]
        above, below = 0.0, 0.0
        for a, one in enumerate(letters):
            for b, other in enumerate(letters):
                x, area, found = pd.OnSurface(pd.stress, one + other, self.region).on_facets(solution)
                exact = np.asarray(self.exact(x, solution.t))[:, a, b]
                size = np.linalg.norm(area, axis=1)
                above, below = above + size @ (found - exact) ** 2, below + size @ exact**2
        above, below = solution.sum([above, below])
        return float(np.sqrt(above / below)) if below > 0.0 else np.nan


def errors(u, stress, rigid=True, surface=None, regular=EVERYWHERE):
    """Return the ``history`` and ``results`` of a case with exact displacements and Cauchy stresses ``(x, t)``.

    ``surface`` is the region of the facets whose stress counts, ``regular`` that of the particles whose stress does.
    """
    history = {
        "error_u": ErrorL2(pd.displacement, u, rigid),
        "error_stress": ErrorL2(pd.stress, stress, region=regular),
    }
    if surface is not None:
        history["error_surface_stress"] = SurfaceStressError(stress, surface)
    return {"history": history, "results": lambda h: {name: h[name][-1] for name in history}}
