"""Location of points: inside or outside of a body, and their particle, by cells, surface or volumes."""

from __future__ import annotations

import itertools
from collections.abc import Sequence
from dataclasses import dataclass, field, replace
from functools import cached_property
from typing import Protocol

import numpy as np
import scipy

from pdpetsc.arrays import Float, GlobalIndex, Lookup, Mask
from pdpetsc.declare.cracks import Crack
from pdpetsc.declare.particles import lattice_cells, numbers_in

# A point this near to a face of a cell, as a share of its side, or to a facet, as a share of its extent, is on it.
ON_FACE = 1e-9
# Facets are the surface of a body if they are closed up to the first share of their area, and enclose the volume of the
# particles up to the second.
CLOSED, HELD = 1e-6, 1e-3
# Radius of a ball of volume 1, by dimension.
BALL = {1: 0.5, 2: np.pi**-0.5, 3: (0.75 / np.pi) ** (1.0 / 3.0)}
# Points between two particles are inside if neither particle is farther away than so many of its sizes.
BETWEEN = {1: 1.0, 2: 1.25, 3: 1.5}
# Number of particles searched for one beyond a point.
AROUND = {1: 6, 2: 24, 3: 48}
# A particle is not larger than so many mean distances to its neighbours, whatever its volume.
LARGEST = 1.5
# Number of facets of each size searched for the nearest one.
FACETS = 16
# The distance of a disc instead of a facet has an error of at most this share of its radius, unless facets are slivers.
UNKNOWN = 0.6


class Inside(Protocol):
    """Locates points in a body."""

    @property
    def sides(self) -> Float:
        """Return lengths along the axes (dim,) by which distances of particles are about equal in all directions."""

    def homes(self, points: Float) -> GlobalIndex:
        """Return the particles of points (m, dim), (m,); -1 outside of the body."""

    def size(self, particles: GlobalIndex) -> Float:
        """Return the sizes of particles (m,) [length]."""


@dataclass(frozen=True)
class Boxes:
    """A body of equal box cells with a particle in the middle of each.

    Attributes
    ----------
    x : (n, dim) float64
        Positions [length].
    sides : (dim,) float64
        Sides of a cell [length].
    """

    x: Float
    sides: Float

    def homes(self, points: Float) -> GlobalIndex:
        """Return the particles whose cells contain the points; on inner faces the upper one."""
        place = (points - self.x.min(axis=0)) / self.sides + 0.5
        found = np.full(len(points), -1, dtype=np.int64)
        counts, particles = self._numbered
        for signs in itertools.product((1.0, -1.0), repeat=len(self.sides)):
            missing = found < 0
            cell = np.floor(place[missing] + ON_FACE * np.array(signs[::-1])).astype(np.int64)
            found[missing] = particles.of(numbers_in(counts, cell))
        return found

    def size(self, particles: GlobalIndex) -> Float:
        """Return the longest side of the cells."""
        return np.full(len(particles), float(self.sides.max()))

    @cached_property
    def _numbered(self) -> tuple[GlobalIndex, Lookup]:
        """Return the numbers of cells along each axis (dim,), and the particles by the numbers of their cells."""
        cell = np.round((self.x - self.x.min(axis=0)) / self.sides).astype(np.int64)
        counts = cell.max(axis=0) + 1
        return counts, Lookup(numbers_in(counts, cell))


def apart(x: Float) -> Float:
    """Return the mean distance of each of two or more points (n, dim) to its nearest neighbours (n,) [length]."""
    distance, _ = scipy.spatial.cKDTree(x).query(x, k=min(1 + 2 * x.shape[1], len(x)))
    return np.asarray(distance[:, 1:].mean(axis=1))


class _Nearest:
    """Search for the nearest items by distance over size, with one tree for each factor of two in size."""

    def __init__(self, x: Float, size: Float) -> None:
        self._x, self._size = x, size
        group = np.floor(np.log2(size / size.min())).astype(np.int64)
        self._members = [np.flatnonzero(group == number) for number in np.unique(group)]
        self._trees = [scipy.spatial.cKDTree(x[members]) for members in self._members]

    def query(self, points: Float, k: int) -> tuple[Float, GlobalIndex]:
        """Return distances over sizes and indices of at most k items (m, k), the nearest first."""
        near = self.of_each_size(points, k)
        distance = np.linalg.norm(self._x[near] - points[:, None], axis=2) / self._size[near]
        order = np.argsort(distance, axis=1, kind="stable")[:, :k]
        return np.take_along_axis(distance, order, axis=1), np.take_along_axis(near, order, axis=1)

    def of_each_size(self, points: Float, k: int) -> GlobalIndex:
        """Return the ``k`` nearest items of each factor of two in size (m, ...)."""
        found = []
        for tree, members in zip(self._trees, self._members, strict=True):
            most = min(k, len(members))
            found.append(members[tree.query(points, k=most)[1].reshape(-1, most)])
        return np.concatenate(found, axis=1)


