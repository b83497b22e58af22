"""Facets of two parts of a surface that face each other."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property

import numpy as np
import scipy

from pdpetsc.arrays import Float, GlobalIndex, LocalIndex, Lookup, Mask, entries_of, row_of_entries, starts_of
from pdpetsc.discrete.cloud import Cloud
from pdpetsc.discrete.communicator import agreed, anywhere, exchange, largest, near_ranks
from pdpetsc.discrete.surface import Surface
from pdpetsc.errors import CaseError
from pdpetsc.gradient.pair_product import MovingFacets
from pdpetsc.kernels.overlap import AREA, GAP, NORMAL, ONE, OTHER, QUANTITIES, overlap, overlap_by_fields
from pdpetsc.problem.body import Body

# Facets face each other if the cosine of the angle between one normal and minus the other exceeds this.
FACING = 0.5
# Sort keys of the facets of one particle.
PER_PARTICLE = 256
# Corners coincide, and edges are straight, up to this share of the length of an edge.
SAME = 1e-9
# Facets of one particle are one part of the surface if the cosine of the angle between their normals exceeds this.
ALIKE = 0.8


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
        edges = _edges(self.corners)
        return np.asarray(self.depth * np.linalg.norm(np.cross(edges[:, 0], edges[:, 1]), axis=1))

    @property
    def sizes(self) -> Float:
        """Return the largest distance of a corner from the centroid (n,) [length]."""
        return np.asarray(np.linalg.norm(self.offsets[:, :, : self.x.shape[1]], axis=2).max(axis=1))

    @cached_property
    def particle(self) -> LocalIndex:
        """Return the local particle whose cell each facet bounds (n,), on any rank: the first of its members."""
        found: LocalIndex = self.members[self.ptr[:-1]]
        return found

    @cached_property
    def offsets(self) -> Float:
        """Return the corners relative to the centroids (n, 4, 3) [length]."""
        found = self.corners.copy()
        found[:, :, : self.x.shape[1]] -= self.x[:, None]
        return found

    @property
    def parts(self) -> GlobalIndex:
        """Return the number of the part of the surface to which each own facet belongs (n,), ascending with the owner.

        Facets of one particle with similar normals are one part.
        """
        n, normal = len(self.x), _frames(_edges(self.corners))[:, 2]
        number, left, kind = np.zeros(n, dtype=np.int64), np.arange(n), 0
        while len(left):
            # The first facet of each particle that is left, and those like it.
            _, first, of = np.unique(self.owner[left], return_index=True, return_inverse=True)
            alike = (normal[left] * normal[left[first[of]]]).sum(axis=1) > ALIKE
            number[left[alike]] = kind
            left, kind = left[~alike], kind + 1
        return np.asarray(np.unique(self.owner.astype(np.int64) * max(kind, 1) + number, return_inverse=True)[1])

    @cached_property
    def edges(self) -> Float:
        """Return the vectors from the middle of one side to that of the opposite one (n, dim - 1, dim) [length]."""
        return _edges(self.corners)[:, : self.x.shape[1] - 1, : self.x.shape[1]]

    @cached_property
    def moving(self) -> MovingFacets:
        """Return how the facets move with the particles."""
        return MovingFacets(self.ptr, self.members, np.concatenate([self.N[:, None], self.G], axis=1))

    def deformed(self, u: Float) -> Float:
        """Compute the deformed corners (n, 4, 3) [length]."""
        dim, y = self.x.shape[1], self.corners.copy()
        q = self.moving.fields(u)
        y[:, :, :dim] += q[:, None, 0] + self.offsets[:, :, :dim] @ q[:, 1:]
        return y


@dataclass(frozen=True)
class Pairs:
    """Store pairs of facets that overlap, ordered by the facets of the one side and the keys of the other.

    Attributes
    ----------
    rows, other_rows : (n,) int64
        Facets of both sides.
    area, gap : (n,) float64
        Area of the overlap [area], and distance [length].
    normal : (n, dim) float64
        Mean normal, from the other to the one.
    one, other : (n, dim) float64
        The middle of the overlap on both facets in the undeformed body, relative to their centroids [length].
    """

    rows: GlobalIndex
    other_rows: GlobalIndex
    area: Float
    gap: Float
    normal: Float
    one: Float
    other: Float

    def chosen(self, mask: Mask | GlobalIndex) -> Pairs:
        """Return some of the pairs."""
        return Pairs(*(getattr(self, name)[mask] for name in self.__dataclass_fields__))


def _edges(corners: Float) -> Float:
    """Return the vectors from the middle of one side of facets to that of the opposite one (n, 2, 3) [length]."""
    diagonals = corners[:, 2] - corners[:, 0], corners[:, 1] - corners[:, 3]
    return np.stack([0.5 * (diagonals[0] + diagonals[1]), 0.5 * (diagonals[0] - diagonals[1])], axis=1)


def _frames(edges: Float) -> Float:
    """Return the axes of facets with edges (n, 2, 3): along the first, across it, and the normal (n, 3, 3)."""
    first, n = edges[:, 0], np.cross(edges[:, 0], edges[:, 1])
    first, n = (one / np.linalg.norm(one, axis=1)[:, None] for one in (first, n))
    return np.stack([first, np.cross(n, first), n], axis=1)


def both_ends(one: Side, other: Side, pairs: Pairs) -> tuple[GlobalIndex, LocalIndex, Float]:
    """Return the particles that both points of pairs move with, those of the one first.

    These are their start (n_pairs + 1,), the particles (n_entries,), and their weights (n_entries,), negative for the
    point on the other facet [-].
    """
    found = []
    for sign, side, rows, points in ((1.0, one, pairs.rows, pairs.one), (-1.0, other, pairs.other_rows, pairs.other)):
        entry, ptr = entries_of(side.ptr, rows)
        of = row_of_entries(ptr)
        found.append((ptr, of, side.members[entry], sign * (side.N[entry] + (side.G[entry] * points[of]).sum(axis=1))))
    (ptr, of, members, weights), (other_ptr, other_of, other_members, other_weights) = found
    order = np.argsort(np.concatenate([of, other_of]), kind="stable")
    members, weights = np.concatenate([members, other_members]), np.concatenate([weights, other_weights])
    return ptr + other_ptr, members[order], weights[order]


def sides_of(
    body: Body, one: Mask, other: Mask, reach: float, corners: Float, depth: float
) -> tuple[Side, Side, Side]:  # fmt: skip
    """Return the own facets of both parts of the surface, and all facets of the other part within a reach of the first.

    The latter include images behind mirror planes.

    Parameters
    ----------
    one, other : (n_facets,) bool
        Facets of the surface of this rank that belong to each part.
    reach : float
        Distance in the undeformed body [length].
    corners, depth
        As of ``corners_of``.

    Notes
    -----
    Collective.
    """
    cloud, surface = body.cloud, body.known_surface
    key = _keys(cloud, surface)
    G = surface.gradient(cloud)
    mine = _side(surface, corners, key, G, one, one & other, depth)
    theirs = _side(surface, corners, key, G, other, one & other, depth)
    alone = cloud.comm.size == 1 and not cloud.places.planes
    return mine, theirs, theirs if alone else _received(cloud, mine, theirs, reach)


def corners_of(body: Body, name: str) -> tuple[Float, float]:
    """Return the corners of all facets of this rank as in ``Side``, and its ``depth`` (collective).

    ``name`` is the condition in the message of the CaseError if outlines are unknown.
    """
    cloud, surface = body.cloud, body.known_surface
    length = largest(cloud.comm, np.linalg.norm(surface.area, axis=1), initial=0.0) / body.thickness
    with agreed(cloud.comm):
        corners = _corners(surface, body.thickness, length, name)
    return corners, body.thickness / length if cloud.dim == 2 else 1.0


def _side(surface: Surface, corners: Float, key: GlobalIndex, G: Float, mask: Mask, both: Mask, depth: float) -> Side:
    rows = np.flatnonzero(mask)
    rows = rows[np.lexsort((key[rows], surface.owner[rows]))]
    entry, ptr = entries_of(surface.ptr, rows)
    found = Side(
        surface.x[rows], corners[rows], key[rows], both[rows], surface.owner[rows].astype(np.int32), ptr,
        surface.members[entry], surface.N[entry], G[entry], depth,
    )  # fmt: skip
    # Plane bodies have few facets, and two halves show better how the gap changes along a surface that slides.
    while surface.x.shape[1] == 3 and len((halves := _halves(found))[0]):
        found = _joined(found, *halves)
    return found


def _halves(side: Side) -> tuple[GlobalIndex, GlobalIndex, Float]:
    """Return facets of one particle that are halves of a flat facet with four corners, (n,) each, and these corners.

    No facet is in two pairs. The halves have two corners in common, and each of these lies on a straight edge of the
    whole facet.
    """
    of = side.owner
    apart = range(1, int(np.bincount(of).max(initial=1)))
    found = [np.stack([np.flatnonzero(of[s:] == of[:-s]) + to for to in (0, s)]) for s in apart]
    one, other = np.concatenate([np.empty((2, 0), dtype=np.int64), *found], axis=1)
    alike = side.both[one] == side.both[other]
    one, other = one[alike], other[alike]
    whole, is_whole = np.empty((len(one), 4, 3)), np.zeros(len(one), dtype=bool)
    # Edges in common have opposite directions.
    for a in (np.roll(side.corners[one], k, axis=1) for k in range(4)):
        for b in (np.roll(side.corners[other], k, axis=1) for k in range(4)):
            size = SAME * np.linalg.norm(a[:, 1] - a[:, 0], axis=1)
            met = (np.linalg.norm(a[:, :2] - b[:, 1::-1], axis=2) < size[:, None]).all(axis=1)
            straight = _straight(b[:, 2], a[:, 0], a[:, 3]) & _straight(a[:, 2], a[:, 1], b[:, 3])
            now = met & straight
            whole[now] = np.stack([a[:, 2], a[:, 3], b[:, 2], b[:, 3]], axis=1)[now]
            is_whole |= now
    one, other, whole = one[is_whole], other[is_whole], whole[is_whole]
    # A pair is kept if it is the first one of both facets.
    number = np.arange(len(one))
    first = np.full(len(of), len(one))
    np.minimum.at(first, np.concatenate([one, other]), np.concatenate([number, number]))
    kept = (first[one] == number) & (first[other] == number)
    return one[kept], other[kept], whole[kept]


def _straight(a: Float, b: Float, c: Float) -> Mask:
    """Return True where the point b lies between a and c (n, 3) on a line."""
    ab, bc = b - a, c - b
    product = (ab * bc).sum(axis=1)
    return np.asarray((product > 0.0) & (np.linalg.norm(np.cross(ab, bc), axis=1) < SAME * product))


def _joined(side: Side, one: GlobalIndex, other: GlobalIndex, corners: Float) -> Side:
    """Return the facets with each ``one`` replaced by the facet with these corners, and without the others.

    Mean weights of both are linear-exact at their common centroid, as the weights of each are at its own.
    """
    area, each = side.areas, side.corners.copy()
    each[one] = corners
    share = np.zeros(len(area))
    share[one] = area[other] / (area[one] + area[other])
    partner = np.arange(len(area))
    partner[one] = other
    kept = np.ones(len(area), dtype=bool)
    kept[other] = False
    rows = np.flatnonzero(kept)
    entry, ptr = entries_of(side.ptr, rows)
    # Facets of one particle have the same members in the same order.
    of_partner, _ = entries_of(side.ptr, partner[rows])
    w = np.repeat(share[rows], np.diff(ptr))[:, None]
    return Side(
        (1.0 - share[rows, None]) * side.x[rows] + share[rows, None] * side.x[partner[rows]],
        each[rows], side.key[rows], side.both[rows], side.owner[rows], ptr, side.members[entry],
        (1.0 - w[:, 0]) * side.N[entry] + w[:, 0] * side.N[of_partner],
        (1.0 - w) * side.G[entry] + w * side.G[of_partner], side.depth,
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
    """Return the facets of all ranks and their images within a reach of the box around the own facets (collective)."""
    comm, dim = cloud.comm, cloud.dim
    ranks, facets, entries = [], [], []
    for behind, (sign, to) in enumerate(zip(*cloud.places.mirrors, strict=True)):
        x = sign * theirs.x + to
        near = near_ranks(comm, mine.x, x, reach)
        rows = np.concatenate(near)
        entry, ptr = entries_of(theirs.ptr, rows)
        members = theirs.members[entry]
        corners = theirs.corners[rows]
        corners[:, :, :dim] = sign * corners[:, :, :dim] + to
        if np.prod(sign) < 0.0:
            corners = corners[:, [1, 0, 3, 2]]
        # Keys of images are below all others: a body does not touch its own image.
        key = theirs.key[rows] if behind == 0 else -theirs.key[rows] * cloud.places.n - behind
        # A body with mirror planes has no periods, so that places are numbered by their planes.
        place = cloud.place[members]
        order = cloud.order[members] + ((place ^ behind) - place)
        ranks.append(np.repeat(np.arange(comm.size), [len(one) for one in near]).astype(np.int32))
        facets.append([x[rows], corners, key, theirs.both[rows], np.diff(ptr)])
        entries.append([order, theirs.N[entry], sign * theirs.G[entry]])
    rank = np.concatenate(ranks)
    of_facets, of_entries = (
        [np.concatenate(parts) for parts in zip(*columns, strict=True)] for columns in (facets, entries)
    )
    (orders, N, G), _ = exchange(comm, np.repeat(rank, of_facets[-1]), of_entries)
    (x, corners, key, both, size), _ = exchange(comm, rank, of_facets)
    ptr = starts_of(size)
    local = Lookup(cloud.order).of(orders)
    unknown = np.add.reduceat(local < 0, ptr[:-1]) if len(size) else np.empty(0, dtype=np.int64)
    # Facets in a corner of the box are further than the reach from all own ones, and their particles are not here.
    kept = np.flatnonzero(unknown == 0)
    entry, ptr = entries_of(ptr, kept)
    owner = np.full(len(kept), -1, dtype=np.int32)
    return Side(
        x[kept], corners[kept], key[kept], both[kept], owner, ptr, local[entry].astype(np.int32), N[entry], G[entry],
        mine.depth,
    )  # fmt: skip


class Search:
    """Find the facets of both sides that overlap, among those that were near at the last search.

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
        self._left_out = np.empty(0, dtype=np.int64)
        self.version = 0

    def leave_out_material(self, u: Float, depth: float) -> None:
        """Leave out pairs of facets of both parts that face each other through material thinner than ``depth``.

        These are the pairs with a negative gap at displacements ``u``, those of the undeformed body (not collective).
        """
        through = self.passed(u, depth)
        twice = self.one.both[through.rows] & self.other.both[through.other_rows]
        through = through.chosen(twice & (through.gap < -1e-6 * depth))
        self._left_out = np.unique(through.rows * len(self.other.x) + through.other_rows)

    def due(self, u: Float) -> bool:
        """Return True if the sides have moved too far since the last search (collective).

        ``u`` (n_local, dim) are the displacements of local particles.
        """
        if self._found_at is None:
            return True
        apart = [
            np.abs(now - before).max(initial=0.0) for now, before in zip(self._deformed(u), self._found_at, strict=True)
        ]
        room = self._slack - float(np.sqrt(self._cloud.dim) * sum(apart))
        return anywhere(self._cloud.comm, room < 0.0)

    def renew(self, u: Float) -> None:
        """Search the facets that are near (not collective).

        They are searched twice as far as is necessary, so that the next states do not require a search.
        """
        y = self._deformed(u)
        self.near, self._found_at = self._within(y, 2.0 * self._slack), y
        self.version += 1

    def pairs(self, u: Float) -> Pairs:
        """Return the near pairs that overlap (not collective)."""
        return self._overlapping(self._deformed(u), *self.near)

    def passed(self, u: Float, slack: float) -> Pairs:
        """Return the pairs that overlap of facets nearer than ``slack`` [length] (not collective)."""
        y = self._deformed(u)
        return self._overlapping(y, *self._within(y, slack))

    def rates(self, u: Float, pairs: Pairs) -> Float:
        """Compute the derivatives of area, gap, normal and both points of pairs by their fields (not collective).

        Returns
        -------
        (n_pairs, 11, 2, 1 + dim, dim) float64
            By displacement and gradient of both facets, as of ``MovingFacets.fields``.
        """
        dim = self._cloud.dim
        J = np.empty((len(pairs.rows), QUANTITIES, 2, 1 + dim, dim))
        overlap_by_fields(
            *self._deformed(u), self.one.offsets, self.other.offsets, pairs.rows, pairs.other_rows, FACING, J
        )
        J[:, AREA] *= self.one.depth
        return J

    def within(self, u: Float, pairs: Pairs) -> Float:
        """Compute the matrices from vectors in space to undeformed ones within the facets of pairs (not collective).

        The undeformed vector c is in the plane of the facet. Seen along the normal n, it deforms to the vector w:
        ``w = F c + l n``.

        Returns
        -------
        (n_pairs, 2, dim, 1 + dim) float64
            ``w S = (c, l)`` for both facets.
        """
        found, n = [], pairs.normal[:, None]
        for side, y, rows in zip(
            (self.one, self.other), self._deformed(u), (pairs.rows, pairs.other_rows), strict=True
        ):
            edges, dim = side.edges[rows], n.shape[2]
            inverse = np.linalg.inv(np.concatenate([_edges(y[rows])[:, : dim - 1, :dim], n], axis=1))
            found.append(np.concatenate([inverse[:, :, :-1] @ edges, inverse[:, :, -1:]], axis=2))
        return np.stack(found, axis=1)

    def frames(self, u: Float) -> tuple[Float, Float]:
        """Compute axes that turn with the facets of both sides, in rows (n, 3, 3) (not collective).

        The first is along an edge, the last is the normal.
        """
        one, other = (_frames(_edges(y)) for y in self._deformed(u))
        return one, other

    def turns(self, u: Float, pairs: Pairs, vectors: Float) -> Float:
        """Compute the derivatives of vectors that turn with the first facets of pairs (not collective).

        ``vectors`` (n, dim) are those at the displacements ``u``.

        Returns
        -------
        (n, dim, 2, 1 + dim, dim) float64
            By displacement and gradient of both facets, as of ``rates``.
        """
        dim, side, rows = self._cloud.dim, self.one, pairs.rows
        edges = _edges(side.deformed(u)[rows])
        _, along, n = _frames(edges).transpose(1, 0, 2)
        dual = np.linalg.inv(np.concatenate([edges, n[:, None]], axis=1))[:, :, :2].transpose(0, 2, 1)
        # Rotation for a unit change of each component of each edge.
        spin = -n[:, None, :, None] * np.cross(n[:, None], dual)[:, :, None]
        spin[:, 0] += (along / np.linalg.norm(edges[:, 0], axis=1)[:, None])[:, :, None] * n[:, None]
        whole = np.zeros((len(rows), 1, 1, 3))
        whole[..., :dim] = vectors[:, None, None]
        turned = np.cross(spin, whole)[:, : dim - 1, :dim, :dim]
        found = np.zeros((len(rows), dim, 2, 1 + dim, dim))
        found[:, :, 0, 1:] = np.einsum("pak,paji->pikj", side.edges[rows], turned)
        return found

    def _deformed(self, u: Float) -> tuple[Float, Float]:
        """Return the deformed corners of both sides [length]."""
        return self.one.deformed(u), self.other.deformed(u)

    def _overlapping(self, y: tuple[Float, Float], one: GlobalIndex, other: GlobalIndex) -> Pairs:
        dim, q = self._cloud.dim, np.zeros((len(one), QUANTITIES))
        overlap(*y, self.one.offsets, self.other.offsets, one, other, FACING, q)
        kept = q[:, AREA] > 0.0
        q = q[kept]
        vectors = (np.ascontiguousarray(q[:, at : at + dim]) for at in (NORMAL, ONE, OTHER))
        return Pairs(one[kept], other[kept], self.one.depth * q[:, AREA], q[:, GAP], *vectors)

    def _within(self, y: tuple[Float, Float], slack: float) -> tuple[GlobalIndex, GlobalIndex]:
        """Return the pairs of facets that are nearer than their sizes and ``slack`` allow, in order."""
        here = [corners.mean(axis=1)[:, : self._cloud.dim] for corners in y]
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
        kept = ~np.isin(one * len(self.other.x) + other, self._left_out)
        one, other = one[kept], other[kept]
        order = np.lexsort((self.other.key[other], one))
        return one[order], other[order]
