"""Block pattern of the tangent and the exchange that completes rows other ranks contribute to."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from pdpetsc.arrays import Float, GlobalIndex, LocalIndex, Mask
from pdpetsc.discrete.cloud import Cloud
from pdpetsc.discrete.communicator import exchange
from pdpetsc.kernels.assembly import add_blocks_kernel
from pdpetsc.kernels.pattern import merge_rows, product_pattern, transpose


@dataclass(frozen=True)
class Rows:
    """A set of block rows, the own columns of each row before the others.

    Attributes
    ----------
    first : int
        Local particle of the first row.
    diag_ptr, off_ptr : (n_rows + 1,) int64
        Blocks in own and in other columns.
    columns : (n_blocks,) int64
        Column of every block, own ones of a row first: below ``n_owned`` own particles, from there on the sorted
        other columns.
    """

    first: int
    diag_ptr: GlobalIndex
    off_ptr: GlobalIndex
    columns: GlobalIndex


@dataclass(frozen=True)
class Arrivals:
    """Where the blocks go that other ranks assembled for this rank's rows.

    Attributes
    ----------
    row_blocks : (n_rows,) int64
        Blocks of each received row.
    start, slot, width : (n_blocks,) int64
        Of the receiving row: blocks before it, position of this block in it, and its number of blocks.
    in_diag : (n_blocks,) bool
        Whether these count in the own columns or in the others.
    """

    row_blocks: GlobalIndex
    start: GlobalIndex
    slot: GlobalIndex
    width: GlobalIndex
    in_diag: Mask


@dataclass(frozen=True)
class Pattern:
    """Block pattern of a matrix ``G^T D G`` distributed by rows.

    Attributes
    ----------
    owned, ghost : Rows
        Rows of the own particles, complete; and this rank's share of the rows of its ghosts.
    other_columns : (n_other,) int64
        Global row number of the columns that this rank does not own, ascending.
    local_of_column : (n_owned + n_other,) int32
        Local particle of a column, -1 for a column that only other ranks add to.
    arrivals : Arrivals
        Destination of the received ghost rows.
    """

    cloud: Cloud
    owned: Rows
    ghost: Rows
    other_columns: GlobalIndex
    local_of_column: LocalIndex
    arrivals: Arrivals

    @property
    def n_blocks(self) -> int:
        """Return the number of blocks in this rank's rows."""
        return int(self.owned.diag_ptr[-1] + self.owned.off_ptr[-1])

    def of_other_columns(self, values: NDArray[Any]) -> NDArray[Any]:
        """Return the owners' rows of ``values`` (n_owned, ...) for the columns this rank does not own (collective)."""
        comm, cloud = self.cloud.comm, self.cloud
        firsts = np.array(comm.allgather(cloud.first), dtype=np.int64)
        owner = np.searchsorted(firsts, self.other_columns, side="right") - 1
        (asked,), counts = exchange(comm, owner, [self.other_columns])
        asker = np.repeat(np.arange(comm.size), counts)
        (answer,), _ = exchange(comm, asker, [values[asked - cloud.first]])
        return answer

    def complete(self, ghost_values: Float, diag: Float, off: Float, dim: int) -> None:
        """Send assembled ghost rows to their owners and add what arrives to ``diag`` and ``off``.

        Parameters
        ----------
        ghost_values : (dim * dim * ghost blocks,) float64
            This rank's share of the ghost rows, in scalar CSR layout.
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


def build_pattern(cloud: Cloud, point_ptr: GlobalIndex, members: LocalIndex) -> Pattern:
    """Return the block pattern of ``G^T D G`` for the stencils ``members[point_ptr[p]:point_ptr[p + 1]]``.

    Notes
    -----
    Collective: rows of ghosts are sent to their owners.
    """
    n_owned, halo = cloud.n_owned, cloud.halo
    entry_ptr, _, entry_point = transpose(point_ptr, members, cloud.n_local)
    row_ptr, local_columns = product_pattern(
        entry_ptr, entry_point, point_ptr, members, np.arange(cloud.n_local, dtype=np.int64)
    )
    ghost_begin = row_ptr[n_owned]
    ghost_blocks = np.diff(row_ptr[n_owned:])
    arriving_blocks = np.zeros(cloud.n_local, dtype=np.int64)[halo.send_index]
    arriving_blocks = halo.reverse_rows(ghost_blocks, np.ones_like(ghost_blocks), np.ones_like(arriving_blocks))
    arriving = halo.reverse_rows(cloud.row[local_columns[ghost_begin:]], ghost_blocks, arriving_blocks)

    own_columns = cloud.row[local_columns[:ghost_begin]]
    is_own = (arriving >= cloud.first) & (arriving < cloud.first + n_owned)
    other_columns = np.unique(np.concatenate([cloud.row[n_owned:], arriving[~is_own]]))

    def number(rows: GlobalIndex) -> GlobalIndex:
        own = (rows >= cloud.first) & (rows < cloud.first + n_owned)
        return np.where(own, rows - cloud.first, n_owned + np.searchsorted(other_columns, rows))

    local_of_column = np.full(n_owned + len(other_columns), -1, dtype=np.int32)
    local_of_column[number(cloud.row)] = np.arange(cloud.n_local, dtype=np.int32)
    arriving_ptr = np.concatenate([[0], np.cumsum(arriving_blocks)])
    merged_ptr, merged = merge_rows(
        row_ptr[: n_owned + 1], number(own_columns), halo.send_index, arriving_ptr, number(arriving),
        n_owned, n_owned + len(other_columns),
    )  # fmt: skip
    owned = _split(merged_ptr, merged, n_owned)
    ghost_ptr = row_ptr[n_owned:] - ghost_begin
    ghost = Rows(n_owned, ghost_ptr, np.zeros_like(ghost_ptr), number(cloud.row[local_columns[ghost_begin:]]))
    arrivals = _arrivals(owned, merged_ptr, merged, halo.send_index, arriving_blocks, number(arriving), n_owned)
    return Pattern(cloud, owned, ghost, other_columns, local_of_column, arrivals)


def _split(row_ptr: GlobalIndex, columns: GlobalIndex, n_owned: int) -> Rows:
    own_before = np.concatenate([[0], np.cumsum(columns < n_owned)])
    diag_ptr = own_before[row_ptr]
    return Rows(0, diag_ptr, row_ptr - diag_ptr, columns)


def _arrivals(
    owned: Rows,
    row_ptr: GlobalIndex,
    columns: GlobalIndex,
    rows: LocalIndex,
    row_blocks: GlobalIndex,
    arriving: GlobalIndex,
    n_owned: int,
) -> Arrivals:
    """Locate each arriving block in the sorted rows: by (row, column) keys, which both lists are ordered by."""
    width = int(columns.max(initial=0)) + 1
    row = np.repeat(rows, row_blocks).astype(np.int64)
    keys = np.repeat(np.arange(len(row_ptr) - 1, dtype=np.int64), np.diff(row_ptr)) * width + columns
    found = np.searchsorted(keys, row * width + arriving)
    in_diag = arriving < n_owned
    n_diag = np.diff(owned.diag_ptr)
    slot = found - row_ptr[row]
    start = np.asarray(np.where(in_diag, owned.diag_ptr[row], owned.off_ptr[row]))
    blocks = np.where(in_diag, n_diag[row], np.diff(owned.off_ptr)[row])
    return Arrivals(np.asarray(row_blocks), start, np.where(in_diag, slot, slot - n_diag[row]), blocks, in_diag)
