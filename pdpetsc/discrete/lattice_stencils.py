"""Lattice stencils: particles on a lattice with the same family share one list of steps."""

from __future__ import annotations

import itertools
from collections.abc import Callable
from dataclasses import dataclass, replace
from functools import cached_property
from typing import TypeVar

import numpy as np
from numpy.typing import NDArray

from pdpetsc.arrays import Float, GlobalIndex, LocalIndex, Mask, row_of_entries, starts_of
from pdpetsc.discrete.cloud import HORIZON_TOLERANCE, Cloud
from pdpetsc.discrete.communicator import agreed, total
from pdpetsc.kernels.lattice_stencils import cells_with_any, families_of_cells, family_keys, onto_cells, order_keys
from pdpetsc.kernels.sparsity import families_with_any

Number = TypeVar("Number", bound=np.generic)
Answer = TypeVar("Answer")

# Positions are on a lattice, and volumes are equal, up to this share of the spacing and of the volume.
ON_LATTICE = 1e-10
# Particles closer than this share of the horizon along an axis are in the same layer.
SAME_LAYER = 1e-6
# Largest number of cells per particle, so that the lattice is not larger than the body.
MOST_CELLS = 4.0
# Families are shared in rows of at least SHORTEST_ROW consecutive cells, and by at least FEWEST particles. A loop over
# fewer costs more than listed families.
SHORTEST_ROW, FEWEST = 8, 24
# Longer rows are divided, so that the data of a loop stays in cache.
LONGEST_ROW = 256


@dataclass(frozen=True)
class Grid:
    """Store the lattice of all local particles of a rank, numbered along its longest axis.

    It extends beyond the particles by the reach of a family on every side, so that every step from a particle leads to
    a cell.

    Attributes
    ----------
    spacing : (dim,) float64
        Distance of neighbouring cells along each axis [length].
    at : (n_cells,) int32
        Local particle in each cell, -1 for an empty cell.
    cell : (n_local,) int64
        Cell of each local particle.
    steps : (n_family,) int64
        Differences of cell numbers to the members of a complete family.
    xi : (n_family, dim) float64
        Bonds to these members [length].
    axis_steps : (dim,) int64
        Difference of cell numbers to the next cell along each axis.
    """

    spacing: Float
    at: LocalIndex
    cell: GlobalIndex
    steps: GlobalIndex
    xi: Float
    axis_steps: GlobalIndex

    def rows(self, particles: LocalIndex) -> Rows:
        """Return the rows of the cells of local particles (n,), the same ones for the same array."""
        kept: dict[int, tuple[LocalIndex, Rows]] = self.__dict__.setdefault("_rows", {})
        known = kept.get(id(particles))
        if known is None or known[0] is not particles:
            known = kept[id(particles)] = particles, rows_of(self.cell[particles])
        return known[1]

    def onto(self, values: Float) -> Float:
        """Copy vectors of local particles (n_local, components) to an array on the lattice (components, n_cells)."""
        on_cells = np.zeros((values.shape[1], len(self.at)))
        onto_cells(self.cell, values, on_cells)
        return on_cells


@dataclass(frozen=True)
class Rows:
    """Store rows of consecutive cells of a lattice.

    Attributes
    ----------
    starts, lengths : (n_rows,) int64
        First cell and number of cells of each row.
    """

    starts: GlobalIndex
    lengths: GlobalIndex

    @property
    def count(self) -> int:
        """Return the number of cells in all rows."""
        return int(self.lengths.sum())


