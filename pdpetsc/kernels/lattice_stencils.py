"""Loops over lattice particles with equal families: rows of consecutive cells share one list of weights.

Arrays on the lattice have one row per component and one column per cell, so that memory access along a row of cells is
contiguous. Cells are numbered along the lattice, and a member of a family has a constant offset in cells.
"""

from __future__ import annotations

from collections.abc import Callable
from functools import lru_cache
from typing import Any

import numpy as np

from pdpetsc.kernels.compile import compiled


@compiled
def family_keys(cell, at, steps, keys_of_steps, good, key, usual):
    """Write a key of the members of the family of every own particle, and a mask of families with good members only."""
    for i in range(key.size):
        c = cell[i]
        usual[i] = good[i]
        found = np.uint64(0)
        for t in range(steps.size):
            j = at[c + steps[t]]
            if j >= 0:
                found ^= keys_of_steps[t]
                usual[i] &= good[j]
        key[i] = found


@compiled
def order_keys(cell, at, steps, keys_of_steps, order, key):
    """Combine the key of every own particle with the ``order`` of the members of its family."""
    sorted_steps = np.empty(steps.size, np.int64)
    for i in range(key.size):
        filled = 0
        for t in range(steps.size):
            j = at[cell[i] + steps[t]]
            if j >= 0:
                s = filled - 1
                while s >= 0 and order[at[cell[i] + steps[sorted_steps[s]]]] > order[j]:
                    sorted_steps[s + 1] = sorted_steps[s]
                    s -= 1
                sorted_steps[s + 1] = t
                filled += 1
        found = np.uint64(0)
        for s in range(filled):
            found = found * np.uint64(6364136223846793005) + keys_of_steps[sorted_steps[s]]
        key[i] ^= found


@compiled
def families_of_cells(particles, cell, at, steps, order):
    """Return the families of selected particles in CSR form, each sorted by ``order``."""
    indptr = np.zeros(particles.size + 1, np.int64)
    for q in range(particles.size):
        count = 0
        for t in range(steps.size):
            if at[cell[particles[q]] + steps[t]] >= 0:
                count += 1
        indptr[q + 1] = indptr[q] + count
    neighbours = np.empty(indptr[-1], np.int32)
    for q in range(particles.size):
        first = indptr[q]
        filled = first
        for t in range(steps.size):
            j = at[cell[particles[q]] + steps[t]]
            if j >= 0:
                s = filled - 1
                while s >= first and order[neighbours[s]] > order[j]:
                    neighbours[s + 1] = neighbours[s]
                    s -= 1
                neighbours[s + 1] = j
                filled += 1
    return indptr, neighbours


@compiled
def cells_with_any(cells, at, steps, marked, found):
    """Write a mask of cells with a marked particle at one of the steps."""
    for q in range(cells.size):
        found[q] = False
        for t in range(steps.size):
            j = at[cells[q] + steps[t]]
            if j >= 0 and marked[j]:
                found[q] = True
                break


@compiled
def onto_cells(cell, values, on_cells):
    """Write vectors of particles (n, components) to their cells (components, n_cells)."""
    for i in range(values.shape[0]):
        for m in range(values.shape[1]):
            on_cells[m, cell[i]] = values[i, m]


@compiled
def add_from_cells(cell, on_cells, values):
    """Add vectors on cells (components, n_cells) to those of their particles (n, components), and clear them."""
    for i in range(values.shape[0]):
        for m in range(values.shape[1]):
            values[i, m] += on_cells[m, cell[i]]
            on_cells[m, cell[i]] = 0.0


