"""Loops over bonds with forces along the bond.

``finite`` is 0 or 1, a compile-time constant: with 0 a bond keeps its direction ``n = xi / |xi|`` and its elongation is
``e = n . eta``, with 1 ``n`` is the current direction and ``e = |xi + eta| - |xi|``.
"""

from __future__ import annotations

from collections.abc import Callable
from functools import lru_cache
from typing import Any

import numpy as np

from pdpetsc.kernels.compile import compiled
from pdpetsc.kernels.components import add_to, difference
from pdpetsc.kernels.rows import add_row, find_slots, widest_row

# Least distance of two particles, against division by zero.
TINY = 1e-300


@compiled
def direction(i, j, x, u, dim, finite):
    """Return the components of the direction of bond ``ij``, its reference and its current length."""
    n_0, n_1, n_2 = difference(i, j, x, dim)
    reference = np.sqrt(n_0 * n_0 + n_1 * n_1 + n_2 * n_2)
    current = reference
    if finite:
        eta_0, eta_1, eta_2 = difference(i, j, u, dim)
        n_0, n_1, n_2 = n_0 + eta_0, n_1 + eta_1, n_2 + eta_2
        current = np.sqrt(n_0 * n_0 + n_1 * n_1 + n_2 * n_2)
    if current > 0.0:
        inverse = 1.0 / current
        n_0, n_1, n_2 = n_0 * inverse, n_1 * inverse, n_2 * inverse
    return n_0, n_1, n_2, reference, current


@lru_cache
def lengths_kernel(dim: int) -> Callable[..., Any]:
    """Return ``lengths(indptr, neighbours, x, length)``: writes the reference length of every bond."""

    @compiled
    def lengths(indptr, neighbours, x, length):
        for i in range(indptr.size - 1):
            for b in range(indptr[i], indptr[i + 1]):
                square = 0.0
                for m in range(dim):
                    xi = x[neighbours[b], m] - x[i, m]
                    square += xi * xi
                length[b] = np.sqrt(square)

    return lengths


@lru_cache
def elongation_kernel(dim: int, finite: int) -> Callable[..., Any]:
    """Return ``elongation(indptr, neighbours, x, u, e)``: writes ``e_ij``; returns the smallest length, or NaN."""

    @compiled
    def elongation(indptr, neighbours, x, u, e):
        least = np.inf
        for i in range(indptr.size - 1):
            for b in range(indptr[i], indptr[i + 1]):
                j = neighbours[b]
                n_0, n_1, n_2, reference, current = direction(i, j, x, u, dim, finite)
                if current < least or np.isnan(current):
                    least = current
                if finite:
                    e[b] = current - reference
                else:
                    eta_0, eta_1, eta_2 = difference(i, j, u, dim)
                    e[b] = n_0 * eta_0 + n_1 * eta_1 + n_2 * eta_2
        return least

    return elongation


@lru_cache
def bond_force_kernel(dim: int, finite: int) -> Callable[..., Any]:
    """Return ``force(indptr, neighbours, x, u, tension, f)``: adds ``t_ij n_ij`` to ``j`` and its opposite to ``i``."""

    @compiled
    def force(indptr, neighbours, x, u, tension, f):
        for i in range(indptr.size - 1):
            own_0, own_1, own_2 = 0.0, 0.0, 0.0
            for b in range(indptr[i], indptr[i + 1]):
                j, t = neighbours[b], tension[b]
                n_0, n_1, n_2, _, _ = direction(i, j, x, u, dim, finite)
                add_to(f, j, t * n_0, t * n_1, t * n_2, dim)
                own_0, own_1, own_2 = own_0 - t * n_0, own_1 - t * n_1, own_2 - t * n_2
            add_to(f, i, own_0, own_1, own_2, dim)

    return force


@lru_cache
def bond_rows_kernel(dim: int, finite: int) -> Callable[..., Any]:
    """Return the kernel that adds the tangent of bonds to rows of K.

    The block of bond ``ij`` is ``k n n + finite t / |xi + eta| (I - n n)``; it is added to ``ii`` and ``jj``, its
    opposite to ``ij`` and ``ji``. The stencils of the layout are the bonds; their members are the ``ends`` ``i`` and
    ``j``.
    """

    @compiled
    def rows(layout, ends, x, u, stiffness, tension, diag, off):
        behind, signs, entry_ptr, entries = layout.behind, layout.signs, layout.entry_ptr, layout.entries
        slot = np.zeros(entry_ptr.size, np.int32)
        n = np.empty(3)
        blocks = np.empty((widest_row(layout), dim, dim))
        for row in range(layout.diag_ptr.size - 1):
            blocks[: find_slots(layout, row, slot)] = 0.0
            a = layout.first + row
            for e in range(entry_ptr[a], entry_ptr[a + 1]):
                b = layout.entry_point[e]
                n[0], n[1], n[2], _, current = direction(ends[2 * b], ends[2 * b + 1], x, u, dim, finite)
                turning = finite * tension[b] / current
                for side in range(2):
                    other = ends[entries[e] ^ side]
                    q = slot[other]
                    sign = 1.0 - 2.0 * side
                    for i in range(dim):
                        for k in range(dim):
                            value = sign * (stiffness[b] - turning) * n[i] * n[k]
                            if i == k:
                                value += sign * turning
                            blocks[q, i, k] += value * signs[behind[a], i] * signs[behind[other], k]
            add_row(layout, row, blocks, diag, off)

    return rows


@lru_cache
def pair_elongation_kernel(dim: int) -> Callable[..., Any]:
    """Return ``elongation(ends, n, u, e)``: ``e = n . (u_j - u_i)`` for pairs with fixed directions ``n``."""

    @compiled
    def elongation(ends, n, u, e):
        for p in range(e.size):
            value = 0.0
            for m in range(dim):
                value += n[p, m] * (u[ends[p, 1], m] - u[ends[p, 0], m])
            e[p] = value

    return elongation


@compiled
def first_failure(e, rate, limit, able):
    """Return the smallest step along ``rate`` at which an ``able`` bond reaches its limit; infinity if none does."""
    least = np.inf
    for b in range(e.size):
        if able[b] and rate[b] > 0.0:
            step = (limit[b] - e[b]) / rate[b]
            if step < least:
                least = step
    return max(least, 0.0)


@compiled
def first_of_tied(e, rate, limit, able, step, tolerance, order):
    """Return the tied bond of smallest ``order``, -1 if no bond is tied.

    A bond is tied if it is ``able``, grows, and is within a relative tolerance of its limit after a step.
    """
    first = -1
    for b in range(e.size):
        tied = able[b] and rate[b] > 0.0 and e[b] + step * rate[b] >= limit[b] * (1.0 - tolerance)
        if tied and (first < 0 or order[b] < order[first]):
            first = b
    return first


@compiled
def change_of_lengths(near, x, u, length, dim, both, begin):
    """Return the largest relative decrease, and increase if ``both``, of distances since ``length`` (n, m) was written.

    ``near`` (n, m) are the particles around each particle. If ``begin``, the distances are written.
    """
    most = 0.0
    for i in range(near.shape[0]):
        for k in range(near.shape[1]):
            j, square = near[i, k], 0.0
            if j == i:
                continue
            for m in range(dim):
                square += (x[j, m] + u[j, m] - x[i, m] - u[i, m]) ** 2
            now = max(np.sqrt(square), TINY)
            change = length[i, k] / now - 1.0
            if both:
                change = max(change, now / length[i, k] - 1.0)
            most = max(most, change)
            if begin:
                length[i, k] = now
    return most
