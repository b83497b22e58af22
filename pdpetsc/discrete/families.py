"""Families: the neighbours of every owned particle within its horizon."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property

import numpy as np
import scipy

from pdpetsc.arrays import Float, GlobalIndex, LocalIndex, Mask, starts_of
from pdpetsc.declare.cracks import Crack
from pdpetsc.discrete.cloud import COINCIDENT, HORIZON_TOLERANCE, Cloud, by_reach
from pdpetsc.discrete.communicator import agreed, anywhere, total
from pdpetsc.discrete.crack_images import images_of_cloud
from pdpetsc.discrete.lattice_stencils import Grid, LatticeStencils, find_grid, find_lattice, listed_families
from pdpetsc.errors import CaseError
from pdpetsc.kernels.bonds import lengths_kernel
from pdpetsc.kernels.sparsity import (
    families_from_pairs,
    families_with_any,
    multiply_families,
    sums_of_families,
    weights_of_bonds,
)


@dataclass(frozen=True)
class Families:
    """Store the bonds of the owned particles in CSR form; the order of a family does not depend on the partition.

    Attributes
    ----------
    indptr : (n_owned + 1,) int64
        Start of each family.
    neighbours : (n_bonds,) int32
        Local index of ``j``.
    grid : Grid or None
        Lattice of the particles; None if they are on none, or the families are not all within one horizon.
    """

    indptr: GlobalIndex
    neighbours: LocalIndex
    grid: Grid | None = None

    @property
    def n_bonds(self) -> int:
        """Return the number of bonds of the own particles."""
        return len(self.neighbours)

    def with_any(self, marked: Mask) -> Mask:
        """Return which own particles have a marked member in their family (n_owned,), for marks (n_local,)."""
        found = np.empty(len(self.indptr) - 1, dtype=bool)
        families_with_any(self.indptr, self.neighbours, marked, found)
        return found

    @property
    def connecting(self) -> Families:
        """Return families with the same connectivity as all bonds: these, or smaller ones."""
        return self

    @property
    def lattice(self) -> LatticeStencils | None:
        """Return the lattice stencils of own particles with a shared family; None if each has its own."""
        return None

    @cached_property
    def centres(self) -> LocalIndex:
        """Return the local index of ``i`` for every bond."""
        return np.repeat(np.arange(len(self.indptr) - 1, dtype=np.int32), np.diff(self.indptr))

    @cached_property
    def everyone(self) -> LocalIndex:
        """Return the own particles (n_owned,)."""
        return np.arange(len(self.indptr) - 1, dtype=np.int32)

    def chosen(self, kept: Mask) -> Families:
        """Return families with the chosen bonds (n_bonds,) only."""
        before = starts_of(kept)
        return Families(before[self.indptr], self.neighbours[kept])

    def bonds(self, x: Float) -> Float:
        """Return ``xi = x_j - x_i`` (n_bonds, dim) [length]."""
        return np.asarray(x[self.neighbours] - x[self.centres])

    def lengths(self, x: Float) -> Float:
        """Return the length of every bond (n_bonds,) [length] as a new array."""
        found = np.empty(len(self.neighbours))
        lengths_kernel(x.shape[1])(self.indptr, self.neighbours, x, found)
        return found

    def lengths_of(self, x: Float, bonds: GlobalIndex) -> Float:
        """Return the length of selected bonds (n,) [length]."""
        one, other, square = self.centres[bonds], self.neighbours[bonds], np.zeros(len(bonds))
        for of_axis in x.T:
            square += (of_axis[other] - of_axis[one]) ** 2
        return np.sqrt(square)

    def weights(self, omega: Float, volume: Float) -> Float:
        """Return ``omega_ij V_j`` of every bond (n_bonds,) [volume] as a new array, for volumes (n_local,)."""
        found = np.empty(len(self.neighbours))
        weights_of_bonds(self.neighbours, omega, volume, found)
        return found

    def sums(self, values: Float | Mask) -> Float:
        """Return the sums of values of bonds (n_bonds,) over the family of each own particle (n_owned,)."""
        found = np.empty(len(self.indptr) - 1)
        sums_of_families(self.indptr, values, found)
        return found

    def multiply(self, values: Float, factor: Float) -> None:
        """Multiply values of bonds (n_bonds,) by a factor of the family of each own particle (n_owned,)."""
        multiply_families(self.indptr, factor, values)

    def reach(self, x: Float) -> Float:
        """Compute the length of the longest bond of every own particle (n_owned,), 0 for a particle without bonds."""
        length = self.lengths(x)
        longest = np.zeros(len(self.indptr) - 1)
        np.maximum.at(longest, self.centres, length)
        return longest


def with_pairs(families: Families, kept: Mask, pairs: LocalIndex) -> tuple[Families, Mask]:
    """Return families with further pairs (n, 2) as bonds, and which bonds are kept (n_bonds,), also the further ones.

    No marks stand for bonds that are all kept.
    """
    if not len(pairs):
        return families, kept
    centres = np.concatenate([families.centres, pairs[:, 0]])
    order = np.argsort(centres, kind="stable")
    count = np.bincount(centres, minlength=len(families.indptr) - 1)
    indptr = starts_of(count)
    neighbours = np.concatenate([families.neighbours, pairs[:, 1]])[order].astype(np.int32)
    if len(kept):
        kept = np.concatenate([kept, np.ones(len(pairs), dtype=bool)])[order]
    return Families(indptr, neighbours), kept


class LatticeFamilies(Families):
    """Represent families of a body on a lattice, most of which share their steps; bonds are listed on first use.

    Parameters
    ----------
    lattice : LatticeStencils
        Own particles that share one family.
    """

    def __init__(self, lattice: LatticeStencils) -> None:
        self.__dict__["_lattice"] = lattice

    @property
    def n_bonds(self) -> int:
        """Return the number of bonds without listing them."""
        return self._of.n_bonds

    def with_any(self, marked: Mask) -> Mask:
        """Return which own particles have a marked member in their family, without listing the bonds."""
        return self._of.with_any(marked)

    @property
    def connecting(self) -> Families:
        """Return irregular families, and of the others the bonds along the axes of the lattice.

        A member that steps along the axes reach from the centre within the family is connected through other members.
        """
        centres, members = self._of.connecting()
        order = np.argsort(centres, kind="stable")
        count = np.bincount(centres, minlength=self._of.cloud.n_owned)
        return Families(starts_of(count), members[order])

    @property
    def lattice(self) -> LatticeStencils:
        """Return the lattice stencils of own particles with a shared family."""
        return self._of

    def reach(self, x: Float) -> Float:
        """Compute the length of the longest bond of every own particle without listing the bonds."""
        irregular = self._of.irregular
        alike = Families(irregular.indptr, irregular.neighbours).reach(x[irregular.local])
        return np.asarray(alike[self._of.represented_by])

    @cached_property
    def everyone(self) -> LocalIndex:
        """Return the own particles (n_owned,)."""
        return self._of.everyone

    @cached_property
    def indptr(self) -> GlobalIndex:
        """Return the start of each family."""
        return self._listed[0]

    @cached_property
    def neighbours(self) -> LocalIndex:
        """Return the local index of ``j`` of every bond."""
        return self._listed[1]

    @cached_property
    def _listed(self) -> tuple[GlobalIndex, LocalIndex]:
        return self._of.families(self.everyone)

    @property
    def _of(self) -> LatticeStencils:
        found: LatticeStencils = self.__dict__["_lattice"]
        return found


def find_families(
    cloud: Cloud, cracks: Sequence[Crack] = (), repeated: float | None = None, in_order: bool = False
) -> Families:
    """Find the neighbours of every own particle within its horizon, unless a crack separates them.

    If the horizon differs between particles, ``j`` is in the family of ``i`` if ``|xi| <= reach_i``. With mutual bonds,
    also if ``|xi| <= reach_j``.

    Parameters
    ----------
    cloud : Cloud
        Particles of this rank with their ghosts.
    cracks : sequence of Crack
        Cracks that cut bonds from the start, also by their images in a periodic cell and behind mirror planes.
    repeated : float, optional
        Bonds of particles with a shared family are not listed if at least this share of all particles have one. By
        default all bonds are listed.
    in_order : bool
        Whether particles share a family only if they list its members in the same order.

    Returns
    -------
    Families

    Raises
    ------
    CaseError
        Two particles coincide, or a crack has another dimension or cuts no bond.

    Notes
    -----
    Collective (the check); the search itself is local.
    """
    cutting = _Cutting(cloud, cracks)
    if repeated is not None and not cloud.varies:
        lattice = find_lattice(cloud, cutting if cutting.cuts else None, repeated, in_order)
        if lattice is not None:
            cutting.refuse_idle()
            return LatticeFamilies(lattice)
    grid = None if cloud.varies else find_grid(cloud)
    if not anywhere(cloud.comm, grid is None):
        assert grid is not None
        with agreed(cloud.comm):
            own = np.arange(cloud.n_owned, dtype=np.int32)
            families = Families(*listed_families(cloud, grid, own, cutting if cutting.cuts else None), grid)
        cutting.refuse_idle()
        return families
    pairs = _pairs(cloud)
    if cutting.cuts:
        with agreed(cloud.comm):
            pairs = pairs[~cutting(pairs)]
    cutting.refuse_idle()
    directed = cloud.varies and not cloud.mutual
    indptr, neighbours = families_from_pairs(pairs, directed, cloud.order, cloud.n_owned)
    families = Families(indptr, neighbours)
    with agreed(cloud.comm):
        length = np.linalg.norm(cloud.x[pairs[:, 0]] - cloud.x[pairs[:, 1]], axis=1)
        close = np.flatnonzero(length < COINCIDENT * cloud.local_horizon[pairs].min(axis=1))
        if len(close):
            one, two = sorted(int(gid) for gid in cloud.gid[pairs[close[0]]])
            raise CaseError(
                f"Particles {one} and {two} coincide ({len(close)} such pairs on one rank); remove one of each pair."
            )
    return families


def reached_back(cloud: Cloud, families: Families, bonds: GlobalIndex) -> Mask:
    """Return which of selected bonds (n,) also exist from their second end (n,)."""
    if cloud.mutual or not cloud.varies:
        return np.ones(len(bonds), dtype=bool)
    reach = cloud.local_horizon[families.neighbours[bonds]]
    return np.asarray(families.lengths_of(cloud.x, bonds) <= reach * (1.0 + HORIZON_TOLERANCE))


def _pairs(cloud: Cloud) -> LocalIndex:
    """Return the pairs with a bond and an own end (n, 2); for a bond from one end only, that end is first."""
    if not cloud.varies:
        # Do not search from ghosts: in a small cell they have many times the pairs with an own end.
        radius, own = cloud.horizon * (1.0 + HORIZON_TOLERANCE), scipy.spatial.cKDTree(cloud.x[: cloud.n_owned])
        inside = own.query_pairs(radius, output_type="ndarray")
        across = own.sparse_distance_matrix(
            scipy.spatial.cKDTree(cloud.x[cloud.n_owned :]), radius, output_type="ndarray"
        )
        return np.concatenate([inside, np.stack([across["i"], across["j"] + cloud.n_owned], axis=1)])
    n = cloud.n_local if cloud.mutual else cloud.n_owned
    every, found = scipy.spatial.cKDTree(cloud.x), [np.empty((0, 2), dtype=np.int64)]
    for members in by_reach(cloud.local_horizon[:n]):
        radius = float(cloud.local_horizon[members].max()) * (1.0 + HORIZON_TOLERANCE)
        near = scipy.spatial.cKDTree(cloud.x[members]).sparse_distance_matrix(every, radius, output_type="ndarray")
        centre, other = members[near["i"]], near["j"]
        kept = (centre != other) & (near["v"] <= cloud.local_horizon[centre] * (1.0 + HORIZON_TOLERANCE))
        found.append(np.stack([centre[kept], other[kept]], axis=1))
    pairs = np.concatenate(found)
    if cloud.mutual:
        pairs = pairs[(pairs < cloud.n_owned).any(axis=1)]
        once = np.unique(pairs.min(axis=1) * np.int64(n) + pairs.max(axis=1))
        pairs = np.stack(np.divmod(once, n), axis=1)
    return np.asarray(pairs)


class _Cutting:
    """Determine which pairs are of two bodies or separated by cracks, and count the cut pairs of each crack."""

    def __init__(self, cloud: Cloud, cracks: Sequence[Crack]) -> None:
        self._cloud = cloud
        with agreed(cloud.comm):
            self._cracks = [images_of_cloud(crack, cloud) for crack in cracks]
        self._count = np.zeros(len(cracks))

    @property
    def cuts(self) -> bool:
        """Return True if there are cracks or several bodies."""
        return bool(self._cracks) or self._cloud.body is not None

    def __call__(self, pairs: LocalIndex) -> Mask:
        """Return which pairs have no bond (n_pairs,) (not collective)."""
        cloud = self._cloud
        cut = np.zeros(len(pairs), dtype=bool)
        if not len(pairs):
            return cut
        if cloud.body is not None:
            cut = cloud.body[pairs[:, 0]] != cloud.body[pairs[:, 1]]
        # Both ends test the same bond, on any rank; rounding at the rim of a crack must give both the same result. The
        # first end is in the cell.
        turned = cloud.gid[pairs[:, 0]] > cloud.gid[pairs[:, 1]]
        pairs = np.where(turned[:, None], pairs[:, ::-1], pairs)
        a, b = cloud.x[pairs[:, 0]], cloud.x[pairs[:, 1]]
        if cloud.images is not None and self._cracks:
            away = np.concatenate([np.zeros((cloud.n_owned, cloud.dim)), cloud.offset])[pairs[:, 0]]
            a, b = a - away, b - away
        for number, crack in enumerate(self._cracks):
            separated = crack.cuts(a, b)
            self._count[number] += np.count_nonzero(separated)
            cut |= separated
        return cut

    def refuse_idle(self) -> None:
        """Raise CaseError on all ranks if a crack has cut no bond (collective)."""
        for number, count in enumerate(total(self._cloud.comm, self._count) if self._cracks else ()):
            if not count:
                raise CaseError(f"Crack {number + 1} cuts no bond: {self._cracks[number].crack}.")
