"""Nodes of quadrilaterals and hexahedra that grow away from a point of contact, of half planes, discs and balls."""

from dataclasses import dataclass

import numpy as np

import pdpetsc as pd
from pdpetsc.declare.cells import (
    FACETS,
    Block,
    edge_lengths,
    facets,
    parts_of_facets,
    shares_of_nodes,
    volumes_and_moments,
)

# Growth of the shells outside the core, in sides of their cells.
GROWTH = 0.8


@dataclass(frozen=True)
class Cloud:
    """Nodes with their facets, and the mean length of the edges at each node (n,) [length]."""

    particles: pd.Arrays
    size: np.ndarray

    def contact(self, tool, friction, modulus, fine, name):
        """Return the contact of the surface, with a stiffness and a penetration by the size of the cells there.

        The defaults of ``pd.Contact`` follow the mean spacing at all facets of the surface, which is much larger.
        """
        x = np.asarray(self.particles.x)
        spacing = np.mean(self.particles.volume) ** (1.0 / x.shape[1])
        return pd.Contact(
            "contact", tool, friction, stiffness=modulus / fine, penetration=1e-3 * fine / spacing, name=name
        )


def corner(n, core, outer, dim, ball=True):
    """Return nodes (k, dim) and cells of the part of a ball of radius ``outer`` with all coordinates positive.

    The square or cube of side ``core`` at the origin has ``n`` cells a side. Shells around it grow with the distance.
    Without ``ball`` the outermost shell is that of a square or cube too.
    """
    m = round(np.log(outer / core) / np.log1p(GROWTH / n))
    index = np.stack(np.meshgrid(*[np.arange(n + 1)] * dim, indexing="ij"), axis=-1).reshape(-1, dim)
    outline = index[index.max(axis=1) == n]
    flat = outline / n
    # Equal angles on the sphere.
    turned = np.tan(0.25 * np.pi * flat)
    turned /= np.linalg.norm(turned, axis=1)[:, None]
    parts = [core / n * index]
    for k in range(1, m + 1):
        radius = core * (outer / core) ** (k / m)
        share = k / m if ball else 0.0
        parts.append(radius * ((1.0 - share) * flat + share * turned))
    points = np.concatenate(parts)
    number = {tuple(at): row for row, at in enumerate(index.tolist())}
    place = {tuple(at): row for row, at in enumerate(outline.tolist())}
    ways = [(0, 0), (1, 0), (1, 1), (0, 1)]

    def node(shell, at):
        return number[at] if shell == 0 else len(index) + (shell - 1) * len(outline) + place[at]

    cells = []
    corners = ways if dim == 2 else [(*way, z) for z in (0, 1) for way in ways]
    for low in np.ndindex(*[n] * dim):
        cells.append([number[tuple(np.add(low, way).tolist())] for way in corners])
    sides = []
    for axis in range(dim):
        for low in np.ndindex(*[n] * (dim - 1)):
            around = [(0,), (1,)] if dim == 2 else ways
            sides.append([tuple(np.insert(np.add(low, way), axis, n).tolist()) for way in around])
    for k in range(m):
        for side in sides:
            inner, far = [node(k, at) for at in side], [node(k + 1, at) for at in side]
            cells.append([*inner, *far[::-1]] if dim == 2 else [*inner, *far])
    return points, np.array(cells)


def mirrored(points, cells):
    """Return the nodes and cells with their mirror image across x = 0."""
    on = np.abs(points[:, 0]) < 1e-12
    image = np.where(on, np.arange(len(points)), len(points) + np.cumsum(~on) - 1)
    return np.concatenate([points, points[~on] * np.where(np.arange(points.shape[1]) == 0, -1.0, 1.0)]), np.concatenate(
        [cells, image[cells]]
    )


def ball(points, radius):
    """Return the images of nodes of a half space in a ball that touches its surface at the origin.

    The map is conformal, with unit scale at the origin; the half sphere of ``2 radius`` becomes the equator.
    """
    up = np.eye(points.shape[1])[-1]
    far = points + 2.0 * radius * up
    return 4.0 * radius**2 * far / (far**2).sum(axis=1)[:, None] * (1.0 - 2.0 * up) + 2.0 * radius * up


def disc(points, cells, radius):
    """Return particles at the nodes of a disc or ball; its surface has the tag ``contact``.

    It lies above the origin, for a negative radius below it.
    """
    beyond = np.linalg.norm(points - radius * np.eye(points.shape[1])[-1], axis=1) - abs(radius)
    return cloud(points, cells, np.abs(beyond) < 1e-9 * abs(radius))


def cloud(points, cells, touches):
    """Return particles at nodes; ``touches`` (n,) are those of the surface whose facets have the tag ``contact``."""
    block = Block("quad", cells) if points.shape[1] == 2 else Block("tetra", tetrahedra(cells))
    block = _positive(points, block)
    nodes, volume = shares_of_nodes(points, [block])
    assert len(nodes) == len(points)
    found = facets(points, [block])
    corners = found.corners[found.free]
    node, x, area, facet, outline = parts_of_facets(points, corners, found.area[found.free])
    on = np.where(corners >= 0, touches[corners], True).all(axis=1)
    outline = outline if points.shape[1] == 3 else None
    surface = pd.Facets(x, area, node, tags={"contact": on[facet]}, corners=outline)
    size = edge_lengths(points, [Block("quad" if points.shape[1] == 2 else "hexahedron", cells)])
    return Cloud(pd.Arrays(points, volume, facets=surface), size)


def tetrahedra(cells):
    """Return six tetrahedra of each hexahedron (n, 8), alike on both sides of a face: its diagonal at the first node.

    Faces of hexahedra on a ball are warped, and a node that lies by chance in the plane of a facet has no neighbour
    there from which the facet could be interpolated.
    """
    found = []
    for cell in cells:
        first = cell.min()
        for face in FACETS["hexahedron"]:
            around = cell[list(face)]
            if first not in around:
                a, b, c, d = np.roll(around, -np.argmin(around))
                found += [(first, a, b, c), (first, a, c, d)]
    return np.array(found)


def _positive(points, block):
    """Return the cells with their corners in the order of positive volume."""
    turned = [0, 3, 2, 1] if block.kind == "quad" else [0, 2, 1, 3]
    volume = volumes_and_moments(points, block)[0]
    return Block(block.kind, np.where(volume[:, None] < 0.0, block.nodes[:, turned], block.nodes))
