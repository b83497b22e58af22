"""Loops around laws in the Lagrangian logarithmic strain ``E = 1/2 ln(F^T F)``: from F to E, from T(E) to P and A.

With the principal values ``c_a`` of ``C = F^T F`` and divided differences ``f[a, b]``, ``f[a, b, c]`` of ``1/2 ln`` at
them, the first and second derivative of E by C are, in the principal frame,

``dE_ab = f[a, b] dC_ab`` and ``d2E_ab = sum_c f[a, c, b] (H_ac K_cb + K_ac H_cb)``.
"""

from __future__ import annotations

from functools import lru_cache
from typing import Any, NamedTuple

import numpy as np

from pdpetsc.kernels.compile import compiled
from pdpetsc.kernels.principal import right_axes

# Relative distance of values below which the second divided difference is a series, and its number of terms.
CLOSE, TERMS = 0.02, 10


class LagrangianLoops(NamedTuple):
    """Compiled loops over points ``select``.

    ``strain(F, select, E, c, N)`` writes E (n, 3, 3), zero in hidden directions, and the principal values (n, dim) and
    directions (n, dim, dim) of C. ``stress(F, select, T, c, N, P)`` and ``tangent(F, select, T, moduli, c, N, A)``
    write at ``select``, from ``T = dpsi/dE`` (n, dim, dim) and ``moduli = dT/dE`` (n, dim, dim, dim, dim).
    """

    strain: Any
    stress: Any
    tangent: Any


@compiled
def first_difference(x, y):
    """Return ``(ln x - ln y) / (2 (x - y))``."""
    r = (x - y) / y
    return 0.5 * (np.log1p(r) / r if abs(r) > 1e-12 else 1.0 - 0.5 * r) / y


@compiled
def second_difference(x, y, z):
    """Return the second divided difference of ``1/2 ln`` at three positive values."""
    low, high = min(x, y, z), max(x, y, z)
    middle = x + y + z - low - high
    if high - low > CLOSE * high:
        return (first_difference(high, middle) - first_difference(middle, low)) / (high - low)
    # sum_k f^(k + 2)(m) / (k + 2)! h_k, with the sums h_k of all products of k deviations from the mean m.
    m = (low + middle + high) / 3.0
    a, b, c = low / m - 1.0, middle / m - 1.0, high / m - 1.0
    one, two, three, power = 1.0, 1.0, 1.0, 1.0
    total, sign = 0.0, -0.5
    for k in range(TERMS):
        total += sign / (k + 2.0) * three
        sign = -sign
        power *= a
        one = power
        two = one + b * two
        three = two + c * three
    return total / (m * m)


@lru_cache
def lagrangian_loops(dim: int) -> LagrangianLoops:
    """Return the loops for dimension ``dim``."""

    @compiled
    def strain(F, select, E, c, N):
        C = np.empty((dim, dim))
        for r in range(select.size):
            right_axes(F[select[r]], dim, C, c[r], N[r])
            for i in range(3):
                for j in range(3):
                    E[r, i, j] = 0.0
            for i in range(dim):
                for j in range(dim):
                    for a in range(dim):
                        E[r, i, j] += 0.5 * np.log(c[r, a]) * N[r, i, a] * N[r, j, a]

    @compiled
    def stress(F, select, T, c, N, P):
        turned, S = np.empty((dim, dim)), np.empty((dim, dim))
        for r in range(select.size):
            p = select[r]
            for a in range(dim):
                for b in range(dim):
                    value = 0.0
                    for i in range(dim):
                        for j in range(dim):
                            value += N[r, i, a] * T[r, i, j] * N[r, j, b]
                    turned[a, b] = 2.0 * first_difference(c[r, a], c[r, b]) * value
            for i in range(dim):
                for j in range(dim):
                    S[i, j] = 0.0
                    for a in range(dim):
                        for b in range(dim):
                            S[i, j] += N[r, i, a] * turned[a, b] * N[r, j, b]
            for i in range(dim):
                for j in range(dim):
                    value = 0.0
                    for k in range(dim):
                        value += F[p, i, k] * S[k, j]
                    P[p, i, j] = value

    @compiled
    def tangent(F, select, T, moduli, c, N, A):
        turned, first = np.empty((dim, dim)), np.empty((dim, dim))
        second, FN, S = np.empty((dim, dim, dim)), np.empty((dim, dim)), np.empty((dim, dim))
        one, two = np.empty((dim, dim, dim, dim)), np.empty((dim, dim, dim, dim))
        for r in range(select.size):
            p = select[r]
            for a in range(dim):
                for b in range(dim):
                    first[a, b] = first_difference(c[r, a], c[r, b])
                    for d in range(dim):
                        second[a, b, d] = second_difference(c[r, a], c[r, b], c[r, d])
                    turned[a, b] = 0.0
                    FN[a, b] = 0.0
                    for i in range(dim):
                        FN[a, b] += F[p, a, i] * N[r, i, b]
                        for j in range(dim):
                            turned[a, b] += N[r, i, a] * T[r, i, j] * N[r, j, b]
            # The moduli in the principal frame, one index after the other.
            one[:] = moduli[r]
            for _ in range(4):
                for i in range(dim):
                    for j in range(dim):
                        for k in range(dim):
                            for a in range(dim):
                                value = 0.0
                                for o in range(dim):
                                    value += one[o, i, j, k] * N[r, o, a]
                                two[i, j, k, a] = value
                one[:] = two
            # dS/d(C/2) there, with both symmetries of its last two indices.
            for a in range(dim):
                for b in range(dim):
                    for k in range(dim):
                        for o in range(dim):
                            one[a, b, k, o] *= 4.0 * first[a, b] * first[k, o]
                    for o in range(dim):
                        left = 2.0 * turned[a, o] * second[a, b, o]
                        one[a, b, b, o] += left
                        one[a, b, o, b] += left
                        right = 2.0 * turned[o, b] * second[o, a, b]
                        one[a, b, o, a] += right
                        one[a, b, a, o] += right
            for i in range(dim):
                for j in range(dim):
                    S[i, j] = 0.0
                    for a in range(dim):
                        for b in range(dim):
                            S[i, j] += 2.0 * first[a, b] * N[r, i, a] * turned[a, b] * N[r, j, b]
            # Back: the first and third index with F N, the others with N.
            for turn in range(4):
                for i in range(dim):
                    for j in range(dim):
                        for k in range(dim):
                            for a in range(dim):
                                value = 0.0
                                for o in range(dim):
                                    value += one[o, i, j, k] * (FN[a, o] if turn % 2 == 0 else N[r, a, o])
                                two[i, j, k, a] = value
                one[:] = two
            for i in range(dim):
                for m in range(dim):
                    for k in range(dim):
                        for o in range(dim):
                            A[p, i, m, k, o] = one[i, m, k, o] + (S[m, o] if i == k else 0.0)

    return LagrangianLoops(strain, stress, tangent)
