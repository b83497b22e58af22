"""Index loops: families from pairs, transposed stencils, and sparsity of the tangent."""

from __future__ import annotations

from typing import Any

import numpy as np

from pdpetsc.kernels.compile import compiled


@compiled
def families_from_pairs(pairs, directed, order, n_owned):
    """Turn neighbour pairs into CSR families of the owned particles, each sorted by ``order``.

    Each particle of a pair is in the family of the other; if ``directed``, only the second in the family of the first.
    """
    sides = 1 if directed else 2
    indptr = np.zeros(n_owned + 1, np.int64)
    for r in range(pairs.shape[0]):
        for side in range(sides):
            if pairs[r, side] < n_owned:
                indptr[pairs[r, side] + 1] += 1
    for i in range(n_owned):
        indptr[i + 1] += indptr[i]
    fill = indptr[:-1].copy()
    neighbours = np.empty(indptr[n_owned], np.int32)
    for r in range(pairs.shape[0]):
        for side in range(sides):
            i = pairs[r, side]
            if i < n_owned:
                neighbours[fill[i]] = pairs[r, 1 - side]
                fill[i] += 1
    for i in range(n_owned):
        # Shell sort with decreasing gaps: families of a small cell can have 100,000 members.
        gap = 1
        while 9 * gap < indptr[i + 1] - indptr[i]:
            gap = 3 * gap + 1
        while gap > 0:
            for t in range(indptr[i] + gap, indptr[i + 1]):
                j = neighbours[t]
                s = t - gap
                while s >= indptr[i] and order[neighbours[s]] > order[j]:
                    neighbours[s + gap] = neighbours[s]
                    s -= gap
                neighbours[s + gap] = j
            gap //= 3
    return indptr, neighbours


@compiled
def transpose(point_ptr, members, n_local):
    """List, for every local particle, the entries of the operator that contain it and the points of these entries."""
    entry_ptr = np.zeros(n_local + 1, np.int64)
    for t in range(members.size):
        entry_ptr[members[t] + 1] += 1
    for k in range(n_local):
        entry_ptr[k + 1] += entry_ptr[k]
    fill = entry_ptr[:-1].copy()
    entries = np.empty(members.size, np.int64)
    entry_point = np.empty(members.size, np.int32)
    for p in range(point_ptr.size - 1):
        for t in range(point_ptr[p], point_ptr[p + 1]):
            e = fill[members[t]]
            fill[members[t]] += 1
            entries[e] = t
            entry_point[e] = p
    return entry_ptr, entries, entry_point


@compiled
def product_sparsity(entry_ptr, entry_point, point_ptr, members, rank_of):
    """Return the sparsity of ``G^T D G`` on local particles in CSR form, each row sorted by ``rank_of``."""
    n_local = entry_ptr.size - 1
    seen = np.full(n_local, -1, np.int64)
    row_ptr = np.zeros(n_local + 1, np.int64)
    for a in range(n_local):
        count = 0
        for e in range(entry_ptr[a], entry_ptr[a + 1]):
            p = entry_point[e]
            for s in range(point_ptr[p], point_ptr[p + 1]):
                if seen[members[s]] != a:
                    seen[members[s]] = a
                    count += 1
        row_ptr[a + 1] = row_ptr[a] + count
    columns = np.empty(row_ptr[n_local], np.int64)
    seen[:] = -1
    for a in range(n_local):
        c = row_ptr[a]
        for e in range(entry_ptr[a], entry_ptr[a + 1]):
            p = entry_point[e]
            for s in range(point_ptr[p], point_ptr[p + 1]):
                if seen[members[s]] != a:
                    seen[members[s]] = a
                    columns[c] = rank_of[members[s]]
                    c += 1
        columns[row_ptr[a] : c].sort()
    return row_ptr, columns


