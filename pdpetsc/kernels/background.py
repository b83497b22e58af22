"""Loops of the background grid: pieces of cells, connection by bonds, interpolation, and element stiffness."""

from __future__ import annotations

from collections.abc import Callable
from functools import lru_cache
from typing import Any

import numpy as np

from pdpetsc.kernels.compile import compiled


@compiled
def root(parent, i):
    """Return the representative of ``i``, with path halving."""
    while parent[i] != i:
        parent[i] = parent[parent[i]]
        i = parent[i]
    return i


@compiled
def join(parent, i, j):
    """Join ``i`` and ``j``: both have the smaller representative."""
    one = root(parent, i)
    two = root(parent, j)
    if one < two:
        parent[two] = one
    else:
        parent[one] = two


@compiled
def join_within_cells(indptr, neighbours, kept, cell, parent):
    """Join the ends of kept bonds within a cell in ``parent`` (n_local,); if ``kept`` is empty, all bonds are kept."""
    for i in range(indptr.size - 1):
        for b in range(indptr[i], indptr[i + 1]):
            j = neighbours[b]
            if cell[j] == cell[i] and parent[i] != parent[j] and (kept.size == 0 or kept[b]):
                join(parent, i, j)
    for i in range(parent.size):
        parent[i] = root(parent, i)


@compiled
def join_corners(indptr, neighbours, kept, order, element, nodes, parent):
    """Join in ``parent`` (n_elements * n_corners,) the corners at one node of elements that a kept bond connects.

    ``nodes`` (n_elements, n_corners) are the nodes of the grid at the corners; a particle with negative ``element``
    connects nothing. ``order`` lists the own particles by their element.
    """
    corners = nodes.shape[1]
    seen = np.full(nodes.shape[0], -1, np.int64)
    for o in range(order.size):
        i = order[o]
        here = element[i]
        for b in range(indptr[i], indptr[i + 1]):
            there = element[neighbours[b]]
            if there < 0 or there == here or seen[there] == here or (kept.size > 0 and not kept[b]):
                continue
            seen[there] = here
            for p in range(corners):
                for q in range(corners):
                    if nodes[here, p] == nodes[there, q]:
                        join(parent, here * corners + p, there * corners + q)
    for c in range(parent.size):
        parent[c] = root(parent, c)


@lru_cache
def interpolate_kernel(dim: int) -> Callable[..., Any]:
    """Return ``interpolate(element, at, corners, wraps, lengths, nodal, strain, u)``.

    Writes ``u_i = sum_q N_q(at_i) (nodal_q + strain o_q)`` of the particles, ``N_q`` linear in each coordinate of
    ``at`` in [0, 1], with the periods ``o_q`` between corner ``q`` and its node: ``lengths`` if the element ``wraps``
    and the corner is the upper one.
    """
    n_corners = 2**dim

    @compiled
    def interpolate(element, at, corners, wraps, lengths, nodal, strain, u):
        for i in range(element.size):
            e = element[i]
            for m in range(dim):
                u[i, m] = 0.0
            for q in range(n_corners):
                weight = 1.0
                for d in range(dim):
                    weight *= at[i, d] if (q >> d) & 1 else 1.0 - at[i, d]
                node = corners[e, q]
                for m in range(dim):
                    value = nodal[node, m]
                    for d in range(dim):
                        if wraps[e, d] and (q >> d) & 1:
                            value += strain[m, d] * lengths[d]
                    u[i, m] += weight * value

    return interpolate


@lru_cache
def restrict_kernel(dim: int) -> Callable[..., Any]:
    """Return ``restrict(element, at, corners, wraps, lengths, f, nodal, moment)``, the transpose of interpolation.

    Adds to ``nodal`` (n_nodes, dim), and to ``moment`` (dim, dim) the sums of ``f (x) o``.
    """
    n_corners = 2**dim

    @compiled
    def restrict(element, at, corners, wraps, lengths, f, nodal, moment):
        for i in range(element.size):
            e = element[i]
            for q in range(n_corners):
                weight = 1.0
                for d in range(dim):
                    weight *= at[i, d] if (q >> d) & 1 else 1.0 - at[i, d]
                node = corners[e, q]
                for m in range(dim):
                    value = weight * f[i, m]
                    nodal[node, m] += value
                    for d in range(dim):
                        if wraps[e, d] and (q >> d) & 1:
                            moment[m, d] += value * lengths[d]

    return restrict


@lru_cache
def tied_kernel(dim: int) -> Callable[..., Any]:
    """Return ``tied(particles, element, at, blocks, begin, K)``: adds ``N_p N_q blocks_i`` to elements of particles.

    ``K`` is (n_elements, n_corners, n_corners, dim, dim), of the elements from ``begin`` on.
    """
    n_corners = 2**dim

    @compiled
    def tied(particles, element, at, blocks, begin, K):
        weight = np.empty(n_corners)
        for s in range(particles.size):
            i = particles[s]
            e = element[i] - begin
            for q in range(n_corners):
                weight[q] = 1.0
                for d in range(dim):
                    weight[q] *= at[i, d] if (q >> d) & 1 else 1.0 - at[i, d]
            for p in range(n_corners):
                for q in range(n_corners):
                    for m in range(dim):
                        for n in range(dim):
                            K[e, p, q, m, n] += weight[p] * weight[q] * blocks[s, m, n]

    return tied


@compiled
def add_elements(slots, K, values):
    """Add the blocks of elements (n, corners, corners, dim, dim) to ``values[slots]`` (n_blocks, dim, dim)."""
    n, corners, dim = K.shape[0], K.shape[1], K.shape[3]
    for e in range(n):
        for p in range(corners):
            for q in range(corners):
                b = slots[e, p, q]
                for m in range(dim):
                    for k in range(dim):
                        values[b, m, k] += K[e, p, q, m, k]


@compiled
def add_at(position, blocks, values):
    """Add blocks (n, dim, dim) to ``values[position]``."""
    for b in range(position.size):
        for m in range(blocks.shape[1]):
            for k in range(blocks.shape[2]):
                values[position[b], m, k] += blocks[b, m, k]


@compiled
def scalar_values(block_ptr, blocks, values):
    """Write blocks (n_blocks, dim, dim) as the values of scalar CSR rows of the same matrix."""
    dim = blocks.shape[1]
    for a in range(block_ptr.size - 1):
        n = block_ptr[a + 1] - block_ptr[a]
        for q in range(n):
            for i in range(dim):
                start = dim * dim * block_ptr[a] + i * dim * n + dim * q
                for k in range(dim):
                    values[start + k] = blocks[block_ptr[a] + q, i, k]


@compiled
def sum_in_elements(element, values, sums):
    """Add the rows of ``values`` (n, m) to those of ``sums`` (n_elements, m)."""
    for i in range(element.size):
        for m in range(values.shape[1]):
            sums[element[i], m] += values[i, m]