@compiled
def row_gradient(s, n, first, last, plus, minus, gx, gy, gz, v, dim, buffer):
    """Write ``sum_e (v_+ - v_-) g_e`` of one component, for the n cells from s on, to the ``dim`` rows of ``buffer``.

    The entries are those from ``first`` to ``last``; entry e reads the cells at the offsets ``plus[e]`` and
    ``minus[e]``. With fewer dimensions the last weights are not read. It is a function of the module because numba
    cannot cache closures over other loops.
    """
    a, b, c = buffer[0], buffer[1], buffer[2]
    for i in range(n):
        a[i] = 0.0
        b[i] = 0.0
        c[i] = 0.0
    e = first
    while e + 4 <= last:
        p0 = v[s + plus[e] : s + plus[e] + n]
        m0 = v[s + minus[e] : s + minus[e] + n]
        p1 = v[s + plus[e + 1] : s + plus[e + 1] + n]
        m1 = v[s + minus[e + 1] : s + minus[e + 1] + n]
        p2 = v[s + plus[e + 2] : s + plus[e + 2] + n]
        m2 = v[s + minus[e + 2] : s + minus[e + 2] + n]
        p3 = v[s + plus[e + 3] : s + plus[e + 3] + n]
        m3 = v[s + minus[e + 3] : s + minus[e + 3] + n]
        a0, a1, a2, a3 = gx[e], gx[e + 1], gx[e + 2], gx[e + 3]
        b0, b1, b2, b3 = gy[e], gy[e + 1], gy[e + 2], gy[e + 3]
        c0, c1, c2, c3 = gz[e], gz[e + 1], gz[e + 2], gz[e + 3]
        for i in range(n):
            d0 = p0[i] - m0[i]
            d1 = p1[i] - m1[i]
            d2 = p2[i] - m2[i]
            d3 = p3[i] - m3[i]
            a[i] += d0 * a0 + d1 * a1 + d2 * a2 + d3 * a3
            if dim > 1:
                b[i] += d0 * b0 + d1 * b1 + d2 * b2 + d3 * b3
            if dim > 2:
                c[i] += d0 * c0 + d1 * c1 + d2 * c2 + d3 * c3
        e += 4
    while e < last:
        p0 = v[s + plus[e] : s + plus[e] + n]
        m0 = v[s + minus[e] : s + minus[e] + n]
        a0, b0, c0 = gx[e], gy[e], gz[e]
        for i in range(n):
            d0 = p0[i] - m0[i]
            a[i] += d0 * a0
            if dim > 1:
                b[i] += d0 * b0
            if dim > 2:
                c[i] += d0 * c0
        e += 1


@lru_cache
def rows_gradient_kernel(dim: int) -> Callable[..., Any]:
    """Return ``gradient(starts, lengths, pattern, at, first_point, lists, gx, gy, gz, u, H)`` on rows of cells.

    ``H_p = sum_e (u_+ - u_-) (x) g_e`` (n_points, dim, dim) of the points of the particles in the rows, for ``u``
    (dim, n_cells); ``lists`` are the points of each pattern, the entries of each point, and the two steps of each.
    """

    @compiled
    def gradient(starts, lengths, pattern, at, first_point, lists, gx, gy, gz, u, H):
        list_ptr, entry_ptr, plus, minus = lists
        buffer = np.empty((3, lengths.max() if lengths.size else 0))
        for q in range(starts.size):
            s, n = starts[q], lengths[q]
            first = list_ptr[pattern[q]]
            for k in range(first, list_ptr[pattern[q] + 1]):
                for m in range(dim):
                    row_gradient(s, n, entry_ptr[k], entry_ptr[k + 1], plus, minus, gx, gy, gz, u[m], dim, buffer)
                    for i in range(n):
                        p = first_point[at[s + i]] + k - first
                        for o in range(dim):
                            H[p, m, o] = buffer[o, i]

    return gradient


