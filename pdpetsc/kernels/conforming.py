"""What a point leaves of numbers on its members once the best linear function is taken out."""

from __future__ import annotations

from collections.abc import Callable
from functools import lru_cache
from typing import Any

import numpy as np

from pdpetsc.kernels.compile import compiled


@lru_cache
def linear_moments_kernel(dim: int) -> Callable[..., Any]:
    """Return ``moments(point_ptr, members, x, size, M)``: ``M_p = sum phi_k (x) phi_k``, ``phi = (1, xi / size_p)``."""
    width = dim + 1

    @compiled
    def moments(point_ptr, members, x, size, M):  # type: ignore[no-untyped-def]
        phi = np.empty(width)
        phi[0] = 1.0
        for p in range(point_ptr.size - 1):
            i = members[point_ptr[p]]
            for a in range(width):
                for b in range(width):
                    M[p, a, b] = 0.0
            for t in range(point_ptr[p], point_ptr[p + 1]):
                for m in range(dim):
                    phi[m + 1] = (x[members[t], m] - x[i, m]) / size[p]
                for a in range(width):
                    for b in range(width):
                        M[p, a, b] += phi[a] * phi[b]

    return moments


@lru_cache
def without_linear_kernel(dim: int, columns: int) -> Callable[..., Any]:
    """Return ``rest(point_ptr, members, x, size, inverse, factor, values, e)``: what no linear function explains.

    ``e_pk = factor_p (v_k - phi_k . M_p^-1 sum_l phi_l v_l)`` for ``columns`` numbers per particle.
    """
    width = dim + 1

    @compiled
    def rest(point_ptr, members, x, size, inverse, factor, values, e):  # type: ignore[no-untyped-def]
        phi = np.empty(width)
        phi[0] = 1.0
        b = np.empty((width, columns))
        c = np.empty((width, columns))
        for p in range(point_ptr.size - 1):
            i = members[point_ptr[p]]
            b[:] = 0.0
            for t in range(point_ptr[p], point_ptr[p + 1]):
                k = members[t]
                for m in range(dim):
                    phi[m + 1] = (x[k, m] - x[i, m]) / size[p]
                for a in range(width):
                    for n in range(columns):
                        b[a, n] += phi[a] * values[k, n]
            for a in range(width):
                for n in range(columns):
                    c[a, n] = 0.0
                    for d in range(width):
                        c[a, n] += inverse[p, a, d] * b[d, n]
            for t in range(point_ptr[p], point_ptr[p + 1]):
                k = members[t]
                for m in range(dim):
                    phi[m + 1] = (x[k, m] - x[i, m]) / size[p]
                for n in range(columns):
                    value = values[k, n]
                    for a in range(width):
                        value -= phi[a] * c[a, n]
                    e[t, n] = factor[p] * value

    return rest


@lru_cache
def gathered_rest_kernel(dim: int, columns: int) -> Callable[..., Any]:
    """Return ``gather(point_ptr, members, x, size, inverse, factor, values, out)``: the sum of ``factor_p e_pk``.

    It is ``without_linear_kernel`` and its transpose in one pass, without the numbers of the entries.
    """
    width = dim + 1

    @compiled
    def gather(point_ptr, members, x, size, inverse, factor, values, out):  # type: ignore[no-untyped-def]
        phi = np.empty(width)
        phi[0] = 1.0
        b = np.empty((width, columns))
        c = np.empty((width, columns))
        for p in range(point_ptr.size - 1):
            i = members[point_ptr[p]]
            b[:] = 0.0
            for t in range(point_ptr[p], point_ptr[p + 1]):
                k = members[t]
                for m in range(dim):
                    phi[m + 1] = (x[k, m] - x[i, m]) / size[p]
                for a in range(width):
                    for n in range(columns):
                        b[a, n] += phi[a] * values[k, n]
            for a in range(width):
                for n in range(columns):
                    c[a, n] = 0.0
                    for d in range(width):
                        c[a, n] += inverse[p, a, d] * b[d, n]
            for t in range(point_ptr[p], point_ptr[p + 1]):
                k = members[t]
                for m in range(dim):
                    phi[m + 1] = (x[k, m] - x[i, m]) / size[p]
                for n in range(columns):
                    value = values[k, n]
                    for a in range(width):
                        value -= phi[a] * c[a, n]
                    out[k, n] += factor[p] * factor[p] * value

    return gather


@lru_cache
def near_members_kernel(dim: int) -> Callable[..., Any]:
    """Return ``near(indptr, neighbours, x, reach, taken)``: which bonds are short against the others of their family.

    A bond is taken up to ``reach`` times the length of the ``2 dim``-th shortest one of its centre, all where
    there are fewer.
    """
    count = 2 * dim

    @compiled
    def near(indptr, neighbours, x, reach, taken):  # type: ignore[no-untyped-def]
        least = np.empty(count)
        for i in range(indptr.size - 1):
            least[:] = np.inf
            for b in range(indptr[i], indptr[i + 1]):
                length = 0.0
                for m in range(dim):
                    length += (x[neighbours[b], m] - x[i, m]) ** 2
                place = count
                while place > 0 and length < least[place - 1]:
                    if place < count:
                        least[place] = least[place - 1]
                    place -= 1
                if place < count:
                    least[place] = length
            limit = reach * reach * least[count - 1]
            for b in range(indptr[i], indptr[i + 1]):
                length = 0.0
                for m in range(dim):
                    length += (x[neighbours[b], m] - x[i, m]) ** 2
                taken[b] = length <= limit

    return near
