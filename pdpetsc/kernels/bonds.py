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
from pdpetsc.kernels.rows import add_row, find_slots, widest_row


@compiled
def direction(i, j, x, u, finite, n):  # type: ignore[no-untyped-def]
    """Write the direction of bond ``ij`` into ``n``; return its reference and its current length."""
    reference = 0.0
    current = 0.0
    for m in range(n.size):
        xi = x[j, m] - x[i, m]
        y = xi + finite * (u[j, m] - u[i, m])
        n[m] = y
        reference += xi * xi
        current += y * y
    current = np.sqrt(current)
    if current > 0.0:
        for m in range(n.size):
            n[m] /= current
    return np.sqrt(reference), current


@lru_cache
def lengths_kernel(dim: int) -> Callable[..., Any]:
    """Return ``lengths(indptr, neighbours, x, length)``: writes the reference length of every bond."""

    @compiled
    def lengths(indptr, neighbours, x, length):  # type: ignore[no-untyped-def]
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
    def elongation(indptr, neighbours, x, u, e):  # type: ignore[no-untyped-def]
        n = np.empty(dim)
        least = np.inf
        for i in range(indptr.size - 1):
            for b in range(indptr[i], indptr[i + 1]):
                j = neighbours[b]
                reference, current = direction(i, j, x, u, finite, n)
                if current < least or np.isnan(current):
                    least = current
                if finite:
                    e[b] = current - reference
                else:
                    value = 0.0
                    for m in range(dim):
                        value += n[m] * (u[j, m] - u[i, m])
                    e[b] = value
        return least

    return elongation


@lru_cache
def bond_force_kernel(dim: int, finite: int) -> Callable[..., Any]:
    """Return ``force(indptr, neighbours, x, u, tension, f)``: adds ``t_ij n_ij`` to ``j`` and its opposite to ``i``."""

    @compiled
    def force(indptr, neighbours, x, u, tension, f):  # type: ignore[no-untyped-def]
        n = np.empty(dim)
        centre = np.empty(dim)
        for i in range(indptr.size - 1):
            centre[:] = 0.0
            for b in range(indptr[i], indptr[i + 1]):
                j = neighbours[b]
                direction(i, j, x, u, finite, n)
                for m in range(dim):
                    value = tension[b] * n[m]
                    f[j, m] += value
                    centre[m] -= value
            for m in range(dim):
                f[i, m] += centre[m]

    return force


@lru_cache
def bond_rows_kernel(dim: int, finite: int) -> Callable[..., Any]:
    """Return the kernel that adds the tangent of bonds to rows of K.

    The block of bond ``ij`` is ``k n n + finite t / |xi + eta| (I - n n)``; it is added to ``ii`` and ``jj``, its
    opposite to ``ij`` and ``ji``. The stencils of the layout are the bonds; their members are the ``ends`` ``i`` and
    ``j``.
    """

    @compiled
    def rows(layout, ends, x, u, stiffness, tension, diag, off):  # type: ignore[no-untyped-def]
        behind, signs, entry_ptr, entries = layout.behind, layout.signs, layout.entry_ptr, layout.entries
        slot = np.zeros(entry_ptr.size, np.int32)
        n = np.empty(dim)
        blocks = np.empty((widest_row(layout), dim, dim))
        for row in range(layout.diag_ptr.size - 1):
            blocks[: find_slots(layout, row, slot)] = 0.0
            a = layout.first + row
            for e in range(entry_ptr[a], entry_ptr[a + 1]):
                b = layout.entry_point[e]
                _, current = direction(ends[2 * b], ends[2 * b + 1], x, u, finite, n)
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
    def elongation(ends, n, u, e):  # type: ignore[no-untyped-def]
        for p in range(e.size):
            value = 0.0
            for m in range(dim):
                value += n[p, m] * (u[ends[p, 1], m] - u[ends[p, 0], m])
            e[p] = value

    return elongation


@compiled
def first_failure(e, rate, limit, able):  # type: ignore[no-untyped-def]
    """Return the smallest step along ``rate`` at which an ``able`` bond reaches its limit; infinity if none does."""
    least = np.inf
    for b in range(e.size):
        if able[b] and rate[b] > 0.0:
            step = (limit[b] - e[b]) / rate[b]
            if step < least:
                least = step
    return max(least, 0.0)


@compiled
def first_of_tied(e, rate, limit, able, step, tolerance, order):  # type: ignore[no-untyped-def]
    """Return the tied bond of smallest ``order``, -1 if no bond is tied.

    A bond is tied if it is ``able``, grows, and is within a relative tolerance of its limit after a step.
    """
    first = -1
    for b in range(e.size):
        tied = able[b] and rate[b] > 0.0 and e[b] + step * rate[b] >= limit[b] * (1.0 - tolerance)
        if tied and (first < 0 or order[b] < order[first]):
            first = b
    return first