@lru_cache
def rows_force_kernel(dim: int, moduli: int, controlled: int) -> Callable[..., Any]:
    """Return the kernel that adds ``sum_p (W_p P_p - c H_p K) g_pk + c w_pk eta_pk`` to the cells of members k.

    The stress P is an argument (n_points, dim dim), zero if empty. If ``moduli``, it is ``A_p H_p`` with moduli
    (n_sets, dim dim, dim dim); ``of`` (n_points,) is the index of the moduli, and if it is empty, each point has its
    own. Terms with c, K and w are added if ``controlled``. Both flags are compile-time constants. For every row of
    cells and every point the loop computes gradient, stress and forces on the members while they are in cache. u and f
    are (dim, n_cells).
    """

    @compiled
    def force(
        starts, lengths, pattern, at, first_point, lists, gx, gy, gz, centre, volume, stress, of, weight, scale, K, u, f
    ):
        list_ptr, entry_ptr, plus, minus = lists
        longest = lengths.max() if lengths.size else 0
        H = np.empty((dim * dim, longest))
        T = np.empty((dim * dim, longest))
        buffer = np.empty((3, longest))
        c = np.zeros(longest)
        own = np.empty(longest)
        force = np.empty(longest)
        stressed, shared = stress.size > 0, of.size > 0
        for q in range(starts.size):
            s, n = starts[q], lengths[q]
            if controlled:
                for i in range(n):
                    c[i] = scale[at[s + i]]
            first_list = list_ptr[pattern[q]]
            for k in range(first_list, list_ptr[pattern[q] + 1]):
                first, last = entry_ptr[k], entry_ptr[k + 1]
                if moduli or controlled:
                    for m in range(dim):
                        row_gradient(s, n, first, last, plus, minus, gx, gy, gz, u[m], dim, buffer)
                        for o in range(dim):
                            H[dim * m + o, :n] = buffer[o, :n]
                for i in range(n):
                    p = first_point[at[s + i]] + k - first_list
                    if moduli and shared:
                        p = of[p]
                    for a in range(dim * dim):
                        value = 0.0
                        if moduli:
                            for b in range(dim * dim):
                                value += stress[p, a, b] * H[b, i]
                        elif stressed:
                            value = stress[p, a]
                        T[a, i] = volume[k] * value
                if controlled:
                    for a in range(dim):
                        for b in range(dim):
                            for o in range(dim):
                                for i in range(n):
                                    T[dim * a + b, i] -= c[i] * H[dim * a + o, i] * K[k, o, b]
                for m in range(dim):
                    x, y, z = T[dim * m], T[dim * m + min(1, dim - 1)], T[dim * m + dim - 1]
                    v, r = u[m], f[m]
                    here = v[s : s + n]
                    for i in range(n):
                        value = x[i] * centre[k, 0]
                        if dim > 1:
                            value += y[i] * centre[k, min(1, dim - 1)]
                        if dim > 2:
                            value += z[i] * centre[k, dim - 1]
                        own[i] = value
                    for e in range(first, last):
                        a0, b0, c0, w = gx[e], gy[e], gz[e], weight[e] if controlled else 0.0
                        up = r[s + plus[e] : s + plus[e] + n]
                        beyond = v[s + plus[e] : s + plus[e] + n]
                        for i in range(n):
                            value = x[i] * a0
                            if dim > 1:
                                value += y[i] * b0
                            if dim > 2:
                                value += z[i] * c0
                            force[i] = value
                        if controlled:
                            for i in range(n):
                                spring = w * c[i] * (beyond[i] - here[i])
                                up[i] += force[i] + spring
                                own[i] -= spring
                        else:
                            for i in range(n):
                                up[i] += force[i]
                        if minus[e] != 0:
                            down = r[s + minus[e] : s + minus[e] + n]
                            before = v[s + minus[e] : s + minus[e] + n]
                            if controlled:
                                for i in range(n):
                                    spring = w * c[i] * (before[i] - here[i])
                                    down[i] += spring - force[i]
                                    own[i] -= spring
                            else:
                                for i in range(n):
                                    down[i] -= force[i]
                    centres = r[s : s + n]
                    for i in range(n):
                        centres[i] += own[i]

    return force


