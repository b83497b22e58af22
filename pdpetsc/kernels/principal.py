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
