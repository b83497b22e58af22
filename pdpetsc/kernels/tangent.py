"""Products of tangents with displacements, family by family, without a matrix."""

from __future__ import annotations

from collections.abc import Callable
from functools import lru_cache
from typing import Any

import numpy as np

from pdpetsc.kernels.bonds import direction
from pdpetsc.kernels.compile import compiled
from pdpetsc.kernels.components import add_to, difference
from pdpetsc.kernels.gradient import add_point_forces

# Empty stiffness and shape tensors for ``gradient_times_kernel`` without control.
NO_CONTROL = np.empty(0), np.empty((0, 0, 0))


@lru_cache
def gradient_times_kernel(dim: int, controlled: int = 0) -> Callable[..., Any]:
    """Return ``times(particles, points_of, point_ptr, members, g, h, volume, A, stiffness, K, u, f)``.

    Adds ``H^T (W A) G u`` in one pass over the points of ``particles``: gradient, stress and its forces while the
    stencil is in cache. If ``controlled``, a compile-time constant, also the forces of a control with the energy
    ``sum_j s_ij |eta_ij - H_i xi_ij|^2 / 2`` for the same gradient ``H_i`` and ``s_ij xi_ij = K_i g_ij``: the force on
    ``j`` is ``(W A H - H K) g_ij + s_ij eta_ij``. There is then one point per particle, over its whole family.
    Otherwise ``stiffness`` and ``K`` are not read.
    """

    @compiled
    def times(particles, points_of, point_ptr, members, g, h, volume, A, stiffness, K, u, f):
        gradient = np.empty((dim, dim))
        stress = np.empty((dim, dim))
        for q in range(particles.size):
            i = particles[q]
            for p in range(points_of[i], points_of[i + 1]):
                first = point_ptr[p]
                gradient[:] = 0.0
                for t in range(first + 1, point_ptr[p + 1]):
                    k = members[t]
                    for m in range(dim):
                        eta = u[k, m] - u[i, m]
                        for n in range(dim):
                            gradient[m, n] += eta * g[t, n]
                for a in range(dim):
                    for b in range(dim):
                        value = 0.0
                        for m in range(dim):
                            for n in range(dim):
                                value += A[p, a, b, m, n] * gradient[m, n]
                        value *= volume[p]
                        if controlled:
                            for n in range(dim):
                                value -= gradient[a, n] * K[p, n, b]
                        stress[a, b] = value
                add_point_forces(p, point_ptr, members, h, stress, stiffness, u, f, dim, controlled)

    return times


@lru_cache
def same_gradient_kernel(dim: int) -> Callable[..., Any]:
    """Return ``deviation(point_ptr, members, g, stiffness, K_inverse, x)``: ``max |g - s K^-1 xi| / max |g|``."""

    @compiled
    def deviation(point_ptr, members, g, stiffness, K_inverse, x):
        worst = 0.0
        largest = 0.0
        for i in range(point_ptr.size - 1):
            for t in range(point_ptr[i] + 1, point_ptr[i + 1]):
                k = members[t]
                for m in range(dim):
                    value = g[t, m]
                    largest = max(largest, abs(value))
                    for n in range(dim):
                        value -= stiffness[t - i - 1] * K_inverse[i, m, n] * (x[k, n] - x[i, n])
                    worst = max(worst, abs(value))
        return worst / largest if largest > 0.0 else 0.0

    return deviation


@lru_cache
def bond_times_kernel(dim: int, finite: int) -> Callable[..., Any]:
    """Return ``times(particles, indptr, neighbours, x, u, stiffness, tension, a, B, du, f)``.

    Adds to ``j`` of every bond of ``particles``, and its opposite to ``i``, with ``n`` at ``u``, ``(s n . d_eta + a_ij
    B_i sum_k a_ik n_ik . d_eta_ik) n + t / |xi + eta| (I - n n) d_eta``; the last term only if ``finite``. ``a`` and
    ``B`` are empty without dilatation.
    """

    @compiled
    def times(particles, indptr, neighbours, x, u, stiffness, tension, a, B, du, f):
        dilates = a.size > 0
        for q in range(particles.size):
            i = particles[q]
            pressure = 0.0
            if dilates:
                for b in range(indptr[i], indptr[i + 1]):
                    n_0, n_1, n_2, _, _ = direction(i, neighbours[b], x, u, dim, finite)
                    d_0, d_1, d_2 = difference(i, neighbours[b], du, dim)
                    pressure += a[b] * (n_0 * d_0 + n_1 * d_1 + n_2 * d_2)
                pressure *= B[i]
            own_0, own_1, own_2 = 0.0, 0.0, 0.0
            for b in range(indptr[i], indptr[i + 1]):
                j = neighbours[b]
                n_0, n_1, n_2, _, current = direction(i, j, x, u, dim, finite)
                d_0, d_1, d_2 = difference(i, j, du, dim)
                along = n_0 * d_0 + n_1 * d_1 + n_2 * d_2
                force = stiffness[b] * along
                if dilates:
                    force += a[b] * pressure
                f_0, f_1, f_2 = force * n_0, force * n_1, force * n_2
                if finite:
                    turning = tension[b] / current
                    f_0 += turning * (d_0 - along * n_0)
                    f_1 += turning * (d_1 - along * n_1)
                    f_2 += turning * (d_2 - along * n_2)
                add_to(f, j, f_0, f_1, f_2, dim)
                own_0, own_1, own_2 = own_0 - f_0, own_1 - f_1, own_2 - f_2
            add_to(f, i, own_0, own_1, own_2, dim)

    return times


@lru_cache
def bond_moduli_kernel(dim: int, finite: int) -> Callable[..., Any]:
    """Return ``moduli(indptr, neighbours, x, u, stiffness, tension, a, B, D)``, in uniform deformation of each family.

    ``D_i = sum_j (s n n + t / |xi + eta| (I - n n)) xi xi + B_i (sum_j a n xi) (sum_j a n xi)``, the derivative of
    ``sum_j t_ij n_ij (x) xi_ij`` by the deformation gradient of the family; the tension only if ``finite``.
    """

    @compiled
    def moduli(indptr, neighbours, x, u, stiffness, tension, a, B, D):
        n = np.empty(3)
        xi = np.empty(dim)
        spread = np.empty((dim, dim))
        dilates = a.size > 0
        for i in range(indptr.size - 1):
            D[i] = 0.0
            spread[:] = 0.0
            for b in range(indptr[i], indptr[i + 1]):
                j = neighbours[b]
                n[0], n[1], n[2], _, current = direction(i, j, x, u, dim, finite)
                turning = tension[b] / current if finite else 0.0
                for m in range(dim):
                    xi[m] = x[j, m] - x[i, m]
                for m in range(dim):
                    for k in range(dim):
                        value = (stiffness[b] - turning) * n[m] * n[k]
                        if m == k:
                            value += turning
                        for o in range(dim):
                            for p in range(dim):
                                D[i, m, o, k, p] += value * xi[o] * xi[p]
                        if dilates:
                            spread[m, k] += a[b] * n[m] * xi[k]
            if dilates:
                for m in range(dim):
                    for o in range(dim):
                        for k in range(dim):
                            for p in range(dim):
                                D[i, m, o, k, p] += B[i] * spread[m, o] * spread[k, p]

    return moduli
