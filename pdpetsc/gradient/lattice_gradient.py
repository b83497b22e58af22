"""The gradient operator of a lattice: particles with equal families share one list of weights.

The particles with unique families form a separate body (``discrete.lattice_stencils.IrregularRest``). It also contains
one particle of each pattern; the weights of a pattern are those of this particle.
"""

from __future__ import annotations

import copy
from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property

import numpy as np

from pdpetsc.arrays import Float, GlobalIndex, LocalIndex, Lookup, entries_of, starts_of
from pdpetsc.discrete.lattice_stencils import LatticeStencils, Part
from pdpetsc.gradient.base import (
    NO_SETS,
    ControlledGradient,
    GradientOperator,
    ListedOnUse,
    Moduli,
    PointLoop,
    SameGradient,
    Springs,
)
from pdpetsc.kernels.lattice_stencils import add_from_cells, rows_blocks_kernel, rows_force_kernel, rows_gradient_kernel

# Tolerance for opposite weights and equal stiffnesses of opposite members, as a share of the largest.
OPPOSITE = 1e-12
NO_STRESS, NO_CONTROL = np.empty((0, 0)), (np.empty(0), np.empty(0), np.empty((0, 0, 0)))


@dataclass(frozen=True)
class Weights:
    """The weights of the points of each pattern. Opposite members with opposite weights are one entry.

    Attributes
    ----------
    list_ptr : (n_patterns + 1,) int64
        Start of the points of each pattern.
    entry_ptr : (n_lists + 1,) int64
        Start of the entries of each point.
    plus, minus : (n_entries,) int64
        Steps in cells: an entry multiplies the difference of the displacements there. ``minus`` is 0, the centre, for a
        single member.
    g : (n_entries, dim) float64
        Weights [1 / length].
    centre : (n_lists, dim) float64
        Weights of the centre, without the contribution of entries with two members [1 / length].
    """

    list_ptr: GlobalIndex
    entry_ptr: GlobalIndex
    plus: GlobalIndex
    minus: GlobalIndex
    g: Float
    centre: Float

    @cached_property
    def arrays(self) -> tuple[tuple[GlobalIndex, ...], Float, Float, Float]:
        """Return the steps and the components of the weights, as arguments of loops over rows."""
        dim = self.g.shape[1]
        columns = [np.ascontiguousarray(self.g[:, min(axis, dim - 1)]) for axis in range(3)]
        return (self.list_ptr, self.entry_ptr, self.plus, self.minus), columns[0], columns[1], columns[2]

    def of_members(self, steps: Sequence[GlobalIndex], values: Sequence[Float]) -> Float | None:
        """Return values (n_entries,) of the members of each point; None if two members of an entry differ."""
        found = np.empty(len(self.plus))
        for number, (one, of_one) in enumerate(zip(steps, values, strict=True)):
            entries = slice(int(self.entry_ptr[number]), int(self.entry_ptr[number + 1]))
            members, two = Lookup(one), self.minus[entries] != 0
            up = of_one[members.of(self.plus[entries])]
            down = of_one[members.of(self.minus[entries][two])]
            if len(down) and np.abs(up[two] - down).max() > OPPOSITE * np.abs(of_one).max():
                return None
            found[entries] = up
        return found


def weights_of(points: Sequence[Sequence[tuple[GlobalIndex, Float]]], dim: int) -> Weights:
    """Return the weights of the points of each pattern, from steps (n,) and weights (n, dim) of their members."""
    list_ptr = starts_of([len(lists) for lists in points])
    flat = [one for lists in points for one in lists]
    found = [_paired(steps, g) for steps, g in flat]
    sizes = [len(plus) for plus, _, _ in found]
    centre = np.array([-g[minus == 0].sum(axis=0) for _, minus, g in found]).reshape(len(flat), dim)
    return Weights(
        list_ptr,
        starts_of(sizes),
        np.concatenate([plus for plus, _, _ in found]),
        np.concatenate([minus for _, minus, _ in found]),
        np.concatenate([g for _, _, g in found]),
        centre,
    )