def rows_of(cells: GlobalIndex) -> Rows:
    """Build the rows of consecutive cells from cells; no row is longer than ``LONGEST_ROW``."""
    cells = np.sort(cells).astype(np.int64)
    begins = np.concatenate([[True], np.diff(cells) > 1]) if len(cells) else np.empty(0, dtype=bool)
    starts = cells[begins]
    lengths = np.diff(np.append(np.flatnonzero(begins), len(cells))).astype(np.int64)
    pieces = -(-lengths // LONGEST_ROW)
    number = np.arange(int(pieces.sum())) - np.repeat(np.cumsum(pieces) - pieces, pieces)
    lengths, starts = np.repeat(lengths, pieces), np.repeat(starts, pieces) + LONGEST_ROW * number
    return Rows(starts, np.minimum(lengths - LONGEST_ROW * number, LONGEST_ROW))


def find_grid(cloud: Cloud) -> Grid | None:
    """Find the lattice of the local particles; None if they are on none (not collective)."""
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
    return Grid(spacing, at, cell, around @ axis_steps, around * spacing, axis_steps)


def positions_on_lattice(x: Float, horizon: float) -> tuple[Float, GlobalIndex] | None:
    """Find the spacing (dim,) of the lattice of points (n, dim), and their positions on it; None if there is none.

    Not collective.
    """
    if not len(x):
        return None
    spacing, index = np.empty(x.shape[1]), np.empty(x.shape, dtype=np.int64)
    for axis in range(x.shape[1]):
        values = np.unique(x[:, axis])
        apart = np.diff(values)
        apart = apart[apart > SAME_LAYER * horizon]
        # A single layer has no neighbour layer in a family.
        spacing[axis] = 3.0 * horizon
        if len(apart):
            # Rounding of the positions would accumulate from cell to cell, so the spacing is computed from the whole
            # extent.
            extent = values[-1] - values[0]
            spacing[axis] = extent / np.rint(extent / apart.min())
        position = (x[:, axis] - values[0]) / spacing[axis]
        nearest = np.rint(position)
        if np.abs(position - nearest).max() > ON_LATTICE:
            return None
        index[:, axis] = nearest
    return spacing, index


def listed_families(
    cloud: Cloud, grid: Grid, particles: LocalIndex, cut: Callable[[LocalIndex], Mask] | None
) -> tuple[GlobalIndex, LocalIndex]:
    """Return the families of own particles as ``indptr`` and local ``neighbours``, in the order of ``Families``.

    ``cut`` marks pairs of local particles (n, 2) without bond.
    """
    indptr, neighbours = families_of_cells(particles, grid.cell, grid.at, grid.steps, cloud.order)
    if cut is not None:
        number = row_of_entries(indptr)
        kept = ~cut(np.stack([particles[number], neighbours], axis=1))
        number, neighbours = number[kept], neighbours[kept]
        indptr = starts_of(np.bincount(number, minlength=len(particles)))
    return indptr, neighbours


@dataclass(frozen=True)
class IrregularRest:
    """Store the own particles with irregular families, and one representative of each pattern, as a separate body.

    Attributes
    ----------
    cloud : Cloud
        These particles as own ones, representatives last, then all members of their families. ``halo`` is not valid.
    local : (n,) int32
        Local particle of each.
    indptr, neighbours
        Families as in ``Families``.
    n : int
        Number of particles with irregular families.
    """

    cloud: Cloud
    local: LocalIndex
    indptr: GlobalIndex
    neighbours: LocalIndex
    n: int

    def add(self, onto: Float, work: Callable[[Float], Answer]) -> Answer:
        """Add what ``work`` adds to values of this body (n, ...) to values of all local particles (n_local, ...)."""
        part = np.zeros((len(self.local), *onto.shape[1:]))
        answer = work(part)
        onto[self.local] += part
        return answer


@dataclass(frozen=True)
class Part:
    """Store a subset of the own particles.

    Attributes
    ----------
    alone : (n,) int32
        Particles with irregular families, by their number in ``IrregularRest``.
    rows : Rows
        Cells of the others.
    pattern : (n_rows,) int64
        Pattern of each row.
    """

    alone: LocalIndex
    rows: Rows
    pattern: GlobalIndex

    @property
    def loop(self) -> tuple[GlobalIndex, GlobalIndex, GlobalIndex]:
        """Return starts, lengths and patterns of the rows, the arguments of loops over rows."""
        return self.rows.starts, self.rows.lengths, self.pattern


class LatticeStencils:
    """Store which own particles of a lattice share a family, and the irregular rest.

    Particles have the same pattern if their families have the same steps: complete families inside, and families at a
    flat face or a crack that are cut in the same way.

    Parameters
    ----------
    cloud : Cloud
        Particles of this rank.
    grid : Grid
        Lattice of the particles.
    pattern_of : (n_owned,) int64
        Pattern of each own particle, -1 for an irregular family.
    cut : callable
        Marks pairs of local particles (n, 2) without bond.
    """

    def __init__(
        self, cloud: Cloud, grid: Grid, pattern_of: GlobalIndex, cut: Callable[[LocalIndex], Mask] | None
    ) -> None:
        self.cloud, self.grid, self.pattern_of, self._cut = cloud, grid, pattern_of, cut
        self.shared: Mask = pattern_of >= 0
        self.n_patterns = int(pattern_of.max(initial=-1)) + 1
        self._parts: dict[int, tuple[LocalIndex, Part]] = {}

    def families(self, particles: LocalIndex) -> tuple[GlobalIndex, LocalIndex]:
        """Return the families of own particles as ``indptr`` and local ``neighbours``, in the order of ``Families``."""
        return listed_families(self.cloud, self.grid, particles, self._cut)

    def of_shared(self, values: NDArray[Number]) -> NDArray[Number]:
        """Return the value of its pattern (n_patterns, ...) for each particle with a shared family (n_shared, ...)."""
        return np.asarray(values[self.pattern_of[self.shared]])

    @cached_property
    def represented_by(self) -> LocalIndex:
        """Return the number in ``irregular`` of each own particle, or of the representative of its pattern."""
        own, found = self.irregular, np.empty(self.cloud.n_owned, dtype=np.int32)
        found[own.local[: own.n]] = np.arange(own.n)
        found[self.shared] = own.n + self.pattern_of[self.shared]
        return found

    def translated(self, particles: LocalIndex, size: GlobalIndex, of: LocalIndex) -> LocalIndex:
        """Translate members about representatives to the members (n_entries,) about own particles.

        Parameters
        ----------
        particles : (n,) int32
            Own particles.
        size : (n,) int64
            Number of members of each.
        of : (n_entries,) int32
            Members about the particles of ``represented_by``, by their number in ``irregular``.
        """
        cell, local = self.grid.cell, self.irregular.local
        shift = cell[particles] - cell[local[self.represented_by[particles]]]
        return np.asarray(self.grid.at[cell[local[of]] + np.repeat(shift, size)])

    def with_any(self, marked: Mask) -> Mask:
        """Return which own particles have a marked member in their family (n_owned,), for marks (n_local,)."""
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
        """Return both particles of bonds (n,) with the same connectivity as all bonds together."""
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
        """Return the number of bonds of the own particles."""
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
        """Return an array of zeros on the lattice (dim, n_cells); every function that writes to it must clear it."""
        return np.zeros((self.cloud.dim, len(self.grid.at)))

    @cached_property
    def steps(self) -> list[GlobalIndex]:
        """Return the steps to the members of each pattern, in the order of its representative."""
        irregular = self.irregular
        cell = self.grid.cell[irregular.local]
        return [
            cell[irregular.neighbours[irregular.indptr[own] : irregular.indptr[own + 1]]] - cell[own]
            for own in range(irregular.n, irregular.n + self.n_patterns)
        ]

    @cached_property
    def irregular(self) -> IrregularRest:
        """Return the particles with irregular families, and a representative of each pattern."""
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
        """Divide own particles into rows with a shared family and irregular ones; cached for the array."""
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
    """Find the shared families; None on all ranks if fewer than a share ``least`` of the particles share one.

    Parameters
    ----------
    cut : callable, optional
        Marks pairs of local particles (n, 2) without bond.
    in_order : bool
        Whether particles share a family only if they list its members in the same order. Otherwise the listed order of
        a representative may differ from that of the others, and on another number of ranks again.

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
    """Return the pattern of each own particle (n_owned,), -1 if too few share it or they are too far apart."""
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
    """Return the steps of a family along the axes, and those that steps along axes do not reach within it."""
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
