"""Loops around laws in principal logarithmic strains: from F to trial strains, and from principal values to P and A."""

from __future__ import annotations

from functools import lru_cache
from typing import Any, NamedTuple

import numpy as np

from pdpetsc.kernels.compile import compiled
from pdpetsc.kernels.eigen import symmetric_eigen
from pdpetsc.kernels.principal import principal_tangent, reference_axes, unload


class LogarithmicLoops(NamedTuple):
    """Compiled loops over points ``select``, whose rows of ``history`` begin with ``G = F_p^-1``.

    ``trial(F, select, history, strain, stretch, N, n)`` writes logarithmic strains (n, 3), 0 where F does not show
    them, and stretches (n, dim) of ``F G`` with their directions (n, dim, dim), columns of ``N`` in the unloaded and of
    ``n`` in the current state. ``stress(select, history, tau, stretch, N, n, P)`` and ``tangent(select, history, tau,
    moduli, shear, stretch, N, n, A)`` write at ``select``; ``shear`` holds ``(tau_a - tau_b) / (eps_a - eps_b)``.
    ``commit(history, elastic, stretch, N, n)`` makes G that of elastic strains (n, 3).
    """

    trial: Any
    stress: Any
    tangent: Any
    commit: Any


@lru_cache
def logarithmic_loops(dim: int) -> LogarithmicLoops:
    """Return the loops for dimension ``dim``."""

    # Trial strains and stresses are written out here, with a dimension that the compiler knows: shared functions of one
    # point, for which it is a variable, take twice the time.
    @compiled
    def trial(F, select, history, strain, stretch, N, n):  # type: ignore[no-untyped-def]
        E, C = np.empty((dim, dim)), np.empty((dim, dim))
        for r in range(select.size):
            p = select[r]
            for i in range(dim):
                for j in range(dim):
                    E[i, j] = 0.0
                    for k in range(dim):
                        E[i, j] += F[p, i, k] * history[r, k * dim + j]
            for i in range(dim):
                for j in range(dim):
                    C[i, j] = 0.0
                    for k in range(dim):
                        C[i, j] += E[k, i] * E[k, j]
            symmetric_eigen(C, stretch[r], N[r])
            for a in range(3):
                strain[r, a] = 0.0
            for a in range(dim):
                strain[r, a] = 0.5 * np.log(stretch[r, a])
                stretch[r, a] = np.sqrt(stretch[r, a])
                for i in range(dim):
                    value = 0.0
                    for k in range(dim):
                        value += E[i, k] * N[r, k, a]
                    n[r, i, a] = value / stretch[r, a]

    @compiled
    def stress(select, history, tau, stretch, N, n, P):  # type: ignore[no-untyped-def]
        C = np.empty((dim, dim))
        for r in range(select.size):
            p = select[r]
            for i in range(dim):
                for j in range(dim):
                    C[i, j] = 0.0
                    for a in range(dim):
                        C[i, j] += tau[r, a] / stretch[r, a] * n[r, i, a] * N[r, j, a]
            for i in range(dim):
                for j in range(dim):
                    value = 0.0
                    for k in range(dim):
                        value += C[i, k] * history[r, j * dim + k]
                    P[p, i, j] = value

    @compiled
    def tangent(select, history, tau, moduli, shear, stretch, N, n, A):  # type: ignore[no-untyped-def]
        M = np.empty((dim, dim))
        for r in range(select.size):
            reference_axes(history[r], N[r], dim, M)
            principal_tangent(dim, stretch[r], tau[r], moduli[r], shear[r], n[r], M, A[select[r]])

    @compiled
    def commit(history, elastic, stretch, N, n):  # type: ignore[no-untyped-def]
        E, C = np.empty((dim, dim)), np.empty((dim, dim))
        for r in range(len(elastic)):
            unload(elastic[r], stretch[r], N[r], n[r], dim, E, C, history[r])

    return LogarithmicLoops(trial, stress, tangent, commit)
