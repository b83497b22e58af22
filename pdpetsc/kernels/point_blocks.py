"""The diagonal blocks of a tangent, particle by particle, without its matrix."""

from __future__ import annotations

from collections.abc import Callable
from functools import lru_cache
from typing import Any

import numpy as np

from pdpetsc.kernels.bonds import direction
from pdpetsc.kernels.compile import compiled


@lru_cache
def gradient_blocks_kernel(dim: int, same: int) -> Callable[..., Any]:
    """Return ``blocks(point_ptr, members, h, g, volume, A, out)``: adds ``W_p h_k . A_p . g_k`` to each member ``k``.

    ``out`` is (n_local, dim * dim) with ``(h . A . g)_ik = sum_mn h_m A_imkn g_n``. If ``same``, a compile-time
    constant, ``h`` is ``g``, and the symmetric products are computed once.
    """
    size = dim * dim
    pairs = [(m, n) for m in range(dim) for n in range(m if same else 0, dim)]
    n_pairs, first, second = len(pairs), tuple(m for m, _ in pairs), tuple(n for _, n in pairs)

    @compiled
    def blocks(point_ptr, members, h, g, volume, A, out):
        WA = np.empty((n_pairs, size))
        block = np.empty(size)
        for p in range(point_ptr.size - 1):
            for q in range(n_pairs):
                m = first[q]
                n = second[q]
                for i in range(dim):
                    for k in range(dim):
                        value = A[p, i, m, k, n]
                        if same and m != n:
                            value += A[p, i, n, k, m]
                        WA[q, i * dim + k] = volume[p] * value
            for t in range(point_ptr[p], point_ptr[p + 1]):
                for v in range(size):
                    block[v] = 0.0
                for q in range(n_pairs):
                    weight = h[t, first[q]] * g[t, second[q]]
                    for v in range(size):
                        block[v] += weight * WA[q, v]
                for v in range(size):
                    out[members[t], v] += block[v]

    return blocks


@lru_cache
def bond_blocks_kernel(dim: int, finite: int) -> Callable[..., Any]:
    """Return ``blocks(indptr, neighbours, x, u, stiffness, tension, a, B, out)`` for the forces of bonds.

    The block of both ends of a bond is ``s n n + t / |xi + eta| (I - n n)``, the last term only if ``finite``. A
    dilatation adds ``B_i (a n) (a n)`` to each member of the family of ``i``, with ``- sum_j a n`` for ``i`` itself.
    """

    @compiled
    def blocks(indptr, neighbours, x, u, stiffness, tension, a, B, out):
        n = np.empty(3)
        centre = np.empty(dim)
        dilates = a.size > 0
        for i in range(indptr.size - 1):
            centre[:] = 0.0
            for b in range(indptr[i], indptr[i + 1]):
                j = neighbours[b]
                n[0], n[1], n[2], _, current = direction(i, j, x, u, dim, finite)
                turning = tension[b] / current if finite else 0.0
                for m in range(dim):
                    for k in range(dim):
                        value = (stiffness[b] - turning) * n[m] * n[k]
                        if m == k:
                            value += turning
                        out[i, m, k] += value
                        out[j, m, k] += value
                        if dilates:
                            out[j, m, k] += B[i] * a[b] * a[b] * n[m] * n[k]
                    if dilates:
                        centre[m] += a[b] * n[m]
            if dilates:
                for m in range(dim):
                    for k in range(dim):
                        out[i, m, k] += B[i] * centre[m] * centre[k]

    return blocks


