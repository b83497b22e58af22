"""Loops over ``sum_s b_s h_s (x) g_s``: stencils whose members have one vector each for forces and for displacements.

The vectors ``h`` and ``g`` (n_entries, dim) are those of the entries of each stencil, ``ptr[s]`` to ``ptr[s + 1]``.
Those of ``g`` sum to zero in a stencil: a translation changes nothing.
"""

from __future__ import annotations

from collections.abc import Callable
from functools import lru_cache
from typing import Any

import numpy as np

from pdpetsc.kernels.compile import compiled


@lru_cache
def rank_one_times_kernel(dim: int) -> Callable[..., Any]:
    """Return ``times(particles, first, ptr, members, h, g, b, u, f)``: adds ``b_s h_k (sum_l g_l . u_l)`` to ``k``.

    The stencils of own particle ``i`` are ``first[i]`` to ``first[i + 1]``; those of the given particles count.
    """

    @compiled
    def times(particles, first, ptr, members, h, g, b, u, f):  # type: ignore[no-untyped-def]
        for q in range(particles.size):
            i = particles[q]
            for s in range(first[i], first[i + 1]):
                if b[s] == 0.0:
                    continue
                # Relative to the first member, so that what moves all of them does not round.
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
def rank_one_rows_kernel(dim: int) -> Callable[..., Any]:
    """Return the kernel that adds ``K_ac = sum_s b_s h_sa (x) g_sc`` to rows of K.

    Arguments up to ``members`` and the layout are those of ``kernels.assembly.assemble_kernel``.
    """
    size = dim * dim

    @compiled
    def rows(  # type: ignore[no-untyped-def]
        first_row, diag_ptr, off_ptr, columns, local_ptr, locals_of, behind, signs, entry_ptr, entries, entry_point,
        ptr, members, h, g, b, diag, off,
    ):  # fmt: skip
        slot = np.zeros(entry_ptr.size, np.int32)
        widest = 0
        for row in range(diag_ptr.size - 1):
            widest = max(widest, diag_ptr[row + 1] - diag_ptr[row] + off_ptr[row + 1] - off_ptr[row])
        blocks = np.empty(widest * size)
        left = np.empty(dim)
        for row in range(diag_ptr.size - 1):
            a = first_row + row
            if entry_ptr[a] == entry_ptr[a + 1]:
                continue
            begin = diag_ptr[row] + off_ptr[row]
            n_diag = diag_ptr[row + 1] - diag_ptr[row]
            n_off = off_ptr[row + 1] - off_ptr[row]
            for q in range(n_diag + n_off):
                column = columns[begin + q]
                for c in range(local_ptr[column], local_ptr[column + 1]):
                    slot[locals_of[c]] = q
            for v in range((n_diag + n_off) * size):
                blocks[v] = 0.0
            for e in range(entry_ptr[a], entry_ptr[a + 1]):
                t = entries[e]
                s = entry_point[e]
                pushed = False
                for i in range(dim):
                    left[i] = b[s] * h[t, i] * signs[behind[a], i]
                    pushed = pushed or left[i] != 0.0
                if not pushed:
                    continue
                for o in range(ptr[s], ptr[s + 1]):
                    member = members[o]
                    base = slot[member] * size
                    for k in range(dim):
                        right = g[o, k] * signs[behind[member], k]
                        for i in range(dim):
                            blocks[base + i * dim + k] += left[i] * right
            for i in range(dim):
                start = size * diag_ptr[row] + i * dim * n_diag
                for q in range(n_diag):
                    for k in range(dim):
                        diag[start + dim * q + k] += blocks[q * size + i * dim + k]
                start = size * off_ptr[row] + i * dim * n_off
                for q in range(n_off):
                    for k in range(dim):
                        off[start + dim * q + k] += blocks[(n_diag + q) * size + i * dim + k]

    return rows


@lru_cache
def rank_one_blocks_kernel(dim: int) -> Callable[..., Any]:
    """Return ``blocks(ptr, members, h, g, b, out)``: adds ``b_s h_k (x) g_k`` to each member ``k``.

    A member with vectors other than zero is listed once in its stencil.
    """

    @compiled
    def blocks(ptr, members, h, g, b, out):  # type: ignore[no-untyped-def]
        for s in range(ptr.size - 1):
            for t in range(ptr[s], ptr[s + 1]):
                for m in range(dim):
                    for n in range(dim):
                        out[members[t], m, n] += b[s] * h[t, m] * g[t, n]

    return blocks
