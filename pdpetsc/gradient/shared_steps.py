"""Weights of the steps of a lattice that families share, and the steps that each family lacks."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property
from typing import TypeAlias

import numpy as np

from pdpetsc.arrays import Float, GlobalIndex, LocalIndex
from pdpetsc.discrete.families import Families
from pdpetsc.discrete.lattice_stencils import Grid
from pdpetsc.kernels.broken_lattice import lacking_steps, subtract_lacking

# Tolerance for equal weights, as a share of the largest weight.
SAME = 1e-12
# Loops over shared steps are used if families lack at most this share of them, and rows have at least SHORTEST cells
# in the mean. Other loops are faster then.
MOST_LACKING, SHORTEST = 0.3, 8

# Steps up and down, components of ``w xi`` of those up, all steps, their ``w xi`` and ``w``.
Table: TypeAlias = tuple[GlobalIndex, GlobalIndex, Float, Float, Float, GlobalIndex, Float, Float]


@dataclass(frozen=True)
class SharedSteps:
    """Weights of the steps of a lattice, and the steps that the families of the own particles lack.

    Attributes
    ----------
    grid : Grid
        The lattice.
    steps : (n_steps,) int64
        Steps in cells; the second half are the opposites of the first one, which lead to higher cells.
    xi : (n_steps, dim) float64
        Their bonds [length].
    w : (n_steps,) float64
        Their weights ``omega V`` [volume].
    number_of : (n,) int32
        Number of each step in cells, counted from minus the longest step.
    ptr, lacking : (n_owned + 1,) int64, (n_lacking,) int16
        Numbers of the steps without bond of each family.
    """

    grid: Grid
    steps: GlobalIndex
    xi: Float
    w: Float
    number_of: LocalIndex
    ptr: GlobalIndex
    lacking: np.ndarray[tuple[int], np.dtype[np.int16]]

    @property
    def reach(self) -> int:
        """Return the longest step in cells."""
        return len(self.number_of) // 2

    @property
    def exceptions(self) -> tuple[GlobalIndex, np.ndarray[tuple[int], np.dtype[np.int16]]]:
        """Return ``ptr`` and ``lacking``."""
        return self.ptr, self.lacking

    @cached_property
    def table(self) -> Table:
        """Return the steps with the components of their weights, as an argument of loops over rows."""
        half, dim = len(self.steps) // 2, self.xi.shape[1]
        wxi = self.w[:, None] * self.xi
        x, y, z = (np.ascontiguousarray(wxi[:half, min(axis, dim - 1)]) for axis in range(3))
        return self.steps[:half], self.steps[half:], x, y, z, self.steps, wxi, self.w

    def shape_tensors(self) -> Float:
        """Return ``K_i = sum_j w_ij xi (x) xi`` of the own particles (n_owned, dim, dim) [volume length^2]."""
        dim = self.xi.shape[1]
        of_steps = np.einsum("e,ei,ej->eij", self.w, self.xi, self.xi)
        K = np.tile(of_steps.sum(axis=0), (len(self.ptr) - 1, 1, 1))
        subtract_lacking(*self.exceptions, of_steps.reshape(-1, dim * dim), K.reshape(-1, dim * dim))
        return K

    def numbers(self, centres: LocalIndex, neighbours: LocalIndex) -> LocalIndex:
        """Return the numbers of the steps of bonds (n,) between local particles."""
        cell = self.grid.cell
        return np.asarray(self.number_of[cell[neighbours] - cell[centres] + self.reach])


def shared_steps(families: Families, weight: Float) -> SharedSteps | None:
    """Return the shared steps of families with bond weights (n_bonds,) [volume], 0 for a broken bond.

    None if the particles are on no lattice, bonds with the same step or an opposite one have different weights, or
    loops over rows would be slower (not collective).
    """
    grid, n = families.grid, len(families.indptr) - 1
    if grid is None or n == 0:
        return None
    up = np.flatnonzero(grid.steps > 0)
    order = np.concatenate([up, [int(np.flatnonzero(grid.steps == -step)[0]) for step in grid.steps[up]]])
    steps, xi = grid.steps[order], grid.xi[order]
    n_lacking = n * len(steps) - int(np.count_nonzero(weight))
    if len(steps) > np.iinfo(np.int16).max:
        return None
    if n_lacking > MOST_LACKING * n * len(steps) or n < SHORTEST * len(grid.rows(families.everyone).starts):
        return None
    number_of = np.full(2 * int(steps.max()) + 1, -1, dtype=np.int32)
    number_of[steps + steps.max()] = np.arange(len(steps))
    ptr, lacking, w = np.zeros(n + 1, dtype=np.int64), np.empty(n_lacking, dtype=np.int16), np.zeros(len(steps))
    family = families.indptr, families.neighbours
    worst = lacking_steps(grid.cell, *family, weight, number_of, steps.max(), ptr, lacking, w)
    half = len(steps) // 2
    if max(worst, np.abs(w[:half] - w[half:]).max()) > SAME * w.max():
        return None
    return SharedSteps(grid, steps, xi, w, number_of, ptr, lacking)