@compiled
def merge_rows(row_ptr, columns, extra_row, extra_ptr, extra_columns, n_rows, n_columns):
    """Return the sparsity whose row ``a`` is the union of row ``a`` and of all extra rows with ``extra_row == a``."""
    by_row = np.zeros(n_rows + 1, np.int64)
    for r in range(extra_row.size):
        by_row[extra_row[r] + 1] += 1
    for a in range(n_rows):
        by_row[a + 1] += by_row[a]
    fill = by_row[:-1].copy()
    order = np.empty(extra_row.size, np.int64)
    for r in range(extra_row.size):
        order[fill[extra_row[r]]] = r
        fill[extra_row[r]] += 1
    seen = np.full(n_columns, -1, np.int64)
    merged_ptr = np.zeros(n_rows + 1, np.int64)
    merged = np.empty(row_ptr[n_rows] + extra_columns.size, np.int64)
    count = 0
    for a in range(n_rows):
        begin = count
        for t in range(row_ptr[a], row_ptr[a + 1]):
            seen[columns[t]] = a
            merged[count] = columns[t]
            count += 1
        for o in range(by_row[a], by_row[a + 1]):
            r = order[o]
            for t in range(extra_ptr[r], extra_ptr[r + 1]):
                c = extra_columns[t]
                if seen[c] != a:
                    seen[c] = a
                    merged[count] = c
                    count += 1
        merged[begin:count].sort()
        merged_ptr[a + 1] = count
    return merged_ptr, merged[:count].copy()


@compiled
def scalar_rows(block_ptr, block_columns, dim, row_ptr, columns):
    """Expand a block sparsity into the scalar CSR rows of the same matrix."""
    row_ptr[0] = 0
    for a in range(block_ptr.size - 1):
        n = block_ptr[a + 1] - block_ptr[a]
        for i in range(dim):
            row = a * dim + i
            row_ptr[row + 1] = row_ptr[row] + n * dim
            for q in range(n):
                c = block_columns[block_ptr[a] + q]
                for k in range(dim):
                    columns[row_ptr[row] + q * dim + k] = c * dim + k


def sum_by(index: Any, values: Any, n: int) -> Any:
    """Return the sums of the rows of ``values`` with the same index, (n, ...)."""
    flat = values.reshape(len(values), int(np.prod(values.shape[1:])))
    sums = np.stack([np.bincount(index, column, n) for column in flat.T], axis=1)
    return sums.reshape(n, *values.shape[1:])


@compiled
def families_with_any(indptr, neighbours, marked, found):
    """Write a mask of families with a marked particle."""
    for i in range(indptr.size - 1):
        found[i] = False
        for b in range(indptr[i], indptr[i + 1]):
            if marked[neighbours[b]]:
                found[i] = True


@compiled
def opposite_bonds(indptr, neighbours, order, opposite):
    """Write the opposite direction of bonds of own particles (n_bonds,) that families sorted by ``order`` contain."""
    n_owned = indptr.size - 1
    for i in range(n_owned):
        for b in range(indptr[i], indptr[i + 1]):
            j = neighbours[b]
            if i < j < n_owned:
                low, high = indptr[j], indptr[j + 1]
                while low < high:
                    middle = (low + high) // 2
                    if order[neighbours[middle]] < order[i]:
                        low = middle + 1
                    else:
                        high = middle
                if low < indptr[j + 1] and neighbours[low] == i:
                    opposite[b] = low
                    opposite[low] = b


@compiled
def sums_of_families(indptr, values, sums):
    """Write the sums of values of bonds (n_bonds,) over each family."""
    for i in range(indptr.size - 1):
        value = 0.0
        for b in range(indptr[i], indptr[i + 1]):
            value += values[b]
        sums[i] = value


@compiled
def weights_of_bonds(neighbours, omega, volume, weight):
    """Write ``omega_ij V_j`` of every bond."""
    for b in range(neighbours.size):
        weight[b] = omega[b] * volume[neighbours[b]]


@compiled
def multiply_families(indptr, factor, values):
    """Multiply values of bonds (n_bonds,) by the factor of their family."""
    for i in range(indptr.size - 1):
        for b in range(indptr[i], indptr[i + 1]):
            values[b] *= factor[i]


@compiled
def nearest_neighbours(indptr, neighbours, x, nearest):
    """Reduce ``nearest`` (n_owned,) to the distance of the nearest member of each family."""
    for i in range(indptr.size - 1):
        for b in range(indptr[i], indptr[i + 1]):
            square = 0.0
            for m in range(x.shape[1]):
                square += (x[neighbours[b], m] - x[i, m]) ** 2
            nearest[i] = min(nearest[i], np.sqrt(square))


@compiled
def first_moments(indptr, neighbours, x, volume, moment, size):
    """Write ``sum_j V_j xi_a`` and ``sum_j V_j |xi_a|``, (n_owned, dim) each."""
    for i in range(indptr.size - 1):
        for a in range(x.shape[1]):
            moment[i, a] = 0.0
            size[i, a] = 0.0
            for b in range(indptr[i], indptr[i + 1]):
                j = neighbours[b]
                xi = x[j, a] - x[i, a]
                moment[i, a] += volume[j] * xi
                size[i, a] += volume[j] * abs(xi)