@lru_cache
def rows_energy_kernel(dim: int) -> Callable[..., Any]:
    """Return ``energy(..., energies)``: ``1/2 c_i (sum_j w_ij |eta_ij|^2 - H_i K : H_i)`` of the particles in rows."""

    @compiled
    def energy(starts, lengths, pattern, at, lists, gx, gy, gz, weight, scale, K, u, energies):
        list_ptr, entry_ptr, plus, minus = lists
        longest = lengths.max() if lengths.size else 0
        buffer, twice = np.empty((3, longest)), np.empty(longest)
        for q in range(starts.size):
            s, n = starts[q], lengths[q]
            k = list_ptr[pattern[q]]
            twice[:n] = 0.0
            for m in range(dim):
                v = u[m]
                here = v[s : s + n]
                row_gradient(s, n, entry_ptr[k], entry_ptr[k + 1], plus, minus, gx, gy, gz, v, dim, buffer)
                for e in range(entry_ptr[k], entry_ptr[k + 1]):
                    w = weight[e]
                    beyond = v[s + plus[e] : s + plus[e] + n]
                    before = v[s + minus[e] : s + minus[e] + n]
                    # An entry with one member has the centre itself as the other one.
                    for i in range(n):
                        twice[i] += w * ((beyond[i] - here[i]) ** 2 + (before[i] - here[i]) ** 2)
                for a in range(dim):
                    for b in range(dim):
                        modulus = K[k, a, b]
                        for i in range(n):
                            twice[i] -= buffer[a, i] * modulus * buffer[b, i]
            for i in range(n):
                energies[at[s + i]] = 0.5 * scale[at[s + i]] * twice[i]

    return energy


@lru_cache
def rows_bonds_kernel(dim: int, finite: int, tangent: int) -> Callable[..., Any]:
    """Return the kernel that adds the forces of bonds to cells, or if ``tangent`` their change with ``du``.

    ``t n`` with ``t = k e`` on the member of a bond and its opposite on the centre; their change is ``k (n . d_eta) n +
    t / |xi + eta| (I - n n) d_eta``, without the second part unless ``finite``. Bonds of a pattern are entries with
    their reference ``xi``, length and stiffness; u, du and f are (dim, n_cells).
    """

    @compiled
    def bonds(starts, lengths, pattern, entry_ptr, steps, xi, reference, k, u, du, f):
        longest = lengths.max() if lengths.size else 0
        n_0, n_1, n_2 = np.empty(longest), np.empty(longest), np.empty(longest)
        own_0, own_1, own_2 = np.empty(longest), np.empty(longest), np.empty(longest)
        second, third = min(1, dim - 1), dim - 1
        u0, u1, u2 = u[0], u[second], u[third]
        v0, v1, v2 = du[0], du[second], du[third]
        f0, f1, f2 = f[0], f[second], f[third]
        for q in range(starts.size):
            s, n = starts[q], lengths[q]
            a0, a1, a2 = u0[s : s + n], u1[s : s + n], u2[s : s + n]
            w0, w1, w2 = v0[s : s + n], v1[s : s + n], v2[s : s + n]
            own_0[:n] = 0.0
            own_1[:n] = 0.0
            own_2[:n] = 0.0
            for e in range(entry_ptr[pattern[q]], entry_ptr[pattern[q] + 1]):
                o = s + steps[e]
                b0, b1, b2 = u0[o : o + n], u1[o : o + n], u2[o : o + n]
                d0, d1, d2 = v0[o : o + n], v1[o : o + n], v2[o : o + n]
                x0, x1, x2 = xi[e, 0], xi[e, second], xi[e, third]
                stiffness, length = k[e], reference[e]
                for i in range(n):
                    if finite:
                        y0 = x0 + b0[i] - a0[i]
                        square = y0 * y0
                        if dim > 1:
                            y1 = x1 + b1[i] - a1[i]
                            square += y1 * y1
                        if dim > 2:
                            y2 = x2 + b2[i] - a2[i]
                            square += y2 * y2
                        current = np.sqrt(square)
                        if tangent:
                            z0 = d0[i] - w0[i]
                            along = y0 * z0
                            if dim > 1:
                                z1 = d1[i] - w1[i]
                                along += y1 * z1
                            if dim > 2:
                                z2 = d2[i] - w2[i]
                                along += y2 * z2
                            turning = stiffness * (current - length) / current
                            along *= (stiffness - turning) / square
                            n_0[i] = along * y0 + turning * z0
                            if dim > 1:
                                n_1[i] = along * y1 + turning * z1
                            if dim > 2:
                                n_2[i] = along * y2 + turning * z2
                        else:
                            factor = stiffness * (current - length) / current
                            n_0[i] = factor * y0
                            if dim > 1:
                                n_1[i] = factor * y1
                            if dim > 2:
                                n_2[i] = factor * y2
                    else:
                        along = x0 * (d0[i] - w0[i])
                        if dim > 1:
                            along += x1 * (d1[i] - w1[i])
                        if dim > 2:
                            along += x2 * (d2[i] - w2[i])
                        along *= stiffness / (length * length)
                        n_0[i] = along * x0
                        if dim > 1:
                            n_1[i] = along * x1
                        if dim > 2:
                            n_2[i] = along * x2
                up = f0[o : o + n]
                for i in range(n):
                    up[i] += n_0[i]
                    own_0[i] -= n_0[i]
                if dim > 1:
                    up = f1[o : o + n]
                    for i in range(n):
                        up[i] += n_1[i]
                        own_1[i] -= n_1[i]
                if dim > 2:
                    up = f2[o : o + n]
                    for i in range(n):
                        up[i] += n_2[i]
                        own_2[i] -= n_2[i]
            for i in range(n):
                f0[s + i] += own_0[i]
                if dim > 1:
                    f1[s + i] += own_1[i]
                if dim > 2:
                    f2[s + i] += own_2[i]

    return bonds


