"""The part of a tangent that comes from the derivative of the integrity of bonds by the displacement."""

from __future__ import annotations

from collections.abc import Callable
from typing import TypeAlias

import numpy as np

from pdpetsc.arrays import Float, GlobalIndex, LocalIndex, Mask
from pdpetsc.damage.criterion import EndpointMean, Gradient, NonlocalPart
from pdpetsc.kernels.assembly import assemble_kernel
from pdpetsc.kernels.bonds import outer_rows_kernel
from pdpetsc.kernels.sparsity import sum_by, transpose
from pdpetsc.kernels.tangent import outer_times_kernel
from pdpetsc.problem.body import Body
from pdpetsc.problem.state import State
from pdpetsc.problem.term import Entries


class SofteningBonds:
    """``v (x) m`` of bonds whose integrity falls: force of the intact bond times the gradient of the integrity.

    Parameters
    ----------
    body : Body
        Whose bonds they are.
    bonds : (n,) int64
        Their numbers, ascending.
    v : (n, dim) float64
        Force of the intact bond on its second end [force].
    m : (n, dim) float64
        Derivative of the integrity by the displacement of the second end, through the own elongation [1 / length].
    """

    def __init__(self, body: Body, bonds: GlobalIndex, v: Float, m: Float) -> None:
        self._body = body
        self._bonds, self._v, self._m = bonds, np.asarray(v), np.asarray(m)
        self._neighbours = body.families.neighbours[bonds]
        self._ptr = np.searchsorted(bonds, body.families.indptr)

    def add_product(self, du: Float, f: Float, particles: LocalIndex) -> None:
        """Add the forces of the families of some own particles (not collective)."""
        outer_times_kernel(self._body.dim)(particles, self._ptr, self._neighbours, self._v, self._m, du, f)

    def add_rows(self, entries: Entries) -> None:
        """Add the rows of the matrix (not collective)."""
        families, cloud = self._body.families, self._body.cloud
        ends = np.stack([families.centres[self._bonds], self._neighbours], axis=1).ravel()
        by_particle = transpose(2 * np.arange(len(self._bonds) + 1, dtype=np.int64), ends, cloud.n_local)
        kernel, sparsity = outer_rows_kernel(self._body.dim), entries.sparsity
        for rows, own in entries.row_sets():
            kernel(
                rows.first, rows.diag_ptr, rows.off_ptr, rows.columns, *sparsity.locals_of_columns, *by_particle,
                ends, self._v, self._m, own, entries.off,
            )  # fmt: skip


class SofteningNonlocal:
    """``v (x) dT/du`` of bonds whose integrity falls with the displacement of particles of the family of their centre.

    Parameters
    ----------
    body : Body
        Whose bonds they are.
    bonds : (n,) int64
        Their numbers, ascending.
    v : (n, dim) float64
        Force of the intact bond on its second end [force].
    beyond : Beyond
        Derivative of the integrity of each.
    """

    def __init__(self, body: Body, bonds: GlobalIndex, v: Float, nonlocal_part: NonlocalPart) -> None:
        self._body, self._v, self._nonlocal_part = body, np.asarray(v), nonlocal_part
        self._ends = np.stack([body.families.centres[bonds], body.families.neighbours[bonds]], axis=1)
        self._bond_of = np.repeat(np.arange(len(bonds)), np.diff(nonlocal_part.ptr))

    def add_product(self, du: Float, f: Float, particles: LocalIndex) -> None:
        """Add the forces of the families of some own particles (not collective)."""
        asked = np.zeros(self._body.cloud.n_owned, dtype=bool)
        asked[particles] = True
        entries = np.flatnonzero(asked[self._ends[self._bond_of, 0]])
        each = np.einsum("ei,ei->e", self._nonlocal_part.by[entries], du[self._nonlocal_part.particles[entries]])
        force = np.bincount(self._bond_of[entries], each, len(self._v))[:, None] * self._v
        np.add.at(f, self._ends[:, 1], force)
        np.subtract.at(f, self._ends[:, 0], force)

    def add_rows(self, entries: Entries) -> None:
        """Add the rows of the matrix (not collective)."""
        dim, n, nonlocal_part, sparsity = self._body.dim, len(self._v), self._nonlocal_part, entries.sparsity
        # Stencils begin with both ends, which have the forces, and go on with the particles that have the derivatives.
        members = np.insert(nonlocal_part.particles, np.repeat(nonlocal_part.ptr[:-1], 2), self._ends.ravel())
        ptr = nonlocal_part.ptr + 2 * np.arange(n + 1)
        h, g = np.zeros((len(members), dim)), np.zeros((len(members), dim))
        h[ptr[:-1], 0], h[ptr[:-1] + 1, 0] = -1.0, 1.0
        g[np.arange(len(nonlocal_part.particles)) + 2 * (self._bond_of + 1)] = nonlocal_part.by
        A = np.zeros((n, *(dim,) * 4))
        A[:, :, 0] = np.einsum("pi,kn->pikn", self._v, np.eye(dim))
        members = members.astype(self._body.families.neighbours.dtype)
        by_particle = transpose(ptr, members, self._body.cloud.n_local)
        for rows, own in entries.row_sets():
            assemble_kernel(dim)(
                rows.first, rows.diag_ptr, rows.off_ptr, rows.columns, *sparsity.locals_of_columns, *by_particle,
                ptr, members, h, g, np.ones(n), A, own, entries.off,
            )  # fmt: skip


