"""Stress and moduli of an isotropic law of a symmetric strain from its principal values."""

from __future__ import annotations

from functools import lru_cache
from typing import Any, NamedTuple

from pdpetsc.kernels.compile import compiled


class StrainLoops(NamedTuple):
    """Compiled loops over points, with the principal directions in the columns of ``N`` (n, dim, dim).

    ``stress(stress, N, S)`` writes ``S = sum_a s_a N_a (x) N_a`` for principal stresses (n, k), k at least dim.
    ``tangent(moduli, shear, N, C)`` writes ``dS/dE`` (n, dim, dim, dim, dim) for ``ds_a / d eps_b`` (n, k, k) and
    ``shear = (s_a - s_b) / (eps_a - eps_b)`` (n, dim, dim), zero where a = b.
    """

    stress: Any
    tangent: Any


@lru_cache
def strain_loops(dim: int) -> StrainLoops:
    """Return the loops for dimension ``dim``."""

    @compiled
    def stress(stress, N, S):  # type: ignore[no-untyped-def]
        for p in range(len(N)):
            for i in range(dim):
                for j in range(dim):
                    S[p, i, j] = 0.0
                    for a in range(dim):
                        S[p, i, j] += stress[p, a] * N[p, i, a] * N[p, j, a]

    @compiled
    def tangent(moduli, shear, N, C):  # type: ignore[no-untyped-def]
        for p in range(len(N)):
            C[p] = 0.0
            for a in range(dim):
                for b in range(dim):
                    normal = moduli[p, a, b]
                    half = 0.5 * shear[p, a, b]
                    if normal == 0.0 and half == 0.0:
                        continue
                    for i in range(dim):
                        for m in range(dim):
                            aa = normal * N[p, i, a] * N[p, m, a]
                            ab = half * N[p, i, a] * N[p, m, b]
                            for k in range(dim):
                                for n in range(dim):
                                    swapped = N[p, k, a] * N[p, n, b] + N[p, k, b] * N[p, n, a]
                                    C[p, i, m, k, n] += aa * N[p, k, b] * N[p, n, b] + ab * swapped

    return StrainLoops(stress, tangent)