@compiled
def elongated(e, cell, steps, xi, reference, u, dim, finite):
    """Return the elongation of entry e of a cell, and three components of ``xi + eta``, or ``xi`` unless ``finite``."""
    other = cell + steps[e]
    y_0, y_1, y_2 = xi[e, 0], 0.0, 0.0
    eta_0, eta_1, eta_2 = u[0, other] - u[0, cell], 0.0, 0.0
    if dim > 1:
        y_1, eta_1 = xi[e, 1], u[1, other] - u[1, cell]
    if dim > 2:
        y_2, eta_2 = xi[e, 2], u[2, other] - u[2, cell]
    if finite:
        y_0, y_1, y_2 = y_0 + eta_0, y_1 + eta_1, y_2 + eta_2
        return np.sqrt(y_0 * y_0 + y_1 * y_1 + y_2 * y_2) - reference[e], y_0, y_1, y_2
    return (eta_0 * y_0 + eta_1 * y_1 + eta_2 * y_2) / reference[e], y_0, y_1, y_2


@compiled
def bond_block(e, cell, steps, xi, reference, k, u, dim, finite, y, block):
    """Write ``k n n + t / |xi + eta| (I - n n)`` of entry e of a cell, the last term only if ``finite``; y is (3,)."""
    elongation, y[0], y[1], y[2] = elongated(e, cell, steps, xi, reference, u, dim, finite)
    square = y[0] * y[0] + y[1] * y[1] + y[2] * y[2]
    turning = finite * k[e] * elongation / np.sqrt(square)
    for m in range(dim):
        for o in range(dim):
            block[m, o] = (k[e] - turning) * y[m] * y[o] / square
        block[m, m] += turning


@lru_cache
def rows_bond_energy_kernel(dim: int, finite: int) -> Callable[..., Any]:
    """Return ``energy(..., energies)``: writes ``1/2 sum_j k e^2`` (n_owned,) of the particles in rows."""

    @compiled
    def energy(starts, lengths, pattern, at, entry_ptr, steps, xi, reference, k, u, energies):
        for q in range(starts.size):
            for cell in range(starts[q], starts[q] + lengths[q]):
                value = 0.0
                for e in range(entry_ptr[pattern[q]], entry_ptr[pattern[q] + 1]):
                    elongation, _, _, _ = elongated(e, cell, steps, xi, reference, u, dim, finite)
                    value += 0.5 * k[e] * elongation * elongation
                energies[at[cell]] = value

    return energy