@dataclass(frozen=True)
class Discs:
    """A body of particles with known positions and volumes only.

    The body is the union of discs, or balls, with the volumes of the particles, and of the balls whose diameters
    connect two near particles.

    Attributes
    ----------
    x : (n, dim) float64
        Positions [length].
    h : (n,) float64
        Size: the side of a cube of the volume [length].
    """

    x: Float
    h: Float

    @classmethod
    def of(cls, x: Float, volume: Float) -> Discs:
        """Return the discs of particles with volumes (n,) [length^dim]."""
        h = volume ** (1.0 / x.shape[1])
        return cls(x, h if len(x) == 1 else np.minimum(h, LARGEST * apart(x)))

    @property
    def sides(self) -> Float:
        """Return equal lengths in all directions."""
        return np.ones(self.x.shape[1])

    def size(self, particles: GlobalIndex) -> Float:
        """Return the sides of cubes with their volumes."""
        return self.h[particles]

    def homes(self, points: Float) -> GlobalIndex:
        """Return the nearest particle, by distance over size of the particle."""
        dim = self.x.shape[1]
        distance, near = self._nearest.query(points, AROUND[dim])
        home = near[:, 0]
        there, back = self.x[near] - points[:, None], self.x[home] - points
        # The tolerance keeps rounding from deciding on the ball itself, on which the middles of faces of cells are.
        round_off = ON_FACE * self.h[home][:, None] ** 2
        beyond = ((there * back[:, None]).sum(axis=2) <= round_off) & (distance <= BETWEEN[dim])
        held = (distance[:, 0] <= BALL[dim] * (1.0 + ON_FACE)) | (
            beyond[:, 1:].any(axis=1) & (distance[:, 0] <= BETWEEN[dim])
        )
        return np.where(held, home, -1)

    @cached_property
    def _nearest(self) -> _Nearest:
        return _Nearest(self.x, self.h)


@dataclass(frozen=True)
class Facets:
    """The surface of a body.

    Attributes
    ----------
    x, area : (m, dim) float64
        Centroids [length] and outward vector areas [area].
    triangles : (k, 3, 3) float64
        The whole surface of a solid body as triangles, outward by the right-hand rule [length]; none if unknown.
    """

    x: Float
    area: Float
    triangles: Float = field(default_factory=lambda: np.empty((0, 3, 3)))


class Surface(Protocol):
    """A closed surface."""

    def holds(self, points: Float) -> Mask:
        """Return True for points (m, dim) known to be inside (m,)."""


