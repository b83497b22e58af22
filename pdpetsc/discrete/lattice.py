"""Families that repeat: particles on a lattice whose whole family is there share one list of steps."""

from __future__ import annotations

import itertools
from collections.abc import Callable
from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np

from pdpetsc.arrays import Float, GlobalIndex, LocalIndex, Mask
from pdpetsc.discrete.cloud import HORIZON_TOLERANCE, Cloud
from pdpetsc.discrete.communicator import agreed, total
from pdpetsc.kernels.repeated import families_of_cells, mark_cells, onto_cells, whole_family

# Positions are on a lattice, and volumes alike, up to this share of the spacing and of the volume.
ON_LATTICE = 1e-10
# Particles closer than this share of the horizon along an axis are in one layer of it.
SAME_LAYER = 1e-6
# A lattice has at most this many cells per particle, so that it is not larger than the body.
MOST_CELLS = 4.0
# Rows of fewer particles with whole families do not repeat: a loop over them costs more than their families.
SHORTEST_ROW = 8


@dataclass(frozen=True)
class Grid:
    """The lattice that all local particles of a rank are on, numbered along its longest axis.

    It is wider than the particles by the reach of a family on every side, so that a step from a particle is a cell.

    Attributes
    ----------
    spacing : (dim,) float64
        Distance of neighbouring cells along each axis [length].
    at : (n_cells,) int32
        The local particle in each cell, -1 where there is none.
    cell : (n_local,) int64
        The cell of each local particle.
    steps : (n_family,) int64
        How many cells away the members of a whole family are.
    axis_steps : (dim,) int64
        How many cells away the next one along each axis is.
    """

    spacing: Float
    at: LocalIndex
    cell: GlobalIndex
    steps: GlobalIndex
    axis_steps: GlobalIndex

    def onto(self, values: Float) -> Float:
        """Return vectors of local particles (n_local, components) as an array on the lattice (components, n_cells)."""
        on_cells = np.zeros((values.shape[1], len(self.at)))
        onto_cells(self.cell, values, on_cells)
        return on_cells


@dataclass(frozen=True)
class Rows:
    """Rows of consecutive cells of a lattice.

    Attributes
    ----------
    starts, lengths : (n_rows,) int64
        First cell and number of cells of each.
    """

    starts: GlobalIndex
    lengths: GlobalIndex

    @property
    def count(self) -> int:
        """Return the cells in all rows."""
        return int(self.lengths.sum())


def rows_of(cells: GlobalIndex, shortest: int = 1) -> Rows:
    """Return the rows of consecutive cells, at least so long, that some cells make."""
    cells = np.sort(cells).astype(np.int64)
    begins = np.concatenate([[True], np.diff(cells) > 1]) if len(cells) else np.empty(0, dtype=bool)
    starts = cells[begins]
    lengths = np.diff(np.append(np.flatnonzero(begins), len(cells)))
    long = lengths >= shortest
    return Rows(starts[long].astype(np.int64), lengths[long].astype(np.int64))


def cells_of(rows: Rows) -> GlobalIndex:
    """Return the cells of rows one after the other."""
    before = np.cumsum(rows.lengths) - rows.lengths
    return np.asarray(np.repeat(rows.starts - before, rows.lengths) + np.arange(rows.count))


def find_grid(cloud: Cloud) -> Grid | None:
    """Return the lattice that the local particles are on; None where they are on none (not collective)."""
    x, dim = cloud.x, cloud.dim
    if not len(x):
        return None
    reach = cloud.horizon * (1.0 + HORIZON_TOLERANCE)
    spacing, index = np.empty(dim), np.empty((len(x), dim), dtype=np.int64)
    for axis in range(dim):
        values = np.unique(x[:, axis])
        apart = np.diff(values)
        apart = apart[apart > SAME_LAYER * cloud.horizon]
        spacing[axis] = apart.min() if len(apart) else 2.0 * reach
        position = (x[:, axis] - values[0]) / spacing[axis]
        nearest = np.rint(position)
        if np.abs(position - nearest).max() > ON_LATTICE:
            return None
        index[:, axis] = nearest
    wide = np.floor(reach / spacing).astype(np.int64)
    extent = index.max(axis=0) + 1 + 2 * wide
    if np.prod(extent.astype(float)) > MOST_CELLS * len(x) + np.prod(2.0 * wide + 2.0):
        return None
    axis_steps = np.ones(dim, dtype=np.int64)
    order = np.argsort(extent, kind="stable")[::-1]
    for before, axis in itertools.pairwise(order):
        axis_steps[axis] = axis_steps[before] * extent[before]
    cell = (index + wide) @ axis_steps
    at = np.full(int(np.prod(extent)), -1, dtype=np.int32)
    at[cell] = np.arange(len(x), dtype=np.int32)
    if np.count_nonzero(at >= 0) < len(x):
        return None
    around = np.array(list(itertools.product(*(range(-int(n), int(n) + 1) for n in wide))), dtype=np.int64)
    length = np.linalg.norm(around * spacing, axis=1)
    around = around[(length > 0.0) & (length <= reach)]
    return Grid(spacing, at, cell, around @ axis_steps, axis_steps)


