"""Families: the neighbours of every owned particle within its horizon."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property

import numpy as np
from scipy.spatial import cKDTree

from pdpetsc.arrays import Float, GlobalIndex, LocalIndex, Mask
from pdpetsc.declare.cracks import Crack
from pdpetsc.discrete.cloud import COINCIDENT, HORIZON_TOLERANCE, Cloud, by_reach
from pdpetsc.discrete.communicator import agreed, total
from pdpetsc.errors import CaseError
from pdpetsc.kernels.sparsity import families_from_pairs


@dataclass(frozen=True)
class Families:
    """Bonds of the owned particles in CSR form, each family in an order that no partition changes.

    Attributes
    ----------
    indptr : (n_owned + 1,) int64
        Where each family starts.
    neighbours : (n_bonds,) int32
        Local index of ``j``.
    """

    indptr: GlobalIndex
    neighbours: LocalIndex

    @cached_property
    def centres(self) -> LocalIndex:
        """Return the local index of ``i`` for every bond."""
        return np.repeat(np.arange(len(self.indptr) - 1, dtype=np.int32), np.diff(self.indptr))

    @cached_property
    def everyone(self) -> LocalIndex:
        """Return the own particles (n_owned,)."""
        return np.arange(len(self.indptr) - 1, dtype=np.int32)

    def bonds(self, x: Float) -> Float:
        """Return ``xi = x_j - x_i`` (n_bonds, dim) [length]."""
        return np.asarray(x[self.neighbours] - x[self.centres])


def find_families(cloud: Cloud, cracks: Sequence[Crack] = ()) -> Families:
    """Find the neighbours of every own particle within its horizon, where no crack separates them.

    Where the horizon differs from particle to particle ``j`` is in the family of ``i`` if ``|xi| <= reach_i``; where
    bonds are mutual if that or ``|xi| <= reach_j``.

    Parameters
    ----------
    cloud : Cloud
        Particles of this rank with their ghosts.
    cracks : sequence of Crack
        What cuts bonds from the start; their images in a periodic cell and behind mirror planes do too.

    Returns
    -------
    Families

    Raises
    ------
    CaseError
        Two particles coincide, or a crack has another dimension or cuts nothing.

    Notes
    -----
    Collective (the check); the search itself is local.
    """
    pairs = _pairs(cloud)
    pairs = pairs[~_cut(cloud, pairs, cracks)]
    directed = cloud.varies and not cloud.mutual
    indptr, neighbours = families_from_pairs(pairs, directed, cloud.order, cloud.n_owned)
    families = Families(indptr, neighbours)
    with agreed(cloud.comm):
        length = np.linalg.norm(cloud.x[pairs[:, 0]] - cloud.x[pairs[:, 1]], axis=1)
        close = np.flatnonzero(length < COINCIDENT * cloud.reach[pairs].min(axis=1))
        if len(close):
            one, two = sorted(int(gid) for gid in cloud.gid[pairs[close[0]]])
            raise CaseError(
                f"Particles {one} and {two} coincide ({len(close)} such pairs on one rank); remove one of each pair."
            )
    return families


def reached_back(cloud: Cloud, families: Families, length: Float) -> Mask:
    """Return which bonds of ``length`` (n_bonds,) [length] exist from their second end too (n_bonds,)."""
    if cloud.mutual or not cloud.varies:
        return np.ones(len(length), dtype=bool)
    return np.asarray(length <= cloud.reach[families.neighbours] * (1.0 + HORIZON_TOLERANCE))


def _pairs(cloud: Cloud) -> LocalIndex:
    """Return the pairs with a bond and an own end (n, 2); of bonds from one end that one is first."""
    if not cloud.varies:
        pairs = cKDTree(cloud.x).query_pairs(cloud.horizon * (1.0 + HORIZON_TOLERANCE), output_type="ndarray")
        return np.asarray(pairs[(pairs < cloud.n_owned).any(axis=1)])
    n = cloud.n_local if cloud.mutual else cloud.n_owned
    every, found = cKDTree(cloud.x), [np.empty((0, 2), dtype=np.int64)]
    for members in by_reach(cloud.reach[:n]):
        radius = float(cloud.reach[members].max()) * (1.0 + HORIZON_TOLERANCE)
        near = cKDTree(cloud.x[members]).sparse_distance_matrix(every, radius, output_type="ndarray")
        centre, other = members[near["i"]], near["j"]
        kept = (centre != other) & (near["v"] <= cloud.reach[centre] * (1.0 + HORIZON_TOLERANCE))
        found.append(np.stack([centre[kept], other[kept]], axis=1))
    pairs = np.concatenate(found)
    if cloud.mutual:
        pairs = pairs[(pairs < cloud.n_owned).any(axis=1)]
        once = np.unique(pairs.min(axis=1) * np.int64(n) + pairs.max(axis=1))
        pairs = np.stack(np.divmod(once, n), axis=1)
    return np.asarray(pairs)


def _cut(cloud: Cloud, pairs: LocalIndex, cracks: Sequence[Crack]) -> Mask:
    """Return which pairs a crack separates (n_pairs,) (collective)."""
    cut = np.zeros(len(pairs), dtype=bool)
    a, b = cloud.x[pairs[:, 0]], cloud.x[pairs[:, 1]]
    home = np.zeros_like(cloud.x)
    if cloud.images is not None:
        home[cloud.n_owned :] = cloud.offset
    for number, crack in enumerate(cracks):
        with agreed(cloud.comm):
            separated = np.zeros(len(pairs), dtype=bool)
            for sign, to in zip(*cloud.places.mirrors, strict=True):
                separated |= crack.cuts(sign * a + to, sign * b + to)
                for end in (0, 1) if cloud.images is not None else ():
                    shift = home[pairs[:, end]]
                    separated |= crack.cuts(sign * (a - shift) + to, sign * (b - shift) + to)
        if int(total(cloud.comm, np.count_nonzero(separated))) == 0:
            raise CaseError(f"Crack {number + 1} cuts no bond: {crack}.")
        cut |= separated
    return cut
