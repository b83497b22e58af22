"""Principal axes of a deformation gradient, and stress and tangent of an isotropic law from its principal values.

All of them are functions of the module for one point: numba cannot cache a closure over another one. G is the inverse
plastic part of F, row by row at the beginning of a history, where there is one.
"""

from __future__ import annotations

import numpy as np

from pdpetsc.kernels.compile import compiled
from pdpetsc.kernels.eigen import symmetric_eigen


@compiled
def right_axes(F, dim, C, squares, N):  # type: ignore[no-untyped-def]
    """Write the principal values of ``C = F^T F``, and their directions as columns of N."""
    for i in range(dim):
        for j in range(dim):
            C[i, j] = 0.0
            for k in range(dim):
                C[i, j] += F[k, i] * F[k, j]
    symmetric_eigen(C, squares, N)


@compiled
def principal_axes(F, dim, C, stretch, N, n):  # type: ignore[no-untyped-def]
    """Write the stretches of F and their directions, columns of N in the reference and of n in the current state."""
    right_axes(F, dim, C, stretch, N)
    for a in range(dim):
        stretch[a] = np.sqrt(stretch[a])
        for i in range(dim):
            value = 0.0
            for k in range(dim):
                value += F[i, k] * N[k, a]
            n[i, a] = value / stretch[a]


@compiled
def reference_axes(G, N, dim, M):  # type: ignore[no-untyped-def]
    """Write ``M_a = G N_a``: the second index of the tangent, brought back to the reference configuration."""
    for m in range(dim):
        for a in range(dim):
            M[m, a] = 0.0
            for k in range(dim):
                M[m, a] += G[m * dim + k] * N[k, a]


@compiled
def unload(elastic, stretch, N, n, dim, E, C, G):  # type: ignore[no-untyped-def]
    """Overwrite G with ``F^-1 V_e = G (F G)^-1 V_e``, where V_e has the elastic strains (3,) after the return."""
    for i in range(dim):
        for j in range(dim):
            C[i, j] = 0.0
            for a in range(dim):
                C[i, j] += np.exp(elastic[a]) / stretch[a] * N[i, a] * n[j, a]
    for i in range(dim):
        for j in range(dim):
            E[i, j] = 0.0
            for k in range(dim):
                E[i, j] += G[i * dim + k] * C[k, j]
    for i in range(dim):
        for j in range(dim):
            G[i * dim + j] = E[i, j]


@compiled
def add_pair(dim, a, b, normal, same, swapped, n, M, A):  # type: ignore[no-untyped-def]
    """Add ``A_aabb = normal, A_abab = same, A_abba = swapped`` of the principal frame to A (dim, dim, dim, dim)."""
    for i in range(dim):
        for m in range(dim):
            aa = normal * n[i, a] * M[m, a]
            ab = n[i, a] * M[m, b]
            for k in range(dim):
                bb = n[k, b]
                for o in range(dim):
                    A[i, m, k, o] += aa * bb * M[o, b] + ab * (same * n[k, a] * M[o, b] + swapped * bb * M[o, a])


@compiled
def shear_moduli(stretch_a, stretch_b, tau_a, tau_b, shear):  # type: ignore[no-untyped-def]
    """Return ``A_abab, A_abba`` of ``principal_tangent``."""
    x = (stretch_a - stretch_b) / stretch_b
    slope = np.log1p(x) / x if abs(x) > 1e-12 else 1.0 - 0.5 * x
    difference = (shear * slope - tau_b) / (stretch_a * stretch_b)
    total = (tau_a / stretch_a + tau_b / stretch_b) / (stretch_a + stretch_b)
    return 0.5 * (difference + total), 0.5 * (difference - total)


@compiled
def principal_tangent(dim, stretch, tau, moduli, shear, n, M, A):  # type: ignore[no-untyped-def]
    """Write ``A = dP/dF`` (dim, dim, dim, dim) of ``P = sum_a tau_a / l_a n_a (x) M_a``.

    ``moduli`` holds ``d tau_a / d eps_b`` and ``shear`` the factors in ``tau_a - tau_b = shear_ab (eps_a - eps_b)``,
    with logarithmic strains eps of the stretches l. Columns of ``n`` and ``M`` are the principal directions of the
    current and, brought to the reference configuration, of the other index. In that frame, with ``p_a = tau_a / l_a``::

        A_aabb = moduli_ab / (l_a l_b) - delta_ab tau_a / l_a^2
        A_abab = (m + q) / 2,  A_abba = (m - q) / 2,   m = (p_a - p_b) / (l_a - l_b),  q = (p_a + p_b) / (l_a + l_b)

    where m is written so that it keeps its accuracy for nearly equal stretches.
    """
    for i in range(dim):
        for m in range(dim):
            for k in range(dim):
                for o in range(dim):
                    A[i, m, k, o] = 0.0
    for a in range(dim):
        for b in range(dim):
            normal = moduli[a, b] / (stretch[a] * stretch[b])
            same = 0.0
            swapped = 0.0
            if a == b:
                normal -= tau[a] / (stretch[a] * stretch[a])
            else:
                same, swapped = shear_moduli(stretch[a], stretch[b], tau[a], tau[b], shear[a, b])
            add_pair(dim, a, b, normal, same, swapped, n, M, A)
