"""Loops of the gradient operator, its weights, its transpose and its determinants."""

from __future__ import annotations

from collections.abc import Callable
from functools import lru_cache
from typing import Any

import numpy as np

from pdpetsc.arrays import Float
from pdpetsc.kernels.compile import compiled
from pdpetsc.kernels.components import add_to, applied, difference, row


@lru_cache
def shape_kernel(dim: int) -> Callable[..., Any]:
    """Return ``moments(owner, point_ptr, members, weight, x, K)``: ``K_p = sum_k weight_pk xi_pk (x) xi_pk``."""

    @compiled
    def moments(owner, point_ptr, members, weight, x, K):
        for p in range(owner.size):
            i = owner[p]
            for m in range(dim):
                for n in range(dim):
                    K[p, m, n] = 0.0
            for t in range(point_ptr[p], point_ptr[p + 1]):
                k = members[t]
                for m in range(dim):
                    for n in range(dim):
                        K[p, m, n] += weight[t] * (x[k, m] - x[i, m]) * (x[k, n] - x[i, n])

    return moments


def inverses(K: Float) -> Float:
    """Invert symmetric positive definite matrices (n, dim, dim) by their factors L D L^T.

    NumPy calls LAPACK once per matrix, which is two hundred times slower for 3 x 3 matrices.

    Raises
    ------
    numpy.linalg.LinAlgError
        A matrix is not positive definite.
    """
    found = np.empty_like(K)
    if not _invert(np.ascontiguousarray(K), found):
        raise np.linalg.LinAlgError("A matrix is not positive definite.")
    return found


@compiled
def _invert(K, found):
    """Write ``L^-T D^-1 L^-1`` of ``K_p = L D L^T`` to ``found``; return True if all are positive definite."""
    dim = K.shape[1]
    L, D = np.empty((dim, dim)), np.empty(dim)
    for p in range(K.shape[0]):
        for m in range(dim):
            D[m] = K[p, m, m]
            for a in range(m):
                D[m] -= L[m, a] ** 2 * D[a]
            if not D[m] > 0.0:
                return False
            for n in range(m + 1, dim):
                value = K[p, n, m]
                for a in range(m):
                    value -= L[n, a] * L[m, a] * D[a]
                L[n, m] = value / D[m]
        # L becomes its inverse, row by row.
        for m in range(dim):
            for n in range(m):
                value = -L[m, n]
                for a in range(n + 1, m):
                    value -= L[m, a] * L[a, n]
                L[m, n] = value
            L[m, m] = 1.0
        for m in range(dim):
            for n in range(m + 1):
                value = 0.0
                for a in range(m, dim):
                    value += L[a, m] * L[a, n] / D[a]
                found[p, m, n] = value
                found[p, n, m] = value
    return True


@lru_cache
def weights_kernel(dim: int) -> Callable[..., Any]:
    """Return ``weights(owner, point_ptr, members, weight, x, K_inverse, g)``: ``g_pk = weight_pk K_p^-1 xi_pk``.

    The first entry of each point is its centre with ``-sum_k g_pk``, so that a translation has no gradient.
    """

    @compiled
    def weights(owner, point_ptr, members, weight, x, K_inverse, g):
        for p in range(owner.size):
            i = owner[p]
            first = point_ptr[p]
            for m in range(dim):
                g[first, m] = 0.0
            for t in range(first + 1, point_ptr[p + 1]):
                k = members[t]
                for m in range(dim):
                    value = 0.0
                    for n in range(dim):
                        value += K_inverse[p, m, n] * (x[k, n] - x[i, n])
                    g[t, m] = weight[t] * value
                    g[first, m] -= g[t, m]

    return weights


@lru_cache
def gradient_kernel(dim: int) -> Callable[..., Any]:
    """Return ``gradient(point_ptr, members, g, u, H)``: ``H_p = sum_k (u_k - u_i) (x) g_pk``."""

    @compiled
    def gradient(point_ptr, members, g, u, H):
        h = np.empty((dim, dim))
        for p in range(point_ptr.size - 1):
            first = point_ptr[p]
            i = members[first]
            h[:] = 0.0
            for t in range(first + 1, point_ptr[p + 1]):
                k = members[t]
                for m in range(dim):
                    eta = u[k, m] - u[i, m]
                    for n in range(dim):
                        h[m, n] += eta * g[t, n]
            for m in range(dim):
                for n in range(dim):
                    H[p, m, n] = h[m, n]

    return gradient


