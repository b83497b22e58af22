"""The gradient operator of a body on a lattice whose families repeat: one list of weights for most particles."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property

import numpy as np

from pdpetsc.arrays import Float, GlobalIndex, LocalIndex
from pdpetsc.discrete.lattice import Part, Repeats, cells_of
from pdpetsc.gradient.base import GradientOperator, Product, SameGradient
from pdpetsc.kernels.repeated import (
    clear_rows,
    points_to_rows,
    rows_force_kernel,
    rows_gradient_kernel,
    rows_springs_kernel,
    rows_stress_kernel,
    rows_to_points,
)

# Weights of opposite members are opposite up to this share of the largest.
OPPOSITE = 1e-12


@dataclass(frozen=True)
class Entries:
    """The weights of one point of the family that repeats, opposite members with opposite weights taken together.

    Attributes
    ----------
    plus, minus : (n,) int64
        Steps in cells: the entry takes the difference of the displacements there; ``minus`` is 0 for a single member.
    g : (n, dim) float64
        Weights [1 / length].
    """

    plus: GlobalIndex
    minus: GlobalIndex
    g: Float


def paired(steps: GlobalIndex, g: Float) -> Entries:
    """Return the entries of a point for its members (n,) and their weights (n, dim)."""
    where = {int(step): number for number, step in enumerate(steps)}
    size = float(np.abs(g).max(initial=0.0))
    plus, minus, weights = [], [], []
    taken = np.zeros(len(steps), dtype=bool)
    for number, step in enumerate(steps):
        if taken[number]:
            continue
        other = where.get(-int(step), number)
        opposite = other != number and bool(np.abs(g[number] + g[other]).max() <= OPPOSITE * size)
        if opposite:
            taken[other] = True
        plus.append(step)
        minus.append(-step if opposite else 0)
        weights.append(0.5 * (g[number] - g[other]) if opposite else g[number])
    return Entries(np.array(plus, dtype=np.int64), np.array(minus, dtype=np.int64), np.array(weights))


class RepeatedOperator(GradientOperator):
    """``GradientOperator`` that keeps the weights of one family for all particles that share it.

    ``g``, ``members`` and ``point_ptr`` list all weights for whoever asks for them.

    Parameters
    ----------
    edge : GradientOperator
        The operator of the particles whose families do not repeat, and of one of the others as the last.
    repeats : Repeats
        Which do.
    """

    def __init__(self, edge: GradientOperator, repeats: Repeats) -> None:
        own, shared = repeats.edge, repeats.shared
        first = int(edge.points_of[own.n])
        each = edge.n_points - first
        count = np.full(len(shared), each)
        count[own.local[: own.n]] = np.diff(edge.points_of)[: own.n]
        owner = np.repeat(np.arange(len(shared), dtype=np.int32), count)
        alone = ~shared[owner]
        volume = np.empty(len(owner))
        volume[alone] = edge.volume[:first]
        volume[~alone] = np.tile(edge.volume[first:], int(np.count_nonzero(shared)))
        cell = repeats.grid.cell[own.local]
        lists, centres = [], []
        for p in range(first, edge.n_points):
            entries = slice(int(edge.point_ptr[p]) + 1, int(edge.point_ptr[p + 1]))
            lists.append((cell[edge.members[entries]] - cell[own.n], edge.g[entries]))
            centres.append(edge.g[int(edge.point_ptr[p])])
        self.__dict__.update(
            owner=owner, volume=volume, note=edge.note, _edge=edge, _repeats=repeats, _alone=np.flatnonzero(alone),
            _first=first, _lists=lists, _centres=centres, _entries=[paired(*one) for one in lists], _on_cells=None,
        )  # fmt: skip

    owner: LocalIndex
    volume: Float
    _edge: GradientOperator
    _repeats: Repeats
    _alone: GlobalIndex
    _first: int
    _lists: list[tuple[GlobalIndex, Float]]
    _centres: list[Float]
    _entries: list[Entries]

    @property
    def edge(self) -> GradientOperator:
        """Return the operator of the particles whose families do not repeat."""
        return self._edge

    @property
    def repeats(self) -> Repeats:
        """Return which families repeat."""
        return self._repeats

    @property
    def entries(self) -> list[Entries]:
        """Return the weights of each point of the family that repeats."""
        return self._entries

    @property
    def point_volumes(self) -> Float:
        """Return the volumes of the points of the family that repeats."""
        return self._edge.volume[self._first :]

    @property
    def alone(self) -> GlobalIndex:
        """Return the points of particles whose families do not repeat."""
        return self._alone

    def alone_values(self, values: Float) -> Float:
        """Return values of points (n_points, ...) as ``edge`` takes them: zero for the particle of the others."""
        found = np.zeros((self._edge.n_points, *values.shape[1:]))
        found[: self._first] = values[self._alone]
        return found

    def gradient(self, u: Float) -> Float:
        """Return ``H_p = sum_k u_k (x) g_pk`` (n_points, dim, dim) for ``u`` (n_local, dim)."""
        repeats, dim = self._repeats, u.shape[1]
        rows, grid, on_cells = repeats.rows, repeats.grid, repeats.on_cells
        H = np.empty((self.n_points, dim, dim))
        H[self._alone] = self._edge.gradient(u[repeats.edge.local])[: self._first]
        u_cells = grid.onto(u)
        for number, one in enumerate(self._entries):
            rows_gradient_kernel(dim)(rows.starts, rows.lengths, one.plus, one.minus, one.g, u_cells, on_cells)
            rows_to_points(rows.starts, rows.lengths, grid.at, self.points_of, number, on_cells, H)
        clear_rows(rows.starts, rows.lengths, on_cells)
        return H

    def divergence(self, P: Float, f: Float) -> None:
        """Add ``sum_p W_p P_p g_pk`` to ``f`` (n_local, dim)."""
        repeats, dim = self._repeats, f.shape[1]
        grid, on_cells = repeats.grid, repeats.on_cells
        whole = repeats.part(repeats.everyone)
        rows, reached = whole.rows, whole.reached
        local = repeats.edge.local
        forces = np.zeros((len(local), dim))
        self._edge.divergence(self.alone_values(P), forces)
        f[local] += forces
        for number, one in enumerate(self._entries):
            W = float(self.point_volumes[number])
            points_to_rows(rows.starts, rows.lengths, grid.at, self.points_of, number, W, P, on_cells)
            data = one.plus, one.minus, one.g, on_cells
            rows_force_kernel(dim)(reached.starts, reached.lengths, grid.at, *data, f)
        clear_rows(rows.starts, rows.lengths, on_cells)

    def product(self, A: Float, h: Float | None = None) -> Product:
        """Return ``G^T (W A) G``; with other weights ``h`` of forces all weights are listed."""
        return RepeatedProduct(self, A) if h is None else self.listed.product(A, h)

    @cached_property
    def listed(self) -> GradientOperator:
        """Return the operator with all weights listed (not collective)."""
        repeats, edge = self._repeats, self._edge
        at, cell, local = repeats.grid.at, repeats.grid.cell, repeats.edge.local
        sizes = np.empty(self.n_points, dtype=np.int64)
        sizes[self._alone] = np.diff(edge.point_ptr)[: self._first]
        together = np.ones(self.n_points, dtype=bool)
        together[self._alone] = False
        each = np.array([len(steps) + 1 for steps, _ in self._lists])
        sizes[together] = np.tile(each, np.count_nonzero(together) // len(each))
        ptr = np.concatenate([[0], np.cumsum(sizes)]).astype(np.int64)
        members = np.empty(int(ptr[-1]), dtype=np.int32)
        g = np.empty((int(ptr[-1]), repeats.cloud.dim))
        entries = np.zeros(int(ptr[-1]), dtype=bool)
        of_alone = np.zeros(self.n_points, dtype=bool)
        of_alone[self._alone] = True
        entries[np.repeat(of_alone, sizes)] = True
        last = int(edge.point_ptr[self._first])
        members[entries], g[entries] = local[edge.members[:last]], edge.g[:last]
        centres = np.flatnonzero(repeats.shared)
        for number, (steps, weights) in enumerate(self._lists):
            start = ptr[self.points_of[centres] + number]
            members[start], g[start] = centres, self._centres[number]
            for k, step in enumerate(steps):
                members[start + 1 + k], g[start + 1 + k] = at[cell[centres] + step], weights[k]
        return GradientOperator(self.owner, ptr, members, g, self.volume, self.note)

    @property
    def point_ptr(self) -> GlobalIndex:
        """Return where the members of each point start."""
        return self.listed.point_ptr

    @property
    def members(self) -> LocalIndex:
        """Return the members of all points."""
        return self.listed.members

    @property
    def g(self) -> Float:
        """Return the weights of all members."""
        return self.listed.g


class RepeatedProduct(Product):
    """``G^T (W A) G`` of an operator whose weights repeat, with the forces of a control on the same gradient.

    Parameters
    ----------
    operator : RepeatedOperator
        The gradient.
    A : (n_points, dim, dim, dim, dim) float64
        Moduli [stress].
    """

    def __init__(self, operator: RepeatedOperator, A: Float) -> None:
        self._operator, self._A = operator, A
        self._alone = operator.edge.product(operator.alone_values(A))
        self._same: RepeatedGradient | None = None

    def absorb(self, same: SameGradient | None) -> bool:
        """Add the forces of a control that uses the same gradient from now on; return whether it can."""
        if self._same is not None or not isinstance(same, RepeatedGradient):
            return False
        self._same = same
        return self._alone.absorb(same.edge)

    def add(self, particles: LocalIndex, u: Float, f: Float) -> None:
        """Add the forces of the points of some own particles for displacements (n_local, dim)."""
        operator, dim = self._operator, u.shape[1]
        repeats, grid, on_cells = operator.repeats, operator.repeats.grid, operator.repeats.on_cells
        part, local = repeats.part(particles), repeats.edge.local
        if len(part.alone):
            forces = np.zeros((len(local), dim))
            self._alone.add(part.alone, u[local], forces)
            f[local] += forces
        rows, reached = part.rows, part.reached
        if not rows.count:
            return
        u_cells = grid.onto(u)
        scale, K = (np.empty(0), np.empty((0, 0))) if self._same is None else self._same.of_part(part)
        for number, one in enumerate(operator.entries):
            rows_gradient_kernel(dim)(rows.starts, rows.lengths, one.plus, one.minus, one.g, u_cells, on_cells)
            W = float(operator.point_volumes[number])
            moduli = operator.points_of, number, self._A, W, scale, K
            rows_stress_kernel(dim)(rows.starts, rows.lengths, grid.at, *moduli, on_cells)
            data = one.plus, one.minus, one.g, on_cells
            rows_force_kernel(dim)(reached.starts, reached.lengths, grid.at, *data, f)
        clear_rows(rows.starts, rows.lengths, on_cells)
        if self._same is not None:
            self._same.add_springs(part, u_cells, f)


class RepeatedGradient(SameGradient):
    """A control on the gradient of a whole family, ``1/2 sum_i c_i sum_j w_ij |eta_ij - H_i xi_ij|^2``.

    Parameters
    ----------
    repeats : Repeats
        Which particles share one family.
    edge : SameGradient
        The control of the particles whose families do not repeat.
    half, weight
        Steps to one of every two opposite members, and their ``w_ij`` [force / length].
    K : (dim, dim) float64
        ``sum_j w_ij xi (x) xi`` [force length].
    scale : (n_owned,) float64
        ``c_i`` [-].
    """

    def __init__(
        self, repeats: Repeats, edge: SameGradient, half: GlobalIndex, weight: Float, K: Float, scale: Float
    ) -> None:
        self._repeats, self.edge = repeats, edge
        self.half, self.weight, self.K, self._scale = half, weight, K, scale
        self._of_parts: dict[int, tuple[Part, Float]] = {}

    def of_part(self, part: Part) -> tuple[Float, Float]:
        """Return ``c`` on the lattice (n_cells,), zero but at the rows of a part, and K."""
        known = self._of_parts.get(id(part))
        if known is None:
            grid = self._repeats.grid
            cells, on_cells = cells_of(part.rows), np.zeros(len(grid.at))
            on_cells[cells] = self._scale[grid.at[cells]]
            known = self._of_parts[id(part)] = part, on_cells
        return known[1], self.K

    def add_springs(self, part: Part, u_cells: Float, f: Float) -> None:
        """Add ``c_i w_ij eta_ij`` to the members of the rows of a part, and its opposite to their centres."""
        reached, scale = part.reached, self.of_part(part)[0]
        data = self._repeats.grid.at, self.half, self.weight, scale, u_cells
        rows_springs_kernel(len(u_cells))(reached.starts, reached.lengths, *data, f)
