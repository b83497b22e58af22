"""Families that repeat: particles on a lattice whose whole family is there share one list of steps."""

from __future__ import annotations

import itertools
from collections.abc import Callable
from dataclasses import dataclass, replace
from functools import cached_property
from typing import TypeVar

import numpy as np
from numpy.typing import NDArray

from pdpetsc.arrays import Float, GlobalIndex, LocalIndex, Mask
from pdpetsc.discrete.cloud import HORIZON_TOLERANCE, Cloud
from pdpetsc.discrete.communicator import agreed, total
from pdpetsc.kernels.lattice_stencils import cells_with_any, families_of_cells, family_keys, onto_cells, order_keys
from pdpetsc.kernels.sparsity import families_with_any

Number = TypeVar("Number", bound=np.generic)
Answer = TypeVar("Answer")

# Positions are on a lattice, and volumes alike, up to this share of the spacing and of the volume.
ON_LATTICE = 1e-10
# Particles closer than this share of the horizon along an axis are in one layer of it.
SAME_LAYER = 1e-6
# A lattice has at most this many cells per particle, so that it is not larger than the body.
MOST_CELLS = 4.0
# Families repeat in rows of at least so many consecutive cells, and where so many particles share one: a loop over
# fewer costs more than their families.
SHORTEST_ROW, FEWEST = 8, 24
# Longer rows are divided, so that what a loop reads of them stays in cache.
LONGEST_ROW = 256


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