@lru_cache
def rows_bond_moments_kernel(dim: int, finite: int) -> Callable[..., Any]:
    """Return ``moments(..., moment)``: writes ``sum_j t n (x) xi`` (n_owned, dim, dim) of the particles in rows."""

    @compiled
    def moments(starts, lengths, pattern, at, entry_ptr, steps, xi, reference, k, u, moment):
        for q in range(starts.size):
            for cell in range(starts[q], starts[q] + lengths[q]):
                i = at[cell]
                moment[i] = 0.0
                for e in range(entry_ptr[pattern[q]], entry_ptr[pattern[q] + 1]):
                    elongation, y_0, y_1, y_2 = elongated(e, cell, steps, xi, reference, u, dim, finite)
                    factor = k[e] * elongation / np.sqrt(y_0 * y_0 + y_1 * y_1 + y_2 * y_2)
                    for o in range(dim):
                        moment[i, 0, o] += factor * y_0 * xi[e, o]
                        if dim > 1:
                            moment[i, 1, o] += factor * y_1 * xi[e, o]
                        if dim > 2:
                            moment[i, 2, o] += factor * y_2 * xi[e, o]

    return moments


@lru_cache
def rows_least_length_kernel(dim: int) -> Callable[..., Any]:
    """Return ``least(starts, lengths, pattern, entry_ptr, steps, xi, u)``: smallest current length of their bonds."""

    @compiled
    def least(starts, lengths, pattern, entry_ptr, steps, xi, u):
        second, third = min(1, dim - 1), dim - 1
        u0, u1, u2 = u[0], u[second], u[third]
        found = np.full(lengths.max() if lengths.size else 0, np.inf)
        for q in range(starts.size):
            s, n = starts[q], lengths[q]
            for e in range(entry_ptr[pattern[q]], entry_ptr[pattern[q] + 1]):
                if steps[e] < 0:
                    continue
                o = s + steps[e]
                x0, x1, x2 = xi[e, 0], xi[e, second], xi[e, third]
                for i in range(n):
                    y0 = x0 + u0[o + i] - u0[s + i]
                    square = y0 * y0
                    if dim > 1:
                        y1 = x1 + u1[o + i] - u1[s + i]
                        square += y1 * y1
                    if dim > 2:
                        y2 = x2 + u2[o + i] - u2[s + i]
                        square += y2 * y2
                    # NaN counts as the smallest: later comparisons with it are false.
                    found[i] = square if square < found[i] or np.isnan(square) else found[i]
        shortest = np.inf
        for i in range(found.size):
            if found[i] < shortest or np.isnan(found[i]):
                shortest = found[i]
        return np.sqrt(shortest)

    return least


@lru_cache
def rows_bond_moduli_kernel(dim: int, finite: int) -> Callable[..., Any]:
    """Return ``moduli(...)``: ``D_i = sum_j (k n n + t / |xi + eta| (I - n n)) xi xi`` of the particles in rows."""

    @compiled
    def moduli(starts, lengths, pattern, at, entry_ptr, steps, xi, reference, k, u, D):
        y, block = np.empty(3), np.empty((dim, dim))
        for q in range(starts.size):
            for cell in range(starts[q], starts[q] + lengths[q]):
                i = at[cell]
                D[i] = 0.0
                for e in range(entry_ptr[pattern[q]], entry_ptr[pattern[q] + 1]):
                    bond_block(e, cell, steps, xi, reference, k, u, dim, finite, y, block)
                    for m in range(dim):
                        for a in range(dim):
                            for o in range(dim):
                                for p in range(dim):
                                    D[i, m, o, a, p] += block[m, a] * xi[e, o] * xi[e, p]

    return moduli


