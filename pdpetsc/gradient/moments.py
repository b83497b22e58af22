"""Weights of the bonds of a family from conditions on their polynomial moments."""

from __future__ import annotations

import itertools
from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np

from pdpetsc.arrays import Float, GlobalIndex, row_of_entries
from pdpetsc.discrete.cloud import Cloud
from pdpetsc.discrete.communicator import largest

# Eigenvalues of a moment matrix, scaled by the horizon, below this share of the largest count as zero.
RANK = 1e-10
# Relative tolerance of a condition on a moment.
MET = 1e-8
# Largest ``horizon sum_k |g_k|`` [-] of accepted weights. Larger weights nearly cancel, as in a family with hardly more
# bonds than conditions.
GAIN = 20.0
# Monomials of higher degrees are indistinguishable in double precision, and their moment matrices are too expensive.
MOST_ORDER = 12
# Largest number of entries of moment matrices in memory at once.
BLOCK = 2**22


@dataclass(frozen=True)
class Conditions:
    """Conditions on the weights of a family, ``sum_k weight_k C_k q(xi_k) = target``.

    Attributes
    ----------
    exponents : (n_basis, dim) int64
        Monomials q, in powers of ``xi / horizon``.
    """

    exponents: GlobalIndex

    @classmethod
    def of_degrees(cls, dim: int, lowest: int, highest: int) -> Conditions:
        """Return all monomials of degrees ``lowest`` to ``highest``, lowest first."""
        powers = itertools.product(range(highest + 1), repeat=dim)
        kept = sorted((p for p in powers if lowest <= sum(p) <= highest), key=lambda p: (sum(p), [-n for n in p]))
        return cls(np.array(kept, dtype=np.int64).reshape(-1, dim))

    def values(self, xi: Float) -> Float:
        """Return q at scaled bonds (n, dim), (n, n_basis)."""
        return np.asarray(np.prod(xi[:, None, :] ** self.exponents[None], axis=2))


def blocks(
    indptr: GlobalIndex, chosen: GlobalIndex, width: int
) -> Iterator[tuple[GlobalIndex, GlobalIndex, GlobalIndex, GlobalIndex]]:
    """Yield chosen families in blocks: numbers, bonds, start of each family in the bonds, family of each bond."""
    size = np.diff(indptr)[chosen]
    start = 0
    while start < len(chosen):
        stop = start + max(1, int(np.searchsorted(np.cumsum(size[start:]) * width**2, BLOCK)))
        part = chosen[start:stop]
        first = np.zeros(len(part) + 1, dtype=np.int64)
        np.cumsum(size[start:stop], out=first[1:])
        bonds = np.arange(first[-1]) + np.repeat(indptr[part] - first[:-1], size[start:stop])
        owner = row_of_entries(first)
        yield part, np.asarray(bonds, dtype=np.int64), first[:-1], owner
        start = stop


def solve(q: Float, weight: Float, first: GlobalIndex, target: Float) -> tuple[Float, Float, Float]:
    """Compute the coefficients c of ``C_k = c . q_k`` that meet the targets with the smallest weighted norm.

    Parameters
    ----------
    q : (n_bonds, n_basis) float64
        Monomials.
    weight : (n_bonds,) float64
        Positive weights.
    first : (n,) int
        Start of each family; no family is empty.
    target : (n, n_basis, m) float64
        Right hand sides.

    Returns
    -------
    c : (n, n_basis, m) float64
    unmet : (n,) float64
        Largest violation of a condition, as a share of the largest target.
    condition : (n,) float64
        Largest over smallest kept eigenvalue of the moment matrix ``sum_k weight_k q_k (x) q_k``.
    """
    M = np.add.reduceat(weight[:, None, None] * q[:, :, None] * q[:, None, :], first, axis=0)
    values, vectors = np.linalg.eigh(M)
    kept = values > RANK * values[:, -1:]
    inverse = np.where(kept, 1.0 / np.where(kept, values, 1.0), 0.0)
    c = vectors @ (inverse[:, :, None] * (np.swapaxes(vectors, 1, 2) @ target))
    violation = np.abs(M @ c - target).max(axis=(1, 2))
    size = np.maximum(np.abs(target).max(axis=(1, 2)), np.finfo(float).tiny)
    lowest = np.where(kept, values, np.inf).min(axis=1)
    return c, violation / size, values[:, -1] / lowest


def conditioning_note(cloud: Cloud, worst: float, lowered: Float) -> str:
    """Return the log note on the largest condition number and the number of lowered orders (collective)."""
    note = f"moment matrices have condition numbers up to {largest(cloud.comm, worst):.1e}"
    steps = cloud.counted(lowered)
    return f"{note}; the order was lowered {steps} times where families are too small for it" if steps else note


def largest_gain(g: Float, first: GlobalIndex, reach: Float) -> Float:
    """Return ``reach sum_k |g_k|`` of families with horizons (n,) for the weights of their bonds (n_bonds, dim)."""
    return np.asarray(np.add.reduceat(np.linalg.norm(g, axis=1), first) * reach)