def _paired(steps: GlobalIndex, g: Float) -> tuple[GlobalIndex, GlobalIndex, Float]:
    """Return plus, minus and weights of the entries of a point."""
    where = {int(step): number for number, step in enumerate(steps)}
    other = np.array([where.get(-int(step), number) for number, step in enumerate(steps)], dtype=np.int64)
    size = float(np.abs(g).max(initial=0.0))
    opposite = (other != np.arange(len(steps))) & (np.abs(g + g[other]).max(axis=1) <= OPPOSITE * size)
    # One of two opposite members represents both.
    kept = ~opposite | (steps > 0)
    minus = np.where(opposite, -steps, 0)
    mean = np.where(opposite[:, None], 0.5 * (g - g[other]), g)
    return steps[kept].astype(np.int64), minus[kept].astype(np.int64), np.ascontiguousarray(mean[kept])


class LatticeGradient(ListedOnUse):
    """``GradientOperator`` that stores one list of weights for all particles with equal families.

    Parameters
    ----------
    irregular : GradientOperator
        The operator of ``lattice.irregular``.
    lattice : LatticeStencils
        Patterns of families.
    """

    irregular: GradientOperator
    lattice: LatticeStencils

    def __init__(self, irregular: GradientOperator, lattice: LatticeStencils) -> None:
        own, shared = lattice.irregular, lattice.shared
        each = np.diff(irregular.points_of)
        count = np.empty(len(shared), dtype=np.int64)
        count[own.local[: own.n]] = each[: own.n]
        count[shared] = lattice.of_shared(each[own.n :])
        owner = np.repeat(np.arange(len(shared), dtype=np.int32), count)
        self.__dict__.update(owner=owner, note=irregular.note, irregular=irregular, lattice=lattice)
        self.__dict__["volume"] = self._from_irregular(irregular.volume)

    @cached_property
    def points_of(self) -> GlobalIndex:
        """Return the start of the points of every own particle (n_owned + 1,)."""
        return starts_of(np.bincount(self.owner, minlength=len(self.lattice.shared)))

    @cached_property
    def alone(self) -> GlobalIndex:
        """Return the points of particles with unique families."""
        return np.flatnonzero(~self.lattice.shared[self.owner])

    @cached_property
    def _members(self) -> list[list[tuple[GlobalIndex, Float]]]:
        """Return steps and weights of the members of each point of each pattern, without the centre."""
        irregular, own = self.irregular, self.lattice.irregular
        cell = self.lattice.grid.cell[own.local]
        found = []
        for number in range(own.n, own.n + self.lattice.n_patterns):
            lists = []
            for p in range(int(irregular.points_of[number]), int(irregular.points_of[number + 1])):
                entries = slice(int(irregular.point_ptr[p]) + 1, int(irregular.point_ptr[p + 1]))
                lists.append((cell[irregular.members[entries]] - cell[number], irregular.g[entries]))
            found.append(lists)
        return found

    @cached_property
    def weights(self) -> Weights:
        """Return the weights of each pattern."""
        return weights_of(self._members, self.lattice.cloud.dim)

    @cached_property
    def point_volumes(self) -> Float:
        """Return the volumes of the points of each pattern (n_lists,) [volume]."""
        return self.irregular.volume[self.irregular.points_of[self.lattice.irregular.n] :]

    def row_points(self, P: Float) -> RowPoints:
        """Return the row points with stresses P (n_points, dim, dim)."""
        return RowPoints(self.points_of, self.point_volumes, P.reshape(len(P), -1), NO_SETS)

    def of_irregular(self, values: Float) -> Float:
        """Return values of points (n_points, ...) at the points of ``irregular``, zero at those of a pattern."""
        found = np.zeros((self.irregular.n_points, *values.shape[1:]))
        found[: len(self.alone)] = values[self.alone]
        return found

    def _from_irregular(self, values: Float) -> Float:
        """Return values at all points (n_points, ...) from those at the points of ``irregular``."""
        own, lattice, points = self.lattice.irregular, self.lattice, self.irregular.points_of
        found = np.empty((self.n_points, *values.shape[1:]))
        found[self.alone] = values[: points[own.n]]
        together = lattice.shared[self.owner]
        found[together] = values[entries_of(points, lattice.represented_by[lattice.shared])[0]]
        return found

    def gradient(self, u: Float) -> Float:
        """Return ``H_p = sum_k u_k (x) g_pk`` (n_points, dim, dim) for ``u`` (n_local, dim)."""
        lattice, dim = self.lattice, u.shape[1]
        part = lattice.whole
        H = np.empty((self.n_points, dim, dim))
        H[self.alone] = self.irregular.gradient(u[lattice.irregular.local])[: len(self.alone)]
        data = lattice.grid.at, self.points_of, *self.weights.arrays, lattice.grid.onto(u)
        rows_gradient_kernel(dim)(*part.loop, *data, H)
        return H

    def divergence(self, P: Float, f: Float, same: ControlledGradient | None = None) -> None:
        """Add ``sum_p W_p P_p g_pk`` to ``f`` (n_local, dim), and the forces of a control on the same gradient."""
        own, control, u, of_irregular = self.lattice.irregular, None, None, None
        if same is not None:
            assert isinstance(same.control, LatticeSharedGradient)
            control, u = same.control, same.u
            of_irregular = ControlledGradient(control.irregular, self.of_irregular(same.H), u[own.local])
        own.add(f, lambda forces: self.irregular.divergence(self.of_irregular(P), forces, of_irregular))
        add_row_forces(self.lattice, self.lattice.whole, self.weights, self.row_points(P), control, u, f)

    def same_gradient(self, springs: Springs) -> SameGradient | None:
        """Return None: only controls with the same patterns as the weights share the loop, and they find it."""
        return None

    def loop(self, A: Moduli, h: Float | None = None) -> PointLoop:
        """Return ``G^T (W A) G``; if forces have other weights ``h``, list all weights."""
        return LatticeLoop(self, A) if h is None else self.listed.loop(A, h)

    def at(self, points: GlobalIndex) -> GradientOperator:
        """Return the operator of selected points (n,), ascending (not collective)."""
        lattice, irregular, owner = self.lattice, self.irregular, self.owner[points]
        first = irregular.points_of[lattice.represented_by[owner]]
        entries, ptr = entries_of(irregular.point_ptr, first + points - self.points_of[owner])
        members = lattice.translated(owner, np.diff(ptr), irregular.members[entries])
        return GradientOperator(owner, ptr, members, irregular.g[entries], self.volume[points], self.note)


