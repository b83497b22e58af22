"""Rows of a block matrix for loops over stencils: its blocks and the positions of their values.

The value arrays have the layout of a scalar CSR matrix: row ``i`` of block row ``a`` holds, for each of its ``n``
blocks in turn, ``dim`` consecutive values, so block ``q`` starts at ``dim * dim * ptr[a] + i * dim * n + dim * q``. The
blocks of a row are first in ``diag`` (columns of this rank), then in ``off``.
"""

from __future__ import annotations

from typing import NamedTuple

from pdpetsc.arrays import Float, GlobalIndex, LocalIndex
from pdpetsc.kernels.compile import compiled


class RowLayout(NamedTuple):
    """Block rows of consecutive local particles, and their stencils.

    Attributes
    ----------
    first : int
        Local particle of the first row.
    diag_ptr, off_ptr : (n_rows + 1,) int64
        Blocks of each row in own and in other columns.
    columns : (n_blocks,) int64
        Column of every block, own columns of a row first.
    local_ptr, locals_of : (n_columns + 1,) int64, (n_local,) int32
        Local particles of a column ``c``, none if only other ranks add to it:
        ``locals_of[local_ptr[c] : local_ptr[c + 1]]``.
    behind, signs : (n_local,) int32, (n_mirrors, components) float64
        Rows and columns of a particle behind mirror planes are multiplied by ``signs[behind[a]]``.
    entry_ptr, entries, entry_point : (n_local + 1,) int64, (n_entries,) int64, (n_entries,) int32
        Entries of the stencils that contain each local particle, and the stencil of each entry.
    """

    first: int
    diag_ptr: GlobalIndex
    off_ptr: GlobalIndex
    columns: GlobalIndex
    local_ptr: GlobalIndex
    locals_of: LocalIndex
    behind: LocalIndex
    signs: Float
    entry_ptr: GlobalIndex
    entries: GlobalIndex
    entry_point: LocalIndex


@compiled
def blocks_of_row(layout, row):
    """Return the number of blocks of a row in own and in other columns."""
    n_diag = layout.diag_ptr[row + 1] - layout.diag_ptr[row]
    return n_diag, layout.off_ptr[row + 1] - layout.off_ptr[row]


@compiled
def widest_row(layout):
    """Return the largest number of blocks of a row."""
    widest = 0
    for row in range(layout.diag_ptr.size - 1):
        n_diag, n_off = blocks_of_row(layout, row)
        widest = max(widest, n_diag + n_off)
    return widest


@compiled
def find_slots(layout, row, slot, mirrors=0):
    """Write to ``slot`` (n_local,) the number of the block of each local particle with a block in the row.

    Particles behind mirror planes have numbers that are ``behind`` times ``mirrors`` higher. Return the number of
    blocks of the row.
    """
    begin = layout.diag_ptr[row] + layout.off_ptr[row]
    n_diag, n_off = blocks_of_row(layout, row)
    for q in range(n_diag + n_off):
        column = layout.columns[begin + q]
        for c in range(layout.local_ptr[column], layout.local_ptr[column + 1]):
            k = layout.locals_of[c]
            slot[k] = mirrors * layout.behind[k] + q
    return n_diag + n_off


@compiled
def add_row(layout, row, blocks, diag, off):
    """Add the blocks of a row (n_blocks, dim, dim) to the values."""
    n_diag, n_off = blocks_of_row(layout, row)
    dim = blocks.shape[1]
    for i in range(dim):
        start = dim * (dim * layout.diag_ptr[row] + i * n_diag)
        for q in range(n_diag):
            for k in range(dim):
                diag[start + dim * q + k] += blocks[q, i, k]
        start = dim * (dim * layout.off_ptr[row] + i * n_off)
        for q in range(n_off):
            for k in range(dim):
                off[start + dim * q + k] += blocks[n_diag + q, i, k]
