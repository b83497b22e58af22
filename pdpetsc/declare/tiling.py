"""The cells of particles: which part of the body belongs to each, for pictures and ParaView."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from functools import cached_property

import numpy as np
import scipy

from pdpetsc.arrays import Float, GlobalIndex, starts_of, twins
from pdpetsc.declare.cells import FACETS, facet_keys

# Corners of a box in the order of VTK; the first 2 and 4 are those of a line and of a rectangle.
BOX = np.array([(0, 0, 0), (1, 0, 0), (1, 1, 0), (0, 1, 0), (0, 0, 1), (1, 0, 1), (1, 1, 1), (0, 1, 1)])
# Kinds of polyhedra by their number of corners.
POLYHEDRA = {4: "tetra", 5: "pyramid", 6: "wedge", 8: "hexahedron"}
# A Delaunay simplex with a larger circumradius is outside of the body; a Voronoi cell with a corner farther away is
# replaced by a square; a mirror image nearer to a particle does not bound the body [spacings].
OUTSIDE, FARTHEST, NEAREST = 1.5, 2.5, 0.75
# Points nearer to a plane are on it, relative to the size of the body.
ON_PLANE = 1e-9


@dataclass(frozen=True)
class Faces:
    """The faces of cells: edges of polygons, faces of polyhedra.

    Attributes
    ----------
    cell : (n_faces,) int64
        The cell of each face.
    turn : (n_faces, 4) int64
        The entries of ``Cells.corners`` around the face, followed by -1 if there are fewer than four.
    key : (n_faces, 4) int64
        The corners, ascending, after -1 if there are fewer than four; equal for the two sides of a face.
    entry : (n_faces, 4) int64
        The entries in the order of ``key``.
    """

    cell: GlobalIndex
    turn: GlobalIndex
    key: GlobalIndex
    entry: GlobalIndex

    @cached_property
    def shared(self) -> tuple[GlobalIndex, GlobalIndex]:
        """Return both sides (n,) of the faces between two cells."""
        return twins(self.key)


@dataclass(frozen=True)
class Cells:
    """Cells of a body: lines, polygons, or polyhedra with the corners of tetrahedra, pyramids, wedges and hexahedra.

    Attributes
    ----------
    points : (n_points, dim) float64
        Corners of cells [length].
    corners : (n_corners,) int64
        Rows of ``points``, cell by cell, in the order of VTK.
    offsets : (n_cells + 1,) int64
        The corners of cell ``c`` are ``corners[offsets[c]:offsets[c + 1]]``.
    particle : (n_cells,) int64 or None
        The particle of each cell; a particle may have several. None if the particles are at the corners of the cells.
    """

    points: Float
    corners: GlobalIndex
    offsets: GlobalIndex
    particle: GlobalIndex | None

    @classmethod
    def of(cls, points: Float, parts: Sequence[GlobalIndex], particle: GlobalIndex | None) -> Cells:
        """Return cells from blocks (n, n_corners) of cells with equally many corners."""
        sizes = np.concatenate([np.full(len(part), part.shape[1]) for part in parts])
        corners = np.concatenate([np.ravel(part) for part in parts])
        return cls(points, corners, starts_of(sizes), particle)

    @property
    def count(self) -> GlobalIndex:
        """Return the number of corners of each cell (n_cells,)."""
        return np.diff(self.offsets)

    @cached_property
    def faces(self) -> Faces:
        """Return the faces of all cells."""
        cells, turns = [], []
        dim, count = self.points.shape[1], self.count
        for size in np.unique(count):
            which = np.flatnonzero(count == size)
            around = [(n, (n + 1) % size) for n in range(size)]
            loops: Sequence[tuple[int, ...]] = (
                around if dim == 2 else FACETS[POLYHEDRA[int(size)] if dim == 3 else "line"]
            )
            for facet in loops:
                entry = self.offsets[which][:, None] + np.array(facet)
                cells.append(which)
                turns.append(np.pad(entry, ((0, 0), (0, 4 - len(facet))), constant_values=-1))
        cell, turn = np.concatenate(cells), np.concatenate(turns)
        corner = np.where(turn >= 0, self.corners[turn], -1)
        order = np.argsort(corner, axis=1, kind="stable")
        return Faces(cell, turn, np.take_along_axis(corner, order, 1), np.take_along_axis(turn, order, 1))

    @property
    def own(self) -> Cells:
        """Return cells that belong to one particle each: the dual cells if particles are at corners.

        A polygon gives each corner the quadrilateral to its middle and those of both edges; a polyhedron the pyramids
        over such parts of its faces, with the tip in its middle.
        """
        if self.particle is not None:
            return self
        dim, count = self.points.shape[1], self.count
        keys, places, owners = [], [], []
        for size in np.unique(count):
            which = np.flatnonzero(count == size)
            nodes = self.corners[self.offsets[which][:, None] + np.arange(size)]
            loops = FACETS[POLYHEDRA[int(size)]] if dim == 3 else [tuple(range(size))]
            middle = np.full((len(which), 4), -1)
            middle[:, 0] = -2 - which
            tip = middle, self.points[nodes].mean(axis=1)
            for loop in loops:
                face = self._middle(nodes[:, list(loop)]) if dim == 3 else tip
                for n, corner in enumerate(loop):
                    after, before = loop[(n + 1) % len(loop)], loop[n - 1]
                    if dim == 3:
                        # Faces look outward, the base of a pyramid toward its tip.
                        after, before = before, after
                    around = [
                        self._middle(nodes[:, [corner]]), self._middle(nodes[:, [corner, after]]), face,
                        self._middle(nodes[:, [corner, before]]), tip,
                    ][: (0, 2, 4, 5)[dim]]  # fmt: skip
                    keys.append(np.stack([key for key, _ in around], axis=1))
                    places.append(np.stack([x for _, x in around], axis=1))
                    owners.append(nodes[:, corner])
        key, x = np.concatenate(keys), np.concatenate(places)
        _, first, corners = np.unique(key.reshape(-1, 4), axis=0, return_index=True, return_inverse=True)
        return Cells.of(x.reshape(-1, dim)[first], [np.ravel(corners).reshape(key.shape[:2])], np.concatenate(owners))

    def _middle(self, nodes: GlobalIndex) -> tuple[GlobalIndex, Float]:
        """Return keys (n, 4) and places (n, dim) of the middles of corners (n, m)."""
        return facet_keys(nodes), np.asarray(self.points[nodes].mean(axis=1))

    def moved(self, y: Callable[[GlobalIndex, Float], Float], joined: tuple[GlobalIndex, GlobalIndex]) -> Cells:
        """Return the cells after a displacement: cells share the corners of faces that join them.

        A corner is at the mean of the positions to which the cells around it carry it, over all cells that are joined
        there. Other cells come apart.

        Parameters
        ----------
        y : callable
            Positions (m, dim) to which particles (m,) carry points (m, dim) [length].
        joined : tuple of (n,) int64
            Both sides of the faces that join cells.
        """
        faces = self.faces
        one, other = (entry[entry >= 0] for entry in (faces.entry[side] for side in joined))
        n = len(self.corners)
        graph = scipy.sparse.coo_matrix((np.ones(len(one), dtype=np.int8), (one, other)), (n, n))
        n_points, label = scipy.sparse.csgraph.connected_components(graph, directed=False)
        carried = y(np.repeat(self.owner, self.count), self.points[self.corners])
        share = np.bincount(label, minlength=n_points)
        points = np.stack([np.bincount(label, along, n_points) / share for along in carried.T], axis=1)
        return Cells(points, label.astype(np.int64), self.offsets, self.particle)

    @property
    def surface(self) -> Cells:
        """Return the faces of one cell only, as cells of its particle."""
        faces = self.faces
        inside = np.zeros(len(faces.cell), dtype=bool)
        inside[np.concatenate(faces.shared)] = True
        turn = faces.turn[~inside]
        here = turn >= 0
        offsets = starts_of(here.sum(axis=1))
        return Cells(self.points, self.corners[turn[here]], offsets, self.owner[faces.cell[~inside]])

    def below(self, axis: int, at: float) -> Cells:
        """Return the cells with a corner below a plane across an axis; corners beyond the plane are moved onto it.

        The faces toward other cells have all corners beyond the plane, and are then on it: the cut face is plane.
        """
        along = self.points[:, axis]
        low = np.minimum.reduceat(along[self.corners], self.offsets[:-1])
        chosen = low < at - ON_PLANE * np.ptp(along)
        points = self.points.copy()
        points[:, axis] = np.minimum(along, at)
        return Cells(
            points, self.corners[np.repeat(chosen, self.count)],
            starts_of(self.count[chosen]),
            None if self.particle is None else self.particle[chosen],
        )  # fmt: skip

    @property
    def owner(self) -> GlobalIndex:
        """Return the particle of each cell (n_cells,), of cells that have one."""
        if self.particle is None:
            raise ValueError("cells between particles belong to none")
        return self.particle


def boxes(x: Float, side: Float) -> Cells:
    """Return a box about each particle (n, dim), with the same side (n,) along all axes [length]."""
    n, dim = x.shape
    corner = BOX[: 2**dim, :dim] - 0.5
    points = x[:, None] + side[:, None, None] * corner
    return Cells.of(points.reshape(-1, dim), [np.arange(n * 2**dim).reshape(n, -1)], np.arange(n))


def lattice(middles: Float, sides: Float) -> Cells:
    """Return the box cells of a lattice with these middles (n, dim) and sides (dim,) [length].

    Corners are in lattice order, the last axis fastest.
    """
    n, dim = middles.shape
    low = middles.min(axis=0)
    cell = np.round((middles - low) / sides).astype(np.int64)
    shape = tuple(cell.max(axis=0) + 2)
    number = np.ravel_multi_index(tuple(np.moveaxis(cell[:, None] + BOX[: 2**dim, :dim], 2, 0)), shape)
    taken, corners = np.unique(number, return_inverse=True)
    points = low + (np.stack(np.unravel_index(taken, shape), axis=1) - 0.5) * sides
    return Cells.of(points, [np.reshape(corners, (n, -1))], np.arange(n))


def voronoi(x: Float, mirrored: tuple[Float, Float, GlobalIndex] | None) -> Cells:
    """Return the Voronoi cells of particles in the plane, which end at the outline of the body.

    The outline is that of facets, given by their centroids, outward vector areas and particles: each particle is
    mirrored at its facets. Without facets the outline is half a spacing beyond the outer edges of the alpha shape.

    Parameters
    ----------
    x : (n, 2) float64
        Positions [length].
    mirrored : tuple, optional
        Centroids (m, 2), areas (m, 2) and particles (m,) of facets.
    """
    n, spacing = len(x), spacings(x)
    beyond = _beyond_edges(x, spacing) if mirrored is None else _mirror_images(x, spacing, *mirrored)
    scale = float(np.median(spacing))
    cells = boxes(x, spacing)
    try:
        diagram = scipy.spatial.Voronoi((np.concatenate([x, beyond]) - x.mean(axis=0)) / scale)
    except (scipy.spatial.QhullError, ValueError):
        return cells
    vertices = diagram.vertices * scale + x.mean(axis=0)
    regions = [diagram.regions[r] if r >= 0 else [] for r in diagram.point_region[:n]]
    size = np.array([len(region) for region in regions])
    particle = np.repeat(np.arange(n), size)
    corner = np.array([v for region in regions for v in region], dtype=np.int64)
    reach = np.where(size > 2, 0.0, np.inf)
    far = np.where(corner >= 0, np.linalg.norm(vertices[corner] - x[particle], axis=1), np.inf)
    np.maximum.at(reach, particle, far)
    good = reach <= FARTHEST * spacing
    corner = np.concatenate([corner[good[particle]], len(vertices) + cells.corners.reshape(n, 4)[~good].ravel()])
    particle = np.concatenate([particle[good[particle]], np.repeat(np.flatnonzero(~good), 4)])
    points = np.concatenate([vertices, cells.points])
    away = points[corner] - x[particle]
    order = np.lexsort([np.arctan2(away[:, 1], away[:, 0]), particle])
    offsets = starts_of(np.bincount(particle, minlength=n))
    used, corners = np.unique(corner[order], return_inverse=True)
    return Cells(points[used], corners, offsets, np.arange(n))


def spacings(x: Float) -> Float:
    """Return the mean distance of each particle (n, dim) from those next to it (n,) [length]."""
    if len(x) < 2:
        return np.ones(len(x))
    distance = scipy.spatial.cKDTree(x).query(x, k=min(1 + 2 * x.shape[1], len(x)))[0][:, 1:]
    # At a corner of a lattice some of them are farther.
    near = np.where(distance <= 1.3 * distance[:, :1], distance, np.nan)
    return np.asarray(np.maximum(np.nanmean(near, axis=1), np.finfo(float).tiny))


def _mirror_images(x: Float, spacing: Float, place: Float, area: Float, particle: GlobalIndex) -> Float:
    """Return the images (m, 2) of particles behind their facets."""
    normal = area / np.maximum(np.linalg.norm(area, axis=1), np.finfo(float).tiny)[:, None]
    away = ((place - x[particle]) * normal).sum(axis=1)
    # A particle on its facet, as a node, has an image all the same.
    return np.asarray(x[particle] + 2.0 * np.maximum(away, 1e-3 * spacing[particle])[:, None] * normal)


def _beyond_edges(x: Float, spacing: Float) -> Float:
    """Return images (m, 2) of particles one spacing beyond the edges of the alpha shape of a cloud."""
    none = np.empty((0, 2))
    try:
        triangles = scipy.spatial.Delaunay((x - x.mean(axis=0)) / float(np.median(spacing)))
    except (scipy.spatial.QhullError, ValueError):
        return none
    corners = x[triangles.simplices]
    sides = np.stack([np.linalg.norm(corners[:, n - 1] - corners[:, n - 2], axis=1) for n in range(3)], axis=1)
    one, other = corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0]
    double = np.abs(one[:, 0] * other[:, 1] - one[:, 1] * other[:, 0])
    with np.errstate(divide="ignore"):
        radius = sides.prod(axis=1) / (2.0 * double)
    body = radius < OUTSIDE * spacing[triangles.simplices].max(axis=1)
    images = [none]
    for n in range(3):
        behind = triangles.neighbors[:, n]
        edge = np.flatnonzero(body & ((behind < 0) | ~body[behind]))
        ends = triangles.simplices[edge][:, [n - 1, n - 2]]
        along = x[ends[:, 1]] - x[ends[:, 0]]
        normal = np.stack([along[:, 1], -along[:, 0]], axis=1) / np.linalg.norm(along, axis=1)[:, None]
        inward = ((corners[edge, n] - x[ends[:, 0]]) * normal).sum(axis=1) > 0.0
        normal[inward] *= -1.0
        images += [x[end] + spacing[end][:, None] * normal for end in ends.T]
    found = np.concatenate(images)
    distance, nearest = scipy.spatial.cKDTree(x).query(found)
    return np.asarray(found[distance >= NEAREST * spacing[nearest]])
