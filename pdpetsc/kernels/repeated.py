"""Loops over particles whose families repeat: rows of consecutive cells of a lattice share one stencil.

Arrays on the lattice have one row per component and one column per cell, so that a row of cells is read and written in
order; cells are numbered along the lattice, and a member of a family is a constant number of cells away.
"""

from __future__ import annotations

from collections.abc import Callable
from functools import lru_cache
from typing import Any

import numpy as np

from pdpetsc.kernels.compile import compiled


@compiled
def whole_family(cell, at, steps, good, whole):  # type: ignore[no-untyped-def]
    """Write which of the own particles that are whole have a good particle at every step of the family."""
    for i in range(whole.size):
        c = cell[i]
        for t in range(steps.size):
            if not whole[i]:
                break
            j = at[c + steps[t]]
            whole[i] = j >= 0 and good[j]


@compiled
def families_of_cells(particles, cell, at, steps, order):  # type: ignore[no-untyped-def]
    """Return the families of some particles in CSR form, each sorted by ``order``."""
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
def mark_cells(starts, lengths, steps, marked):  # type: ignore[no-untyped-def]
    """Mark the cells of rows and those at every step from them."""
    for q in range(starts.size):
        s, n = starts[q], lengths[q]
        marked[s : s + n] = True
        for t in range(steps.size):
            marked[s + steps[t] : s + steps[t] + n] = True


@compiled
def onto_cells(cell, values, on_cells):  # type: ignore[no-untyped-def]
    """Write vectors of particles (n, components) to their cells (components, n_cells)."""
    for i in range(values.shape[0]):
        for m in range(values.shape[1]):
            on_cells[m, cell[i]] = values[i, m]


@lru_cache
def rows_gradient_kernel(dim: int) -> Callable[..., Any]:
    """Return ``gradient(starts, lengths, plus, minus, g, u, H)``: ``H = sum_e (u_+ - u_-) (x) g_e`` on rows of cells.

    Entry e reads the cells ``plus[e]`` and ``minus[e]`` away; u and H are arrays on the lattice, H with ``dim dim``
    rows, of which the cells of the rows are written.
    """

    @compiled
    def gradient(starts, lengths, plus, minus, g, u, H):  # type: ignore[no-untyped-def]
        n_entries = plus.size
        longest = 0
        for q in range(lengths.size):
            longest = max(longest, lengths[q])
        buffer = np.empty((3, longest))
        # With fewer dimensions the last columns are not read.
        gx = g[:, 0].copy()
        gy = g[:, min(1, dim - 1)].copy()
        gz = g[:, dim - 1].copy()
        for q in range(starts.size):
            s, n = starts[q], lengths[q]
            a, b, c = buffer[0], buffer[1], buffer[2]
            for m in range(dim):
                v = u[m]
                buffer[:, :n] = 0.0
                e = 0
                while e + 4 <= n_entries:
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
                while e < n_entries:
                    p0 = v[s + plus[e] : s + plus[e] + n]
                    m0 = v[s + minus[e] : s + minus[e] + n]
                    for i in range(n):
                        d0 = p0[i] - m0[i]
                        a[i] += d0 * gx[e]
                        if dim > 1:
                            b[i] += d0 * gy[e]
                        if dim > 2:
                            c[i] += d0 * gz[e]
                    e += 1
                for k in range(dim):
                    H[dim * m + k, s : s + n] = buffer[k, :n]

    return gradient


@lru_cache
def rows_force_kernel(dim: int) -> Callable[..., Any]:
    """Return ``force(starts, lengths, at, plus, minus, g, P, f)``: the transpose of ``rows_gradient_kernel``.

    Adds ``sum_e (P_{c - plus} - P_{c - minus}) g_e`` to the particle of every cell c of the rows; P (dim dim, n_cells)
    is zero but where points put forces on others.
    """

    @compiled
    def force(starts, lengths, at, plus, minus, g, P, f):  # type: ignore[no-untyped-def]
        n_entries = plus.size
        longest = 0
        for q in range(lengths.size):
            longest = max(longest, lengths[q])
        buffer = np.empty(longest)
        gx = g[:, 0].copy()
        gy = g[:, min(1, dim - 1)].copy()
        gz = g[:, dim - 1].copy()
        second, third = min(1, dim - 1), dim - 1
        for q in range(starts.size):
            s, n = starts[q], lengths[q]
            for m in range(dim):
                x, y, z = P[dim * m], P[dim * m + second], P[dim * m + third]
                buffer[:n] = 0.0
                e = 0
                while e + 2 <= n_entries:
                    o, r = s - plus[e], s - minus[e]
                    v, w = s - plus[e + 1], s - minus[e + 1]
                    xp, xm, yp, ym, zp, zm = x[o : o + n], x[r : r + n], y[o : o + n], y[r : r + n], z[o : o + n], z[r : r + n]  # fmt: skip  # noqa: E501
                    xq, xn, yq, yn, zq, zn = x[v : v + n], x[w : w + n], y[v : v + n], y[w : w + n], z[v : v + n], z[w : w + n]  # fmt: skip  # noqa: E501
                    a0, b0, c0, a1, b1, c1 = gx[e], gy[e], gz[e], gx[e + 1], gy[e + 1], gz[e + 1]
                    for i in range(n):
                        value = (xp[i] - xm[i]) * a0 + (xq[i] - xn[i]) * a1
                        if dim > 1:
                            value += (yp[i] - ym[i]) * b0 + (yq[i] - yn[i]) * b1
                        if dim > 2:
                            value += (zp[i] - zm[i]) * c0 + (zq[i] - zn[i]) * c1
                        buffer[i] += value
                    e += 2
                while e < n_entries:
                    o, r = s - plus[e], s - minus[e]
                    for i in range(n):
                        value = (x[o + i] - x[r + i]) * gx[e]
                        if dim > 1:
                            value += (y[o + i] - y[r + i]) * gy[e]
                        if dim > 2:
                            value += (z[o + i] - z[r + i]) * gz[e]
                        buffer[i] += value
                    e += 1
                for i in range(n):
                    f[at[s + i], m] += buffer[i]

    return force


