"""Nearest neighbours within families."""

from __future__ import annotations

from collections.abc import Callable
from functools import lru_cache
from typing import Any

import numpy as np

from pdpetsc.kernels.compile import compiled


@lru_cache
def reach_kernel(dim: int, most: int) -> Callable[..., Any]:
    """Return ``reach(indptr, neighbours, kept, x, reach)``: the length of the ``most``-th shortest kept bond of each.

    For a family with fewer bonds it is the longest length, 0 without bonds.
    """

    @compiled
    def reach(indptr, neighbours, kept, x, reach):
        shortest = np.empty(most)
        for i in range(indptr.size - 1):
            count = 0
            for b in range(indptr[i], indptr[i + 1]):
                if not kept[b]:
                    continue
                j = neighbours[b]
                square = 0.0
                for m in range(dim):
                    square += (x[j, m] - x[i, m]) ** 2
                if count < most:
                    count += 1
                elif square >= shortest[most - 1]:
                    continue
                at = count - 1
                while at > 0 and shortest[at - 1] > square:
                    shortest[at] = shortest[at - 1]
                    at -= 1
                shortest[at] = square
            reach[i] = np.sqrt(shortest[count - 1]) if count else 0.0

    return reach


@lru_cache
def near_bonds_kernel(dim: int) -> Callable[..., Any]:
    """Return ``near(indptr, neighbours, kept, x, reach, near)``: marks bonds no longer than ``reach`` of an end."""

    @compiled
    def near(indptr, neighbours, kept, x, reach, near):
        for i in range(indptr.size - 1):
            for b in range(indptr[i], indptr[i + 1]):
                j = neighbours[b]
                square = 0.0
                for m in range(dim):
                    square += (x[j, m] - x[i, m]) ** 2
                limit = max(reach[i], reach[j])
                near[b] = kept[b] and square <= limit * limit

    return near
