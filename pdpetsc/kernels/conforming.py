"""Residuals of linear fits to values on the members of points."""

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
    def moments(point_ptr, members, x, size, M):
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
def remainder_kernel(dim: int, columns: int, gathered: int) -> Callable[..., Any]:
    """Return ``rest(point_ptr, members, x, size, inverse, factor, values, out)``: residuals of the linear fit.

    ``e_pk = factor_p (v_k - phi_k . M_p^-1 sum_l phi_l v_l)`` for ``columns`` numbers per particle, added to the entry
    ``pk`` of ``out``, or to its particle ``k`` if ``gathered`` is 1.
    """
    width = dim + 1
    # The values may be far larger than the residuals, to which a single fit leaves their round-off.
    fits = 1 if gathered else 2

    @compiled
    def rest(point_ptr, members, x, size, inverse, factor, values, out):
        largest = 0
        for p in range(point_ptr.size - 1):
            largest = max(largest, point_ptr[p + 1] - point_ptr[p])
        phi, left = np.empty((largest, width)), np.empty((largest, columns))
        b, c = np.empty((width, columns)), np.empty((width, columns))
        phi[:, 0] = 1.0
        for p in range(point_ptr.size - 1):
            first, count = point_ptr[p], point_ptr[p + 1] - point_ptr[p]
            i = members[first]
            for t in range(count):
                k = members[first + t]
                for m in range(dim):
                    phi[t, m + 1] = (x[k, m] - x[i, m]) / size[p]
                for n in range(columns):
                    # The fit removes the value of the centre, and with it most of the round-off.
                    left[t, n] = values[k, n] - values[i, n]
            for _ in range(fits):
                b[:] = 0.0
                for t in range(count):
                    for a in range(width):
                        for n in range(columns):
                            b[a, n] += phi[t, a] * left[t, n]
                for a in range(width):
                    for n in range(columns):
                        c[a, n] = 0.0
                        for d in range(width):
                            c[a, n] += inverse[p, a, d] * b[d, n]
                for t in range(count):
                    for n in range(columns):
                        for a in range(width):
                            left[t, n] -= phi[t, a] * c[a, n]
            for t in range(count):
                row = members[first + t] if gathered else first + t
                for n in range(columns):
                    out[row, n] += factor[p] * left[t, n]

    return rest
