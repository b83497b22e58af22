"""Overlap of facets that face each other."""

from __future__ import annotations

import numpy as np

from pdpetsc.kernels.compile import compiled

# Corners of the overlap of two convex quadrilaterals, at most.
MOST = 8
# Edges and areas below this share of those of a facet are none.
NONE = 1e-12


@compiled
def overlap(one, other, facing, area, at, across, normal, gap):  # type: ignore[no-untyped-def]
    """Compute the overlap of pairs of facets, seen along the mean of their normals.

    Parameters
    ----------
    one, other : (n_pairs, 4, 3) float64
        Corners of both facets, in turn as seen from outside [length].
    facing : float
        Pairs overlap only if the cosine of the angle between the normal of one and minus that of the other exceeds it.
    area : (n_pairs,) float64
        Area of the overlap, across the mean normal; 0 if there is none (output).
    at, across : (n_pairs, 3) float64
        The middle of the overlap on one facet, and on the other (output) [length].
    normal : (n_pairs, 3) float64
        Mean normal, from the other facet to the one (output).
    gap : (n_pairs,) float64
        Distance along it, negative if the facets have passed through each other (output) [length].
    """
    p, q = np.empty((MOST + 1, 2)), np.empty((MOST + 1, 2))
    edge = np.empty((4, 2))
    n, e = np.empty(3), np.empty((2, 3))
    a, b = np.empty(3), np.empty(3)
    ca, cb = np.empty(3), np.empty(3)
    for s in range(one.shape[0]):
        area[s] = 0.0
        sa = _plane(one[s], ca, a)
        sb = _plane(other[s], cb, b)
        if a[0] * b[0] + a[1] * b[1] + a[2] * b[2] > -facing:
            continue
        size = 0.0
        for m in range(3):
            n[m] = b[m] - a[m]
            size += n[m] * n[m]
        size = np.sqrt(size)
        for m in range(3):
            n[m] /= size
        # Axes across the normal: the first one is across the axis along which the normal is longest.
        k = 0
        for m in range(1, 3):
            if abs(n[m]) > abs(n[k]):
                k = m
        m1, m2 = (k + 1) % 3, (k + 2) % 3
        e[0, :] = 0.0
        size = np.sqrt(n[k] * n[k] + n[m1] * n[m1])
        e[0, k], e[0, m1] = -n[m1] / size, n[k] / size
        e[1, 0] = n[1] * e[0, 2] - n[2] * e[0, 1]
        e[1, 1] = n[2] * e[0, 0] - n[0] * e[0, 2]
        e[1, 2] = n[0] * e[0, 1] - n[1] * e[0, 0]
        # Relative to the middle of the one. As seen along n, the other facet turns left and the one turns right.
        count = 0
        for c in range(4):
            for d in range(2):
                p[c, d] = 0.0
                edge[c, d] = 0.0
                for m in range(3):
                    p[c, d] += e[d, m] * (one[s, 3 - c, m] - ca[m])
                    edge[c, d] += e[d, m] * (other[s, c, m] - ca[m])
        count = 4
        least = NONE * np.sqrt(max(sa, sb))
        for c in range(4):
            x0, y0 = edge[c, 0], edge[c, 1]
            dx, dy = edge[(c + 1) % 4, 0] - x0, edge[(c + 1) % 4, 1] - y0
            if abs(dx) + abs(dy) <= least:
                continue
            kept = 0
            for v in range(count):
                w = (v + 1) % count
                left = dx * (p[v, 1] - y0) - dy * (p[v, 0] - x0)
                after = dx * (p[w, 1] - y0) - dy * (p[w, 0] - x0)
                if left >= 0.0 and kept < MOST + 1:
                    q[kept, 0], q[kept, 1] = p[v, 0], p[v, 1]
                    kept += 1
                if (left >= 0.0) != (after >= 0.0) and kept < MOST + 1:
                    share = left / (left - after)
                    q[kept, 0] = p[v, 0] + share * (p[w, 0] - p[v, 0])
                    q[kept, 1] = p[v, 1] + share * (p[w, 1] - p[v, 1])
                    kept += 1
            count = kept
            for v in range(count):
                p[v, 0], p[v, 1] = q[v, 0], q[v, 1]
            if count < 3:
                break
        if count < 3:
            continue
        twice, mx, my = 0.0, 0.0, 0.0
        for v in range(1, count - 1):
            x1, y1 = p[v, 0] - p[0, 0], p[v, 1] - p[0, 1]
            x2, y2 = p[v + 1, 0] - p[0, 0], p[v + 1, 1] - p[0, 1]
            part = x1 * y2 - x2 * y1
            twice += part
            mx += part * (x1 + x2) / 3.0
            my += part * (y1 + y2) / 3.0
        if 0.5 * twice <= NONE * min(sa, sb):
            continue
        mx, my = p[0, 0] + mx / twice, p[0, 1] + my / twice
        # Heights of both facets above the middle.
        ha, hb, na, nb = 0.0, 0.0, 0.0, 0.0
        for m in range(3):
            y = ca[m] + mx * e[0, m] + my * e[1, m]
            ha += a[m] * (ca[m] - y)
            hb += b[m] * (cb[m] - y)
            na += a[m] * n[m]
            nb += b[m] * n[m]
            at[s, m] = y
            across[s, m] = y
        for m in range(3):
            at[s, m] += ha / na * n[m]
            across[s, m] += hb / nb * n[m]
            normal[s, m] = n[m]
        gap[s] = ha / na - hb / nb
        area[s] = 0.5 * twice


@compiled
def _plane(corners, middle, normal):  # type: ignore[no-untyped-def]
    """Compute the mean of four corners (4, 3) and the unit normal of their facet; return its area."""
    for m in range(3):
        middle[m] = 0.25 * (corners[0, m] + corners[1, m] + corners[2, m] + corners[3, m])
    size = 0.0
    for m in range(3):
        m1, m2 = (m + 1) % 3, (m + 2) % 3
        normal[m] = 0.5 * (
            (corners[2, m1] - corners[0, m1]) * (corners[3, m2] - corners[1, m2])
            - (corners[2, m2] - corners[0, m2]) * (corners[3, m1] - corners[1, m1])
        )
        size += normal[m] * normal[m]
    size = np.sqrt(size)
    for m in range(3):
        normal[m] /= size
    return size
