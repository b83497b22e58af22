"""Stress and moduli of materials with a stress-free deformation."""

from __future__ import annotations

from collections.abc import Callable
from functools import lru_cache
from typing import Any

import numpy as np

from pdpetsc.kernels.compile import compiled


@lru_cache
def pull_back_kernel(inside: int, shown: int) -> Callable[..., Any]:
    """Return ``pull_back(elastic, inverse, J, points, A)``: ``A_imkn = J (A_e)_iakb (F^-1)_ma (F^-1)_nb``.

    ``elastic`` (n, inside, inside, inside, inside), ``inverse`` (n, inside, inside) and ``J`` (n,) are those of the
    points of a material; the moduli of the body (shown, ...) are written to the rows ``points`` of ``A``.
    """

    @compiled
    def pull_back(elastic, inverse, J, points, A):
        half = np.empty((inside, shown))
        for row in range(points.size):
            p = points[row]
            for i in range(shown):
                for k in range(shown):
                    for a in range(inside):
                        for n in range(shown):
                            value = 0.0
                            for b in range(inside):
                                value += elastic[row, i, a, k, b] * inverse[row, n, b]
                            half[a, n] = value
                    for m in range(shown):
                        for n in range(shown):
                            value = 0.0
                            for a in range(inside):
                                value += inverse[row, m, a] * half[a, n]
                            A[p, i, m, k, n] = J[row] * value

    return pull_back


@lru_cache
def pull_back_stress_kernel(inside: int) -> Callable[..., Any]:
    """Return ``pull_back(elastic, inverse, J, P)``: ``P_im = J (P_e)_ia (F^-1)_ma`` at the points of a material."""

    @compiled
    def pull_back(elastic, inverse, J, P):
        for row in range(J.size):
            for i in range(inside):
                for m in range(inside):
                    value = 0.0
                    for a in range(inside):
                        value += elastic[row, i, a] * inverse[row, m, a]
                    P[row, i, m] = J[row] * value

    return pull_back
