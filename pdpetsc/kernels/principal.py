"""Principal axes and inverse of a deformation gradient, and tangent of an isotropic law from principal values.

All functions are functions of the module, for one point, because numba cannot cache closures over other functions.
"""

from __future__ import annotations

import numpy as np

from pdpetsc.kernels.compile import compiled
from pdpetsc.kernels.eigen import symmetric_eigen


@compiled
def right_axes(F, dim, C, squares, N):
    """Write the principal values of ``C = F^T F``, and their directions as columns of N."""
    for i in range(dim):
        for j in range(dim):
            C[i, j] = 0.0
            for k in range(dim):
                C[i, j] += F[k, i] * F[k, j]
    symmetric_eigen(C, squares, N)


@compiled
def principal_axes(F, dim, C, stretch, N, n):
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
def add_pair(dim, a, b, normal, same, swapped, n, M, A):
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
def inverse(F, dim, G):
    """Write ``F^-1`` to G and return ``det F``."""
    if dim == 1:
        J = F[0, 0]
        G[0, 0] = 1.0 / J
    elif dim == 2:
        J = F[0, 0] * F[1, 1] - F[0, 1] * F[1, 0]
        G[0, 0] = F[1, 1] / J
        G[0, 1] = -F[0, 1] / J
        G[1, 0] = -F[1, 0] / J
        G[1, 1] = F[0, 0] / J
    else:
        for i in range(3):
            for j in range(3):
                k, l = (j + 1) % 3, (j + 2) % 3
                m, n = (i + 1) % 3, (i + 2) % 3
                G[i, j] = F[k, m] * F[l, n] - F[k, n] * F[l, m]
        J = F[0, 0] * G[0, 0] + F[0, 1] * G[1, 0] + F[0, 2] * G[2, 0]
        for i in range(3):
            for j in range(3):
                G[i, j] /= J
    return J
