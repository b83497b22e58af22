"""Exchange of numbers between the two directions of bonds."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np

from pdpetsc.arrays import Float, GlobalIndex, twins
from pdpetsc.discrete.cloud import Cloud
from pdpetsc.discrete.communicator import exchange, owners
from pdpetsc.discrete.families import Families
from pdpetsc.kernels.sparsity import opposite_bonds


class OppositeBonds:
    """Find the direction ``ji`` of every bond ``ij``, on any rank.

    Parameters
    ----------
    cloud, families
        Particles and bonds.
    keys : callable
        Returns the keys of selected bonds (n, 3), equal for both directions of a bond and different for all others.

    Notes
    -----
    Construction and ``of`` are collective.
    """

    def __init__(self, cloud: Cloud, families: Families, keys: Callable[[GlobalIndex], GlobalIndex]) -> None:
        comm, n = cloud.comm, families.n_bonds
        self._comm = comm
        # A bond to the own mirror image has only one direction, which is its own opposite.
        self._partner = np.arange(n, dtype=np.int32 if n <= np.iinfo(np.int32).max else np.int64)
        opposite_bonds(families.indptr, families.neighbours, cloud.order, self._partner)
        rest = np.flatnonzero(self._partner == np.arange(n))  # to images, to other ranks, and from one end only
        owner, _ = owners(comm, cloud.first, cloud.row[families.neighbours[rest]])
        away, here = rest[owner != comm.rank], rest[owner == comm.rank]
        one, other = (here[rows] for rows in twins(keys(here)[:, ::-1]))
        self._partner[one], self._partner[other] = other, one
        (their_keys, theirs), counts = exchange(comm, owner[owner != comm.rank], [keys(away), away])
        both, number = np.unique(np.concatenate([keys(away), their_keys]), axis=0, return_inverse=True)
        number = number.reshape(-1)
        mine = np.full(len(both), -1, dtype=np.int64)
        mine[number[: len(away)]] = away
        bond = mine[number[len(away) :]]
        # Bonds that exist from one end only receive nothing.
        found = bond >= 0
        self._bond = bond[found]
        self._rank = np.repeat(np.arange(comm.size), counts)[found]
        self._there = theirs[found]
        mirrored = np.flatnonzero(families.neighbours >= cloud.n_owned) if len(cloud.sign) else np.empty(0, np.int64)
        self._mirrored, self._sign = mirrored, cloud.sign[families.neighbours[mirrored] - cloud.n_owned]

    def of(self, values: Float) -> Float:
        """Return the values of the opposite direction of every bond (n_bonds, ...), for ``values`` (n_bonds, ...).

        A bond that exists from one end only gets its own value.
        """
        found = values[self._partner]
        (there, theirs), _ = exchange(self._comm, self._rank, [self._there, values[self._bond]])
        found[there] = theirs
        return np.asarray(found)

    def of_vectors(self, values: Float) -> Float:
        """Return ``of`` vectors (n_bonds, dim), mirrored if the other end is behind a mirror plane."""
        found = self.of(np.asarray(values, dtype=float))
        found[self._mirrored] *= self._sign
        return found
