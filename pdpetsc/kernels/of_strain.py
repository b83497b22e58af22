"""Stress and moduli of an isotropic law of a symmetric strain from its principal values."""

from __future__ import annotations

from functools import lru_cache
from typing import Any, NamedTuple

from pdpetsc.kernels.compile import compiled


class StrainLoops(NamedTuple):
    """Compiled loops over points, with the principal directions in the columns of ``N`` (n, dim, dim).

    ``stress(stress, N, S)`` writes ``S = sum_a s_a N_a (x) N_a`` for principal stresses (n, k), k at least dim.
    ``tangent(moduli, shear, N, C)`` writes ``dS/dE`` (n, dim, dim, dim, dim) for ``ds_a / d eps_b`` (n, k, k) and
    ``shear = (s_a - s_b) / (eps_a - eps_b)`` (n, dim, dim), zero for a = b.
    """

    stress: Any
    tangent: Any


@lru_cache
def strain_loops(dim: int) -> StrainLoops:
    """Return the loops for dimension ``dim``."""

    # Sums are accumulated in scalars: for x86 without AVX the compiler generates wrong code for in-place sums of S and
    # C.
    @compiled
    def stress(stress, N, S):
        for p in range(len(N)):
            for i in range(dim):
                for j in range(dim):
                    value = 0.0
                    for a in range(dim):
                        value += stress[p, a] * N[p, i, a] * N[p, j, a]
                    S[p, i, j] = value

    @compiled
    def tangent(moduli, shear, N, C):
        for p in range(len(N)):
            for i in range(dim):
                for m in range(dim):
                    for k in range(dim):
                        for n in range(dim):
                            value = 0.0
                            for a in range(dim):
                                for b in range(dim):
                                    value += moduli[p, a, b] * N[p, i, a] * N[p, m, a] * N[p, k, b] * N[p, n, b]
                                    swapped = N[p, k, a] * N[p, n, b] + N[p, k, b] * N[p, n, a]
                                    value += 0.5 * shear[p, a, b] * N[p, i, a] * N[p, m, b] * swapped
                            C[p, i, m, k, n] = value

    return StrainLoops(stress, tangent)