@dataclass(frozen=True)
class Enclosed(Discs):
    """A body with a known surface: a point is inside if the surface encloses it."""

    surface: Surface

    def homes(self, points: Float) -> GlobalIndex:
        """Return the nearest particle, by distance over size of the particle."""
        near = self._nearest.query(points, 1)[1][:, 0]
        held = np.zeros(len(points), dtype=bool)
        for part in np.array_split(np.arange(len(points)), 1 + len(points) // 20_000):
            held[part] = self.surface.holds(points[part])
        return np.where(held, near, -1)


@dataclass(frozen=True)
class Flat:
    """Facets with known area and middle: ends of a line, lines in the plane, discs of equal area in space.

    A point is inside if it is behind the nearest facet. Outlines of facets in space are unknown: if facets that may be
    the nearest disagree, as near edges, the point is outside.

    Attributes
    ----------
    x, normals : (m, dim) float64
        Middles [length] and outward unit normals.
    reach : (m,) float64
        Half the length of lines, the radius of discs; 0 for the ends of a line body [length].
    """

    x: Float
    normals: Float
    reach: Float

    def holds(self, points: Float) -> Mask:
        """Return True for points behind the nearest facet."""
        near = self._nearest.of_each_size(points, FACETS)
        away = points[:, None] - self.x[near]
        height = (away * self.normals[near]).sum(axis=2)
        across = np.linalg.norm(away - height[..., None] * self.normals[near], axis=2)
        distance = np.hypot(height, np.maximum(across - self.reach[near], 0.0))
        extent = np.maximum(self.reach[near], ON_FACE * np.linalg.norm(away, axis=2))
        first = distance.min(axis=1, keepdims=True)
        if self.x.shape[1] == 3:
            may_be = distance <= first + UNKNOWN * extent
            return np.asarray((~may_be | (height <= ON_FACE * extent)).all(axis=1))
        # At a corner of two lines their normals are added.
        beside = distance <= first + 1e3 * ON_FACE * extent
        return np.asarray(np.where(beside, height, 0.0).sum(axis=1) <= ON_FACE * extent.max(axis=1))

    @cached_property
    def _nearest(self) -> _Nearest:
        # Facets of a line body have no extent.
        return _Nearest(self.x, self.reach if self.reach.min() > 0.0 else np.ones(len(self.x)))


@dataclass(frozen=True)
class Triangles:
    """A surface of triangles (k, 3, 3) [length]: a point is inside if it is behind the nearest triangle.

    If triangles disagree at the nearest edge or corner, solid angles decide.
    """

    corners: Float

    def holds(self, points: Float) -> Mask:
        """Return True for points inside."""
        near = self._nearest.of_each_size(points, FACETS)
        corners, (normal, size) = self.corners[near], (one[near] for one in self._normals)
        foot = _foot(points[:, None], corners)
        away = points[:, None] - foot
        distance, height = np.linalg.norm(away, axis=2), ((points[:, None] - corners[:, :, 0]) * normal).sum(axis=2)
        beside = distance <= distance.min(axis=1, keepdims=True) + 1e3 * ON_FACE * size
        behind = height <= ON_FACE * size
        found = np.asarray((~beside | behind).all(axis=1))
        for k in np.flatnonzero(~found & (beside & behind).any(axis=1) & (distance.min(axis=1) > ON_FACE * size[:, 0])):
            found[k] = _turns(self.corners - points[k]) > 0.5
        return np.asarray(found | (distance.min(axis=1) <= ON_FACE * size[:, 0]))

    @cached_property
    def _normals(self) -> tuple[Float, Float]:
        """Return unit normals and lengths of the longest sides."""
        a, b, c = np.moveaxis(self.corners, 1, 0)
        normal = np.cross(b - a, c - a)
        size = np.max([np.linalg.norm(side, axis=1) for side in (b - a, c - b, a - c)], axis=0)
        return normal / np.linalg.norm(normal, axis=1)[:, None], size

    @cached_property
    def _nearest(self) -> _Nearest:
        return _Nearest(self.corners.mean(axis=1), self._normals[1])


def _foot(p: Float, corners: Float) -> Float:
    """Return the points of triangles (m, k, 3, 3) nearest to points (m, 1, 3), by the regions around them.

    The nearest point of the plane if it is within the triangle, else the nearest point of a side.
    """
    a, b, c = np.moveaxis(corners, 2, 0)
    ab, ac, ap = b - a, c - a, p - a
    d00, d01, d11 = (ab * ab).sum(axis=2), (ab * ac).sum(axis=2), (ac * ac).sum(axis=2)
    d20, d21 = (ap * ab).sum(axis=2), (ap * ac).sum(axis=2)
    whole = d00 * d11 - d01 * d01
    v, w = (d11 * d20 - d01 * d21) / whole, (d00 * d21 - d01 * d20) / whole
    within = (v >= 0.0) & (w >= 0.0) & (v + w <= 1.0)
    best = a + v[..., None] * ab + w[..., None] * ac
    least = np.where(within, -1.0, np.inf)
    for start, end in ((a, b), (b, c), (c, a)):
        side = end - start
        share = np.clip(((p - start) * side).sum(axis=2) / (side * side).sum(axis=2), 0.0, 1.0)
        there = start + share[..., None] * side
        apart = ((p - there) ** 2).sum(axis=2)
        closer = apart < least
        best[closer], least = there[closer], np.minimum(least, apart)
    return np.asarray(best)


def _turns(corners: Float) -> float:
    """Return the winding numbers of triangles (k, 3, 3) about the origin: solid angles over that of a sphere.

    By the formula of Van Oosterom and Strackee.
    """
    a, b, c = np.moveaxis(corners, 1, 0)
    la, lb, lc = (np.linalg.norm(one, axis=1) for one in (a, b, c))
    over = (a * np.cross(b, c)).sum(axis=1)
    under = la * lb * lc + (a * b).sum(axis=1) * lc + (b * c).sum(axis=1) * la + (c * a).sum(axis=1) * lb
    return float(2.0 * np.arctan2(over, under).sum() / (4.0 * np.pi))


def inside_of(x: Float, volume: Float, thickness: float, facets: Facets | None = None) -> Inside:
    """Return the point location of a body: by its cells, else by its facets, else by discs of its particles.

    Parameters
    ----------
    x : (n, dim) float64
        Positions of the particles [length].
    volume : (n,) float64
        Their volumes [length^dim times thickness].
    thickness : float
        Of a plane body [length], cross-section of a line body [length^2], 1 of a solid one.
    facets : Facets, optional
        The surface.
    """
    dim = x.shape[1]
    lattice = lattice_cells(x, volume, thickness)
    if lattice is not None:
        cell, sides = lattice
        wide = cell.max(axis=0)
        return Boxes(x, np.where(wide > 0, np.ptp(x, axis=0) / np.maximum(wide, 1), sides))
    discs = Discs.of(x, volume / thickness)
    if facets is None or not len(facets.x):
        return discs
    places, area = facets.x, facets.area
    size = np.linalg.norm(area, axis=1)
    places, area, size = places[size > 0.0], area[size > 0.0], size[size > 0.0]
    middle = x.mean(axis=0)
    open_by = np.linalg.norm(area.sum(axis=0)) / size.sum()
    held = float(((places - middle) * area).sum()) / dim
    if open_by > CLOSED or abs(held - volume.sum()) > HELD * volume.sum():
        # A part of the surface is not sufficient to locate points.
        return discs
    if len(facets.triangles):
        return Enclosed(discs.x, discs.h, Triangles(facets.triangles))
    reach = {1: 0.0 * size, 2: 0.5 * size / thickness, 3: np.sqrt(size / np.pi)}[dim]
    return Enclosed(discs.x, discs.h, Flat(places, area / size[:, None], reach))


@dataclass(frozen=True)
class Held:
    """Connection of particles: their bond is neither broken nor cut by a crack.

    Attributes
    ----------
    x : (n, dim) float64
        Positions [length].
    cracks : sequence of Crack
        Pre-cracks of the case.
    broken : (k, 2) int64
        Pairs of particles whose bond is broken.
    horizon : float
        Particles farther apart have no bond; their connection is unknown [length].
    """

    x: Float
    cracks: Sequence[Crack] = ()
    broken: GlobalIndex = field(default_factory=lambda: np.empty((0, 2), dtype=np.int64))
    horizon: float = np.inf

    def of_body(self, particles: GlobalIndex, dim: int) -> Held:
        """Return the connection of the particles of a body, in ascending order, by their first coordinates."""
        broken = self.broken[np.isin(self.broken, particles).all(axis=1)]
        return replace(self, x=self.x[particles, :dim], broken=np.searchsorted(particles, broken))

    def connects(self, home: GlobalIndex, near: GlobalIndex) -> Mask:
        """Return True for particles near a home particle (m, k) that are connected with it (m,)."""
        a, b = np.repeat(self.x[home], near.shape[1], axis=0), self.x[near.ravel()]
        held = ~self.cut(a, b).reshape(near.shape)
        if len(self.broken):
            own = home[:, None]
            held &= ~np.isin(np.minimum(own, near) * len(self.x) + np.maximum(own, near), self._codes)
            held &= np.linalg.norm(b - a, axis=1).reshape(near.shape) <= self.horizon * (1.0 + 1e-9)
        return np.asarray(held | (near == home[:, None]))

    def cut(self, a: Float, b: Float) -> Mask:
        """Return True for lines from ``a`` to ``b`` (n, dim) that a pre-crack crosses."""
        found = np.zeros(len(a), dtype=bool)
        for crack in self.cracks:
            found |= crack.cuts(a, b)
        return found

    def on_side(self, points: Float, homes: GlobalIndex, sides: Float) -> GlobalIndex:
        """Return home particles (m,) on the same side of cracks as points (m, dim); unchanged on a crack."""
        if not self.cracks:
            return homes
        wrong = np.flatnonzero(homes >= 0)
        wrong = wrong[self.cut(points[wrong], self.x[homes[wrong]])]
        if not len(wrong):
            return homes
        most = min(2 * 3 ** self.x.shape[1], len(self.x))
        near = scipy.spatial.cKDTree(self.x / sides).query(points[wrong] / sides, k=most)[1].reshape(len(wrong), most)
        free = ~self.cut(np.repeat(points[wrong], most, axis=0), self.x[near.ravel()]).reshape(near.shape)
        chosen = np.array(homes)
        chosen[wrong] = np.where(free.any(axis=1), near[np.arange(len(wrong)), free.argmax(axis=1)], homes[wrong])
        return chosen

    @cached_property
    def _codes(self) -> GlobalIndex:
        return np.asarray(np.sort(self.broken, axis=1) @ np.array([len(self.x), 1]))
