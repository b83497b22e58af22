"""Loops over rows of lattice cells whose families lack some members: sums over all steps, less those that are lacking.

Arrays on the lattice are those of ``kernels.lattice_stencils``. The first half of the steps leads to higher cells, the
other half to their opposites. Cells without particle have no displacement, and the forces on them are not used.
"""

from __future__ import annotations

from collections.abc import Callable
from functools import lru_cache
from typing import Any

import numpy as np

from pdpetsc.kernels.compile import compiled
from pdpetsc.kernels.lattice_stencils import row_gradient


@compiled
def lacking_steps(cell, indptr, neighbours, weight, number_of, reach, ptr, lacking, w):
    """Write the steps that each family lacks, and the weights ``w`` of the steps; return their largest deviation.

    A bond without weight is lacking. ``number_of[step + reach]`` is the number of a step in cells.
    """
    here = np.zeros(w.size, np.bool_)
    worst = 0.0
    for i in range(indptr.size - 1):
        here[:] = False
        for b in range(indptr[i], indptr[i + 1]):
            if weight[b] > 0.0:
                t = number_of[cell[neighbours[b]] - cell[i] + reach]
                here[t] = True
                if w[t] == 0.0:
                    w[t] = weight[b]
                worst = max(worst, abs(weight[b] - w[t]))
        filled = ptr[i]
        for t in range(w.size):
            if not here[t]:
                lacking[filled] = t
                filled += 1
        ptr[i + 1] = filled
    return worst


@compiled
def subtract_lacking(ptr, lacking, of_step, sums):
    """Subtract values of steps (n_steps, n) from the sums of the families that lack them (n_owned, n)."""
    for i in range(ptr.size - 1):
        for b in range(ptr[i], ptr[i + 1]):
            for m in range(sums.shape[1]):
                sums[i, m] -= of_step[lacking[b], m]


@compiled
def families_alike(cell, indptr, neighbours, stiffness, number_of, reach, ptr, lacking, w, same, c):
    """Write ``c_i`` with ``s_ij = c_i w_ij``, 0 for a family without one; ``same`` is a relative tolerance."""
    of_step = np.empty(w.size)
    for i in range(indptr.size - 1):
        of_step[:] = w
        for b in range(ptr[i], ptr[i + 1]):
            of_step[lacking[b]] = 0.0
        c[i] = 0.0
        largest = 0.0
        for b in range(indptr[i], indptr[i + 1]):
            weight = of_step[number_of[cell[neighbours[b]] - cell[i] + reach]]
            if stiffness[b] > largest:
                largest = stiffness[b]
                c[i] = stiffness[b] / weight if weight > 0.0 else np.inf
        for b in range(indptr[i], indptr[i + 1]):
            weight = of_step[number_of[cell[neighbours[b]] - cell[i] + reach]]
            if not abs(stiffness[b] - c[i] * weight) <= same * largest:
                c[i] = 0.0
                break


@compiled
def row_moments(s, n, at, plus, minus, wx, wy, wz, steps, wxi, ptr, lacking, u, dim, buffer, M):
    """Write ``M = sum_j w eta (x) xi`` (dim dim, n) of the n cells from s on."""
    for m in range(dim):
        row_gradient(s, n, 0, plus.size, plus, minus, wx, wy, wz, u[m], dim, buffer)
        for o in range(dim):
            M[dim * m + o, :n] = buffer[o, :n]
    for i in range(n):
        p = at[s + i]
        for b in range(ptr[p], ptr[p + 1]):
            e = lacking[b]
            j = s + i + steps[e]
            for m in range(dim):
                eta = u[m, j] - u[m, s + i]
                for o in range(dim):
                    M[dim * m + o, i] -= eta * wxi[e, o]


@lru_cache
def broken_gradient_kernel(dim: int) -> Callable[..., Any]:
    """Return ``gradient(starts, lengths, at, table, ptr, lacking, K_inverse, u, H)``: ``H_i = M_i K_i^-1``.

    H is (n_owned, dim, dim), u (dim, n_cells). ``table`` holds the steps: up and down, components of ``w xi`` of those
    up, all steps, and their ``w xi`` and ``w``.
    """

    @compiled
    def gradient(starts, lengths, at, table, ptr, lacking, K_inverse, u, H):
        plus, minus, wx, wy, wz, steps, wxi, _ = table
        longest = lengths.max() if lengths.size else 0
        M, buffer = np.empty((dim * dim, longest)), np.empty((3, longest))
        for q in range(starts.size):
            s, n = starts[q], lengths[q]
            row_moments(s, n, at, plus, minus, wx, wy, wz, steps, wxi, ptr, lacking, u, dim, buffer, M)
            for i in range(n):
                p = at[s + i]
                for m in range(dim):
                    for o in range(dim):
                        value = 0.0
                        for a in range(dim):
                            value += M[dim * m + a, i] * K_inverse[p, a, o]
                        H[p, m, o] = value

    return gradient