@lru_cache
def rows_stress_kernel(dim: int) -> Callable[..., Any]:
    """Return ``stress(starts, lengths, at, first_point, A, volume, scale, K, H)``: ``W A H - c H K`` in place of H.

    Of the points of each own particle, which ``first_point`` counts from, the moduli of number ``point`` are read; no
    moduli count as zero. ``scale`` (n_cells,) is ``c`` and empty where there is no control in the loop.
    """

    @compiled
    def stress(starts, lengths, at, first_point, point, A, volume, scale, K, H):  # type: ignore[no-untyped-def]
        size = dim * dim
        gradient = np.empty(size)
        controlled = scale.size > 0
        elastic = A.size > 0
        for q in range(starts.size):
            for cell in range(starts[q], starts[q] + lengths[q]):
                p = first_point[at[cell]] + point if elastic else 0
                for r in range(size):
                    gradient[r] = H[r, cell]
                for a in range(dim):
                    for b in range(dim):
                        value = 0.0
                        if elastic:
                            for m in range(dim):
                                for n in range(dim):
                                    value += A[p, a, b, m, n] * gradient[dim * m + n]
                            value *= volume
                        if controlled:
                            for n in range(dim):
                                value -= scale[cell] * gradient[dim * a + n] * K[n, b]
                        H[dim * a + b, cell] = value

    return stress


@lru_cache
def rows_springs_kernel(dim: int) -> Callable[..., Any]:
    """Return ``springs(starts, lengths, at, half, weight, scale, u, f)``: forces ``c_i w_ij eta_ij`` on j, less on i.

    ``half`` and ``weight`` are the steps to one of every two opposite members and their weights; ``scale`` (n_cells,)
    is zero but where the centre is one of the rows of points.
    """

    @compiled
    def springs(starts, lengths, at, half, weight, scale, u, f):  # type: ignore[no-untyped-def]
        longest = 0
        for q in range(lengths.size):
            longest = max(longest, lengths[q])
        buffer = np.empty(longest)
        for q in range(starts.size):
            s, n = starts[q], lengths[q]
            here = scale[s : s + n]
            for m in range(dim):
                v = u[m]
                own = v[s : s + n]
                buffer[:n] = 0.0
                for e in range(half.size):
                    o, w = half[e], weight[e]
                    up, down = v[s + o : s + o + n], v[s - o : s - o + n]
                    c_up, c_down = scale[s + o : s + o + n], scale[s - o : s - o + n]
                    for i in range(n):
                        buffer[i] += w * (
                            (here[i] + c_down[i]) * (own[i] - down[i]) + (here[i] + c_up[i]) * (own[i] - up[i])
                        )
                for i in range(n):
                    f[at[s + i], m] += buffer[i]

    return springs


@lru_cache
def rows_spring_energy_kernel(dim: int) -> Callable[..., Any]:
    """Return ``energy(starts, lengths, half, weight, scale, K, u, H)``: ``1/2 sum c (sum_j w |eta|^2 - H K : H)``."""

    @compiled
    def energy(starts, lengths, half, weight, scale, K, u, H):  # type: ignore[no-untyped-def]
        total = 0.0
        for q in range(starts.size):
            s, n = starts[q], lengths[q]
            here = scale[s : s + n]
            for m in range(dim):
                v = u[m]
                own = v[s : s + n]
                for e in range(half.size):
                    o = half[e]
                    up, down = v[s + o : s + o + n], v[s - o : s - o + n]
                    square = 0.0
                    for i in range(n):
                        one, other = up[i] - own[i], down[i] - own[i]
                        square += here[i] * (one * one + other * other)
                    total += 0.5 * weight[e] * square
                for i in range(n):
                    for a in range(dim):
                        for b in range(dim):
                            total -= 0.5 * here[i] * H[dim * m + a, s + i] * K[a, b] * H[dim * m + b, s + i]
        return total

    return energy


@compiled
def rows_to_points(starts, lengths, at, first_point, point, H, result):  # type: ignore[no-untyped-def]
    """Write values on cells (dim dim, n_cells) to the points of the particles (n_points, dim, dim)."""
    dim = result.shape[1]
    for q in range(starts.size):
        for cell in range(starts[q], starts[q] + lengths[q]):
            p = first_point[at[cell]] + point
            for a in range(dim):
                for b in range(dim):
                    result[p, a, b] = H[dim * a + b, cell]


@compiled
def points_to_rows(starts, lengths, at, first_point, point, volume, P, on_cells):  # type: ignore[no-untyped-def]
    """Write ``W P`` of the points of the particles (n_points, dim, dim) to their cells (dim dim, n_cells)."""
    dim = P.shape[1]
    for q in range(starts.size):
        for cell in range(starts[q], starts[q] + lengths[q]):
            p = first_point[at[cell]] + point
            for a in range(dim):
                for b in range(dim):
                    on_cells[dim * a + b, cell] = volume * P[p, a, b]


@compiled
def clear_rows(starts, lengths, on_cells):  # type: ignore[no-untyped-def]
    """Set the columns of rows of cells to zero."""
    for q in range(starts.size):
        on_cells[:, starts[q] : starts[q] + lengths[q]] = 0.0
