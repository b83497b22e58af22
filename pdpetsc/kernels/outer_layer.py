"""Empty cones of families, and the parts of planes nearest to a particle."""

from __future__ import annotations

import numpy as np

from pdpetsc.kernels.compile import compiled
from pdpetsc.kernels.overlap import clip, polygon_moments


@compiled
def is_empty(indptr, neighbours, x, i, n, limit):
    """Return True if no bond of own particle ``i`` has a cosine above a limit with the unit direction ``n`` (dim,)."""
    for b in range(indptr[i], indptr[i + 1]):
        j, along, square = neighbours[b], 0.0, 0.0
        for m in range(x.shape[1]):
            xi = x[j, m] - x[i, m]
            along += xi * n[m]
            square += xi * xi
        if along > limit * np.sqrt(square):
            return False
    return True


@compiled
def empty_cones(indptr, neighbours, x, rows, n, limit, found):
    """Mark the unit directions ``n`` (m, dim) of own particles ``rows`` (m,) that are axes of empty cones (m,).

    ``limit`` is the largest cosine of the axis with a bond [-].
    """
    for k in range(rows.size):
        found[k] = is_empty(indptr, neighbours, x, rows[k], n[k], limit)


@compiled
def emptiest(indptr, neighbours, x, directions, limit, turns, cosine, n):
    """Find the axes of the widest empty cones of families: of the widest one, and of the widest one behind it.

    The best of some directions is turned away from the bond that is nearest to it, in ever smaller steps.

    Parameters
    ----------
    indptr, neighbours
        Families.
    x : (n_local, dim) float64
        Positions [length].
    directions : (n_directions, dim) float64
        Unit directions to begin with.
    limit : float
        Largest cosine with a bond of a direction to begin with [-].
    turns : (n_turns,) float64
        The steps [-].
    cosine : (n_owned, 2) float64
        Largest cosine of each axis with a bond [-]; 2 without an empty cone.
    n : (n_owned, 2, dim) float64
        The axes.
    """
    dim = x.shape[1]
    most = 0
    for i in range(indptr.size - 1):
        most = max(most, indptr[i + 1] - indptr[i])
    e, trial = np.empty((most, dim)), np.empty(dim)
    for i in range(indptr.size - 1):
        size = indptr[i + 1] - indptr[i]
        for b in range(size):
            j, square = neighbours[indptr[i] + b], 0.0
            for m in range(dim):
                e[b, m] = x[j, m] - x[i, m]
                square += e[b, m] ** 2
            for m in range(dim):
                e[b, m] /= np.sqrt(square)
        for side in range(2):
            cosine[i, side] = 2.0
            for k in range(directions.shape[0]):
                if side == 1:
                    along = 0.0
                    for m in range(dim):
                        along += directions[k, m] * n[i, 0, m]
                    if along > -0.5:
                        continue
                nearest = -1.0
                for b in range(size):
                    along = 0.0
                    for m in range(dim):
                        along += directions[k, m] * e[b, m]
                    nearest = max(nearest, along)
                    if nearest > limit:
                        break
                if nearest <= limit and nearest < cosine[i, side]:
                    cosine[i, side] = nearest
                    for m in range(dim):
                        n[i, side, m] = directions[k, m]
            if cosine[i, side] == 2.0:
                break
            for m in range(dim):
                trial[m] = n[i, side, m]
            for turn in turns:
                nearest, at = -2.0, -1
                for b in range(size):
                    along = 0.0
                    for m in range(dim):
                        along += trial[m] * e[b, m]
                    if along > nearest:
                        nearest, at = along, b
                if at < 0:
                    break
                if nearest < cosine[i, side]:
                    cosine[i, side] = nearest
                    for m in range(dim):
                        n[i, side, m] = trial[m]
                square = 0.0
                for m in range(dim):
                    trial[m] -= turn * e[at, m]
                    square += trial[m] ** 2
                for m in range(dim):
                    trial[m] /= np.sqrt(square)


