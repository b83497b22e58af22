"""Overlap of facets that face each other, and its derivatives."""

from __future__ import annotations

import numpy as np

from pdpetsc.kernels.compile import compiled

# Corners of the overlap of two convex quadrilaterals, at most.
MOST = 8
# Edges and areas below this share of those of a facet are none. Corners this near to an edge are on it: round-off would
# place edges that coincide on either side, with a derivative without bound.
NONE = 1e-9
# Square of the distance across the normal, over that at which facets cannot overlap, which allows for round-off.
BESIDE = 1.000001
# Step of complex differences over the size of a facet: its square vanishes beside 1.
STEP = 1e-30
# Quantities of a pair: area, gap, normal (3), and the point on both facets (3 each).
AREA, GAP, NORMAL, ONE, OTHER, QUANTITIES = 0, 1, 2, 5, 8, 11


@compiled
def overlap(y, other_y, X, other_X, one, other, facing, q):
    """Compute the overlap of pairs of facets, seen along the mean of their normals.

    Parameters
    ----------
    y, other_y : (n_one, 4, 3), (n_other, 4, 3) float64
        Deformed corners of the facets of both sides, in turn as seen from outside [length].
    X, other_X : as these
        Undeformed corners relative to the centroids of their facets [length].
    one, other : (n_pairs,) int64
        Facets of both sides of each pair.
    facing : float
        Pairs overlap only if the cosine of the angle between the normal of one and minus that of the other exceeds it.
    q : (n_pairs, 11) float64
        Quantities of each pair, written here; zeros at first. First the area of the overlap across the mean normal, 0
        if there is none. Then the distance of the facets along that normal at the middle of the overlap, negative if
        they have passed through each other. Then the mean normal, from the other facet to the one. Last the undeformed
        points of both facets that are at the middle, relative to their centroids.
    """
    p, r, edge = np.empty((MOST + 1, 2)), np.empty((MOST + 1, 2)), np.empty((4, 2))
    v = np.empty((6, 3))
    middle, other_middle = _middles(y), _middles(other_y)
    for s in range(one.size):
        a, b = one[s], other[s]
        if not _beside(middle[a], other_middle[b]):
            _pair(y[a], other_y[b], X[a], other_X[b], facing, p, r, edge, v, q[s])


@compiled
def overlap_by_fields(y, other_y, X, other_X, one, other, facing, J):
    """Compute the derivatives of the quantities of ``overlap`` by the motion of the facets, with complex differences.

    ``J`` (n_pairs, 11, 2, 1 + dim, dim) has those by displacement and displacement gradient of both facets:
    ``[:, :, :, 1 + k]`` is the derivative by that of the displacement along axis ``k``. Nothing depends on a
    displacement of both facets together.
    """
    p, r = np.empty((MOST + 1, 2), np.complex128), np.empty((MOST + 1, 2), np.complex128)
    edge, v = np.empty((4, 2), np.complex128), np.empty((6, 3), np.complex128)
    q = np.empty(QUANTITIES, np.complex128)
    facets = np.empty((2, 4, 3), np.complex128)
    dim = J.shape[4]
    for s in range(one.size):
        a, b = one[s], other[s]
        size = 0.0
        for m in range(3):
            size += abs(y[a, 2, m] - y[a, 0, m])
        for side in range(2):
            offsets = X[a] if side == 0 else other_X[b]
            for k in range(1 + dim):
                wide = k == 0 and side == 0
                for corner in range(4):
                    wide = wide or (k > 0 and offsets[corner, k - 1] != 0.0)
                for i in range(dim):
                    if not wide:
                        for number in range(QUANTITIES):
                            J[s, number, side, k, i] = -J[s, number, 0, 0, i] if k == 0 else 0.0
                        continue
                    step = STEP * size if k == 0 else STEP
                    for corner in range(4):
                        for m in range(3):
                            facets[0, corner, m] = y[a, corner, m]
                            facets[1, corner, m] = other_y[b, corner, m]
                    for corner in range(4):
                        facets[side, corner, i] += 1j * step * (1.0 if k == 0 else offsets[corner, k - 1])
                    _pair(facets[0], facets[1], X[a], other_X[b], facing, p, r, edge, v, q)
                    for number in range(QUANTITIES):
                        J[s, number, side, k, i] = q[number].imag / step