@lru_cache
def rows_blocks_kernel(dim: int) -> Callable[..., Any]:
    """Return the kernel that adds ``W_p g_pk . A_p . g_pk`` to the cells of members k: blocks on the diagonal.

    ``blocks`` is (dim dim, n_cells) with ``(g . A . g)_ik = sum_mn g_m A_imkn g_n``; the symmetric products of g with
    itself are computed once.
    """
    size = dim * dim
    pairs = [(m, n) for m in range(dim) for n in range(m, dim)]
    n_pairs, first, second = len(pairs), tuple(m for m, _ in pairs), tuple(n for _, n in pairs)

    @compiled
    def add(starts, lengths, pattern, at, first_point, lists, g, centre, volume, A, of, blocks):
        list_ptr, entry_ptr, plus, minus = lists
        longest = lengths.max() if lengths.size else 0
        WA = np.empty((n_pairs, size, longest))
        block = np.empty(longest)
        weight = np.empty(n_pairs)
        for q in range(starts.size):
            s, n = starts[q], lengths[q]
            for k in range(list_ptr[pattern[q]], list_ptr[pattern[q] + 1]):
                for i in range(n):
                    p = first_point[at[s + i]] + k - list_ptr[pattern[q]]
                    if of.size > 0:
                        p = of[p]
                    for r in range(n_pairs):
                        for a in range(dim):
                            for b in range(dim):
                                value = A[p, a * dim + first[r], b * dim + second[r]]
                                if first[r] != second[r]:
                                    value += A[p, a * dim + second[r], b * dim + first[r]]
                                WA[r, a * dim + b, i] = volume[k] * value
                # The centre is the last entry.
                for e in range(entry_ptr[k], entry_ptr[k + 1] + 1):
                    last = e == entry_ptr[k + 1]
                    for r in range(n_pairs):
                        if last:
                            weight[r] = centre[k, first[r]] * centre[k, second[r]]
                        else:
                            weight[r] = g[e, first[r]] * g[e, second[r]]
                    up = 0 if last else plus[e]
                    down = 0 if last else minus[e]
                    for v in range(size):
                        block[:n] = 0.0
                        for r in range(n_pairs):
                            w = weight[r]
                            of_pair = WA[r, v]
                            for i in range(n):
                                block[i] += w * of_pair[i]
                        out = blocks[v, s + up : s + up + n]
                        for i in range(n):
                            out[i] += block[i]
                        if down != 0:
                            out = blocks[v, s + down : s + down + n]
                            for i in range(n):
                                out[i] += block[i]

    return add


@lru_cache
def rows_control_blocks_kernel(dim: int) -> Callable[..., Any]:
    """Return the kernel that adds ``c (w - g . K g)`` times the identity to members, and the sum to centres.

    ``diagonal`` is (1, n_cells); ``c (sum_j w_j - g . K g)`` is added to a centre, with its own weight g.
    """

    @compiled
    def add(starts, lengths, pattern, at, lists, g, centre, weight, scale, K, diagonal):
        list_ptr, entry_ptr, plus, minus = lists
        out = diagonal[0]
        for q in range(starts.size):
            s, n = starts[q], lengths[q]
            k = list_ptr[pattern[q]]
            of_centre = 0.0
            for e in range(entry_ptr[k], entry_ptr[k + 1]):
                value = weight[e]
                of_centre += weight[e] if minus[e] == 0 else 2.0 * weight[e]
                for a in range(dim):
                    for b in range(dim):
                        value -= g[e, a] * K[k, a, b] * g[e, b]
                for i in range(n):
                    out[s + plus[e] + i] += scale[at[s + i]] * value
                    if minus[e] != 0:
                        out[s + minus[e] + i] += scale[at[s + i]] * value
            for a in range(dim):
                for b in range(dim):
                    of_centre -= centre[k, a] * K[k, a, b] * centre[k, b]
            for i in range(n):
                out[s + i] += scale[at[s + i]] * of_centre

    return add


@lru_cache
def rows_bond_blocks_kernel(dim: int, finite: int) -> Callable[..., Any]:
    """Return ``add(..., blocks)``: ``k n n + t / |xi + eta| (I - n n)`` of bonds in rows, on both of their ends."""

    @compiled
    def add(starts, lengths, pattern, at, entry_ptr, steps, xi, reference, k, u, blocks):
        y, block = np.empty(3), np.empty((dim, dim))
        for q in range(starts.size):
            for cell in range(starts[q], starts[q] + lengths[q]):
                i = at[cell]
                for e in range(entry_ptr[pattern[q]], entry_ptr[pattern[q] + 1]):
                    j = at[cell + steps[e]]
                    bond_block(e, cell, steps, xi, reference, k, u, dim, finite, y, block)
                    for m in range(dim):
                        for o in range(dim):
                            blocks[i, m, o] += block[m, o]
                            blocks[j, m, o] += block[m, o]

    return add
