"""Array aliases. Local indices are int32, global ones and CSR offsets int64."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any, TypeAlias

import numpy as np
from numpy.typing import NDArray

Float: TypeAlias = NDArray[np.float64]
Complex: TypeAlias = NDArray[np.complex128]
LocalIndex: TypeAlias = NDArray[np.int32]
GlobalIndex: TypeAlias = NDArray[np.int64]
Mask: TypeAlias = NDArray[np.bool_]


def twins(key: GlobalIndex) -> tuple[GlobalIndex, GlobalIndex]:
    """Return the rows of each pair of equal rows of ``key`` (n, k), of which no three are equal."""
    order = np.lexsort(key.T)
    same = np.flatnonzero((key[order[1:]] == key[order[:-1]]).all(axis=1))
    return order[same], order[same + 1]


class Lookup:
    """Find numbers among known ones.

    Parameters
    ----------
    known : (n,) int
        The known numbers.
    """

    def __init__(self, known: GlobalIndex) -> None:
        self._order = np.argsort(known, kind="stable")
        self._ascending = known[self._order]

    def of(self, sought: GlobalIndex) -> GlobalIndex:
        """Return the first place of each number among the known ones, -1 for unknown numbers."""
        if not len(self._ascending):
            return np.full(np.shape(sought), -1, dtype=np.int64)
        place = np.minimum(np.searchsorted(self._ascending, sought), len(self._ascending) - 1)
        return np.where(self._ascending[place] == sought, self._order[place], -1)


def starts_of(counts: NDArray[Any] | Sequence[int]) -> GlobalIndex:
    """Return where the entries of each row of a CSR structure begin (n + 1,), for the count of each row (n,)."""
    return np.concatenate([[0], np.cumsum(counts)]).astype(np.int64, copy=False)


def row_of_entries(ptr: GlobalIndex) -> GlobalIndex:
    """Return the row of every entry of a CSR structure (n_entries,)."""
    return np.repeat(np.arange(len(ptr) - 1), np.diff(ptr))


def entries_of(ptr: GlobalIndex, rows: GlobalIndex | LocalIndex) -> tuple[GlobalIndex, GlobalIndex]:
    """Return the entries of some rows of a CSR structure (n_entries,), and where those of each row begin (n + 1,)."""
    size: GlobalIndex = np.diff(ptr)[rows]
    first = starts_of(size)
    within: GlobalIndex = np.arange(first[-1])
    return np.repeat(ptr[rows] - first[:-1], size) + within, first


def irregular(gid: GlobalIndex, dim: int) -> Float:
    """Return numbers between -1 and 1 (n, dim) without order, which belong to particles and not to ranks."""
    return np.asarray(np.sin(1.0 + 12.9898 * gid[:, None].astype(float) + 78.233 * np.arange(dim)))
