"""Rigid tools of any shape: a closed polygon in 2D, a closed surface of triangles in space."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property
from pathlib import Path

import numpy as np
import scipy
from numpy.typing import ArrayLike

from pdpetsc.arrays import Float, GlobalIndex
from pdpetsc.declare.formats import read_surface
from pdpetsc.declare.schedule import Ramp, Schedule
from pdpetsc.declare.tools import RigidTool
from pdpetsc.declared import real_numbers
from pdpetsc.errors import CaseError

# Vertices closer than this share of the size of the tool are one: STL files repeat them for every triangle.
SAME = 1e-9
# A triangle has no area if it is below this share of the largest.
FLAT = 1e-12
# Pairs of points and parts of the surface that are compared at once.
AT_ONCE = 1_000_000


@dataclass(frozen=True, eq=False)
class RigidSurface(RigidTool):
    """A rigid body within one or several closed surfaces.

    The normal at an edge or a corner is that of the distance outside, and the mean of the sides inside, weighted by
    their angles. A facet of the body outside of the box around the tool gets its distance from the box, which is
    shorter.

    Parameters
    ----------
    points : (n, dim) array_like
        Vertices [length].
    parts : (m, dim) array_like of int, optional
        Numbers of the vertices of each segment in 2D, of each triangle in space, in any sense; by default the segments
        from each vertex to the next, and from the last to the first.
    move, turn, about, force, moment, follows, schedule, mass, inertia, velocity, spin
        As for ``RigidTool``.

    Raises
    ------
    CaseError
        A surface is open (an edge belongs to one triangle, or to more than two), or surfaces intersect.

    References
    ----------
    Baerentzen2005 (sign of the distance by normals weighted by angles).

    Examples
    --------
    >>> import pdpetsc as pd
    >>> wedge = pd.RigidSurface([(0.0, 10.0), (2.0, 16.0), (-2.0, 16.0)], move=(0.0, -3.0))
    """

    points: ArrayLike
    parts: ArrayLike | None = None

    @classmethod
    def read(
        cls, path: str | Path, unit: float = 1.0, move: Sequence[float] = (), turn: Sequence[float] = (),
        about: Sequence[float] = (), schedule: Schedule | Sequence[Schedule] | None = None, *,
        force: Sequence[float | None] = (), moment: float | Sequence[float] = (), mass: float | None = None,
        inertia: float | Sequence[float] | Sequence[Sequence[float]] | None = None, velocity: Sequence[float] = (),
        spin: float | Sequence[float] = (), follows: bool = False,
    ) -> RigidSurface:  # fmt: skip
        """Read a surface of triangles, such as an STL file.

        Parameters
        ----------
        path : str or Path
            A file of any format of ``Mesh``, or STL.
        unit : float
            Length of the unit of the file [length].
        move, turn, about, force, moment, follows, schedule, mass, inertia, velocity, spin
            As for ``RigidTool``.
        """
        mesh = read_surface(Path(path))
        triangles = [block.nodes for block in mesh.blocks if block.dim == 2 and block.nodes.shape[1] == 3]
        if not triangles:
            raise CaseError(f"{path} holds no triangles; a RigidSurface needs the surface of the tool.")
        points, parts = unit * np.asarray(mesh.points), np.concatenate(triangles)
        return cls(
            points, parts, move=move, turn=turn, about=about, schedule=schedule or Ramp(), force=force, moment=moment,
            mass=mass, inertia=inertia, velocity=velocity, spin=spin, follows=follows,
        )  # fmt: skip

    def __post_init__(self) -> None:
        super().__post_init__()
        points = real_numbers(self.points)
        if points is None or points.ndim != 2 or points.shape[1] not in (2, 3) or not np.isfinite(points).all():
            raise CaseError("RigidSurface takes vertices of 2 or 3 finite numbers each.")
        if self.parts is None and points.shape[1] == 3:
            raise CaseError("RigidSurface takes the numbers of the vertices of its triangles as parts.")
        _ = self._surface

    def check(self, dim: int) -> None:
        """Raise CaseError if the surface has another number of dimensions than ``dim``."""
        super().check(dim)
        if self._surface.x.shape[1] != dim:
            raise CaseError(f"RigidSurface has vertices of {self._surface.x.shape[1]} numbers in {dim} dimensions.")

    @cached_property
    def _surface(self) -> _Surface:
        x = np.asarray(self.points, dtype=float)
        if self.parts is None:
            parts = np.stack([np.arange(len(x)), np.roll(np.arange(len(x)), -1)], axis=1)
        else:
            parts = np.asarray(self.parts)
        if parts.ndim != 2 or parts.shape[1] != x.shape[1] or not np.issubdtype(parts.dtype, np.integer):
            raise CaseError(f"RigidSurface takes parts of {x.shape[1]} numbers of vertices each.")
        if parts.size == 0 or parts.min() < 0 or parts.max() >= len(x):
            raise CaseError(f"RigidSurface has {len(x)} vertices, and parts with others.")
        return _Surface.of(x, parts.astype(np.int64))

    def gap(self, x: Float, u: Float) -> tuple[Float, Float, Float]:
        """Compute the signed distance from the nearest part."""
        return self._surface.gap(x + u)


class _Surface:
    """Store a closed surface with its normals.

    Attributes
    ----------
    x : (n, dim) float64
        Vertices.
    parts : (m, dim) int64
        Vertices of the parts, which all look outwards.
    normals : (m, n_features, dim) float64
        Normals at the vertices and, of triangles, at the edges opposite to them, and of the part itself. They decide on
        the sign only, so that those of vertices and edges are not normalised.
    """

    def __init__(self, x: Float, parts: GlobalIndex, normals: Float) -> None:
        self.x, self.parts, self.normals = x, parts, normals
        corners = x[parts]
        middle = corners.mean(axis=1)
        self._reach = float(np.linalg.norm(corners - middle[:, None], axis=2).max())
        self._tree = scipy.spatial.cKDTree(middle)
        self._low, self._high = x.min(axis=0), x.max(axis=0)

    @classmethod
    def of(cls, x: Float, parts: GlobalIndex) -> _Surface:
        """Join equal vertices, turn all parts outwards and compute the normals."""
        size = float(np.linalg.norm(x.max(axis=0) - x.min(axis=0)))
        _, first, number = np.unique(np.round(x / (SAME * size)), axis=0, return_index=True, return_inverse=True)
        x, parts = x[first], number.ravel()[parts]
        parts = parts[[len(set(part)) == len(part) for part in parts.tolist()]]
        if not _is_closed(parts):
            raise CaseError(
                "The surface of a RigidSurface is open, or its parts are not turned alike: let each edge (each vertex "
                "in 2D) belong to two parts, with all normals outwards or all inwards."
            )
        shells = [_outwards(x, shell) for shell in _shells(len(x), parts)]
        if len(shells) > 1:
            whole = [cls(x[np.unique(shell)], _renumbered(shell), _normals(x, shell)) for shell in shells]
            for number, shell in enumerate(shells):
                others = [one for other, one in enumerate(whole) if other != number]
                within = [one.gap(x[np.unique(shell)])[0] < 0.0 for one in others]
                if any(inside.any() != inside.all() for inside in within):
                    raise CaseError("Surfaces of a RigidSurface intersect; join them, or use several contacts.")
                if sum(bool(inside.all()) for inside in within) % 2:
                    shells[number] = shell[:, ::-1]
            parts = np.concatenate(shells)
        else:
            parts = shells[0]
        return cls(x, parts, _normals(x, parts))

    def gap(self, y: Float) -> tuple[Float, Float, Float]:
        """Compute distance, normal and curvature at points (n, dim)."""
        dim = y.shape[1]
        outside = np.maximum(np.maximum(self._low - y, y - self._high), 0.0)
        g = np.linalg.norm(outside, axis=1)
        n = np.where((g > 0.0)[:, None], np.sign(y - self._low - 0.5 * (self._high - self._low)), 0.0)
        n = n * outside / np.where(g > 0.0, g, 1.0)[:, None]
        H = np.zeros((len(y), dim, dim))
        near = np.flatnonzero(g == 0.0)
        step = max(1, AT_ONCE // max(len(self.parts), 1))
        for start in range(0, len(near), step):
            rows = near[start : start + step]
            g[rows], n[rows], H[rows] = self._within(y[rows])
        return g, n, H

    def _within(self, y: Float) -> tuple[Float, Float, Float]:
        """As ``gap``, of points in the box around the surface."""
        nearest, _ = self._tree.query(y)
        found = self._tree.query_ball_point(y, nearest + self._reach)
        counts = np.array([len(one) for one in found])
        part = np.concatenate([np.asarray(one, dtype=np.int64) for one in found])
        of = np.repeat(np.arange(len(y)), counts)
        corners = self.x[self.parts[part]]
        q, feature = _closest_of_segment(y[of], corners) if y.shape[1] == 2 else _closest_of_triangle(y[of], corners)
        apart = np.linalg.norm(y[of] - q, axis=1)
        # The first of the smallest distances of each point.
        order = np.lexsort((apart, of))
        best = order[np.cumsum(counts) - counts]
        v, r, normal = y - q[best], apart[best], self.normals[part[best], feature[best]]
        n_features, dim = self.normals.shape[1:]
        on_part = feature[best] == n_features - 1
        sign = np.where((v * normal).sum(axis=1) < 0.0, -1.0, 1.0)
        flat = on_part | (r <= SAME * self._reach)
        unit = normal / np.linalg.norm(normal, axis=1)[:, None]
        far = np.where(flat, 1.0, r)[:, None]
        n = np.where(flat[:, None], unit, sign[:, None] * v / far)
        across = np.eye(dim) - n[:, :, None] * n[:, None, :]
        if dim == 3:
            # No curvature along an edge.
            ends = self.x[self.parts[part[best]]]
            number = np.clip(feature[best] - 3, 0, 2)
            along = ends[np.arange(len(y)), (number + 2) % 3] - ends[np.arange(len(y)), (number + 1) % 3]
            along = along / np.linalg.norm(along, axis=1)[:, None]
            on_edge = (feature[best] >= 3) & ~on_part
            across = across - np.where(on_edge[:, None, None], along[:, :, None] * along[:, None, :], 0.0)
        H = np.where(flat[:, None, None], 0.0, sign[:, None, None] * across / far[:, :, None])
        return sign * r, n, H


def _shells(count: int, parts: GlobalIndex) -> list[GlobalIndex]:
    """Return the connected parts of a surface of ``count`` vertices."""
    ends = np.concatenate([parts[:, [0, c]] for c in range(1, parts.shape[1])])
    graph = scipy.sparse.coo_matrix((np.ones(len(ends)), (ends[:, 0], ends[:, 1])), (count, count))
    _, label = scipy.sparse.csgraph.connected_components(graph, directed=False)
    of = label[parts[:, 0]]
    return [parts[of == number] for number in np.unique(of)]


def _outwards(x: Float, parts: GlobalIndex) -> GlobalIndex:
    """Return the parts of one shell with their normals outwards."""
    corners = x[parts] - x[parts].reshape(-1, x.shape[1]).mean(axis=0)
    return parts[:, ::-1] if float(np.linalg.det(corners).sum()) < 0.0 else parts


def _renumbered(parts: GlobalIndex) -> GlobalIndex:
    return np.unique(parts, return_inverse=True)[1].reshape(parts.shape)


def _is_closed(parts: GlobalIndex) -> bool:
    """Return True if each vertex (2D) or edge belongs to two parts, which go through it in opposite senses."""
    if parts.shape[1] == 2:
        starts, ends = np.sort(parts, axis=0).T
        return bool(len(np.unique(starts)) == len(starts) and np.array_equal(starts, ends))
    edges = np.concatenate([parts[:, [0, 1]], parts[:, [1, 2]], parts[:, [2, 0]]])
    forth, back = np.unique(edges, axis=0), np.unique(edges[:, ::-1], axis=0)
    return len(forth) == len(edges) and np.array_equal(forth, back)


def _normals(x: Float, parts: GlobalIndex) -> Float:
    """Compute the normals at the features of each part (m, n_features, dim)."""
    corners, dim = x[parts], x.shape[1]
    if dim == 2:
        along = corners[:, 1] - corners[:, 0]
        own = np.stack([along[:, 1], -along[:, 0]], axis=1) / np.linalg.norm(along, axis=1)[:, None]
        at = np.zeros_like(x)
        np.add.at(at, parts, own[:, None])
        return np.concatenate([at[parts], own[:, None]], axis=1)
    own = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
    size = np.linalg.norm(own, axis=1)
    flat = size <= FLAT * size.max()
    # Triangles without area, which STL files contain, have no normal.
    own = np.where(flat[:, None], 0.0, own / np.where(flat, 1.0, size)[:, None])
    at = np.zeros_like(x)
    for c in range(3):
        one, other = (corners[:, (c + k) % 3] - corners[:, c] for k in (1, 2))
        cosine = (one * other).sum(axis=1) / np.linalg.norm(one, axis=1) / np.linalg.norm(other, axis=1)
        np.add.at(at, parts[:, c], np.arccos(np.clip(cosine, -1.0, 1.0))[:, None] * own)
    edges = np.stack([parts[:, [1, 2]], parts[:, [2, 0]], parts[:, [0, 1]]], axis=1)
    _, number = np.unique(np.sort(edges, axis=2).reshape(-1, 2), axis=0, return_inverse=True)
    at_edge = np.zeros((number.max() + 1, 3))
    np.add.at(at_edge, number.ravel(), np.repeat(own, 3, axis=0))
    return np.concatenate([at[parts], at_edge[number.reshape(-1, 3)], own[:, None]], axis=1)


def _closest_of_segment(y: Float, ends: Float) -> tuple[Float, GlobalIndex]:
    """Compute the closest points (n, 2) of segments (n, 2, 2), and their feature: an end, or 2 between them."""
    along = ends[:, 1] - ends[:, 0]
    t = ((y - ends[:, 0]) * along).sum(axis=1) / (along * along).sum(axis=1)
    feature = np.where(t <= 0.0, 0, np.where(t >= 1.0, 1, 2))
    return ends[:, 0] + np.clip(t, 0.0, 1.0)[:, None] * along, feature


def _closest_of_triangle(y: Float, corners: Float) -> tuple[Float, GlobalIndex]:
    """Compute the closest points (n, 3) of triangles (n, 3, 3), and their feature.

    The features are the corners 0 to 2, the edges opposite to them 3 to 5, and the inside 6.
    """
    a, b, c = corners[:, 0], corners[:, 1], corners[:, 2]
    normal = np.cross(b - a, c - a)
    square = (normal * normal).sum(axis=1)
    square = np.where(square > 0.0, square, np.nan)
    # Barycentric coordinates of the projection onto the plane.
    shares = np.stack(
        [(np.cross(q - p, y - p) * normal).sum(axis=1) / square for p, q in ((b, c), (c, a), (a, b))], axis=1
    )
    inside = np.einsum("nk,nkj->nj", shares, corners)
    best, feature = inside, np.full(len(y), 6)
    distance = np.where((shares > 0.0).all(axis=1), ((y - inside) ** 2).sum(axis=1), np.inf)
    for edge, (one, other) in enumerate(((1, 2), (2, 0), (0, 1))):
        q, at = _closest_of_segment(y, corners[:, [one, other]])
        d = ((y - q) ** 2).sum(axis=1)
        nearer = d < distance
        best = np.where(nearer[:, None], q, best)
        feature = np.where(nearer, np.choose(at, (one, other, 3 + edge)), feature)
        distance = np.where(nearer, d, distance)
    return best, feature