@compiled
def _middles(y):
    """Return the middles of facets, their unit normals, and the largest distance of a corner from them (n, 7)."""
    found = np.empty((y.shape[0], 7))
    for a in range(y.shape[0]):
        _plane(y[a], found[a, :3], found[a, 3:6])
        size = 0.0
        for c in range(4):
            away = 0.0
            for m in range(3):
                away += (y[a, c, m] - found[a, m]) ** 2
            size = max(size, away)
        found[a, 6] = np.sqrt(size)
    return found


@compiled
def _beside(one, other):
    """Return True if two facets are too far apart across the mean of their normals to overlap."""
    size, along, far = 0.0, 0.0, 0.0
    for m in range(3):
        n, d = other[3 + m] - one[3 + m], other[m] - one[m]
        size += n * n
        along += n * d
        far += d * d
    reach = one[6] + other[6]
    return (far - BESIDE * reach * reach) * size > along * along


@compiled
def _pair(one, other, X, other_X, facing, p, r, edge, v, q):
    """Compute the quantities ``q`` of one pair; ``p, r, edge, v`` are memory for it."""
    ca, cb, a, b, n, at = v[0], v[1], v[2], v[3], v[4], v[5]
    q[AREA] = 0.0
    sa, sb = _plane(one, ca, a), _plane(other, cb, b)
    if (a[0] * b[0] + a[1] * b[1] + a[2] * b[2]).real > -facing:
        return
    size = (b[0] - a[0]) ** 2 + (b[1] - a[1]) ** 2 + (b[2] - a[2]) ** 2
    size = np.sqrt(size)
    for m in range(3):
        n[m] = (b[m] - a[m]) / size
    # Axes across the normal: the first one is also across an axis of space.
    k = 0
    for m in range(1, 3):
        if abs(n[m].real) > abs(n[k].real):
            k = m
    m1, m2 = (k + 1) % 3, (k + 2) % 3
    size = np.sqrt(n[k] * n[k] + n[m1] * n[m1])
    ek, e1 = -n[m1] / size, n[k] / size
    # The second one is n x (the first one).
    fk, f1, f2 = -n[m2] * e1, n[m2] * ek, n[k] * e1 - n[m1] * ek
    # Relative to the middle of the one. As seen along n, the other facet turns left and the one turns right.
    for c in range(4):
        dk, d1, d2 = one[3 - c, k] - ca[k], one[3 - c, m1] - ca[m1], one[3 - c, m2] - ca[m2]
        p[c, 0], p[c, 1] = ek * dk + e1 * d1, fk * dk + f1 * d1 + f2 * d2
        dk, d1, d2 = other[c, k] - ca[k], other[c, m1] - ca[m1], other[c, m2] - ca[m2]
        edge[c, 0], edge[c, 1] = ek * dk + e1 * d1, fk * dk + f1 * d1 + f2 * d2
    count = 4
    near = NONE * max(sa.real, sb.real)
    least = NONE * np.sqrt(max(sa.real, sb.real))
    for c in range(4):
        x0, y0 = edge[c, 0], edge[c, 1]
        dx, dy = edge[(c + 1) % 4, 0] - x0, edge[(c + 1) % 4, 1] - y0
        if abs(dx.real) + abs(dy.real) <= least:
            continue
        count = clip(p, r, count, dy * x0 - dx * y0, dy, -dx, near)
        if count < 3:
            return
    twice, mx, my = polygon_moments(p, count)
    if 0.5 * twice.real <= NONE * min(sa.real, sb.real):
        return
    mx, my = p[0, 0] + mx / twice, p[0, 1] + my / twice
    at[k] = mx * ek + my * fk
    at[m1] = mx * e1 + my * f1
    at[m2] = my * f2
    # Heights of both facets above the middle.
    ha, hb, na, nb = 0.0 * mx, 0.0 * mx, 0.0 * mx, 0.0 * mx
    for m in range(3):
        ha -= a[m] * at[m]
        hb += b[m] * (cb[m] - ca[m] - at[m])
        na += a[m] * n[m]
        nb += b[m] * n[m]
    ha, hb = ha / na, hb / nb
    q[AREA], q[GAP] = 0.5 * twice, ha - hb
    for m in range(3):
        q[NORMAL + m] = n[m]
    # a and b are not needed any more: the points on both facets, relative to their middles.
    for m in range(3):
        a[m] = at[m] + ha * n[m]
        b[m] = at[m] + hb * n[m] + ca[m] - cb[m]
    _undeformed(one, X, a, q[ONE:OTHER])
    _undeformed(other, other_X, b, q[OTHER:QUANTITIES])


