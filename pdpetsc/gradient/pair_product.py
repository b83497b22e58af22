"""Forces between facets that move affinely with the particles around them."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property

import numpy as np

from pdpetsc.arrays import Float, GlobalIndex, LocalIndex
from pdpetsc.gradient.base import StencilMembers
from pdpetsc.gradient.products import Entries, FacetSprings, Product
from pdpetsc.kernels.facet_pairs import carry_all, facet_blocks, members_of_groups, pair_times_kernel, push, spread
from pdpetsc.kernels.facet_pairs import vectors_of_members as write_vectors


@dataclass(frozen=True)
class MovingFacets:
    """Store how facets move: displacement and displacement gradient follow from those of particles.

    Attributes
    ----------
    ptr : (n + 1,) int64
        Start of the particles of each facet.
    members : (n_entries,) int32
        Local particles.
    weights : (n_entries, 1 + dim) float64
        Weights of their displacements in that of the centroid [-], and in the gradient [1 / length].
    """

    ptr: GlobalIndex
    members: LocalIndex
    weights: Float

    @property
    def arrays(self) -> tuple[GlobalIndex, LocalIndex, Float]:
        """Return all arrays, as the loops take them."""
        return self.ptr, self.members, self.weights

    def fields(self, u: Float) -> Float:
        """Compute displacements and gradients (n, 1 + dim, dim) from displacements of local particles (n_local, dim).

        ``[:, 1 + k]`` is the derivative along axis ``k``.
        """
        found = np.empty((len(self.ptr) - 1, self.weights.shape[1], u.shape[1]))
        carry_all(*self.arrays, u, found)
        return found


@dataclass(frozen=True)
class FacetPairs:
    """Store pairs of facets, and a point of each.

    Attributes
    ----------
    sides : tuple of two MovingFacets
        Facets of both sides.
    rows : tuple of two (n,) int64
        Facets of each pair.
    at : (n, 2, dim) float64
        Points on both facets, relative to their centroids [length].
    """

    sides: tuple[MovingFacets, MovingFacets]
    rows: tuple[GlobalIndex, GlobalIndex]
    at: Float

    def moved(self, u: Float) -> Float:
        """Compute the displacements of the first points relative to the second (n, dim) [length]."""
        found = np.zeros((len(self.at), u.shape[1]))
        for side, sign in enumerate((1.0, -1.0)):
            q = self.sides[side].fields(u)[self.rows[side]]
            found += sign * (q[:, 0] + np.einsum("pk,pki->pi", self.at[:, side], q[:, 1:]))
        return found

    def spread(self, force: Float, f: Float) -> None:
        """Add opposite forces at both points (n, dim) to those of local particles (n_local, dim)."""
        used = [np.zeros(len(side.ptr) - 1, dtype=bool) for side in self.sides]
        pushed = [np.zeros((len(side.ptr) - 1, side.weights.shape[1], f.shape[1])) for side in self.sides]
        push(*self.rows, self.at, force, *used, *pushed)
        for side, mask, q in zip(self.sides, used, pushed, strict=True):
            spread(*side.arrays, mask, q, f)


class PairProduct(Product):
    """Opposite forces at the points of pairs of facets, by the displacements and gradients of these.

    The rates of a group of pairs are ``r_a = sum_p G_pa . q_p``, with displacements and gradients q of both facets. The
    first facet of a pair feels the force ``sum_a r_a h_pa`` at its point, and its force F moves with the point by the
    rates that follow, dim of each facet. The product works on facets: particles move many pairs.

    Parameters
    ----------
    pairs : FacetPairs
        The pairs, those of a group one after the other.
    owner : (n_groups,) int32
        Own particle of each group, ascending.
    start : (n_groups + 1,) int64
        First pair of each group.
    n_owned : int
        Number of own particles.
    G : (n, r, 2, 1 + dim, dim) float64
        ``G_p`` of both facets.
    h : (n, q, dim) float64
        ``h_p``. ``G h`` is a force per length; q is r, or ``r - 2 dim`` if points move.
    force : (n, dim) float64, optional
        F, if points move [force].
    stiff : bool
        True if these are springs many times stiffer than the body.
    """

    def __init__(
        self, pairs: FacetPairs, owner: LocalIndex, start: GlobalIndex, n_owned: int, G: Float, h: Float,
        force: Float | None = None, stiff: bool = False,
    ) -> None:  # fmt: skip
        self._pairs, self._owner, self._start, self._n_owned = pairs, owner, start, n_owned
        self._vectors = G, h, pairs.at, np.empty((0, h.shape[2])) if force is None else force
        self._first = np.searchsorted(owner, np.arange(n_owned + 1))
        self._stiff = stiff

    def add_product(self, du: Float, f: Float, particles: LocalIndex) -> None:
        """Add the forces of the groups of the particles."""
        one, other = self._pairs.sides
        times, rows = pair_times_kernel(du.shape[1]), self._pairs.rows
        times(particles, self._first, self._start, *rows, *self._vectors, *one.arrays, *other.arrays, du, f)

    @cached_property
    def listed(self) -> FacetSprings:
        """Compute the vectors of every particle of each group."""
        (one, other), rows, (G, *_) = self._pairs.sides, self._pairs.rows, self._vectors
        most = sum(int(np.diff(side.ptr)[of].sum()) for side, of in zip((one, other), rows, strict=True))
        n = 1 + max(int(side.members.max(initial=-1)) for side in (one, other))
        starts, found = np.zeros(len(self._start), dtype=np.int64), np.empty(most, dtype=np.int32)
        memory = np.full(n, -1)
        stencils = one.ptr, one.members, other.ptr, other.members
        members_of_groups(self._start, *rows, *stencils, memory, starts, found)
        members = found[: starts[-1]].copy()
        h, g = np.zeros((2, len(members), G.shape[1], G.shape[4]))
        write_vectors(self._start, *rows, *self._vectors, *one.arrays, *other.arrays, starts, members, memory, h, g)
        return FacetSprings(StencilMembers(self._owner, starts, members), self._n_owned, h, g)

    def add_rows(self, entries: Entries) -> None:
        """Add the rows of the particles."""
        self.listed.add_rows(entries)

    def add_point_blocks(self, blocks: Float) -> bool:
        """Add the diagonal blocks of the particles."""
        if self._stiff:
            return self.listed.add_point_blocks(blocks)
        for number, (side, rows) in enumerate(zip(self._pairs.sides, self._pairs.rows, strict=True)):
            facet_blocks(number, rows, *self._vectors, *side.arrays, blocks)
        return True

    def stiff(self) -> FacetSprings | None:
        """Return the springs with the vectors of every particle, if they are stiff."""
        return self.listed if self._stiff else None