@lru_cache
def non_uniform_blocks_kernel(dim: int) -> Callable[..., Any]:
    """Return ``blocks(indptr, neighbours, stiffness, weight, K_inverse, x, out)`` for ``s_ij z_ij``.

    ``s_j (1 - w_j xi_j . K^-1 xi_j)`` times the identity for ``j``, and for ``i``
    ``sum_j s_j - (sum_j s_j xi_j) . K^-1 (sum_j w_j xi_j)``.
    """

    @compiled
    def blocks(indptr, neighbours, stiffness, weight, K_inverse, x, out):
        xi = np.empty(dim)
        left = np.empty(dim)
        right = np.empty(dim)
        for i in range(indptr.size - 1):
            left[:] = 0.0
            right[:] = 0.0
            centre = 0.0
            for b in range(indptr[i], indptr[i + 1]):
                j = neighbours[b]
                for m in range(dim):
                    xi[m] = x[j, m] - x[i, m]
                    left[m] += stiffness[b] * xi[m]
                    right[m] += weight[b] * xi[m]
                square = 0.0
                for m in range(dim):
                    for n in range(dim):
                        square += xi[m] * K_inverse[i, m, n] * xi[n]
                value = stiffness[b] * (1.0 - weight[b] * square)
                centre += stiffness[b]
                for m in range(dim):
                    out[j, m, m] += value
            for m in range(dim):
                for n in range(dim):
                    centre -= left[m] * K_inverse[i, m, n] * right[n]
            for m in range(dim):
                out[i, m, m] += centre

    return blocks


@lru_cache
def directed_blocks_kernel(dim: int) -> Callable[..., Any]:
    """Return ``blocks(indptr, neighbours, S, g, x, out)`` for ``z_ij . S_ij z_ij / 2``, ``z_ij = eta_ij - H_i xi_ij``.

    For ``j``: ``S_j (1 - 2 xi_j . g_j) + sum_k S_k (xi_k . g_j)^2``; for ``i`` the same with ``-g = sum_j g_j`` and
    every bond: ``sum_k S_k (1 - xi_k . g)^2``.
    """

    @compiled
    def blocks(indptr, neighbours, S, g, x, out):
        moments = np.empty((dim, dim, dim, dim))
        whole = np.empty(dim)
        xi = np.empty(dim)
        for i in range(indptr.size - 1):
            moments[:] = 0.0
            whole[:] = 0.0
            for b in range(indptr[i], indptr[i + 1]):
                for m in range(dim):
                    xi[m] = x[neighbours[b], m] - x[i, m]
                    whole[m] += g[b, m]
                for m in range(dim):
                    for n in range(dim):
                        for p in range(dim):
                            for q in range(dim):
                                moments[m, n, p, q] += S[b, m, n] * xi[p] * xi[q]
            for b in range(indptr[i], indptr[i + 1]):
                j = neighbours[b]
                own = 0.0
                of_centre = 0.0
                for m in range(dim):
                    own += (x[j, m] - x[i, m]) * g[b, m]
                    of_centre += (x[j, m] - x[i, m]) * whole[m]
                for m in range(dim):
                    for n in range(dim):
                        value = S[b, m, n] * (1.0 - 2.0 * own)
                        for p in range(dim):
                            for q in range(dim):
                                value += moments[m, n, p, q] * g[b, p] * g[b, q]
                        out[j, m, n] += value
                        out[i, m, n] += S[b, m, n] * (1.0 - of_centre) ** 2

    return blocks


@compiled
def definite(blocks, least):
    """Increase diagonals until the leading minors of every symmetric part are positive, by Gershgorin rows.

    ``least`` is the smallest eigenvalue after the increase; return the number of changed blocks.
    """
    changed = 0
    dim = blocks.shape[1]
    for b in range(blocks.shape[0]):
        a = blocks[b]
        bad = not a[0, 0] > least
        if dim > 1 and not bad:
            s = 0.5 * (a[0, 1] + a[1, 0])
            second = a[1, 1] - s * s / a[0, 0]
            bad = not second > least
            if dim > 2 and not bad:
                p = 0.5 * (a[0, 2] + a[2, 0])
                q = 0.5 * (a[1, 2] + a[2, 1]) - s * p / a[0, 0]
                bad = not a[2, 2] - p * p / a[0, 0] - q * q / second > least
        if bad:
            changed += 1
            for m in range(dim):
                size = 0.0
                for n in range(dim):
                    if n != m:
                        size += abs(0.5 * (a[m, n] + a[n, m]))
                a[m, m] = max(abs(a[m, m]), size + least) + least
    return changed