@dataclass(frozen=True)
class Edge:
    """The own particles whose families do not repeat, and one of the others, as a body of its own.

    Attributes
    ----------
    cloud : Cloud
        Those particles as own ones, the one that stands for all others last, then all members of their families. Its
        ``halo`` is not theirs.
    local : (n,) int32
        The local particle that each is.
    """

    cloud: Cloud
    local: LocalIndex
    indptr: GlobalIndex
    neighbours: LocalIndex

    @property
    def n(self) -> int:
        """Return the number of particles whose families do not repeat."""
        return self.cloud.n_owned - 1


class Repeats:
    """Which own particles share one family, and what is needed to treat the others by themselves.

    Parameters
    ----------
    cloud : Cloud
        Particles of this rank.
    grid : Grid
        The lattice they are on.
    rows : Rows
        Own particles whose families are whole, by cells.
    cut : callable
        Tells which pairs of local particles (n, 2) are no bond.
    """

    def __init__(self, cloud: Cloud, grid: Grid, rows: Rows, cut: Callable[[LocalIndex], Mask]) -> None:
        self.cloud, self.grid, self.rows, self._cut = cloud, grid, rows, cut
        self.shared = np.zeros(cloud.n_owned, dtype=bool)
        self.shared[grid.at[cells_of(rows)]] = True
        self._parts: dict[int, tuple[LocalIndex, Part]] = {}

    def families(self, particles: LocalIndex) -> tuple[GlobalIndex, LocalIndex]:
        """Return the families of own particles as ``indptr`` and local ``neighbours``, in the order of any other."""
        indptr, neighbours = families_of_cells(
            particles, self.grid.cell, self.grid.at, self.grid.steps, self.cloud.order
        )
        number = np.repeat(np.arange(len(particles)), np.diff(indptr))
        kept = ~self._cut(np.stack([particles[number], neighbours], axis=1))
        if not kept.all():
            number, neighbours = number[kept], neighbours[kept]
            indptr = np.concatenate([[0], np.cumsum(np.bincount(number, minlength=len(particles)))]).astype(np.int64)
        return indptr, neighbours

    def with_any(self, marked: Mask) -> Mask:
        """Return which own particles have a marked member in their family (n_owned,), of marks (n_local,)."""
        clean = self.shared.copy()
        whole_family(self.grid.cell, self.grid.at, self.grid.steps, ~marked, clean)
        found = self.shared & ~clean
        edge = self.edge
        hits = np.concatenate([[0], np.cumsum(marked[edge.local[edge.neighbours]], dtype=np.int64)])
        found[edge.local[: edge.n]] = np.diff(hits[edge.indptr])[: edge.n] > 0
        return np.asarray(found)

    def connecting(self) -> tuple[LocalIndex, LocalIndex]:
        """Return both particles of bonds (n,) that connect what all bonds together do."""
        edge, grid = self.edge, self.grid
        steps = grid.axis_steps[np.isin(grid.axis_steps, grid.steps)]
        around = np.concatenate([steps, -steps])
        centres = np.flatnonzero(self.shared).astype(np.int32)
        members = grid.at[grid.cell[centres][:, None] + around]
        number = np.repeat(np.arange(edge.n + 1), np.diff(edge.indptr))
        return (
            np.concatenate([edge.local[number], np.repeat(centres, len(around))]),
            np.concatenate([edge.local[edge.neighbours], members.ravel()]),
        )

    @property
    def n_bonds(self) -> int:
        """Return the bonds of the own particles."""
        return len(self.edge.neighbours) + (self.rows.count - 1) * len(self.grid.steps)

    @cached_property
    def everyone(self) -> LocalIndex:
        """Return the own particles (n_owned,)."""
        return np.arange(self.cloud.n_owned, dtype=np.int32)

    @cached_property
    def on_cells(self) -> Float:
        """Return an array on the lattice (dim dim, n_cells) of zeros, which whoever writes to it clears."""
        return np.zeros((self.cloud.dim**2, len(self.grid.at)))

    @cached_property
    def edge(self) -> Edge:
        """Return the particles whose families do not repeat, with one that stands for the others."""
        cloud = self.cloud
        own = np.append(np.flatnonzero(~self.shared), self.grid.at[self.rows.starts[0]]).astype(np.int32)
        indptr, neighbours = self.families(own)
        beyond = np.zeros(cloud.n_local, dtype=bool)
        beyond[neighbours] = True
        beyond[own] = False
        local = np.concatenate([own, np.flatnonzero(beyond)]).astype(np.int32)
        number = np.empty(cloud.n_local, dtype=np.int32)
        number[local] = np.arange(len(local), dtype=np.int32)
        n = len(own)
        offset, sign = cloud.offset, cloud.sign
        if len(offset):
            offset = np.concatenate([np.zeros((cloud.n_owned, cloud.dim)), offset])[local[n:]]
        if len(sign):
            sign = np.concatenate([np.ones((cloud.n_owned, cloud.dim)), sign])[local[n:]]
        part = replace(
            cloud, x=cloud.x[local], volume=cloud.volume[local], gid=cloud.gid[local], row=cloud.row[local], sets={},
            n_owned=n, offset=offset, sign=sign, place=cloud.place[local],
        )  # fmt: skip
        return Edge(part, local, indptr, number[neighbours])

    def part(self, particles: LocalIndex) -> Part:
        """Return some own particles divided into rows that share a family and others; remembered by the array."""
        known = self._parts.get(id(particles))
        if known is None or known[0] is not particles:
            known = particles, self._divided(particles)
            self._parts[id(particles)] = known
        return known[1]

    def _divided(self, particles: LocalIndex) -> Part:
        chosen = np.zeros(self.cloud.n_owned, dtype=bool)
        chosen[particles] = True
        alone = np.flatnonzero(chosen[self.edge.local[: self.edge.n]]).astype(np.int32)
        rows = rows_of(self.grid.cell[: self.cloud.n_owned][chosen & self.shared])
        reached = np.zeros(len(self.grid.at), dtype=bool)
        mark_cells(rows.starts, rows.lengths, self.grid.steps, reached)
        return Part(alone, rows, rows_of(np.flatnonzero(reached)))


