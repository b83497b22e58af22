"""Clouds of a thick ring with radii 1 and 2: a lattice with staircases, polar quadrilaterals, irregular triangles."""

import common
import numpy as np
from scipy.spatial import Delaunay

import pdpetsc as pd
from pdpetsc.declare.cells import Block

INNER, OUTER = 1.0, 2.0
# The facets within are those of the inner surface.
HOLE = pd.region.Sphere((0.0, 0.0), 0.5 * (INNER + OUTER))


def lattice(n):
    """Return the cells of a lattice, n across the ring, whose centres lie in it: both surfaces are staircases."""
    inside = pd.region.Where(lambda x: (np.hypot(*x.T) > INNER) & (np.hypot(*x.T) < OUTER))
    side = np.full(2, OUTER)
    return pd.Lattice(-side, side, (OUTER - INNER) / n, keep=inside)


def polar(n):
    """Return nodes and quadrilaterals between n + 1 circles and as many rays as make them square in the middle."""
    m = round(np.pi * (INNER + OUTER) / (OUTER - INNER) * n)
    radius, angle = np.meshgrid(np.linspace(INNER, OUTER, n + 1), np.arange(m) * 2.0 * np.pi / m, indexing="ij")
    points = np.stack([(radius * np.cos(angle)).ravel(), (radius * np.sin(angle)).ravel()], axis=1)
    return points, common.grid_cells(n, m, closed=True)


def triangles(n, shake, seed):
    """Return nodes and triangles as large as cells n across, whose inner nodes are moved by up to ``shake`` sides."""
    # Equilateral triangles of area a have the height sqrt(sqrt(3) a).
    rings = max(round(n / 3.0**0.25), 2)
    return between(np.linspace(INNER, OUTER, rings + 1), lambda radius: 1.0 / rings, shake, seed)


def between(radii, height, shake, seed):
    """Return nodes on circles and irregular triangles between them, of sides moved by up to ``shake`` of their length.

    The first and the last circle are the surfaces; triangles at a radius have about the height ``height(radius)``.
    """
    random, points, inside = np.random.default_rng(seed), [], 0
    for radius in radii:
        # Equilateral triangles of the height of the rings have sides 2 / sqrt(3) as long.
        side = float(height(np.array(radius))) / np.sqrt(0.75)
        m = round(2.0 * np.pi * radius / side)
        angle = 2.0 * np.pi * (np.arange(m) + random.uniform()) / m
        on = radius * np.stack([np.cos(angle), np.sin(angle)], axis=1)
        if radii[0] < radius < radii[-1]:
            on += shake * side * random.uniform(-1.0, 1.0, on.shape)
        elif radius == radii[0]:
            inside = m
        points.append(on)
    points = np.concatenate(points)
    cells = Delaunay(points).simplices
    # Those of three nodes of the inner circle fill the hole.
    cells = cells[(cells >= inside).any(axis=1)]
    area, _ = common.centres(points, Block("triangle", cells))
    cells[area < 0.0] = cells[area < 0.0][:, ::-1]
    return points, Block("triangle", cells.astype(np.int64))


def cloud(mesh, n, shake, seed):
    """Return the particles that a word of the command line stands for."""
    known = {
        "lattice": lambda: lattice(n),
        "quads": lambda: common.of_cells(*polar(n)),
        "quad_nodes": lambda: common.of_nodes(*polar(n)),
        "triangles": lambda: common.of_cells(*triangles(n, shake, seed)),
        "nodes": lambda: common.of_nodes(*triangles(2.0**0.5 * n, shake, seed)),
    }
    return pd.choose("mesh", mesh, known)()


def radial(x, of_radius, around):
    """Return the tensors ``a e_r e_r + b e_t e_t`` (n, 2, 2) at ``x`` (n, 2)."""
    e = x / np.linalg.norm(x, axis=1)[:, None]
    rr = np.einsum("ni,nj->nij", e, e)
    return of_radius[:, None, None] * rr + around[:, None, None] * (np.eye(2) - rr)


def supports(exact):
    """Return three supports with exact displacements: the particles next to the ends of the x axis."""
    return common.three_supports([(-OUTER, 0.001), (OUTER, 0.001)], exact)
