"""Controls of bodies on a lattice whose families repeat."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np

from pdpetsc.arrays import Float, LocalIndex
from pdpetsc.control.base import Control, ControlMatrix, Stencil, Stiffness
from pdpetsc.control.non_uniform import NonUniform
from pdpetsc.discrete.lattice import Repeats
from pdpetsc.discrete.sparsity import Sparsity
from pdpetsc.gradient.base import GradientOperator, SameGradient
from pdpetsc.gradient.repeated import RepeatedGradient, RepeatedOperator, paired
from pdpetsc.kernels.repeated import (
    clear_rows,
    rows_force_kernel,
    rows_gradient_kernel,
    rows_spring_energy_kernel,
    rows_stress_kernel,
)


class RepeatedControl(Control):
    """``NonUniform`` whose bond stiffness is ``c_i w_ij`` with the ``w`` of one family for all that share it.

    Parameters
    ----------
    repeats : Repeats
        Which particles share one family.
    edge : NonUniform
        The control of the particles whose families do not repeat, and of one of the others as the last.
    scale : (n_owned,) float64
        ``c_i``, 1 at that one [-].
    listed : callable
        Makes the control with all bonds listed, for whoever assembles its matrix (collective).
    """

    def __init__(self, repeats: Repeats, edge: NonUniform, scale: Float, listed: Callable[[], Control]) -> None:
        self._repeats, self._edge, self._scale, self._make = repeats, edge, scale, listed
        self._all: Control | None = None
        own = repeats.edge
        bonds = slice(int(own.indptr[own.n]), int(own.indptr[own.n + 1]))
        stiffness, K_inverse = edge.stiffness[bonds], edge.K_inverse[own.n]
        members = own.neighbours[bonds]
        cell = repeats.grid.cell[own.local]
        steps = cell[members] - cell[own.n]
        xi = own.cloud.x[members] - own.cloud.x[own.n]
        self._entries = paired(steps, stiffness[:, None] * (xi @ K_inverse))
        self._K = np.linalg.inv(K_inverse) if K_inverse.any() else np.zeros_like(K_inverse)
        self._half, self._weight = steps[steps > 0], stiffness[steps > 0]
        self._alone = RepeatedGradient(repeats, SameGradient(), self._half, self._weight, self._K, scale)

    @property
    def _listed(self) -> Control:
        if self._all is None:
            self._all = self._make()
        return self._all

    @property
    def stencils(self) -> Stencil:
        """Return the families with their centre first, all of them listed (collective the first time)."""
        return self._listed.stencils

    def matrix(self, sparsity: Sparsity) -> ControlMatrix:
        """Return the matrix of the listed control (collective)."""
        return self._listed.matrix(sparsity)

    def of_gradient(self, operator: GradientOperator) -> SameGradient | None:
        """Return what a loop over the gradient of the scheme needs where it is that of the control."""
        if not isinstance(operator, RepeatedOperator):
            return None
        edge = self._edge.of_gradient(operator.edge)
        if edge is None:
            return None
        return RepeatedGradient(self._repeats, edge, self._half, self._weight, self._K, self._scale)

    def force(self, u: Float, f: Float, particles: LocalIndex) -> float:
        """Add ``s_ij z_ij`` to ``j`` and its opposite to ``i``; return the energy."""
        repeats, dim = self._repeats, u.shape[1]
        grid, part, local = repeats.grid, repeats.part(particles), repeats.edge.local
        energy = 0.0
        if len(part.alone):
            forces = np.zeros((len(local), dim))
            energy = self._edge.force(u[local], forces, part.alone)
            f[local] += forces
        rows, reached, one = part.rows, part.reached, self._entries
        if not rows.count:
            return energy
        u_cells, H = grid.onto(u), repeats.on_cells
        scale, K = self._alone.of_part(part)
        rows_gradient_kernel(dim)(rows.starts, rows.lengths, one.plus, one.minus, one.g, u_cells, H)
        data = self._half, self._weight, scale, K, u_cells, H
        energy += float(rows_spring_energy_kernel(dim)(rows.starts, rows.lengths, *data))
        none = np.zeros(1, dtype=np.int64), 0, np.empty((0, dim, dim, dim, dim)), 1.0
        rows_stress_kernel(dim)(rows.starts, rows.lengths, grid.at, *none, scale, K, H)
        rows_force_kernel(dim)(reached.starts, reached.lengths, grid.at, one.plus, one.minus, one.g, H, f)
        clear_rows(rows.starts, rows.lengths, H)
        self._alone.add_springs(part, u_cells, f)
        return energy


def of_edge(stiffness: Stiffness, repeats: Repeats) -> Stiffness:
    """Return the stiffness of the particles whose families do not repeat, and of the one that stands for the others."""
    own = repeats.edge.local[: repeats.edge.n + 1]
    return Stiffness(stiffness.kappa[own], stiffness.moduli, stiffness.material_of[own], stiffness.factor[own])


def relative_scale(stiffness: Stiffness, repeats: Repeats) -> Float:
    """Return ``kappa_i`` over that of the particle that stands for all that share its family (n_owned,) [-]."""
    return np.asarray(stiffness.kappa / stiffness.kappa[repeats.edge.local[repeats.edge.n]])
