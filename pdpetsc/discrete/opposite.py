"""Exchange of numbers between the two directions of bonds."""

from __future__ import annotations

import numpy as np

from pdpetsc.arrays import Float, GlobalIndex, twins
from pdpetsc.discrete.cloud import Cloud
from pdpetsc.discrete.communicator import exchange, owners
from pdpetsc.discrete.families import Families


class OppositeBonds:
    """Find the direction ``ji`` of every bond ``ij``, on any rank.

    Parameters
    ----------
    cloud, families
        Particles and bonds.
    keys : (n_bonds, 3) int64
        Keys, equal for both directions of a bond and different for all other bonds.

    Notes
    -----
    Construction and ``of`` are collective.
    """

    def __init__(self, cloud: Cloud, families: Families, keys: GlobalIndex) -> None:
        comm = cloud.comm
        self._comm, self._n = comm, len(keys)
        owner, _ = owners(comm, cloud.first, cloud.row[families.neighbours])
        away = np.flatnonzero(owner != comm.rank)
        here = np.flatnonzero(owner == comm.rank)
        # A bond to the own mirror image has only one direction, which is its own opposite.
        self._partner = np.arange(self._n)
        one, other = (here[rows] for rows in twins(keys[here][:, ::-1]))
        self._partner[one], self._partner[other] = other, one
        (their_keys, theirs), counts = exchange(comm, owner[away], [keys[away], away])
        both, number = np.unique(np.concatenate([keys[away], their_keys]), axis=0, return_inverse=True)
        number = number.reshape(-1)
        mine = np.full(len(both), -1, dtype=np.int64)
        mine[number[: len(away)]] = away
        bond = mine[number[len(away) :]]
        # Bonds that exist from one end only receive nothing.
        found = bond >= 0
        self._bond = bond[found]
        self._rank = np.repeat(np.arange(comm.size), counts)[found]
        self._there = theirs[found]
        sign = np.ones((self._n, cloud.dim))
        if len(cloud.sign):
            ghost = families.neighbours >= cloud.n_owned
            sign[ghost] = cloud.sign[families.neighbours[ghost] - cloud.n_owned]
        self._sign = sign

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
        return np.asarray(self._sign * self.of(values))
