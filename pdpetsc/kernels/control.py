"""Loops of the zero-energy controls: forces, energy and the constant matrix."""

from __future__ import annotations

from collections.abc import Callable
from functools import lru_cache
from typing import Any

import numpy as np

from pdpetsc.kernels.compile import compiled
from pdpetsc.kernels.components import add_to, applied, difference
from pdpetsc.kernels.rows import add_row, find_slots, widest_row


@lru_cache
def non_uniform_force_kernel(dim: int) -> Callable[..., Any]:
    """Return ``force(particles, indptr, neighbours, stiffness, weight, K_inverse, x, u, f, energy)``.

    Adds ``s_ij z_ij`` to ``j``, and its opposite to ``i``, with ``z_ij = eta_ij - H_i xi_ij``,
    ``H_i = (sum_j w_ij eta_ij (x) xi_ij) K_i^-1``; writes ``psi_i = 1/2 sum_j s_ij |z_ij|^2`` of these families to
    ``energy`` (n_particles,). If ``w`` is ``s``, these are the forces of ``psi``, because then
    ``sum_j s_ij z_ij (x) xi_ij = 0``.
    """

    @compiled
    def force(particles, indptr, neighbours, stiffness, weight, K_inverse, x, u, f, energy):
        moment = np.empty((dim, dim))
        H = np.empty((dim, dim))
        for q in range(particles.size):
            i = particles[q]
            moment[:] = 0.0
            for t in range(indptr[i], indptr[i + 1]):
                j, w = neighbours[t], weight[t]
                eta, xi = difference(i, j, u, dim), difference(i, j, x, dim)
                for m in range(dim):
                    for n in range(dim):
                        moment[m, n] += w * eta[m] * xi[n]
            for m in range(dim):
                for n in range(dim):
                    H[m, n] = 0.0
                    for o in range(dim):
                        H[m, n] += moment[m, o] * K_inverse[i, o, n]
            own_0, own_1, own_2, psi = 0.0, 0.0, 0.0, 0.0
            for t in range(indptr[i], indptr[i + 1]):
                j, s = neighbours[t], stiffness[t]
                z_0, z_1, z_2 = difference(i, j, u, dim)
                xi_0, xi_1, xi_2 = difference(i, j, x, dim)
                h_0, h_1, h_2 = applied(H, xi_0, xi_1, xi_2, dim)
                z_0, z_1, z_2 = z_0 - h_0, z_1 - h_1, z_2 - h_2
                add_to(f, j, s * z_0, s * z_1, s * z_2, dim)
                own_0, own_1, own_2 = own_0 - s * z_0, own_1 - s * z_1, own_2 - s * z_2
                psi += 0.5 * s * (z_0 * z_0 + z_1 * z_1 + z_2 * z_2)
            energy[q] = psi
            add_to(f, i, own_0, own_1, own_2, dim)

    return force


@lru_cache
def non_uniform_matrix_kernel(dim: int) -> Callable[..., Any]:
    """Return the kernel that fills the scalar matrix of the control, one number per block, for one component.

    ``M_jk = s_j delta_jk - s_j w_k xi_j . K^-1 xi_k`` for neighbours of ``i``; rows and columns of ``i`` follow from
    zero sums of all rows and columns. ``point_ptr`` and ``members`` are the families with the centre first.
    """

    @compiled
    def matrix(layout, point_ptr, members, stiffness, weight, K_inverse, x, diag, off):
        behind, signs, entry_ptr = layout.behind, layout.signs, layout.entry_ptr
        slot = np.zeros(entry_ptr.size, np.int64)
        left = np.empty(dim)
        blocks = np.empty((widest_row(layout), 1, 1))
        for row in range(layout.diag_ptr.size - 1):
            blocks[: find_slots(layout, row, slot)] = 0.0
            a = layout.first + row
            for e in range(entry_ptr[a], entry_ptr[a + 1]):
                t = layout.entries[e]
                i = layout.entry_point[e]
                first = point_ptr[i]
                # Row a of M is left . K^-1 w_k xi_k on the neighbours k, plus s on the diagonal and its centre.
                for m in range(dim):
                    left[m] = 0.0
                if t == first:
                    for s in range(first + 1, point_ptr[i + 1]):
                        k = members[s]
                        for m in range(dim):
                            left[m] += stiffness[s] * (x[k, m] - x[i, m])
                else:
                    for m in range(dim):
                        left[m] = -stiffness[t] * (x[a, m] - x[i, m])
                centre = 0.0
                for s in range(first + 1, point_ptr[i + 1]):
                    k = members[s]
                    value = 0.0
                    for m in range(dim):
                        projected = 0.0
                        for n in range(dim):
                            projected += K_inverse[i, m, n] * (x[k, n] - x[i, n])
                        value += left[m] * projected
                    value *= weight[s]
                    if t == first:
                        value -= stiffness[s]
                    elif s == t:
                        value += stiffness[s]
                    centre -= value
                    blocks[slot[k], 0, 0] += value * signs[behind[a], 0] * signs[behind[k], 0]
                blocks[slot[i], 0, 0] += centre * signs[behind[a], 0]
            add_row(layout, row, blocks, diag, off)

    return matrix