@dataclass(frozen=True)
class RowPoints:
    """Stresses or moduli at points with shared weights.

    Attributes
    ----------
    first : (n_owned,) int64
        The first point of each own particle.
    volume : (n_lists,) float64
        Volumes of the points of each pattern [volume].
    stress : (n_points, dim dim) or (n_sets, dim dim, dim dim) float64
        Stress, or moduli that multiply the gradient of the displacement [stress].
    of : (n_points,) int32
        Index of the moduli of each point; empty if each point has its own.
    """

    first: GlobalIndex
    volume: Float
    stress: Float
    of: LocalIndex


class LatticeSharedGradient(SameGradient):
    """A control on the gradient of a whole family, ``1/2 sum_i c_i sum_j w_ij |eta_ij - H_i xi_ij|^2``.

    Parameters
    ----------
    irregular : SameGradient
        The control of the particles with unique families, without stiffness at particles that represent a pattern.
    weight : (n_entries,) float64
        ``w_ij`` of the entries of the weights of the gradient [force / length].
    K : (n_patterns, dim, dim) float64
        ``sum_j w_ij xi (x) xi`` [force length].
    scale : (n_owned,) float64
        ``c_i`` [-].
    """

    def __init__(self, irregular: SameGradient, weight: Float, K: Float, scale: Float) -> None:
        self.irregular, self.weight, self.K, self.scale = irregular, weight, K, scale