def rows_of(cells: GlobalIndex) -> Rows:
    """Return the rows of consecutive cells that some cells make, none longer than ``LONGEST_ROW``."""
    cells = np.sort(cells).astype(np.int64)
    begins = np.concatenate([[True], np.diff(cells) > 1]) if len(cells) else np.empty(0, dtype=bool)
    starts = cells[begins]
    lengths = np.diff(np.append(np.flatnonzero(begins), len(cells))).astype(np.int64)
    pieces = -(-lengths // LONGEST_ROW)
    number = np.arange(int(pieces.sum())) - np.repeat(np.cumsum(pieces) - pieces, pieces)
    lengths, starts = np.repeat(lengths, pieces), np.repeat(starts, pieces) + LONGEST_ROW * number
    return Rows(starts, np.minimum(lengths - LONGEST_ROW * number, LONGEST_ROW))


def find_grid(cloud: Cloud) -> Grid | None:
    """Return the lattice that the local particles are on; None where they are on none (not collective)."""
    x, dim = cloud.x, cloud.dim
    found = positions_on_lattice(x, cloud.horizon)
    if found is None:
        return None
    spacing, index = found
    reach = cloud.horizon * (1.0 + HORIZON_TOLERANCE)
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


def positions_on_lattice(x: Float, horizon: float) -> tuple[Float, GlobalIndex] | None:
    """Return the spacing (dim,) of the lattice that points (n, dim) are on, and their places on it; None without one.

    Not collective.
    """
    if not len(x):
        return None
    spacing, index = np.empty(x.shape[1]), np.empty(x.shape, dtype=np.int64)
    for axis in range(x.shape[1]):
        values = np.unique(x[:, axis])
        apart = np.diff(values)
        apart = apart[apart > SAME_LAYER * horizon]
        # A single layer has no member of a family beside it.
        spacing[axis] = 3.0 * horizon
        if len(apart):
            # Rounding of the positions would add up from cell to cell, so the spacing is that of all cells together.
            extent = values[-1] - values[0]
            spacing[axis] = extent / np.rint(extent / apart.min())
        position = (x[:, axis] - values[0]) / spacing[axis]
        nearest = np.rint(position)
        if np.abs(position - nearest).max() > ON_LATTICE:
            return None
        index[:, axis] = nearest
    return spacing, index


@dataclass(frozen=True)
class IrregularRest:
    """The own particles whose families do not repeat, and one of each pattern of the others, as a body of its own.

    Attributes
    ----------
    cloud : Cloud
        Those particles as own ones, the ones that stand for a pattern last, then all members of their families. Its
        ``halo`` is not theirs.
    local : (n,) int32
        The local particle that each is.
    indptr, neighbours
        Families as in ``Families``.
    n : int
        The number of particles whose families do not repeat.
    """

    cloud: Cloud
    local: LocalIndex
    indptr: GlobalIndex
    neighbours: LocalIndex
    n: int

    def add(self, onto: Float, work: Callable[[Float], Answer]) -> Answer:
        """Add to values of all local particles (n_local, ...) what ``work`` adds to those of this body (n, ...)."""
        part = np.zeros((len(self.local), *onto.shape[1:]))
        answer = work(part)
        onto[self.local] += part
        return answer


@dataclass(frozen=True)
class Part:
    """Some own particles.

    Attributes
    ----------
    alone : (n,) int32
        Those whose families do not repeat, by their number in ``IrregularRest``.
    rows : Rows
        The cells of the others.
    pattern : (n_rows,) int64
        The pattern of each row.
    """

    alone: LocalIndex
    rows: Rows
    pattern: GlobalIndex

    @property
    def loop(self) -> tuple[GlobalIndex, GlobalIndex, GlobalIndex]:
        """Return starts, lengths and patterns of the rows, as loops over rows take them."""
        return self.rows.starts, self.rows.lengths, self.pattern


class LatticeStencils:
    """Which own particles of a lattice share a family, and what is needed to treat the others by themselves.

    Particles have the same pattern where their families have the same steps: whole ones inside, and on a flat face or
    beside a crack those that it cuts alike.

    Parameters
    ----------
    cloud : Cloud
        Particles of this rank.
    grid : Grid
        The lattice they are on.
    pattern_of : (n_owned,) int64
        The pattern of each own particle, -1 where its family does not repeat.
    cut : callable
        Tells which pairs of local particles (n, 2) are no bond.
    """

    def __init__(
        self, cloud: Cloud, grid: Grid, pattern_of: GlobalIndex, cut: Callable[[LocalIndex], Mask] | None
    ) -> None:
        self.cloud, self.grid, self.pattern_of, self._cut = cloud, grid, pattern_of, cut
        self.shared: Mask = pattern_of >= 0
        self.n_patterns = int(pattern_of.max(initial=-1)) + 1
        self._parts: dict[int, tuple[LocalIndex, Part]] = {}

    def families(self, particles: LocalIndex) -> tuple[GlobalIndex, LocalIndex]:
        """Return the families of own particles as ``indptr`` and local ``neighbours``, in the order of any other."""
        grid = self.grid
        indptr, neighbours = families_of_cells(particles, grid.cell, grid.at, grid.steps, self.cloud.order)
        if self._cut is not None:
            number = np.repeat(np.arange(len(particles)), np.diff(indptr))
            kept = ~self._cut(np.stack([particles[number], neighbours], axis=1))
            number, neighbours = number[kept], neighbours[kept]
            indptr = np.concatenate([[0], np.cumsum(np.bincount(number, minlength=len(particles)))]).astype(np.int64)
        return indptr, neighbours

    def of_shared(self, values: NDArray[Number]) -> NDArray[Number]:
        """Return what a pattern has for each particle that shares it (n_shared, ...), of (n_patterns, ...)."""
        return np.asarray(values[self.pattern_of[self.shared]])

    @cached_property
    def represented_by(self) -> LocalIndex:
        """Return the number in ``irregular`` of each own particle, or of the one that stands for its pattern."""
        own, found = self.irregular, np.empty(self.cloud.n_owned, dtype=np.int32)
        found[own.local[: own.n]] = np.arange(own.n)
        found[self.shared] = own.n + self.pattern_of[self.shared]
        return found

    def translated(self, particles: LocalIndex, size: GlobalIndex, of: LocalIndex) -> LocalIndex:
        """Return members (n_entries,) about own particles that lie as others do about those which stand for them.

        Parameters
        ----------
        particles : (n,) int32
            Own particles.
        size : (n,) int64
            Number of members of each.
        of : (n_entries,) int32
            The members of the particles that ``represented_by`` names, by their number in ``irregular``.
        """
        cell, local = self.grid.cell, self.irregular.local
        shift = cell[particles] - cell[local[self.represented_by[particles]]]
        return np.asarray(self.grid.at[cell[local[of]] + np.repeat(shift, size)])

    def with_any(self, marked: Mask) -> Mask:
        """Return which own particles have a marked member in their family (n_owned,), of marks (n_local,)."""
        found = np.zeros(self.cloud.n_owned, dtype=bool)
        irregular = self.irregular
        of_irregular = np.empty(irregular.cloud.n_owned, dtype=bool)
        families_with_any(irregular.indptr, irregular.neighbours, marked[irregular.local], of_irregular)
        found[irregular.local[: irregular.n]] = of_irregular[: irregular.n]
        for number, steps in enumerate(self.steps):
            own = np.flatnonzero(self.pattern_of == number)
            hit = np.empty(len(own), dtype=bool)
            cells_with_any(self.grid.cell[own], self.grid.at, steps, marked, hit)
            found[own] = hit
        return found

    def connecting(self) -> tuple[LocalIndex, LocalIndex]:
        """Return both particles of bonds (n,) that connect what all bonds together do."""
        irregular, grid = self.irregular, self.grid
        number = np.repeat(np.arange(irregular.n), np.diff(irregular.indptr)[: irregular.n])
        one, other = [irregular.local[number]], [irregular.local[irregular.neighbours[: len(number)]]]
        along = np.concatenate([grid.axis_steps, -grid.axis_steps])
        for pattern, steps in enumerate(self.steps):
            centres = np.flatnonzero(self.pattern_of == pattern).astype(np.int32)
            needed = steps if self._cut is not None else _not_along_axes(steps, along)
            one.append(np.repeat(centres, len(needed)))
            other.append(grid.at[grid.cell[centres][:, None] + needed].ravel())
        return np.concatenate(one), np.concatenate(other)

    @property
    def n_bonds(self) -> int:
        """Return the bonds of the own particles."""
        counts = np.bincount(self.pattern_of[self.shared], minlength=self.n_patterns)
        return int(self.irregular.indptr[self.irregular.n]) + sum(
            int(count) * len(steps) for count, steps in zip(counts, self.steps, strict=True)
        )

    @cached_property
    def everyone(self) -> LocalIndex:
        """Return the own particles (n_owned,)."""
        return np.arange(self.cloud.n_owned, dtype=np.int32)

    @cached_property
    def forces_on_cells(self) -> Float:
        """Return an array on the lattice (dim, n_cells) of zeros, which whoever writes to it clears."""
        return np.zeros((self.cloud.dim, len(self.grid.at)))

    @cached_property
    def steps(self) -> list[GlobalIndex]:
        """Return the steps of the members of each pattern, in the order of the one that stands for it."""
        irregular = self.irregular
        cell = self.grid.cell[irregular.local]
        return [
            cell[irregular.neighbours[irregular.indptr[own] : irregular.indptr[own + 1]]] - cell[own]
            for own in range(irregular.n, irregular.n + self.n_patterns)
        ]

    @cached_property
    def irregular(self) -> IrregularRest:
        """Return the particles whose families do not repeat, with one that stands for each pattern of the others."""
        cloud = self.cloud
        alone = np.flatnonzero(~self.shared)
        patterns, first = np.unique(self.pattern_of, return_index=True)
        own = np.concatenate([alone, first[patterns >= 0]]).astype(np.int32)
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
        stands_for = np.ones(n)
        stands_for[len(alone) :] = np.bincount(self.pattern_of[self.shared], minlength=self.n_patterns)
        part = replace(
            cloud, x=cloud.x[local], volume=cloud.volume[local], gid=cloud.gid[local], row=cloud.row[local], sets={},
            n_owned=n, offset=offset, sign=sign, place=cloud.place[local], local_horizon=cloud.local_horizon[local],
            stands_for=stands_for,
        )  # fmt: skip
        return IrregularRest(part, local, indptr, number[neighbours], len(alone))

    @cached_property
    def whole(self) -> Part:
        """Return all own particles."""
        return self.part(self.everyone)

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
        alone = np.flatnonzero(chosen[self.irregular.local[: self.irregular.n]]).astype(np.int32)
        found = []
        for pattern in range(self.n_patterns):
            found.append(rows_of(self.grid.cell[: self.cloud.n_owned][chosen & (self.pattern_of == pattern)]))
        rows = Rows(np.concatenate([one.starts for one in found]), np.concatenate([one.lengths for one in found]))
        return Part(alone, rows, np.repeat(np.arange(self.n_patterns), [len(one.starts) for one in found]))


def find_lattice(
    cloud: Cloud, cut: Callable[[LocalIndex], Mask] | None, least: float, in_order: bool = False
) -> LatticeStencils | None:
    """Return which families repeat; None on all ranks where fewer than a share ``least`` of the particles share one.

    Parameters
    ----------
    cut : callable, optional
        Tells which pairs of local particles (n, 2) are no bond.
    in_order : bool
        Whether particles share a family only where they list its members in the same order. Else what is listed for one
        of them may be in another order than for the others, and on another rank count in a third.

    Notes
    -----
    Collective.
    """
    grid = find_grid(cloud)
    with agreed(cloud.comm):
        found = np.empty(0, dtype=np.int64) if grid is None else _patterns(cloud, grid, cut, in_order)
    shared = int(np.count_nonzero(found >= 0))
    counts = total(cloud.comm, [shared, int(shared == 0)])
    if int(counts[1]) or counts[0] < least * cloud.n_global:
        return None
    assert grid is not None
    return LatticeStencils(cloud, grid, found, cut)


def _patterns(
    cloud: Cloud, grid: Grid, cut: Callable[[LocalIndex], Mask] | None, in_order: bool
) -> GlobalIndex:  # fmt: skip
    """Return the pattern of each own particle (n_owned,), -1 where too few share it or they lie too far apart."""
    n = cloud.n_owned
    typical = float(np.median(cloud.volume[:n])) if n else 0.0
    good = np.abs(cloud.volume - typical) <= ON_LATTICE * typical
    of_steps = np.random.default_rng(1).integers(1, 2**63, len(grid.steps), dtype=np.uint64)
    key, usual = np.empty(n, dtype=np.uint64), np.empty(n, dtype=bool)
    family_keys(grid.cell, grid.at, grid.steps, of_steps, good, key, usual)
    if in_order:
        order_keys(grid.cell, grid.at, grid.steps, of_steps, cloud.order, key)
    for number, step in enumerate(grid.steps if cut is not None else ()):
        assert cut is not None
        other = grid.at[grid.cell[:n] + step]
        pairs = np.stack([np.arange(n, dtype=np.int32), other], axis=1)[other >= 0]
        gone = pairs[cut(pairs), 0]
        key[gone] ^= of_steps[number]
    order = np.argsort(grid.cell[:n])
    cell, ordered = grid.cell[:n][order], key[order]
    begins = np.ones(n, dtype=bool)
    begins[1:] = (np.diff(cell) > 1) | (ordered[1:] != ordered[:-1]) | ~usual[order][1:] | ~usual[order][:-1]
    row = np.cumsum(begins) - 1
    long = np.empty(n, dtype=bool)
    long[order] = (np.bincount(row, minlength=1)[row] >= SHORTEST_ROW) & usual[order]
    kinds, kind, count = np.unique(key[long], return_inverse=True, return_counts=True)
    number_of = np.full(len(kinds), -1, dtype=np.int64)
    many = np.flatnonzero(count >= FEWEST)
    number_of[many] = np.arange(len(many))
    found = np.full(n, -1, dtype=np.int64)
    found[long] = number_of[kind]
    return found


def _not_along_axes(steps: GlobalIndex, along: GlobalIndex) -> GlobalIndex:
    """Return the steps of a family along the axes, and those that moves along them do not reach within it."""
    there = {int(step) for step in steps}
    reached, front = {0}, [0]
    while front:
        at = front.pop()
        for move in along:
            beyond = at + int(move)
            if beyond in there and beyond not in reached:
                reached.add(beyond)
                front.append(beyond)
    near = {int(move) for move in along}
    return np.array([step for step in steps if int(step) in near or int(step) not in reached], dtype=np.int64)