@lru_cache
def broken_force_kernel(dim: int, moduli: int, controlled: int) -> Callable[..., Any]:
    """Return the kernel that adds ``w_ij (Q_i xi_ij + c_i eta_ij)`` to the cells of j and its opposite to that of i.

    ``Q_i = V_i P_i K_i^-1 - c_i M_i K'_i^-1`` with the moments ``M_i``. The stress P is an argument (n_owned, dim dim).
    If ``moduli``, it is ``A_i M_i K_i^-1`` with moduli (n_sets, dim dim, dim dim); ``of`` (n_owned,) is the index of
    the moduli, and if it is empty, each particle has its own. Terms with c and K' are added if ``controlled``. Both
    flags are compile-time constants. u and f are (dim, n_cells), ``table`` as for the gradient.
    """

    @compiled
    def force(starts, lengths, at, table, ptr, lacking, K_inverse, volume, stress, of, scale, of_control, u, f):
        plus, minus, wx, wy, wz, steps, wxi, w = table
        longest = lengths.max() if lengths.size else 0
        M, Q, buffer = np.empty((dim * dim, longest)), np.empty((dim * dim, longest)), np.empty((3, longest))
        c, own, part = np.zeros(longest), np.empty(longest), np.empty(longest)
        H, P = np.empty(dim * dim), np.empty(dim * dim)
        shared = of.size > 0
        for r in range(starts.size):
            s, n = starts[r], lengths[r]
            if moduli or controlled:
                row_moments(s, n, at, plus, minus, wx, wy, wz, steps, wxi, ptr, lacking, u, dim, buffer, M)
            for i in range(n):
                p = at[s + i]
                if moduli:
                    for m in range(dim):
                        for o in range(dim):
                            value = 0.0
                            for a in range(dim):
                                value += M[dim * m + a, i] * K_inverse[p, a, o]
                            H[dim * m + o] = value
                    k = of[p] if shared else p
                    for a in range(dim * dim):
                        value = 0.0
                        for b in range(dim * dim):
                            value += stress[k, a, b] * H[b]
                        P[a] = volume[p] * value
                else:
                    for a in range(dim * dim):
                        P[a] = volume[p] * stress[p, a]
                if controlled:
                    c[i] = scale[p]
                for m in range(dim):
                    for o in range(dim):
                        value = 0.0
                        for a in range(dim):
                            value += P[dim * m + a] * K_inverse[p, a, o]
                            if controlled:
                                value -= c[i] * M[dim * m + a, i] * of_control[p, a, o]
                        Q[dim * m + o, i] = value
            for m in range(dim):
                x, y, z = Q[dim * m], Q[dim * m + min(1, dim - 1)], Q[dim * m + dim - 1]
                v, g = u[m], f[m]
                here = v[s : s + n]
                own[:n] = 0.0
                for e in range(plus.size):
                    a0, b0, c0, we = wx[e], wy[e], wz[e], w[e]
                    up, down = g[s + plus[e] : s + plus[e] + n], g[s + minus[e] : s + minus[e] + n]
                    for i in range(n):
                        value = x[i] * a0
                        if dim > 1:
                            value += y[i] * b0
                        if dim > 2:
                            value += z[i] * c0
                        part[i] = value
                    if controlled:
                        beyond = v[s + plus[e] : s + plus[e] + n]
                        before = v[s + minus[e] : s + minus[e] + n]
                        for i in range(n):
                            spring = we * c[i] * (beyond[i] - here[i])
                            up[i] += part[i] + spring
                            own[i] -= spring
                        for i in range(n):
                            spring = we * c[i] * (before[i] - here[i])
                            down[i] += spring - part[i]
                            own[i] -= spring
                    else:
                        for i in range(n):
                            up[i] += part[i]
                        for i in range(n):
                            down[i] -= part[i]
                centres = g[s : s + n]
                for i in range(n):
                    centres[i] += own[i]
            for i in range(n):
                p = at[s + i]
                for b in range(ptr[p], ptr[p + 1]):
                    e = lacking[b]
                    j = s + i + steps[e]
                    for m in range(dim):
                        value = 0.0
                        for o in range(dim):
                            value += Q[dim * m + o, i] * wxi[e, o]
                        if controlled:
                            value += w[e] * c[i] * (u[m, j] - u[m, s + i])
                        f[m, j] -= value
                        f[m, s + i] += value

    return force


@lru_cache
def broken_blocks_kernel(dim: int) -> Callable[..., Any]:
    """Return the kernel that adds ``V_i g_k . A_i . g_k`` of every member k to ``blocks`` (n_local, dim dim).

    ``g_k = w_k K_i^-1 xi_k``, and minus their sum for the centre. Arguments as for the forces.
    """
    size = dim * dim
    pairs = [(m, n) for m in range(dim) for n in range(m, dim)]
    n_pairs, first, second = len(pairs), tuple(m for m, _ in pairs), tuple(n for _, n in pairs)

    @compiled
    def add(particles, cell, at, table, ptr, lacking, K_inverse, volume, A, of, blocks):
        _, _, _, _, _, steps, wxi, _ = table
        WA = np.empty((n_pairs, size))
        g, centre = np.empty(dim), np.empty(dim)
        left = np.empty(steps.size, np.bool_)
        for i in particles:
            k = of[i] if of.size > 0 else i
            for q in range(n_pairs):
                for a in range(dim):
                    for b in range(dim):
                        value = A[k, a * dim + first[q], b * dim + second[q]]
                        if first[q] != second[q]:
                            value += A[k, a * dim + second[q], b * dim + first[q]]
                        WA[q, a * dim + b] = volume[i] * value
            left[:] = True
            for b in range(ptr[i], ptr[i + 1]):
                left[lacking[b]] = False
            centre[:] = 0.0
            for e in range(steps.size + 1):
                if e == steps.size:
                    j = i
                    for m in range(dim):
                        g[m] = centre[m]
                elif left[e]:
                    j = at[cell[i] + steps[e]]
                    for m in range(dim):
                        g[m] = 0.0
                        for o in range(dim):
                            g[m] += K_inverse[i, m, o] * wxi[e, o]
                        centre[m] -= g[m]
                else:
                    continue
                for q in range(n_pairs):
                    weight = g[first[q]] * g[second[q]]
                    for v in range(size):
                        blocks[j, v] += weight * WA[q, v]

    return add
