"""The gradient operator of a lattice with broken bonds: weights of its steps, and the steps that each family lacks."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from functools import cached_property

import numpy as np

from pdpetsc.arrays import Float, GlobalIndex, LocalIndex, Mask, entries_of, row_of_entries
from pdpetsc.discrete.cloud import Cloud
from pdpetsc.discrete.families import Families
from pdpetsc.gradient.base import (
    NO_SETS,
    ControlledGradient,
    GradientOperator,
    ListedOnUse,
    Moduli,
    PointLoop,
    SameGradient,
    Springs,
    stencil_weights,
    with_centres,
)
from pdpetsc.gradient.shared_steps import SAME, SharedSteps
from pdpetsc.kernels.broken_lattice import (
    broken_blocks_kernel,
    broken_force_kernel,
    broken_gradient_kernel,
    families_alike,
)
from pdpetsc.kernels.lattice_stencils import add_from_cells
from pdpetsc.kernels.tangent import NO_CONTROL


class BrokenLatticeGradient(ListedOnUse):
    """``GradientOperator`` of whole families ``g_ij = w_ij K_i^-1 xi_ij`` that stores the steps that a family lacks.

    Parameters
    ----------
    cloud, families
        The bonds, also broken ones.
    steps : SharedSteps
        Weights of the lattice, and broken bonds.
    K_inverse : (n_owned, dim, dim) float64
        Inverse shape tensors [1 / (volume length^2)].
    volume : (n_owned,) float64
        Volumes of the points [volume].
    """

    def __init__(
        self, cloud: Cloud, families: Families, steps: SharedSteps, K_inverse: Float, volume: Float
    ) -> None:  # fmt: skip
        owner = np.arange(cloud.n_owned, dtype=np.int32)
        self.__dict__.update(owner=owner, volume=volume, note="", parts=None)
        self.__dict__.update(cloud=cloud, families=families, steps=steps, K_inverse=K_inverse)

    cloud: Cloud
    families: Families
    steps: SharedSteps
    K_inverse: Float

    @cached_property
    def points_of(self) -> GlobalIndex:
        """Return the point of every own particle, and their number (n_owned + 1,)."""
        return np.arange(self.n_points + 1)

    def row_loop(self, particles: LocalIndex) -> tuple[GlobalIndex, GlobalIndex, LocalIndex]:
        """Return first cells and lengths of the rows of own particles, and the particle of each cell."""
        rows = self.steps.grid.rows(particles)
        return rows.starts, rows.lengths, self.steps.grid.at

    def gradient(self, u: Float) -> Float:
        """Return ``H_i = sum_j w_ij eta_ij (x) xi_ij K_i^-1`` (n_owned, dim, dim) for ``u`` (n_local, dim)."""
        dim, H = u.shape[1], np.empty((self.n_points, u.shape[1], u.shape[1]))
        data = self.steps.table, *self.steps.exceptions, self.K_inverse, self.steps.grid.onto(u)
        broken_gradient_kernel(dim)(*self.row_loop(self.families.everyone), *data, H)
        return H

    def divergence(self, P: Float, f: Float, same: ControlledGradient | None = None) -> None:
        """Add ``sum_p W_p P_p g_pk`` to ``f`` (n_local, dim), and the forces of a control on the same gradient."""
        control, u = (None, None) if same is None else (same.control, same.u)
        assert control is None or isinstance(control, RowSprings)
        self.add_forces(self.families.everyone, P.reshape(len(P), -1), NO_SETS, control, u, f)

    def same_gradient(self, springs: Springs) -> SameGradient | None:
        """Return the control family by family; families with other stiffnesses have their own loop."""
        steps, family = self.steps, springs.families
        scale = np.empty(self.n_points)
        families_alike(
            steps.grid.cell, family.indptr, family.neighbours, springs.stiffness, steps.number_of, steps.reach,
            *steps.exceptions, steps.w, SAME, scale,
        )  # fmt: skip
        apart = (scale == 0.0) & springs.K_inverse.any(axis=(1, 2))
        K_inverse = scale[:, None, None] * springs.K_inverse
        return RowSprings(scale, K_inverse, springs.add_forces, apart if apart.any() else None)

    def loop(self, A: Moduli, h: Float | None = None) -> PointLoop:
        """Return ``G^T (W A) G``; if forces have other weights ``h``, list all weights."""
        return RowLoop(self, A) if h is None else self.listed.loop(A, h)

    def add_forces(
        self, particles: LocalIndex, stress: Float, of: LocalIndex, control: RowSprings | None, u: Float | None,
        f: Float,
    ) -> None:  # fmt: skip
        """Add the forces of selected own particles to ``f`` (n_local, dim) (not collective).

        Parameters
        ----------
        stress : (n_owned, dim dim) or (n_sets, dim dim, dim dim) float64
            Stress, or moduli that multiply the gradient of the displacement [stress].
        of : (n_owned,) int32
            Index of the moduli of each particle; empty if each has its own.
        control : RowSprings, optional
            Control on the same gradient.
        u : (n_local, dim) float64, optional
            Displacements [length]; not read if there are stresses and no control.
        """
        dim, grid = f.shape[1], self.steps.grid
        on_cells = np.zeros((dim, len(grid.at)))
        data = self.steps.table, *self.steps.exceptions, self.K_inverse, self.volume, stress, of
        springs = NO_CONTROL if control is None else (control.scale, control.K_inverse)
        broken_force_kernel(dim, int(stress.ndim == 3), int(control is not None))(
            *self.row_loop(particles), *data, *springs, on_cells[:, :0] if u is None else grid.onto(u), on_cells
        )
        add_from_cells(grid.cell, on_cells, f)
        if control is not None and control.apart is not None and u is not None:
            control.add_forces(u, f, particles[control.apart[particles]])

    def at(self, points: GlobalIndex) -> GradientOperator:
        """Return the operator of selected points (n,), ascending (not collective)."""
        bonds, first = entries_of(self.families.indptr, points)
        number, neighbours = row_of_entries(first), self.families.neighbours[bonds]
        step = self.steps.numbers(points[number].astype(np.int32), neighbours)
        entries, lost = entries_of(self.steps.ptr, points)
        n_steps = len(self.steps.steps)
        lacking = row_of_entries(lost) * n_steps + self.steps.lacking[entries]
        weight = np.where(np.isin(number * n_steps + step, lacking), 0.0, self.steps.w[step])
        stencils = with_centres(points.astype(np.int32), first, neighbours, weight)
        g = stencil_weights(stencils, self.cloud.x, self.K_inverse[points])
        return GradientOperator(stencils.owner, stencils.point_ptr, stencils.members, g, self.volume[points])


@dataclass(frozen=True)
class RowSprings(SameGradient):
    """A control on the gradient of whole families, ``1/2 sum_i c_i sum_j w_ij |eta_ij - H_i xi_ij|^2``.

    Attributes
    ----------
    scale : (n_owned,) float64
        ``c_i`` [force / (length volume)], 0 for families that are ``apart``.
    K_inverse : (n_owned, dim, dim) float64
        Inverse of ``sum_j w_ij xi (x) xi`` [1 / (volume length^2)].
    add_forces : callable
        Adds its forces in families of selected own particles, bond by bond.
    apart : (n_owned,) bool or None
        Families whose stiffness is not in proportion to ``w``; None if there are none.
    """

    scale: Float
    K_inverse: Float
    add_forces: Callable[[Float, Float, LocalIndex], object]
    apart: Mask | None


@dataclass(frozen=True)
class RowLoop(PointLoop):
    """``G^T (W A) G`` of a lattice with broken bonds, with the forces of a control on the same gradient.

    Attributes
    ----------
    operator : BrokenLatticeGradient
        The gradient.
    A : Moduli
        Moduli of the points.
    control : RowSprings or None
        The control in the loop.
    """

    operator: BrokenLatticeGradient
    A: Moduli
    control: RowSprings | None = None

    def controlled(self, same: SameGradient | None) -> PointLoop | None:
        """Return the loop with a control that has the same steps; None for other controls."""
        return RowLoop(self.operator, self.A, same) if isinstance(same, RowSprings) else None

    def add(self, u: Float, f: Float, particles: LocalIndex) -> None:
        """Add the forces of the points of selected own particles for displacements (n_local, dim)."""
        self.operator.add_forces(particles, *self.A.matrices, self.control, u, f)

    def add_point_blocks(self, blocks: Float) -> None:
        """Add ``W_p g_pk . A_p . g_pk`` of every local particle ``k`` (n_local, dim, dim)."""
        of, dim = self.operator, blocks.shape[-1]
        grid, data = of.steps.grid, (of.steps.table, *of.steps.exceptions, of.K_inverse, of.volume)
        kernel = broken_blocks_kernel(dim)
        kernel(of.families.everyone, grid.cell, grid.at, *data, *self.A.matrices, blocks.reshape(-1, dim * dim))
