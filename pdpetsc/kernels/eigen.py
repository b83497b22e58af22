"""Eigenvalues of small symmetric matrices inside compiled loops."""

from __future__ import annotations

import numpy as np

from pdpetsc.kernels.compile import compiled

SWEEPS = 30


@compiled
def symmetric_eigen(S, values, vectors):
    """Diagonalise the symmetric ``S`` (overwritten) by cyclic Jacobi rotations: ``S = sum_a values_a N_a (x) N_a``.

    Columns of ``vectors`` are the ``N_a``. Jacobi rotations have full relative accuracy for nearly equal eigenvalues,
    as in the undeformed state.
    """
    dim = S.shape[0]
    for i in range(dim):
        for j in range(dim):
            vectors[i, j] = 1.0 if i == j else 0.0
    for _ in range(SWEEPS):
        off = 0.0
        for i in range(dim):
            for j in range(i + 1, dim):
                off += abs(S[i, j])
        if off == 0.0:
            break
        for i in range(dim):
            for j in range(i + 1, dim):
                if abs(S[i, j]) <= 1e-300 or abs(S[i, j]) < 1e-18 * (abs(S[i, i]) + abs(S[j, j])):
                    S[i, j] = 0.0
                    S[j, i] = 0.0
                    continue
                theta = (S[j, j] - S[i, i]) / (2.0 * S[i, j])
                t = 1.0 / (abs(theta) + np.sqrt(theta * theta + 1.0))
                if theta < 0.0:
                    t = -t
                c = 1.0 / np.sqrt(t * t + 1.0)
                s = t * c
                for k in range(dim):
                    a = S[i, k]
                    b = S[j, k]
                    S[i, k] = c * a - s * b
                    S[j, k] = s * a + c * b
                for k in range(dim):
                    a = S[k, i]
                    b = S[k, j]
                    S[k, i] = c * a - s * b
                    S[k, j] = s * a + c * b
                    a = vectors[k, i]
                    b = vectors[k, j]
                    vectors[k, i] = c * a - s * b
                    vectors[k, j] = s * a + c * b
                S[i, j] = 0.0
                S[j, i] = 0.0
    for i in range(dim):
        values[i] = S[i, i]