class SofteningFamilies:
    """``sum_b q_b (x) dc/du`` in every family: forces of its bonds with one number that depends on all its members.

    Parameters
    ----------
    body : Body
        Whose families they are.
    q : (n_bonds, dim) float64
        Force of every bond on its second end for a number of 1 [force].
    g : (n_entries, dim) float64
        Derivative of the number by the displacement of the members of the family, its centre first [1 / length].
    counts : (n_owned,) bool
        Which families have any.
    """

    def __init__(self, body: Body, q: Float, g: Float, counts: Mask) -> None:
        self._body, self._g, self._counts = body, g, counts
        families = body.families
        self._h = np.insert(q, families.indptr[:-1], -sum_by(families.centres, q, len(counts)), axis=0)

    @classmethod
    def of_ends(cls, body: Body, bonds: GlobalIndex, v: Float, ends: EndpointMean) -> SofteningFamilies:
        """Return the part of bonds whose integrity follows the mean of a number of each end.

        Parameters
        ----------
        bonds : (n,) int64
            The bonds.
        v : (n, dim) float64
            Half the difference of what both directions of each, intact, put on its second end [force].
        ends : OfEnds
            How their integrity follows.
        """
        q = np.zeros((len(body.families.neighbours), body.dim))
        q[bonds] = ends.factor[:, None] * v
        counts = np.zeros(body.cloud.n_owned, dtype=bool)
        counts[body.families.centres[bonds]] = True
        return cls(body, q, ends.by, counts)

    @classmethod
    def of_dilatation(cls, body: Body, gradient: Gradient, q: Float, n: Float, s: Float) -> SofteningFamilies:
        """Return what bonds whose integrity falls take from the dilatation that their family shares.

        Parameters
        ----------
        gradient : Gradient
            Of the integrity of those that fall.
        q : (n_bonds, dim) float64
            Force of every bond on its second end for a dilatation of 1 [force].
        n : (n_bonds, dim) float64
            Directions of the bonds [-].
        s : (n,) float64
            What those that fall would add to the dilatation if they were intact [-].
        """
        families, whole, bonds = body.families, body.with_centres, gradient.bonds
        centres = families.centres
        counts = np.zeros(body.cloud.n_owned, dtype=bool)
        counts[centres[bonds]] = True
        # Entries of the families with their centres: the b-th bond is one further for each family before it.
        of_bond = np.arange(len(centres)) + centres + 1
        g = np.zeros((len(whole.members), body.dim))
        own = (s * gradient.along)[:, None] * n[bonds]
        g[of_bond[bonds]] += own
        np.subtract.at(g, whole.point_ptr[:-1][centres[bonds]], own)
        if gradient.nonlocal_part is not None:
            count = np.diff(gradient.nonlocal_part.ptr)
            key = np.repeat(np.arange(len(counts)), np.diff(whole.point_ptr)) * body.cloud.n_local + whole.members
            order = np.argsort(key)
            asked = (
                np.repeat(centres[bonds].astype(np.int64), count) * body.cloud.n_local
                + gradient.nonlocal_part.particles
            )
            at = order[np.searchsorted(key[order], asked)]
            np.add.at(g, at, np.repeat(s, count)[:, None] * gradient.nonlocal_part.by)
        for ends in gradient.ends:
            # What the other ends of the bonds see is beyond the family; their own stands for it.
            sums = np.bincount(centres[bonds], s * ends.factor, len(counts))
            g += np.repeat(sums, np.diff(whole.point_ptr))[:, None] * ends.by
        return cls(body, q, g, counts)

    def add_product(self, du: Float, f: Float, particles: LocalIndex) -> None:
        """Add the forces of the families of some own particles (not collective)."""
        whole = self._body.with_centres
        asked = np.zeros(len(self._counts), dtype=bool)
        asked[particles] = True
        families = np.flatnonzero(asked & self._counts)
        size = np.diff(whole.point_ptr)[families]
        entries = np.repeat(whole.point_ptr[families] - np.cumsum(size) + size, size) + np.arange(size.sum())
        of, members = np.repeat(np.arange(len(families)), size), whole.members[entries]
        change = np.bincount(of, np.einsum("ei,ei->e", self._g[entries], du[members]), len(families))
        np.add.at(f, members, change[of, None] * self._h[entries])

    def add_rows(self, entries: Entries) -> None:
        """Add the rows of the matrix (not collective)."""
        body, whole, dim = self._body, self._body.with_centres, self._body.dim
        one = np.eye(dim)
        A = np.tile(np.einsum("im,kn->imkn", one, one), (len(self._counts), 1, 1, 1, 1))
        by_particle = transpose(whole.point_ptr, whole.members, body.cloud.n_local)
        for rows, own in entries.row_sets():
            assemble_kernel(dim)(
                rows.first, rows.diag_ptr, rows.off_ptr, rows.columns, *entries.sparsity.locals_of_columns,
                *by_particle, whole.point_ptr, whole.members, self._h, self._g, self._counts.astype(float), A, own,
                entries.off,
            )  # fmt: skip


