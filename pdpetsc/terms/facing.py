"""Facets of two parts of a surface that face each other."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import scipy

from pdpetsc.arrays import Float, GlobalIndex, LocalIndex, Mask, entries_of
from pdpetsc.discrete.cloud import Cloud
from pdpetsc.discrete.communicator import agreed, exchange, largest, total
from pdpetsc.discrete.surface import Surface
from pdpetsc.errors import CaseError
from pdpetsc.kernels.overlap import overlap
from pdpetsc.problem.body import Body

# Facets face each other if the cosine of the angle between one normal and minus the other exceeds this.
FACING = 0.5
# Sort keys of the facets of one particle.
PER_PARTICLE = 256
# Facets of one particle are one part of the surface if the cosine of the angle between their normals exceeds this.
ALIKE = 0.8
# Moments of the corners of a facet below this share of the largest are zero.
FLAT = 1e-12


@dataclass(frozen=True)
class Side:
    """Store the facets of one part of a surface that a rank knows, with the particles that they move with.

    Attributes
    ----------
    x : (n, dim) float64
        Centroids [length].
    corners : (n, 4, 3) float64
        Corners in turn as seen from outside [length]; facets of plane bodies are as deep as the longest one is long.
    key : (n,) int64
        Sort key of each facet, equal on all ranks.
    both : (n,) bool
        Whether each facet belongs to both parts.
    owner : (n,) int32
        Own particle of each facet; -1 on other ranks.
    ptr, members, N, G
        Particles of each facet, and the weights of its displacement [-] and displacement gradient [1 / length].
    depth : float
        Thickness of a plane body over the depth of its facets; 1 for a solid one [-].
    """

    x: Float
    corners: Float
    key: GlobalIndex
    both: Mask
    owner: LocalIndex
    ptr: GlobalIndex
    members: LocalIndex
    N: Float
    G: Float
    depth: float

    @property
    def areas(self) -> Float:
        """Return the areas of the facets (n,) [area]."""
        return np.asarray(self.depth * np.linalg.norm(self._vectors, axis=1))

    @property
    def _vectors(self) -> Float:
        c = self.corners
        return np.asarray(0.5 * np.cross(c[:, 2] - c[:, 0], c[:, 3] - c[:, 1]))

    @property
    def sizes(self) -> Float:
        """Return the largest distance of a corner from the centroid (n,) [length]."""
        dim = self.x.shape[1]
        return np.asarray(np.linalg.norm(self.corners[:, :, :dim] - self.x[:, None], axis=2).max(axis=1))

    @property
    def parts(self) -> GlobalIndex:
        """Return the number of the part of the surface to which each own facet belongs (n,), ascending with the owner.

        Facets of one particle with similar normals are one part.
        """
        n = len(self.x)
        normal = self._vectors / np.linalg.norm(self._vectors, axis=1)[:, None]
        number, left, kind = np.zeros(n, dtype=np.int64), np.arange(n), 0
        while len(left):
            # The first facet of each particle that is left, and those like it.
            _, first, of = np.unique(self.owner[left], return_index=True, return_inverse=True)
            alike = (normal[left] * normal[left[first[of]]]).sum(axis=1) > ALIKE
            number[left[alike]] = kind
            left, kind = left[~alike], kind + 1
        return np.unique(self.owner.astype(np.int64) * max(kind, 1) + number, return_inverse=True)[1]

    def displaced(self, u: Float) -> Float:
        """Compute the displacements of the corners (n, 4, dim) for displacements of local particles (n_local, dim)."""
        n, dim = self.x.shape
        of, at = np.repeat(np.arange(n), np.diff(self.ptr)), u[self.members]
        moved = np.stack([np.bincount(of, self.N * along, n) for along in at.T], axis=1)
        gradient = np.empty((n, dim, dim))
        for i in range(dim):
            for k in range(dim):
                gradient[:, i, k] = np.bincount(of, at[:, i] * self.G[:, k], n)
        return moved[:, None] + np.einsum("fik,fck->fci", gradient, self.corners[:, :, :dim] - self.x[:, None])

    def weights_at(self, rows: GlobalIndex, y: Float, corners: Float) -> tuple[GlobalIndex, LocalIndex, Float, Float]:
        """Compute the weights of the points that are at ``y`` (n, dim) on facets with deformed ``corners`` (n, 4, dim).

        Returns
        -------
        ptr, members, weights, X
            Particles of each point, their weights [-], and where the points are in the undeformed body (n, dim).
        """
        dim = y.shape[1]
        middle = corners.mean(axis=1)
        apart = corners - middle[:, None]
        moments = np.einsum("nci,ncj->nij", apart, apart)
        share = np.einsum("nci,nij,nj->nc", apart, np.linalg.pinv(moments, rcond=FLAT, hermitian=True), y - middle)
        X = np.einsum("nc,nci->ni", 0.25 + share, self.corners[rows][:, :, :dim])
        entry, ptr = entries_of(self.ptr, rows)
        of = np.repeat(np.arange(len(rows)), np.diff(ptr))
        offset = X - self.x[rows]
        return ptr, self.members[entry], self.N[entry] + (self.G[entry] * offset[of]).sum(axis=1), X


@dataclass(frozen=True)
class Pairs:
    """Store pairs of facets that overlap, ordered by the facets of the one side and the keys of the other.

    Attributes
    ----------
    one, other : (n,) int64
        Facets of both sides.
    area, gap : (n,) float64
        Area of the overlap [area], and distance [length].
    at, across, normal : (n, dim) float64
        Middle of the overlap on both facets [length], and the mean normal, from the other to the one.
    """

    one: GlobalIndex
    other: GlobalIndex
    area: Float
    gap: Float
    at: Float
    across: Float
    normal: Float

    def chosen(self, mask: Mask) -> Pairs:
        """Return some of the pairs."""
        return Pairs(*(getattr(self, name)[mask] for name in self.__dataclass_fields__))


def sides_of(body: Body, one: Mask, other: Mask, reach: float, name: str) -> tuple[Side, Side, Side]:
    """Return the own facets of both parts of the surface, and all facets of the other part within a reach of the first.

    Parameters
    ----------
    one, other : (n_facets,) bool
        Facets of the surface of this rank that belong to each part.
    reach : float
        Distance in the undeformed body [length].
    name : str
        Name of the condition in messages.

    Raises
    ------
    CaseError
        The outlines of the facets are unknown.

    Notes
    -----
    Collective.
    """
    cloud, surface = body.cloud, body.surface
    assert surface is not None
    length = largest(cloud.comm, float(np.linalg.norm(surface.area, axis=1).max(initial=0.0))) / body.thickness
    with agreed(cloud.comm):
        corners = _corners(surface, body.thickness, length, name)
    depth = body.thickness / length if cloud.dim == 2 else 1.0
    key = _keys(cloud, surface)
    G = surface.gradient(cloud)
    mine = _side(surface, corners, key, G, one, one & other, depth)
    theirs = _side(surface, corners, key, G, other, one & other, depth)
    return mine, theirs, theirs if cloud.comm.size == 1 else _received(cloud, mine, theirs, reach)


def _side(
    surface: Surface, corners: Float, key: GlobalIndex, G: Float, mask: Mask, both: Mask, depth: float
) -> Side:
    rows = np.flatnonzero(mask)
    rows = rows[np.argsort(key[rows])]
    rows = rows[np.argsort(surface.owner[rows], kind="stable")]
    entry, ptr = entries_of(surface.ptr, rows)
    return Side(
        surface.x[rows], corners[rows], key[rows], both[rows], surface.owner[rows].astype(np.int32), ptr,
        surface.members[entry], surface.N[entry], G[entry], depth,
    )  # fmt: skip


def _keys(cloud: Cloud, surface: Surface) -> GlobalIndex:
    """Return a sort key of each facet that does not depend on the ranks (n_facets,)."""
    order = np.argsort(surface.owner, kind="stable")
    count = np.bincount(surface.owner, minlength=cloud.n_owned)
    number = np.empty(len(order), dtype=np.int64)
    number[order] = np.arange(len(order)) - np.repeat(np.cumsum(count) - count, count)
    return np.asarray(cloud.gid[surface.owner] * PER_PARTICLE + number)


def _corners(surface: Surface, thickness: float, depth: float, name: str) -> Float:
    """Return the corners of facets (n, 4, 3) in turn as seen from outside; raise CaseError if they are unknown.

    Facets of plane bodies are ``depth`` deep [length].
    """
    x, area = surface.x, surface.area
    dim = x.shape[1]
    if dim == 1:
        raise CaseError(f"{name} is for plane and solid bodies.")
    if dim == 2:
        half = 0.5 / thickness * np.stack([-area[:, 1], area[:, 0]], axis=1)
        flat = np.stack([x - half, x + half, x + half, x - half], axis=1)
        z = np.broadcast_to(np.array([0.0, 0.0, depth, depth])[:, None], (len(x), 4, 1))
        return np.concatenate([flat, z], axis=2)
    if surface.corners is None:
        raise CaseError(
            f"{name} requires the outlines of the facets of a solid body. Use LatticeNodes, MeshNodes or Lattice, or "
            "Facets with corners."
        )
    corners = surface.corners
    turn = np.cross(corners[:, 2] - corners[:, 0], corners[:, 3] - corners[:, 1])
    inward = (turn * area).sum(axis=1) < 0.0
    return np.where(inward[:, None, None], corners[:, ::-1], corners)


def _received(cloud: Cloud, mine: Side, theirs: Side, reach: float) -> Side:
    """Return the facets of all ranks within a reach of the box around the own facets (collective)."""
    comm, dim = cloud.comm, cloud.dim
    box = np.concatenate([mine.x.min(axis=0, initial=np.inf), mine.x.max(axis=0, initial=-np.inf)])
    boxes = np.array(comm.allgather(box))
    near = [
        np.flatnonzero(np.all((theirs.x >= low - reach) & (theirs.x <= high + reach), axis=1))
        for low, high in zip(boxes[:, :dim], boxes[:, dim:], strict=True)
    ]
    rank = np.repeat(np.arange(comm.size), [len(rows) for rows in near]).astype(np.int32)
    rows = np.concatenate(near)
    entry, ptr = entries_of(theirs.ptr, rows)
    size = np.diff(ptr)
    facets = [theirs.x[rows], theirs.corners[rows], theirs.key[rows], theirs.both[rows], size]
    (x, corners, key, both, size), counts = exchange(comm, rank, facets)
    of = cloud.order[theirs.members[entry]], theirs.N[entry], theirs.G[entry]
    (members, N, G), _ = exchange(comm, np.repeat(rank, np.diff(ptr)), list(of))
    ptr = np.concatenate([[0], np.cumsum(size)]).astype(np.int64)
    order = np.argsort(cloud.order)
    place = np.minimum(np.searchsorted(cloud.order[order], members), cloud.n_local - 1)
    local = order[place]
    unknown = np.add.reduceat(cloud.order[local] != members, ptr[:-1]) if len(size) else np.empty(0, dtype=np.int64)
    # Facets in a corner of the box are further than the reach from all own ones, and their particles are not here.
    kept = np.flatnonzero(unknown == 0)
    entry, ptr = entries_of(ptr, kept)
    owner = np.full(len(kept), -1, dtype=np.int32)
    return Side(
        x[kept], corners[kept], key[kept], both[kept], owner, ptr, local[entry].astype(np.int32), N[entry], G[entry],
        mine.depth,
    )  # fmt: skip


class Search:
    """Find the facets of both sides that overlap.

    Near facets are searched again only after the sides have moved by more than ``slack``.

    Parameters
    ----------
    cloud : Cloud
        Particles of this rank.
    one, other : Side
        Both sides.
    slack : float
        Facets are near if the gap between them is at most this [length].

    Attributes
    ----------
    near : tuple of (n,) int64
        Facets of both sides that are near.
    version : int
        Number of searches.
    """

    def __init__(self, cloud: Cloud, one: Side, other: Side, slack: float) -> None:
        self._cloud, self.one, self.other, self._slack = cloud, one, other, slack
        self._sizes = one.sizes, other.sizes
        self._found_at: tuple[Float, Float] | None = None
        self.near = np.empty(0, dtype=np.int64), np.empty(0, dtype=np.int64)
        self.version = 0

    def pairs(self, u: Float) -> Pairs:
        """Return the pairs that overlap for displacements of local particles (n_local, dim) (collective)."""
        moved = self.one.displaced(u), self.other.displaced(u)
        comm = self._cloud.comm
        room = -1.0
        if self._found_at is not None:
            apart = [np.abs(now - before).max(initial=0.0) for now, before in zip(moved, self._found_at, strict=True)]
            room = self._slack - float(np.sqrt(self._cloud.dim) * sum(apart))
        if int(total(comm, int(room < 0.0))):
            # As far again as is necessary, so that the next pairs do not require a search.
            self.near, self._found_at = self._within(moved, 2.0 * self._slack), moved
            self.version += 1
        return self._overlapping(moved, *self.near)

    def passed(self, u: Float, slack: float) -> Pairs:
        """Return the pairs that overlap, of facets that were nearer than ``slack`` [length] (not collective)."""
        moved = self.one.displaced(u), self.other.displaced(u)
        return self._overlapping(moved, *self._within(moved, slack))

    def _overlapping(self, moved: tuple[Float, Float], one: GlobalIndex, other: GlobalIndex) -> Pairs:
        dim, corners = self._cloud.dim, []
        for side, displaced, rows in zip((self.one, self.other), moved, (one, other), strict=True):
            at = side.corners[rows]
            at[:, :, :dim] += displaced[rows]
            corners.append(at)
        n = len(one)
        area, gap = np.empty(n), np.zeros(n)
        at, across, normal = np.zeros((n, 3)), np.zeros((n, 3)), np.zeros((n, 3))
        overlap(*corners, FACING, area, at, across, normal, gap)
        found = Pairs(one, other, self.one.depth * area, gap, at[:, :dim], across[:, :dim], normal[:, :dim])
        return found.chosen(area > 0.0)

    def _within(self, moved: tuple[Float, Float], slack: float) -> tuple[GlobalIndex, GlobalIndex]:
        """Return the pairs of facets that are nearer than their sizes and ``slack`` allow, in order."""
        here = [side.x + displaced.mean(axis=1) for side, displaced in zip((self.one, self.other), moved, strict=True)]
        if not (len(here[0]) and len(here[1])):
            return np.empty(0, dtype=np.int64), np.empty(0, dtype=np.int64)
        radius = self._sizes[0].max() + self._sizes[1].max() + slack
        near = scipy.spatial.cKDTree(here[0]).sparse_distance_matrix(
            scipy.spatial.cKDTree(here[1]), radius, output_type="ndarray"
        )
        one, other = near["i"], near["j"]
        kept = near["v"] <= self._sizes[0][one] + self._sizes[1][other] + slack
        # Of two facets of both parts, the pair counts once.
        twice = self.one.both[one] & self.other.both[other]
        kept &= ~twice | (self.one.key[one] < self.other.key[other])
        one, other = one[kept].astype(np.int64), other[kept].astype(np.int64)
        order = np.lexsort((self.other.key[other], one))
        return one[order], other[order]
