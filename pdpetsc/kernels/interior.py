"""Loops over families for the search of the surface; members are the bonds within a reach of their first end."""

from __future__ import annotations

import numpy as np

from pdpetsc.kernels.compile import compiled


@compiled
def distance(i, j, x):
    """Return the distance of two particles."""
    square = 0.0
    for m in range(x.shape[1]):
        square += (x[j, m] - x[i, m]) ** 2
    return np.sqrt(square)


@compiled
def family_moments(indptr, neighbours, x, volume, reach, count, first, second):
    """Write the number of members, ``sum_j V_j xi`` and ``sum_j V_j xi (x) xi`` of each family."""
    dim = x.shape[1]
    for i in range(indptr.size - 1):
        count[i] = 0.0
        first[i] = 0.0
        second[i] = 0.0
        for b in range(indptr[i], indptr[i + 1]):
            j = neighbours[b]
            if distance(i, j, x) <= reach[i]:
                count[i] += 1.0
                for m in range(dim):
                    moment = volume[j] * (x[j, m] - x[i, m])
                    first[i, m] += moment
                    for n in range(dim):
                        second[i, m, n] += moment * (x[j, n] - x[i, n])


@compiled
def largest_of_members(indptr, neighbours, x, reach, values, largest):
    """Increase ``largest`` (n_owned,) to the largest value (n_local,) of the members of each family."""
    for i in range(indptr.size - 1):
        for b in range(indptr[i], indptr[i + 1]):
            j = neighbours[b]
            if values[j] > largest[i] and distance(i, j, x) <= reach[i]:
                largest[i] = values[j]


@compiled
def lacks_members(indptr, neighbours, x, reach, direction, beside, lacks):
    """Write whether no member is further than ``beside`` along a direction of each particle (n_owned, dim)."""
    for i in range(indptr.size - 1):
        lacks[i] = beside[i] > 0.0
        for b in range(indptr[i], indptr[i + 1]):
            j, along = neighbours[b], 0.0
            for m in range(x.shape[1]):
                along += (x[j, m] - x[i, m]) * direction[i, m]
            if along >= beside[i] and distance(i, j, x) <= reach[i]:
                lacks[i] = False
                break


@compiled
def marked_within(indptr, neighbours, x, reach, marked, found):
    """Write whether a marked member (n_local,) is within the reach of each particle."""
    for i in range(indptr.size - 1):
        found[i] = False
        for b in range(indptr[i], indptr[i + 1]):
            j = neighbours[b]
            if marked[j] > 0.0 and distance(i, j, x) <= reach[i]:
                found[i] = True
                break