Softening: TypeAlias = SofteningBonds | SofteningNonlocal | SofteningFamilies


def softening_parts(state: State, gradient: Gradient, v: Float, opposite: Callable[[Float], Float]) -> list[Softening]:
    """Return what the derivative of the integrity adds where elongations are those of the current length (collective).

    Parameters
    ----------
    state : State
        Where.
    gradient : Gradient
        Of the integrity.
    v : (n_bonds, dim) float64
        Force of every bond, intact, on its second end [force].
    opposite : callable
        Gives what the other direction of every bond has of such forces (``OppositeBonds.of_vectors``).
    """
    body, bonds, u_local = state.body, gradient.bonds, state.u_local
    centres, neighbours = body.families.centres[bonds], body.families.neighbours[bonds]
    y = body.cloud.x[neighbours] + u_local[neighbours] - body.cloud.x[centres] - u_local[centres]
    m = np.asarray(gradient.along[:, None] * y / np.linalg.norm(y, axis=1)[:, None])
    found: list[Softening] = [SofteningBonds(body, bonds, v[bonds], m)]
    return [*found, *softening_nonlocal(body, gradient, v, opposite)]


def softening_nonlocal(body: Body, gradient: Gradient, v: Float, opposite: Callable[[Float], Float]) -> list[Softening]:
    """Return what is left where the part of the own elongation is counted elsewhere; nothing for most drives.

    Arguments as for ``softening_parts`` (collective).
    """
    bonds = gradient.bonds
    found: list[Softening] = []
    if gradient.nonlocal_part is not None:
        found.append(SofteningNonlocal(body, bonds, v[bonds], gradient.nonlocal_part))
    if gradient.ends:
        both = 0.5 * (v - opposite(v))[bonds]
        found += [SofteningFamilies.of_ends(body, bonds, both, ends) for ends in gradient.ends]
    return found