@compiled
def add_point_forces(p, point_ptr, members, g, s, stiffness, u, f, dim, controlled):
    """Add ``s g_pk`` to the members of a point, if ``controlled`` with ``stiffness_pk eta_pk``, less the sum to i."""
    first = point_ptr[p]
    i = members[first]
    own_0, own_1, own_2 = 0.0, 0.0, 0.0
    for t in range(first + 1, point_ptr[p + 1]):
        k = members[t]
        g_0, g_1, g_2 = row(g, t, dim)
        f_0, f_1, f_2 = applied(s, g_0, g_1, g_2, dim)
        if controlled:
            c = stiffness[t - p - 1]
            eta_0, eta_1, eta_2 = difference(i, k, u, dim)
            f_0, f_1, f_2 = f_0 + c * eta_0, f_1 + c * eta_1, f_2 + c * eta_2
        add_to(f, k, f_0, f_1, f_2, dim)
        own_0, own_1, own_2 = own_0 - f_0, own_1 - f_1, own_2 - f_2
    add_to(f, i, own_0, own_1, own_2, dim)


@lru_cache
def divergence_kernel(dim: int, controlled: int = 0) -> Callable[..., Any]:
    """Return ``divergence(point_ptr, members, g, volume, P, f, stiffness, K, H, u)``: ``f_k += sum_p W_p P_p g_pk``.

    If ``controlled``, a compile-time constant, also add the forces of a control on the same gradient H, as in
    ``gradient_times_kernel``. Otherwise the last four arguments are not read.
    """

    @compiled
    def divergence(point_ptr, members, g, volume, P, f, stiffness, K, H, u):
        s = np.empty((dim, dim))
        for p in range(point_ptr.size - 1):
            for m in range(dim):
                for n in range(dim):
                    s[m, n] = volume[p] * P[p, m, n]
                    if controlled:
                        for o in range(dim):
                            s[m, n] -= H[p, m, o] * K[p, o, n]
            add_point_forces(p, point_ptr, members, g, s, stiffness, u, f, dim, controlled)

    return divergence


@lru_cache
def residual_kernel(dim: int) -> Callable[..., Any]:
    """Return ``residual(owner, point_ptr, members, x, u, F, square, Z)``, with ``z = eta - (F - I) xi``.

    Writes ``sum |xi|^2`` (n_points,) and ``sum z (x) z`` (n_points, dim, dim) over the stencil of each point.
    """

    @compiled
    def residual(owner, point_ptr, members, x, u, F, square, Z):
        for p in range(owner.size):
            i = owner[p]
            total = 0.0
            xx, yy, zz, xy, xz, yz = 0.0, 0.0, 0.0, 0.0, 0.0, 0.0
            for t in range(point_ptr[p], point_ptr[p + 1]):
                xi_0, xi_1, xi_2 = difference(i, members[t], x, dim)
                z_0, z_1, z_2 = difference(i, members[t], u, dim)
                y_0, y_1, y_2 = applied(F[p], xi_0, xi_1, xi_2, dim)
                z_0, z_1, z_2 = z_0 + xi_0 - y_0, z_1 + xi_1 - y_1, z_2 + xi_2 - y_2
                total += xi_0 * xi_0 + xi_1 * xi_1 + xi_2 * xi_2
                xx, yy, zz = xx + z_0 * z_0, yy + z_1 * z_1, zz + z_2 * z_2
                xy, xz, yz = xy + z_0 * z_1, xz + z_0 * z_2, yz + z_1 * z_2
            square[p] = total
            Z[p, 0, 0] = xx
            if dim > 1:
                Z[p, 1, 1], Z[p, 0, 1], Z[p, 1, 0] = yy, xy, xy
            if dim > 2:
                Z[p, 2, 2], Z[p, 0, 2], Z[p, 2, 0], Z[p, 1, 2], Z[p, 2, 1] = zz, xz, xz, yz, yz

    return residual


@lru_cache
def determinant_kernel(dim: int) -> Callable[..., Any]:
    """Return ``smallest(F)``: the smallest ``det F_p`` (infinity for no points, NaN counts as the smallest)."""

    @compiled
    def smallest(F):
        lowest = np.inf
        for p in range(F.shape[0]):
            if dim == 1:
                J = F[p, 0, 0]
            elif dim == 2:
                J = F[p, 0, 0] * F[p, 1, 1] - F[p, 0, 1] * F[p, 1, 0]
            else:
                J = (
                    F[p, 0, 0] * (F[p, 1, 1] * F[p, 2, 2] - F[p, 1, 2] * F[p, 2, 1])
                    - F[p, 0, 1] * (F[p, 1, 0] * F[p, 2, 2] - F[p, 1, 2] * F[p, 2, 0])
                    + F[p, 0, 2] * (F[p, 1, 0] * F[p, 2, 1] - F[p, 1, 1] * F[p, 2, 0])
                )
            if not lowest <= J:
                lowest = J
                if np.isnan(J):
                    return J
        return lowest

    return smallest