@lru_cache
def directed_force_kernel(dim: int) -> Callable[..., Any]:
    """Return ``force(particles, indptr, neighbours, S, g, x, u, f)`` -> energy of these families.

    Adds the forces of ``psi = 1/2 sum_i sum_j z_ij . S_ij z_ij``, ``z_ij = eta_ij - H_i xi_ij``,
    ``H_i = sum_j eta_ij (x) g_ij``: on ``j`` ``S_ij z_ij - R_i g_ij`` with ``R_i = sum_j S_ij z_ij (x) xi_ij``.
    """

    @compiled
    def force(particles, indptr, neighbours, S, g, x, u, f):
        H = np.empty((dim, dim))
        R = np.empty((dim, dim))
        z = np.empty(dim)
        energy = 0.0
        for q in range(particles.size):
            i = particles[q]
            H[:] = 0.0
            R[:] = 0.0
            for t in range(indptr[i], indptr[i + 1]):
                j = neighbours[t]
                for m in range(dim):
                    for n in range(dim):
                        H[m, n] += (u[j, m] - u[i, m]) * g[t, n]
            for t in range(indptr[i], indptr[i + 1]):
                j = neighbours[t]
                for m in range(dim):
                    z[m] = u[j, m] - u[i, m]
                    for n in range(dim):
                        z[m] -= H[m, n] * (x[j, n] - x[i, n])
                for m in range(dim):
                    value = 0.0
                    for n in range(dim):
                        value += S[t, m, n] * z[n]
                    energy += 0.5 * value * z[m]
                    f[j, m] += value
                    f[i, m] -= value
                    for n in range(dim):
                        R[m, n] += value * (x[j, n] - x[i, n])
            for t in range(indptr[i], indptr[i + 1]):
                j = neighbours[t]
                for m in range(dim):
                    value = 0.0
                    for n in range(dim):
                        value += R[m, n] * g[t, n]
                    f[j, m] -= value
                    f[i, m] += value
        return energy

    return force


@lru_cache
def directed_matrix_kernel(dim: int) -> Callable[..., Any]:
    """Return the kernel that fills the block matrix of the control, ``dim x dim`` values per block.

    For neighbours ``j, k`` of ``i``: ``M_jk = S_j delta_jk - S_j (xi_j . g_k) - S_k (g_j . xi_k) + g_j . T . g_k`` with
    ``T = sum_j S_j (x) xi_j (x) xi_j``; rows and columns of ``i`` follow from zero sums of all rows and columns.
    ``point_ptr`` and ``members`` are the families with the centre first; ``S`` and ``g`` do not contain the centre.
    """

    @compiled
    def matrix(layout, point_ptr, members, S, g, T, x, diag, off):
        behind, signs, entry_ptr = layout.behind, layout.signs, layout.entry_ptr
        slot = np.zeros(entry_ptr.size, np.int64)
        blocks = np.empty((widest_row(layout), dim, dim))
        block = np.empty((dim, dim))
        centre = np.empty((dim, dim))
        for row in range(layout.diag_ptr.size - 1):
            blocks[: find_slots(layout, row, slot)] = 0.0
            a = layout.first + row
            for e in range(entry_ptr[a], entry_ptr[a + 1]):
                t = layout.entries[e]
                i = layout.entry_point[e]
                first = point_ptr[i]
                # A row of the centre is minus the sum of the rows of its neighbours.
                begin_rows = t
                end_rows = t + 1
                sign = 1.0
                if t == first:
                    begin_rows = first + 1
                    end_rows = point_ptr[i + 1]
                    sign = -1.0
                for r in range(begin_rows, end_rows):
                    j = members[r]
                    bj = r - i - 1
                    centre[:] = 0.0
                    for s in range(first + 1, point_ptr[i + 1]):
                        k = members[s]
                        bk = s - i - 1
                        j_on_k = 0.0
                        k_on_j = 0.0
                        for m in range(dim):
                            j_on_k += (x[j, m] - x[i, m]) * g[bk, m]
                            k_on_j += g[bj, m] * (x[k, m] - x[i, m])
                        for m in range(dim):
                            for n in range(dim):
                                value = -S[bj, m, n] * j_on_k - S[bk, m, n] * k_on_j
                                if s == r:
                                    value += S[bj, m, n]
                                for c in range(dim):
                                    for d in range(dim):
                                        value += g[bj, c] * T[i, m, n, c, d] * g[bk, d]
                                block[m, n] = sign * value
                        q = slot[k]
                        for m in range(dim):
                            for n in range(dim):
                                blocks[q, m, n] += signs[behind[a], m] * block[m, n] * signs[behind[k], n]
                                centre[m, n] -= block[m, n]
                    q = slot[i]
                    for m in range(dim):
                        for n in range(dim):
                            blocks[q, m, n] += signs[behind[a], m] * centre[m, n]
            add_row(layout, row, blocks, diag, off)

    return matrix


@lru_cache
def average_force_kernel(dim: int) -> Callable[..., Any]:
    """Return ``force(particles, point_ptr, members, b, c, u, f)`` -> energy of these families.

    Adds the forces of ``psi = 1/2 sum_i c_i |a_i|^2``, ``a_i = sum_k b_ik u_k``.
    """

    @compiled
    def force(particles, point_ptr, members, b, c, u, f):
        energy = 0.0
        for q in range(particles.size):
            i = particles[q]
            for m in range(dim):
                a = 0.0
                for t in range(point_ptr[i], point_ptr[i + 1]):
                    a += b[t] * u[members[t], m]
                energy += 0.5 * c[i] * a * a
                for t in range(point_ptr[i], point_ptr[i + 1]):
                    f[members[t], m] += c[i] * a * b[t]
        return energy

    return force