@compiled
def cut_planes(n, offset, half, axes, ptr, points, x, area):
    """Compute the parts of planes that are nearer to the origin than to any of some points.

    The plane ``n . y = offset`` is cut off at ``half`` along two axes, and by the planes half-way to the points.

    Parameters
    ----------
    n : (n_planes, dim) float64
        Unit normals.
    offset, half : (n_planes,) float64
        Distances of the planes, and half widths [length].
    axes : (n_planes, dim - 1, dim) float64
        Unit axes of each plane.
    ptr : (n_planes + 1,) int64
        Start of the points of each plane.
    points : (n_points, dim) float64
        [length].
    x : (n_planes, dim) float64
        Centroids of the parts [length]; not set without area.
    area : (n_planes,) float64
        Their areas, or lengths in the plane [length^(dim - 1)].
    """
    dim = n.shape[1]
    # A convex polygon has one more corner after each cut.
    corner, kept = np.empty((4 + points.shape[0], 2)), np.empty((4 + points.shape[0], 2))
    for p in range(n.shape[0]):
        area[p] = 0.0
        h = half[p]
        if dim == 2:
            low, high = -h, h
            for q in range(ptr[p], ptr[p + 1]):
                a = points[q, 0] * axes[p, 0, 0] + points[q, 1] * axes[p, 0, 1]
                c = points[q, 0] * n[p, 0] + points[q, 1] * n[p, 1]
                room = 0.5 * (points[q, 0] ** 2 + points[q, 1] ** 2) - offset[p] * c + 1e-9 * h * h
                if a > 1e-12 * h:
                    high = min(high, room / a)
                elif a < -1e-12 * h:
                    low = max(low, room / a)
                elif room < 0.0:
                    high = low
            area[p] = max(high - low, 0.0)
            for m in range(2):
                x[p, m] = offset[p] * n[p, m] + 0.5 * (low + high) * axes[p, 0, m]
            continue
        count = 4
        corner[0, 0], corner[0, 1] = -h, -h
        corner[1, 0], corner[1, 1] = h, -h
        corner[2, 0], corner[2, 1] = h, h
        corner[3, 0], corner[3, 1] = -h, h
        for q in range(ptr[p], ptr[p + 1]):
            a, b, c, square = 0.0, 0.0, 0.0, 0.0
            for m in range(3):
                a += points[q, m] * axes[p, 0, m]
                b += points[q, m] * axes[p, 1, m]
                c += points[q, m] * n[p, m]
                square += points[q, m] ** 2
            room = 0.5 * square - offset[p] * c + 1e-9 * h * h
            count = clip(corner, kept, count, room, a, b, 0.0)
            if count < 3:
                break
        if count < 3:
            continue
        twice, first, second = polygon_moments(corner, count)
        if twice <= 0.0:
            continue
        area[p] = 0.5 * twice
        first, second = corner[0, 0] + first / twice, corner[0, 1] + second / twice
        for m in range(3):
            x[p, m] = offset[p] * n[p, m] + first * axes[p, 0, m] + second * axes[p, 1, m]


@compiled
def bare(indptr, neighbours, x, rows, normals, directions, empty, covered, found):
    """Mark own particles with an empty cone whose axis is far from all of their normals.

    Parameters
    ----------
    indptr, neighbours, x
        As for ``emptiest``.
    rows : (m,) int64
        The particles.
    normals : (m, most, dim) float64
        Their unit normals, followed by zeros.
    directions : (n_directions, dim) float64
        Unit axes of the cones.
    empty, covered : float
        Largest cosine of the axis with a bond, and smallest one with a normal [-].
    found : (m,) bool
        The marks.
    """
    dim = x.shape[1]
    for p in range(rows.size):
        i = rows[p]
        found[p] = False
        for k in range(directions.shape[0]):
            beside = False
            for one in range(normals.shape[1]):
                along = 0.0
                for m in range(dim):
                    along += directions[k, m] * normals[p, one, m]
                beside = beside or along >= covered
            if beside:
                continue
            if is_empty(indptr, neighbours, x, i, directions[k], empty):
                found[p] = True
                break