@compiled
def bonds_of_entries(owner, point_ptr, members, indptr, neighbours, n_local, bond):
    """Write for every entry of the operator the bond from the owner of its point to its member, -1 for the owner."""
    slot = np.full(n_local, -1, np.int64)
    for p in range(owner.size):
        i = owner[p]
        for b in range(indptr[i], indptr[i + 1]):
            slot[neighbours[b]] = b
        bond[point_ptr[p]] = -1
        for t in range(point_ptr[p] + 1, point_ptr[p + 1]):
            bond[t] = slot[members[t]]


@lru_cache
def bond_family_sizes_kernel(dim: int) -> Callable[..., Any]:
    """Return ``sizes(indptr, neighbours, x, radius, size)``: number of members of ``i`` within ``radius`` of ``j``."""

    @compiled
    def sizes(indptr, neighbours, x, radius, size):
        for i in range(indptr.size - 1):
            for b in range(indptr[i], indptr[i + 1]):
                j = neighbours[b]
                count = 0
                for t in range(indptr[i], indptr[i + 1]):
                    square = 0.0
                    for m in range(dim):
                        square += (x[neighbours[t], m] - x[j, m]) ** 2
                    if square <= radius[b] * radius[b]:
                        count += 1
                size[b] = count

    return sizes


@lru_cache
def bond_families_kernel(dim: int) -> Callable[..., Any]:
    """Return ``list(indptr, neighbours, x, radius, point_ptr, bonds)``: bonds to these members, in family order."""

    @compiled
    def members(indptr, neighbours, x, radius, point_ptr, bonds):
        for i in range(indptr.size - 1):
            for b in range(indptr[i], indptr[i + 1]):
                j = neighbours[b]
                at = point_ptr[b]
                for t in range(indptr[i], indptr[i + 1]):
                    square = 0.0
                    for m in range(dim):
                        square += (x[neighbours[t], m] - x[j, m]) ** 2
                    if square <= radius[b] * radius[b]:
                        bonds[at] = t
                        at += 1

    return members


@lru_cache
def smoothed_moments_kernel(dim: int) -> Callable[..., Any]:
    """Return ``moments(indptr, neighbours, x, volume, weight, radius, rest, M)``: gradients of averages, by members.

    ``M_ik = sum_j weight_ij (S_jk - S_ik) xi_ij`` over the neighbours ``j`` of ``i`` nearer than ``rest``, where
    ``S_jk`` is the share of member ``k`` in the mean over the members of ``i``, including ``i``, within ``radius`` of
    ``j``. ``radius`` and ``rest`` are those of each centre. Bonds without weight are ignored in both sums.
    """

    @compiled
    def moments(indptr, neighbours, x, volume, weight, radius, rest, M):
        xi = np.empty(dim)
        for i in range(indptr.size - 1):
            first, last = indptr[i], indptr[i + 1]
            for t in range(first, last):
                for m in range(dim):
                    M[t, m] = 0.0
            for b in range(first - 1, last):
                # first - 1 is the centre, whose average is subtracted once for every neighbour.
                j = i if b < first else neighbours[b]
                for m in range(dim):
                    xi[m] = 0.0
                if b < first:
                    for t in range(first, last):
                        k = neighbours[t]
                        square = 0.0
                        for m in range(dim):
                            square += (x[k, m] - x[i, m]) ** 2
                        if square <= rest[i] * rest[i]:
                            for m in range(dim):
                                xi[m] -= weight[t] * (x[k, m] - x[i, m])
                else:
                    square = 0.0
                    for m in range(dim):
                        square += (x[j, m] - x[i, m]) ** 2
                    if weight[b] == 0.0 or square > rest[i] * rest[i]:
                        continue
                    for m in range(dim):
                        xi[m] = weight[b] * (x[j, m] - x[i, m])
                total = 0.0
                for t in range(first - 1, last):
                    k = i if t < first else neighbours[t]
                    square = 0.0
                    for m in range(dim):
                        square += (x[k, m] - x[j, m]) ** 2
                    if square <= radius[i] * radius[i] and (t < first or weight[t] != 0.0):
                        total += volume[k]
                for t in range(first, last):
                    k = neighbours[t]
                    square = 0.0
                    for m in range(dim):
                        square += (x[k, m] - x[j, m]) ** 2
                    if square <= radius[i] * radius[i] and weight[t] != 0.0:
                        for m in range(dim):
                            M[t, m] += volume[k] / total * xi[m]

    return moments