@dataclass(frozen=True)
class Part:
    """Some own particles.

    Attributes
    ----------
    alone : (n,) int32
        Those whose families do not repeat, by their number in ``Edge``.
    rows, reached : Rows
        The cells of the others, and those with the members of their families.
    """

    alone: LocalIndex
    rows: Rows
    reached: Rows


def find_repeats(cloud: Cloud, cut: Callable[[LocalIndex], Mask], least: float) -> Repeats | None:
    """Return which families repeat; None on all ranks where fewer than a share ``least`` of all do.

    Parameters
    ----------
    cut : callable
        Tells which pairs of local particles (n, 2) are no bond.

    Notes
    -----
    Collective.
    """
    grid = find_grid(cloud)
    with agreed(cloud.comm):
        rows = _whole_rows(cloud, grid, cut)
    counts = total(cloud.comm, [rows.count, int(rows.count == 0)])
    if int(counts[1]) or counts[0] < least * cloud.n_global:
        return None
    assert grid is not None
    return Repeats(cloud, grid, rows, cut)


def _whole_rows(cloud: Cloud, grid: Grid | None, cut: Callable[[LocalIndex], Mask]) -> Rows:
    """Return the rows of own particles whose families are whole and of particles of the usual volume."""
    if grid is None or not cloud.n_owned:
        return rows_of(np.empty(0, dtype=np.int64))
    typical = float(np.median(cloud.volume[: cloud.n_owned]))
    good = np.abs(cloud.volume - typical) <= ON_LATTICE * typical
    whole = good[: cloud.n_owned].copy()
    for step in grid.steps[grid.steps > 0]:
        other = grid.at[np.minimum(grid.cell + step, len(grid.at) - 1)]
        pairs = np.stack([np.arange(cloud.n_local, dtype=np.int32), other], axis=1)[other >= 0]
        ends = pairs[cut(pairs)].ravel()
        whole[ends[ends < cloud.n_owned]] = False
    whole_family(grid.cell, grid.at, grid.steps, good, whole)
    return rows_of(grid.cell[: cloud.n_owned][whole], SHORTEST_ROW)