class LatticeLoop(PointLoop):
    """``G^T (W A) G`` of an operator with shared weights, with the forces of a control on the same gradient.

    Parameters
    ----------
    operator : LatticeGradient
        The gradient.
    A : Moduli
        Moduli of the points.
    """

    def __init__(self, operator: LatticeGradient, A: Moduli) -> None:
        self._operator = operator
        self._points = RowPoints(operator.points_of, operator.point_volumes, *A.matrices)
        of_irregular = np.zeros((operator.irregular.n_points, *A.values.shape[1:]))
        of_irregular[: len(operator.alone)] = A.at(operator.alone)
        self._alone = operator.irregular.loop(Moduli(of_irregular))
        self._same: LatticeSharedGradient | None = None

    def controlled(self, same: SameGradient | None) -> PointLoop | None:
        """Return the loop with a control that uses the same patterns as the weights; None for other controls."""
        if not isinstance(same, LatticeSharedGradient):
            return None
        alone = self._alone.controlled(same.irregular)
        if alone is None:
            return None
        found = copy.copy(self)
        found._alone, found._same = alone, same
        return found

    def add(self, u: Float, f: Float, particles: LocalIndex) -> None:
        """Add the forces of the points of selected own particles for displacements (n_local, dim)."""
        operator, lattice = self._operator, self._operator.lattice
        part, own = lattice.part(particles), lattice.irregular
        if len(part.alone):
            own.add(f, lambda forces: self._alone.add(u[own.local], forces, part.alone))
        add_row_forces(lattice, part, operator.weights, self._points, self._same, u, f)

    def add_point_blocks(self, blocks: Float) -> None:
        """Add ``sum_p W_p g_pk . A_p . g_pk`` of every local particle ``k`` (n_local, dim, dim)."""
        operator, lattice, dim = self._operator, self._operator.lattice, blocks.shape[-1]
        part, grid, weights = lattice.whole, lattice.grid, operator.weights
        lattice.irregular.add(blocks, self._alone.add_point_blocks)
        on_cells, points = np.zeros((dim * dim, len(grid.at))), self._points
        data = weights.arrays[0], weights.g, weights.centre, points.volume, points.stress, points.of
        rows_blocks_kernel(dim)(*part.loop, grid.at, points.first, *data, on_cells)
        add_from_cells(grid.cell, on_cells, blocks.reshape(-1, dim * dim))


def add_row_forces(
    lattice: LatticeStencils, part: Part, weights: Weights, points: RowPoints | None,
    same: LatticeSharedGradient | None, u: Float | None, f: Float,
) -> None:  # fmt: skip
    """Add the forces of points with shared weights, and of a control on their gradient, to ``f`` (n_local, dim).

    Parameters
    ----------
    points : RowPoints, optional
        Their stresses or moduli; no stress if absent.
    same : LatticeSharedGradient, optional
        The control.
    u : (n_local, dim) float64, optional
        Displacements [length]; not read if there are stresses and no control.
    """
    if not part.rows.count:
        return
    dim, grid, forces = f.shape[1], lattice.grid, lattice.forces_on_cells
    if points is None:
        points = RowPoints(
            np.zeros(lattice.cloud.n_owned, dtype=np.int64), np.ones(len(weights.centre)), NO_STRESS, NO_SETS
        )
    control = NO_CONTROL if same is None else (same.weight, same.scale, same.K)
    rows_force_kernel(dim, int(points.stress.ndim == 3), int(same is not None))(
        *part.loop, grid.at, points.first, *weights.arrays, weights.centre, points.volume, points.stress, points.of,
        *control, np.empty((dim, 0)) if u is None else grid.onto(u), forces,
    )  # fmt: skip
    add_from_cells(grid.cell, forces, f)
