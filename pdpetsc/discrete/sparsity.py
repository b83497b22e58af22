"""Sparsity of the tangent, and the exchange that completes rows with contributions of other ranks."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from pdpetsc.arrays import Float, GlobalIndex, LocalIndex, Mask, row_of_entries, starts_of
from pdpetsc.discrete.cloud import Cloud
from pdpetsc.discrete.communicator import Comm, exchange, fetch, owners
from pdpetsc.kernels.assembly import add_blocks_kernel
from pdpetsc.kernels.sparsity import merge_rows, product_sparsity, transpose


@dataclass(frozen=True)
class Rows:
    """Store block rows; in each row the own columns precede the others.

    Attributes
    ----------
    first : int
        Local particle of the first row.
    diag_ptr, off_ptr : (n_rows + 1,) int64
        Blocks in own and in other columns.
    columns : (n_blocks,) int64
        Column of every block, own columns of a row first. Columns below ``n_owned`` are own particles; from there on
        the sorted other columns.
    """

    first: int
    diag_ptr: GlobalIndex
    off_ptr: GlobalIndex
    columns: GlobalIndex


@dataclass(frozen=True)
class Arrivals:
    """Store the destinations of the blocks that other ranks assembled for rows of this rank.

    Attributes
    ----------
    row_blocks : (n_rows,) int64
        Number of blocks of each received row.
    start, slot, width : (n_blocks,) int64
        Blocks before the receiving row, position of the block in the row, and number of blocks of the row.
    in_diag : (n_blocks,) bool
        Whether these refer to the own columns or to the others.
    """

    row_blocks: GlobalIndex
    start: GlobalIndex
    slot: GlobalIndex
    width: GlobalIndex
    in_diag: Mask


@dataclass(frozen=True)
class Border:
    """Store the own particles whose forces depend on the virtual unknowns; on the last rank those of all ranks.

    Attributes
    ----------
    particles : (n,) int64
        Own particles with blocks in the virtual columns.
    columns : (n_virtual_global,) int64
        Numbers of the virtual columns on this rank.
    arrived : (n_all,) int64
        Column of every such particle of all ranks, in the order of ``gather``; empty on ranks without the unknowns.
    """

    comm: Comm
    particles: GlobalIndex
    columns: GlobalIndex
    arrived: GlobalIndex

    def gather(self, values: NDArray[Any]) -> NDArray[Any]:
        """Gather ``values`` (n, ...) of all ranks on the last rank, nothing elsewhere (collective)."""
        return _to_last(self.comm, values)


@dataclass(frozen=True)
class Sparsity:
    """Store the possibly nonzero blocks of a matrix ``G^T D G``, distributed by rows.

    Columns are numbered: own particles, own virtual rows, then the others in the order of their global rows.

    Attributes
    ----------
    owned, ghost : Rows
        Rows of the own particles, complete, and the share of this rank in the rows of its ghosts.
    virtual : Rows
        Rows of the virtual unknowns that this rank holds; their own columns are those of particles and virtual
        unknowns.
    other_columns : (n_other,) int64
        Global row numbers of the columns that this rank does not own, ascending.
    locals_of_columns : (n_columns + 1,) int64, (n_local,) int32, (n_local,) int32, (n_mirrors, dim) float64
        Start of the local particles of each column in the second array: several with images, none for a column to which
        only other ranks add. Then the combination of mirror planes that each local particle is behind, and the factors
        of vector components behind each combination.
    border : Border or None
        Coupling of the rows with the virtual unknowns of a periodic cell.
    arrivals : Arrivals
        Destination of the received ghost rows.
    """

    cloud: Cloud
    owned: Rows
    ghost: Rows
    virtual: Rows
    other_columns: GlobalIndex
    locals_of_columns: tuple[GlobalIndex, LocalIndex, LocalIndex, Float]
    arrivals: Arrivals
    border: Border | None

    @property
    def n_own_columns(self) -> int:
        """Return the number of columns that this rank owns."""
        return self.cloud.n_rows

    @property
    def rows(self) -> Rows:
        """Return all rows that this rank holds: those of particles, then virtual ones."""
        one, two = self.owned, self.virtual
        return Rows(
            0,
            np.concatenate([one.diag_ptr, one.diag_ptr[-1] + two.diag_ptr[1:]]),
            np.concatenate([one.off_ptr, one.off_ptr[-1] + two.off_ptr[1:]]),
            np.concatenate([one.columns, two.columns]),
        )

    @property
    def n_blocks(self) -> int:
        """Return the number of blocks in the rows of this rank."""
        return len(self.owned.columns) + len(self.virtual.columns)

    def of_other_columns(self, values: NDArray[Any]) -> NDArray[Any]:
        """Fetch the rows of ``values`` (n_owned, ...) of the columns that this rank does not own (collective)."""
        comm, first = self.cloud.comm, self.cloud.first
        return fetch(comm, *owners(comm, first, self.other_columns), values)

    def complete(self, ghost_values: Float, diag: Float, off: Float, dim: int) -> None:
        """Send assembled ghost rows to their owners and add the received rows to ``diag`` and ``off``.

        Parameters
        ----------
        ghost_values : (dim * dim * ghost blocks,) float64
            Share of this rank in the ghost rows, in scalar CSR layout.
        diag, off : float64
            Values of the own rows, in scalar CSR layout.
        dim : int
            Block size: the dimension, or 1 for a matrix of one scalar per block.

        Notes
        -----
        Collective.
        """
        size = dim * dim
        lengths = size * np.diff(self.ghost.diag_ptr)
        received = self.cloud.halo.reverse_rows(ghost_values, lengths, size * self.arrivals.row_blocks)
        to = self.arrivals
        add_blocks_kernel(dim)(to.row_blocks, received, to.start, to.slot, to.width, to.in_diag, diag, off)


def build_sparsity(cloud: Cloud, point_ptr: GlobalIndex, members: LocalIndex) -> Sparsity:
    """Build the sparsity of ``G^T D G`` for the stencils ``members[point_ptr[p]:point_ptr[p + 1]]``.

    Notes
    -----
    Collective: rows of ghosts are sent to their owners.
    """
    n_owned, n_own, halo = cloud.n_owned, cloud.n_rows, cloud.halo
    entry_ptr, _, entry_point = transpose(point_ptr, members, cloud.n_local)
    row_ptr, local_columns = product_sparsity(
        entry_ptr, entry_point, point_ptr, _one_of_each(cloud)[members], np.arange(cloud.n_local, dtype=np.int64)
    )
    ghost_begin = row_ptr[n_owned]
    ghost_blocks = np.diff(row_ptr[n_owned:])
    arriving_blocks = np.zeros(cloud.n_local, dtype=np.int64)[halo.send_index]
    arriving_blocks = halo.reverse_rows(ghost_blocks, np.ones_like(ghost_blocks), np.ones_like(arriving_blocks))
    arriving = halo.reverse_rows(cloud.row[local_columns[ghost_begin:]], ghost_blocks, arriving_blocks)
    reached = _bordering(cloud, point_ptr, members)
    virtual = cloud.n_global + np.arange(cloud.n_virtual_global, dtype=np.int64)
    reached_rows = _to_last(cloud.comm, cloud.row[reached])

    own_columns = cloud.row[local_columns[:ghost_begin]]
    others = np.concatenate([cloud.row[n_owned:], arriving, virtual, reached_rows])
    other_columns = np.unique(others[(others < cloud.first) | (others >= cloud.first + n_own)])

    def number(rows: GlobalIndex) -> GlobalIndex:
        own = (rows >= cloud.first) & (rows < cloud.first + n_own)
        return np.where(own, rows - cloud.first, n_own + np.searchsorted(other_columns, rows))

    arriving_ptr = starts_of(arriving_blocks)
    virtual_ptr = arriving_ptr[-1] + len(virtual) * np.arange(1, len(reached) + 1)
    merged_ptr, merged = merge_rows(
        row_ptr[: n_owned + 1], number(own_columns),
        np.concatenate([halo.send_index, reached]), np.concatenate([arriving_ptr, virtual_ptr]),
        number(np.concatenate([arriving, np.tile(virtual, len(reached))])), n_owned, n_own + len(other_columns),
    )  # fmt: skip
    owned = _split(0, merged_ptr, merged, n_own)
    ghost_ptr = row_ptr[n_owned:] - ghost_begin
    ghost = Rows(n_owned, ghost_ptr, np.zeros_like(ghost_ptr), number(cloud.row[local_columns[ghost_begin:]]))
    arrivals = _arrivals(owned, merged_ptr, merged, halo.send_index, arriving_blocks, number(arriving), n_own)
    border_columns = np.sort(number(np.concatenate([reached_rows, virtual]))) if cloud.n_virtual else virtual[:0]
    held = _split(
        n_owned, len(border_columns) * np.arange(cloud.n_virtual + 1), np.tile(border_columns, cloud.n_virtual), n_own
    )
    border = None
    if cloud.images is not None:
        border = Border(cloud.comm, reached, number(virtual), number(reached_rows))
    behind = cloud.places.behind(cloud.place).astype(np.int32), np.ascontiguousarray(cloud.places.mirrors[0])
    locals_of_columns = *_locals(number(cloud.row), n_own + len(other_columns)), *behind
    return Sparsity(cloud, owned, ghost, held, other_columns, locals_of_columns, arrivals, border)


def positions_of_own_blocks(rows: Rows, n_own: int, dim: int) -> GlobalIndex:
    """Return the positions of the values of the diagonal block of each row (n_rows, dim, dim)."""
    row = row_of_entries(rows.diag_ptr)
    block = np.flatnonzero(rows.columns[rows.columns < n_own] == row)
    width = np.diff(rows.diag_ptr)
    start = dim * dim * rows.diag_ptr[:-1] + dim * (block - rows.diag_ptr[:-1])
    i, k = np.arange(dim)[:, None], np.arange(dim)[None, :]
    return np.asarray(start[:, None, None] + (dim * width)[:, None, None] * i + k)


def _one_of_each(cloud: Cloud) -> LocalIndex:
    """Return for every local particle the first local particle with the same row; images share the columns."""
    _, first, inverse = np.unique(cloud.row, return_index=True, return_inverse=True)
    return first[inverse].astype(np.int32)


def _locals(columns: GlobalIndex, n_columns: int) -> tuple[GlobalIndex, LocalIndex]:
    """Return the inverse of the map from local particles to columns."""
    counts = np.bincount(columns, minlength=n_columns)
    return starts_of(counts), np.argsort(columns, kind="stable").astype(np.int32)


def _bordering(cloud: Cloud, point_ptr: GlobalIndex, members: LocalIndex) -> GlobalIndex:
    """Return the own particles that share a stencil with an image, or have an image that does (collective)."""
    if cloud.images is None:
        return np.empty(0, dtype=np.int64)
    image = np.zeros(cloud.n_local)
    image[cloud.n_owned :] = cloud.offset.any(axis=1)
    reached = sharing_stencil(cloud, point_ptr, members, image)
    return np.flatnonzero(reached)


def sharing_stencil(cloud: Cloud, point_ptr: GlobalIndex, members: LocalIndex, marked: Float) -> Mask:
    """Return the own particles in a stencil with a marked local particle (n_local,) (collective)."""
    n_points = len(point_ptr) - 1
    point_of = row_of_entries(point_ptr)
    touched = np.bincount(point_of, marked[members], n_points) > 0.0
    reached = np.bincount(members, touched[point_of].astype(float), cloud.n_local)
    cloud.halo.reverse(reached)
    return np.asarray(reached[: cloud.n_owned] > 0.0)


def _to_last(comm: Comm, values: NDArray[Any]) -> NDArray[Any]:
    (arrived,), _ = exchange(comm, np.full(len(values), comm.size - 1), [values])
    return arrived


def _split(first: int, row_ptr: GlobalIndex, columns: GlobalIndex, n_own: int) -> Rows:
    own_before = starts_of(columns < n_own)
    diag_ptr = own_before[row_ptr]
    return Rows(first, diag_ptr, row_ptr - diag_ptr, columns)


def _arrivals(
    owned: Rows,
    row_ptr: GlobalIndex,
    columns: GlobalIndex,
    rows: LocalIndex,
    row_blocks: GlobalIndex,
    arriving: GlobalIndex,
    n_own: int,
) -> Arrivals:
    """Locate each arriving block in the sorted rows, by (row, column) keys that order both lists."""
    width = int(columns.max(initial=0)) + 1
    row = np.repeat(rows, row_blocks).astype(np.int64)
    keys = row_of_entries(row_ptr) * width + columns
    found = np.searchsorted(keys, row * width + arriving)
    in_diag = arriving < n_own
    n_diag = np.diff(owned.diag_ptr)
    slot = found - row_ptr[row]
    start = np.asarray(np.where(in_diag, owned.diag_ptr[row], owned.off_ptr[row]))
    blocks = np.where(in_diag, n_diag[row], np.diff(owned.off_ptr)[row])
    return Arrivals(np.asarray(row_blocks), start, np.where(in_diag, slot, slot - n_diag[row]), blocks, in_diag)
