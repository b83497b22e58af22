"""Bonds as pairs of particles: both directions of a bond together, on every rank that holds either."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TypeAlias

import numpy as np

from pdpetsc.arrays import Float, GlobalIndex, LocalIndex, Mask
from pdpetsc.discrete.cloud import Cloud
from pdpetsc.discrete.communicator import exchange, owners
from pdpetsc.errors import CaseError
from pdpetsc.kernels.bonds import first_failure, first_of_tied, pair_elongation_kernel
from pdpetsc.terms.bond_forces import BondForces

# Name of a bond, identical on every rank: ids of both ends, and the relative place of the second end.
Key: TypeAlias = tuple[int, int, int]


@dataclass(frozen=True)
class Pairs:
    """Store the bonds of own particles, in an order that does not depend on the partition.

    Attributes
    ----------
    keys : (n, 3) int64
        Name of each bond, identical on every rank.
    bonds : (n, 2) int64
        Bonds of the pair from either end; the same bond twice if the other end is on another rank.
    ends : (n, 2) int32
        Local particles of each pair.
    n : (n, dim) float64
        Direction of the pair, from the first end to the second.
    k : (n,) float64
        Stiffness from both ends [force / length].
    limit : (n,) float64
        Elongation of first failure [length].
    final : (n,) float64
        Driving variable at zero force, 1 for a bond that snaps or does not fail [-].
    order : (n,) float64
        Order in which equal bonds fail. It follows from the positions of both ends in units of the horizon, not from
        the numbers of the particles [-].
    reported : (n,) bool
        Whether this rank reports the pair to the others; exactly one rank does.
    """

    keys: GlobalIndex
    bonds: GlobalIndex
    ends: LocalIndex
    n: Float
    k: Float
    limit: Float
    final: Float
    order: Float
    reported: Mask

    def elongation(self, u_local: Float) -> Float:
        """Compute the elongation of every pair (n,) [length] for displacements with ghosts (n_local, dim)."""
        e = np.empty(len(self.k))
        pair_elongation_kernel(u_local.shape[1])(self.ends, self.n, u_local, e)
        return e

    def local(self, key: Key) -> int:
        """Return the local number of a pair, -1 if it is not on this rank."""
        span = np.searchsorted(self.keys[:, 0], key[0]), np.searchsorted(self.keys[:, 0], key[0], side="right")
        found = np.flatnonzero((self.keys[span[0] : span[1], 1:] == key[1:]).all(axis=1))
        return int(span[0] + found[0]) if len(found) else -1


def make_pairs(term: BondForces) -> Pairs:
    """Build the pairs of a body whose bonds can fail (collective)."""
    cloud, families = term.body.cloud, term.body.families
    if term.damage is None:
        raise CaseError("This body has no bonds that fail.")
    if term.a is not None:
        raise CaseError("The event-driven solver takes bonds without dilatation: BondBased, or Newton for LinearSolid.")
    failure, limit = term.damage.bonds, term.damage.limit
    of_bonds = failure.of.keys()
    keys, first, of_bond = np.unique(of_bonds, axis=0, return_index=True, return_inverse=True)
    of_bond = of_bond.reshape(-1)
    k = np.bincount(of_bond, term.k, len(keys))
    # The owner of the ghost holds the other direction of a bond that leaves the rank.
    outward = np.flatnonzero(families.neighbours >= cloud.n_owned)
    owner, _ = owners(cloud.comm, cloud.first, cloud.row[families.neighbours[outward]])
    leaving = outward[owner != cloud.comm.rank]
    (their_keys, their_k), _ = exchange(
        cloud.comm, owner[owner != cloud.comm.rank], [of_bonds[leaving], term.k[leaving]]
    )
    if len(their_keys):
        together, index = np.unique(np.concatenate([keys, their_keys]), axis=0, return_inverse=True)
        index = index.reshape(-1)
        sums = np.bincount(index, np.concatenate([k, their_k]), len(together))
        k = sums[index[: len(keys)]]
    centre_first = cloud.gid[families.centres] == of_bonds[:, 0]
    reported = np.zeros(len(keys), dtype=bool)
    reported[of_bond[centre_first]] = True
    ends = np.stack([families.centres[first], families.neighbours[first]], axis=1)
    xi = cloud.x[ends[:, 1]] - cloud.x[ends[:, 0]]
    n = xi / np.linalg.norm(xi, axis=1)[:, None]
    last = np.empty(len(keys), dtype=np.int64)
    last[of_bond] = np.arange(len(of_bond))
    stiffness: Float = np.asarray(k, dtype=float)
    order = _by_place(cloud, ends, xi)
    final = failure.laws.final()[first]
    final[np.isinf(final)] = 1.0
    return Pairs(keys, np.stack([first, last], axis=1), ends, n, stiffness, limit[first], final, order, reported)


def _by_place(cloud: Cloud, ends: LocalIndex, xi: Float) -> Float:
    """Compute a number for every pair that is equal from both ends and differs between positions."""
    # On a line of irrational slope no two nodes of a lattice have the same projection.
    line = np.array([1.0, np.sqrt(2.0), np.sqrt(5.0)])[: cloud.dim] / cloud.horizon
    first, second = (cloud.places.at_home(cloud.place[end], cloud.x[end]) @ line for end in ends.T)
    return np.asarray(first + second + np.sqrt(3.0) * (first - second) ** 2 + np.abs(xi @ line))


def rehearse_pairs(bonds: BondForces) -> None:
    """Compile or load the kernels between events (collective on the ranks of the body)."""
    pairs = make_pairs(bonds)
    e = pairs.elongation(np.zeros_like(bonds.body.cloud.x))
    able = np.ones(len(e), dtype=bool)
    first_failure(e, e, pairs.limit, able)
    first_of_tied(e, e, pairs.limit, able, 0.0, 0.0, pairs.order)
