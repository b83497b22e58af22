"""Loops over ``sum_s b_s h_s (x) g_s``: stencils with one force vector and one displacement vector per member.

The vectors ``h`` and ``g`` (n_entries, dim) are those of the entries of each stencil, ``ptr[s]`` to ``ptr[s + 1]``. The
vectors ``g`` of a stencil sum to zero: a translation has no effect.
"""

from __future__ import annotations

from collections.abc import Callable
from functools import lru_cache
from typing import Any

import numpy as np

from pdpetsc.kernels.compile import compiled
from pdpetsc.kernels.rows import add_row, find_slots, widest_row


@lru_cache
def rank_one_times_kernel(dim: int) -> Callable[..., Any]:
    """Return ``times(particles, first, ptr, members, h, g, b, u, f)``: adds ``b_s h_k (sum_l g_l . u_l)`` to ``k``.

    The stencils of own particle ``i`` are ``first[i]`` to ``first[i + 1]``; only those of ``particles`` are added.
    """

    @compiled
    def times(particles, first, ptr, members, h, g, b, u, f):
        for q in range(particles.size):
            i = particles[q]
            for s in range(first[i], first[i + 1]):
                if b[s] == 0.0:
                    continue
                # Relative to the first member: a translation causes no round-off.
                c = members[ptr[s]]
                rate = 0.0
                for t in range(ptr[s] + 1, ptr[s + 1]):
                    k = members[t]
                    for m in range(dim):
                        rate += g[t, m] * (u[k, m] - u[c, m])
                rate *= b[s]
                for t in range(ptr[s], ptr[s + 1]):
                    k = members[t]
                    for m in range(dim):
                        f[k, m] += rate * h[t, m]

    return times


@lru_cache
def facet_times_kernel(dim: int, rank: int) -> Callable[..., Any]:
    """Return ``times(particles, first, ptr, members, h, g, u, f)``: adds ``sum_a h_ka (sum_l g_la . u_l)`` to ``k``.

    The vectors are (n_entries, rank, dim), and those of a stencil need not sum to zero. The stencils of own particle
    ``i`` are ``first[i]`` to ``first[i + 1]``; only those of ``particles`` are added.
    """

    @compiled
    def times(particles, first, ptr, members, h, g, u, f):
        rate = np.empty(rank)
        for q in range(particles.size):
            i = particles[q]
            for s in range(first[i], first[i + 1]):
                for a in range(rank):
                    rate[a] = 0.0
                for t in range(ptr[s], ptr[s + 1]):
                    k = members[t]
                    for a in range(rank):
                        for m in range(dim):
                            rate[a] += g[t, a, m] * u[k, m]
                for t in range(ptr[s], ptr[s + 1]):
                    k = members[t]
                    for m in range(dim):
                        force = 0.0
                        for a in range(rank):
                            force += h[t, a, m] * rate[a]
                        f[k, m] += force

    return times


@lru_cache
def rank_one_rows_kernel(dim: int) -> Callable[..., Any]:
    """Return ``rows(layout, ptr, members, h, g, b, diag, off)``, which adds ``K_ac = sum_s b_s h_sa (x) g_sc``."""

    @compiled
    def rows(layout, ptr, members, h, g, b, diag, off):
        behind, signs, entry_ptr = layout.behind, layout.signs, layout.entry_ptr
        slot = np.zeros(entry_ptr.size, np.int32)
        blocks = np.empty((widest_row(layout), dim, dim))
        left = np.empty(dim)
        for row in range(layout.diag_ptr.size - 1):
            a = layout.first + row
            if entry_ptr[a] == entry_ptr[a + 1]:
                continue
            blocks[: find_slots(layout, row, slot)] = 0.0
            for e in range(entry_ptr[a], entry_ptr[a + 1]):
                t = layout.entries[e]
                s = layout.entry_point[e]
                pushed = False
                for i in range(dim):
                    left[i] = b[s] * h[t, i] * signs[behind[a], i]
                    pushed = pushed or left[i] != 0.0
                if not pushed:
                    continue
                for o in range(ptr[s], ptr[s + 1]):
                    member = members[o]
                    q = slot[member]
                    for k in range(dim):
                        right = g[o, k] * signs[behind[member], k]
                        for i in range(dim):
                            blocks[q, i, k] += left[i] * right
            add_row(layout, row, blocks, diag, off)

    return rows


@lru_cache
def rank_one_blocks_kernel(dim: int) -> Callable[..., Any]:
    """Return ``blocks(ptr, members, h, g, b, out)``: adds ``b_s h_k (x) g_k`` to each member ``k``.

    A member with vectors other than zero is listed once in its stencil.
    """

    @compiled
    def blocks(ptr, members, h, g, b, out):
        for s in range(ptr.size - 1):
            for t in range(ptr[s], ptr[s + 1]):
                for m in range(dim):
                    for n in range(dim):
                        out[members[t], m, n] += b[s] * h[t, m] * g[t, n]

    return blocks