@compiled
def clip(p, r, count, room, a, b, near):
    """Cut the polygon of the first corners ``p`` (count, 2) off where ``a x + b y > room``; return its new count.

    Corners up to ``near`` beyond are kept. ``r`` is memory like ``p``.
    """
    kept = 0
    for s in range(count):
        t = (s + 1) % count
        left = room - a * p[s, 0] - b * p[s, 1]
        after = room - a * p[t, 0] - b * p[t, 1]
        if left.real >= -near and kept < r.shape[0]:
            r[kept, 0], r[kept, 1] = p[s, 0], p[s, 1]
            kept += 1
        if min(left.real, after.real) < -near and max(left.real, after.real) > near and kept < r.shape[0]:
            share = left / (left - after)
            for m in range(2):
                r[kept, m] = p[s, m] + share * (p[t, m] - p[s, m])
            kept += 1
    for s in range(kept):
        p[s, 0], p[s, 1] = r[s, 0], r[s, 1]
    return kept


@compiled
def polygon_moments(p, count):
    """Compute twice the area of the polygon of the first corners ``p`` (count, 2), and its moments.

    These are twice the area times the centroid, relative to the first corner.
    """
    twice = 0.0 * p[0, 0]
    first, second = twice, twice
    for s in range(1, count - 1):
        x1, y1 = p[s, 0] - p[0, 0], p[s, 1] - p[0, 1]
        x2, y2 = p[s + 1, 0] - p[0, 0], p[s + 1, 1] - p[0, 1]
        part = x1 * y2 - x2 * y1
        twice += part
        first += part * (x1 + x2) / 3.0
        second += part * (y1 + y2) / 3.0
    return twice, first, second


@compiled
def _undeformed(y, X, d, point):
    """Compute the undeformed point that is at ``d`` from the mean of the deformed corners of a flat facet."""
    aa, ab, bb, ad, bd = 0.0 * d[0], 0.0 * d[0], 0.0 * d[0], 0.0 * d[0], 0.0 * d[0]
    for m in range(3):
        a = 0.5 * (y[1, m] + y[2, m] - y[0, m] - y[3, m])
        b = 0.5 * (y[2, m] + y[3, m] - y[0, m] - y[1, m])
        aa += a * a
        ab += a * b
        bb += b * b
        ad += a * d[m]
        bd += b * d[m]
    det = aa * bb - ab * ab
    along, across = (bb * ad - ab * bd) / det, (aa * bd - ab * ad) / det
    for m in range(3):
        middle = 0.25 * (X[0, m] + X[1, m] + X[2, m] + X[3, m])
        a = 0.5 * (X[1, m] + X[2, m] - X[0, m] - X[3, m])
        b = 0.5 * (X[2, m] + X[3, m] - X[0, m] - X[1, m])
        point[m] = middle + along * a + across * b


@compiled
def _plane(corners, middle, normal):
    """Compute the mean of four corners (4, 3) and the unit normal of their facet; return its area."""
    for m in range(3):
        middle[m] = 0.25 * (corners[0, m] + corners[1, m] + corners[2, m] + corners[3, m])
        m1, m2 = (m + 1) % 3, (m + 2) % 3
        normal[m] = 0.5 * (
            (corners[2, m1] - corners[0, m1]) * (corners[3, m2] - corners[1, m2])
            - (corners[2, m2] - corners[0, m2]) * (corners[3, m1] - corners[1, m1])
        )
    size = np.sqrt(normal[0] * normal[0] + normal[1] * normal[1] + normal[2] * normal[2])
    for m in range(3):
        normal[m] /= size
    return size
