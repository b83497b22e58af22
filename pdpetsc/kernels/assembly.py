"""Row-wise (Gustavson) assembly of ``K = G^T (W A) G`` into the value arrays of a block matrix."""

from __future__ import annotations

from collections.abc import Callable
from functools import lru_cache
from typing import Any

import numpy as np

from pdpetsc.kernels.compile import compiled
from pdpetsc.kernels.rows import blocks_of_row, find_slots, widest_row


@lru_cache
def assemble_kernel(dim: int) -> Callable[..., Any]:
    """Return ``assemble(layout, point_ptr, members, h, g, volume, A, diag, off)``, which adds to rows of K.

    ``K_ab = sum_p W_p h_pa . A_p . g_pb``, with ``(K_ab)_ik = sum_mn W_p h_pa,m A_p,imkn g_pb,n``; ``h`` is ``g``
    unless damage scales forces.
    """
    size = dim * dim

    @compiled
    def assemble(layout, point_ptr, members, h, g, volume, A, diag, off):
        behind, signs, entry_ptr = layout.behind, layout.signs, layout.entry_ptr
        slot = np.zeros(entry_ptr.size, np.int32)
        # Columns behind different mirror planes are summed separately, and multiplied by their signs at the end.
        n_mirrors = signs.shape[0]
        widest = widest_row(layout)
        blocks = np.empty(n_mirrors * widest * size)
        left = np.empty(size * dim)
        for row in range(layout.diag_ptr.size - 1):
            n_blocks = find_slots(layout, row, slot, widest)
            for mirror in range(n_mirrors):
                for v in range(mirror * widest * size, (mirror * widest + n_blocks) * size):
                    blocks[v] = 0.0
            a = layout.first + row
            for e in range(entry_ptr[a], entry_ptr[a + 1]):
                t = layout.entries[e]
                p = layout.entry_point[e]
                for n in range(dim):
                    for i in range(dim):
                        for k in range(dim):
                            value = 0.0
                            for m in range(dim):
                                value += A[p, i, m, k, n] * h[t, m]
                            left[n * size + i * dim + k] = volume[p] * value
                for s in range(point_ptr[p], point_ptr[p + 1]):
                    base = slot[members[s]] * size
                    for v in range(size):
                        value = blocks[base + v]
                        for n in range(dim):
                            value += left[n * size + v] * g[s, n]
                        blocks[base + v] = value
            # As ``add_row``, but with compile-time dimensions and with signs: the performance-critical loop.
            n_diag, n_off = blocks_of_row(layout, row)
            for mirror in range(n_mirrors):
                base = mirror * widest * size
                for i in range(dim):
                    row_sign = signs[behind[a], i]
                    start = size * layout.diag_ptr[row] + i * dim * n_diag
                    for q in range(n_diag):
                        for k in range(dim):
                            value = row_sign * signs[mirror, k] * blocks[base + q * size + i * dim + k]
                            diag[start + dim * q + k] += value
                    start = size * layout.off_ptr[row] + i * dim * n_off
                    for q in range(n_off):
                        for k in range(dim):
                            value = row_sign * signs[mirror, k] * blocks[base + (n_diag + q) * size + i * dim + k]
                            off[start + dim * q + k] += value

    return assemble


@lru_cache
def add_blocks_kernel(dim: int) -> Callable[..., Any]:
    """Return ``add_blocks(row_blocks, received, start, slot, width, in_diag, diag, off)``.

    Adds rows from another rank. ``row_blocks`` is the number of blocks of each received row. Each block is added at
    position ``slot`` of a row of ``width`` blocks, after ``start`` blocks.
    """
    size = dim * dim

    @compiled
    def add_blocks(row_blocks, received, start, slot, width, in_diag, diag, off):
        b = 0
        offset = 0
        for r in range(row_blocks.size):
            n = row_blocks[r]
            for q in range(n):
                for i in range(dim):
                    source = offset + i * dim * n + dim * q
                    target = size * start[b] + i * dim * width[b] + dim * slot[b]
                    for k in range(dim):
                        if in_diag[b]:
                            diag[target + k] += received[source + k]
                        else:
                            off[target + k] += received[source + k]
                b += 1
            offset += size * n

    return add_blocks


@lru_cache
def add_diagonal_kernel(dim: int) -> Callable[..., Any]:
    """Return ``add_diagonal(ptr, scalars, values)``: adds ``scalars[i, b]`` to entry ``ii`` of block ``b``.

    If ``scalars`` has one row, it applies to all ``i``.
    """

    @compiled
    def add_diagonal(ptr, scalars, values):
        for row in range(ptr.size - 1):
            n = ptr[row + 1] - ptr[row]
            for i in range(dim):
                start = dim * dim * ptr[row] + i * dim * n + i
                c = min(i, scalars.shape[0] - 1)
                for q in range(n):
                    values[start + dim * q] += scalars[c, ptr[row] + q]

    return add_diagonal
