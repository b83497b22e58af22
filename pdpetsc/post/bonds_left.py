"""The state of bonds between particles: intact, damaged, broken, or cut by a pre-crack."""

from __future__ import annotations

import numpy as np
import scipy

from pdpetsc.arrays import Float, GlobalIndex, Mask, entries_of
from pdpetsc.discrete.cloud import HORIZON_TOLERANCE
from pdpetsc.post.solution import Solution


def pairs_of(solution: Solution, zone: GlobalIndex) -> tuple[GlobalIndex, Float, Mask]:
    """Return pairs of owned particles with those of their body in their local horizon, and the state of their bonds.

    Parameters
    ----------
    solution : Solution
        A state.
    zone : (n,) int64
        Owned particles.

    Returns
    -------
    pairs : (n_pairs, 2) int64
        A particle of the zone, and a local one of its body within its local horizon.
    left : (n_pairs,) float64
        Degradation factor of the bond [-]: 1 intact, 0 broken or cut by a pre-crack.
    bonded : (n_pairs,) bool
        True for pairs with a bond at the start; pre-cracks have cut the others.

    Notes
    -----
    Not collective.
    """
    cloud = solution.cloud
    if not len(zone):
        return np.empty((0, 2), dtype=np.int64), np.empty(0), np.empty(0, dtype=bool)
    own, reach = cloud.x[zone], cloud.local_horizon[zone]
    widest = float(reach.max()) * (1.0 + HORIZON_TOLERANCE)
    low, high = own.min(axis=0) - widest, own.max(axis=0) + widest
    around = np.flatnonzero(np.all((cloud.x >= low) & (cloud.x <= high), axis=1))
    found = scipy.spatial.cKDTree(own).sparse_distance_matrix(
        scipy.spatial.cKDTree(cloud.x[around]), widest, output_type="ndarray"
    )
    i, j = zone[found["i"]], around[found["j"]]
    near = (i != j) & (found["v"] <= cloud.local_horizon[i] * (1.0 + HORIZON_TOLERANCE))
    if cloud.body is not None:
        near &= cloud.body[i] == cloud.body[j]
    pairs = np.stack([i[near], j[near]], axis=1)
    centres, neighbours, phi = _bonds_of(solution, zone)
    key = pairs[:, 0] * np.int64(cloud.n_local) + pairs[:, 1]
    bonded = centres * np.int64(cloud.n_local) + neighbours
    left, same = np.zeros(len(key)), np.zeros(len(key), dtype=bool)
    _, pair, bond = np.intersect1d(key, bonded, assume_unique=True, return_indices=True)
    left[pair], same[pair] = phi[bond], True
    return pairs, left, same


def _bonds_of(solution: Solution, zone: GlobalIndex) -> tuple[GlobalIndex, GlobalIndex, Float]:
    """Return both ends of the bonds of owned particles, and their degradation factors (n,) [-]."""
    families, damage = solution.problem.body.families, solution.problem.bond_damage
    lattice = families.lattice
    if lattice is not None:
        indptr, neighbours = lattice.families(zone.astype(np.int32))
        return np.repeat(zone, np.diff(indptr)), neighbours.astype(np.int64), np.ones(len(neighbours))
    bonds, first = entries_of(families.indptr, zone)
    phi = np.ones(len(bonds)) if damage is None else damage.bonds.phi[bonds]
    return np.repeat(zone, np.diff(first)), families.neighbours[bonds].astype(np.int64), phi
