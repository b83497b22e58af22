"""Quadratic cells: nodes between corners, and integrals over curved edges and faces."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
import scipy

from pdpetsc.arrays import Float, GlobalIndex, Mask
from pdpetsc.errors import CaseError

_BOTTOM, _TOP = [(0, 1), (1, 2), (2, 3), (3, 0)], [(4, 5), (5, 6), (6, 7), (7, 4)]
_UPRIGHT = [(0, 4), (1, 5), (2, 6), (3, 7)]
_TETRA = [(0, 1), (1, 2), (2, 0), (0, 3), (1, 3), (2, 3)]
# Edges of a cell in the order of their middle nodes. Exodus and Nastran have upright edges before those of the top,
# Abaqus and VTK after them, and Gmsh orders edges by their first corner. Readers do not reorder all of them, so the
# order with the nodes nearest to the middles is used.
EDGES: dict[str, list[list[tuple[int, int]]]] = {
    "triangle": [[(0, 1), (1, 2), (2, 0)]],
    "quad": [_BOTTOM],
    "tetra": [_TETRA, [*_TETRA[:4], _TETRA[5], _TETRA[4]]],
    "pyramid": [
        [*_BOTTOM, (0, 4), (1, 4), (2, 4), (3, 4)],
        [(0, 1), (0, 3), (0, 4), (1, 2), (1, 4), (2, 3), (2, 4), (3, 4)],
    ],
    "wedge": [
        [(0, 1), (1, 2), (2, 0), (3, 4), (4, 5), (5, 3), (0, 3), (1, 4), (2, 5)],
        [(0, 1), (1, 2), (2, 0), (0, 3), (1, 4), (2, 5), (3, 4), (4, 5), (5, 3)],
        [(0, 1), (0, 2), (0, 3), (1, 2), (1, 4), (2, 5), (3, 4), (3, 5), (4, 5)],
    ],
    "hexahedron": [
        [*_BOTTOM, *_TOP, *_UPRIGHT],
        [*_BOTTOM, *_UPRIGHT, *_TOP],
        [(0, 1), (0, 3), (0, 4), (1, 2), (1, 5), (2, 3), (2, 6), (3, 7), (4, 5), (4, 7), (5, 6), (6, 7)],
    ],
}
# Nodes of a facet besides its corners: in the middles of up to four edges, and one inside.
MIDDLES = 5
# A node this near to the middle of a straight edge, as a share of the edge, is in the middle.
_STRAIGHT = 1e-10
# A node farther from the middle of its edge than this, as a share of the edge, is not of that edge.
_FAR = 0.5
_SIGNS = np.array([[-1.0, -1.0], [1.0, -1.0], [1.0, 1.0], [-1.0, 1.0]])


def middles(
    points: Float, kind: str, nodes: GlobalIndex, n_corners: int, facets: Sequence[tuple[int, ...]]
) -> GlobalIndex:
    """Return the nodes between the corners of the facets of cells (n_facets of a cell, n, ``MIDDLES``); -1 if missing.

    Parameters
    ----------
    points : (n_points, dim) float64
        Positions of the nodes [length].
    kind : str
        A key of ``CORNERS``.
    nodes : (n, m) int64
        The nodes of the cells, corners first.
    n_corners : int
        Their number of corners.
    facets : sequence of tuple of int
        The corners of each facet in turn.

    Raises
    ------
    CaseError
        Nodes are not near the middles of the edges in any known order.
    """
    found = np.full((len(facets), len(nodes), MIDDLES), -1, dtype=np.int64)
    orders = EDGES.get(kind, [[]])
    count = len(orders[0])
    if count == 0 or nodes.shape[1] < n_corners + count or len(nodes) == 0:
        return found
    off = [_off_middles(points, nodes, n_corners, order) for order in orders]
    best = int(np.argmin([np.nansum(one) for one in off]))
    far = np.flatnonzero((off[best] > _FAR).any(axis=1))
    if len(far):
        raise CaseError(
            f"{len(far)} quadratic cells of kind {kind} have nodes far from the middles of their edges, the first at "
            f"{points[nodes[far[0], :n_corners]].mean(axis=0)}. Reorder their nodes, or use linear cells."
        )
    middle = {frozenset(edge): n_corners + k for k, edge in enumerate(orders[best])}
    rest = nodes[:, n_corners + count :]
    for place, corners in enumerate(facets):
        ring = [(corners[k], corners[(k + 1) % len(corners)]) for k in range(len(corners))]
        ring = ring[:1] if len(corners) == 2 else ring
        for k, edge in enumerate(ring):
            found[place, :, k] = nodes[:, middle[frozenset(edge)]]
        if len(corners) == 4 and kind != "quad" and rest.shape[1]:
            found[place, :, 4] = _nearest_within(points, nodes[:, list(corners)], found[place, :, :4], rest)
    return found


def _off_middles(points: Float, nodes: GlobalIndex, n_corners: int, order: Sequence[tuple[int, int]]) -> Float:
    """Return the distances of nodes from the middles of edges over their lengths (n, n_edges); 0 on collapsed edges."""
    x = points[nodes]
    found = []
    for k, (a, b) in enumerate(order):
        length = np.linalg.norm(x[:, b] - x[:, a], axis=1)
        away = np.linalg.norm(x[:, n_corners + k] - 0.5 * (x[:, a] + x[:, b]), axis=1)
        found.append(np.where(length > 0.0, away / np.where(length > 0.0, length, 1.0), 0.0))
    return np.stack(found, axis=1)


def _nearest_within(points: Float, corners: GlobalIndex, edges: GlobalIndex, rest: GlobalIndex) -> GlobalIndex:
    """Return the remaining node of each cell (n, k) that is in the middle of a face; -1 if none is near."""
    middle = 0.5 * points[edges].sum(axis=1) - 0.25 * points[corners].sum(axis=1)
    size = np.linalg.norm(points[corners[:, 2]] - points[corners[:, 0]], axis=1)
    away = np.linalg.norm(points[rest] - middle[:, None], axis=2)
    nearest = np.argmin(away, axis=1)
    rows = np.arange(len(rest))
    # The middle of the cell is about half a cell away.
    return np.where(away[rows, nearest] < 0.25 * size, rest[rows, nearest], -1)


def bent(points: Float, corners: GlobalIndex, middle: GlobalIndex) -> Mask:
    """Return True for facets with a node off their straight edges or bilinear face (n,).

    Parameters
    ----------
    corners : (n, 4) int64
        Corner nodes of facets in cyclic order, followed by -1 if there are fewer than four.
    middle : (n, ``MIDDLES``) int64
        Their other nodes; -1 if missing.
    """
    found = np.zeros(len(corners), dtype=bool)
    count = (corners >= 0).sum(axis=1)
    for m in (2, 3, 4):
        of = np.flatnonzero((count == m) & (middle[:, 0] >= 0))
        x = points[corners[of, :m]]
        size = np.linalg.norm(x - np.roll(x, 1, axis=1), axis=2).max(axis=1, initial=0.0)
        for k in range(1 if m == 2 else m):
            between = 0.5 * (x[:, k] + x[:, (k + 1) % m])
            found[of] |= np.linalg.norm(points[middle[of, k]] - between, axis=1) > _STRAIGHT * size
        within = middle[of, 4] >= 0
        off = np.linalg.norm(points[middle[of, 4]] - x.mean(axis=1), axis=1) > _STRAIGHT * size
        found[of] |= within & off
    return found


def quadrature(points: Float, corners: GlobalIndex, middle: GlobalIndex, degree: int) -> tuple[Float, Float]:
    """Return positions (n, q, dim) and vector areas (n, q, dim) of curved facets with equal numbers of corners.

    Parameters
    ----------
    corners : (n, 2, 3 or 4) int64
        Nodes in turn.
    middle : (n, ``MIDDLES``) int64
        Nodes within.
    degree : {1, 2}
        Degree of positions with exact sums over the areas: ``sum x (x) a`` for 1, also ``sum x^2 a`` for 2.
    """
    m = corners.shape[1]
    x = points[np.concatenate([corners, middle[:, : 1 if m == 2 else m]], axis=1)]
    if m == 2:
        return _on_lines(x, degree + 1)
    if m == 3:
        return _summed(x, *_triangle(2 * degree + 1))
    ring, full = _square(degree + 2)
    places, areas = _summed(x, *ring)
    within = np.flatnonzero(middle[:, 4] >= 0)
    if len(within):
        nine = np.concatenate([x[within], points[middle[within, 4]][:, None]], axis=1)
        places[within], areas[within] = _summed(nine, *full)
    return places, areas


def _summed(x: Float, N: Float, along: Float, across: Float, weight: Float) -> tuple[Float, Float]:
    """Return positions and vector areas from shape functions (q, m), their derivatives, and weights (q,)."""
    areas = np.cross(np.einsum("qm,nmi->nqi", along, x), np.einsum("qm,nmi->nqi", across, x)) * weight[:, None]
    return np.einsum("qm,nmi->nqi", N, x), areas


def _on_lines(x: Float, order: int) -> tuple[Float, Float]:
    s, weight = scipy.special.roots_legendre(order)
    N = np.stack([0.5 * s * (s - 1.0), 0.5 * s * (s + 1.0), 1.0 - s**2], axis=1)
    along = np.einsum("qm,nmi->nqi", np.stack([s - 0.5, s + 0.5, -2.0 * s], axis=1), x)
    area = np.stack([along[..., 1], -along[..., 0]], axis=-1) * weight[:, None]
    return np.einsum("qm,nmi->nqi", N, x), area


def _triangle(order: int) -> tuple[Float, Float, Float, Float]:
    """Return shape functions of six nodes and their derivatives at the points of a collapsed square."""
    s, w = scipy.special.roots_legendre(order)
    u, v = np.meshgrid(0.5 * (s + 1.0), 0.5 * (s + 1.0), indexing="ij")
    weight = (0.25 * np.outer(w, w) * (1.0 - u)).ravel()
    b, c = u.ravel(), (v * (1.0 - u)).ravel()
    a = 1.0 - b - c
    zero = np.zeros_like(a)
    N = np.stack([a * (2 * a - 1), b * (2 * b - 1), c * (2 * c - 1), 4 * a * b, 4 * b * c, 4 * c * a], axis=1)
    along = np.stack([1 - 4 * a, 4 * b - 1, zero, 4 * (a - b), 4 * c, -4 * c], axis=1)
    across = np.stack([1 - 4 * a, zero, 4 * c - 1, -4 * b, 4 * b, 4 * (a - c)], axis=1)
    return N, along, across, weight


def _square(order: int) -> list[tuple[Float, Float, Float, Float]]:
    """Return shape functions of eight and of nine nodes, and their derivatives, at the points of a square."""
    g, w = scipy.special.roots_legendre(order)
    s, t = (one.ravel() for one in np.meshgrid(g, g, indexing="ij"))
    weight = np.outer(w, w).ravel()
    N, along, across = [], [], []
    for a, b in _SIGNS:
        p, q, r = 1 + a * s, 1 + b * t, a * s + b * t - 1
        N.append(0.25 * p * q * r)
        along.append(0.25 * a * q * (r + p))
        across.append(0.25 * b * p * (r + q))
    for k in range(4):
        a, b = 0.5 * (_SIGNS[k] + _SIGNS[(k + 1) % 4])
        if a == 0.0:
            N.append(0.5 * (1 - s**2) * (1 + b * t))
            along.append(-s * (1 + b * t))
            across.append(0.5 * b * (1 - s**2))
        else:
            N.append(0.5 * (1 - t**2) * (1 + a * s))
            along.append(0.5 * a * (1 - t**2))
            across.append(-t * (1 + a * s))
    eight = [np.stack(one, axis=1) for one in (N, along, across)]
    # The bubble is subtracted from corners and middles.
    bubble = ((1 - s**2) * (1 - t**2), -2 * s * (1 - t**2), -2 * t * (1 - s**2))
    share = np.array([0.25] * 4 + [-0.5] * 4)
    nine = [np.column_stack([one + np.outer(part, share), part]) for one, part in zip(eight, bubble, strict=True)]
    return [(eight[0], eight[1], eight[2], weight), (nine[0], nine[1], nine[2], weight)]
