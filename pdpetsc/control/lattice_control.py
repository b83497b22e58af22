"""Controls of bodies on a lattice with equal families."""

from __future__ import annotations

import copy
from collections.abc import Callable

import numpy as np

from pdpetsc.arrays import Float, LocalIndex
from pdpetsc.control.base import Control, ControlMatrix, Stencil, Stiffness
from pdpetsc.control.non_uniform import NonUniform, forces_on_members
from pdpetsc.discrete.families import Families
from pdpetsc.discrete.lattice_stencils import LatticeStencils, Part
from pdpetsc.discrete.sparsity import Sparsity
from pdpetsc.gradient.base import BondGradient, GradientOperator, SameGradient, StencilMembers
from pdpetsc.gradient.lattice_gradient import (
    LatticeGradient,
    LatticeSharedGradient,
    Weights,
    add_row_forces,
    weights_of,
)
from pdpetsc.kernels.gradient import inverses
from pdpetsc.kernels.lattice_stencils import add_from_cells, rows_control_blocks_kernel, rows_energy_kernel


class LatticeControl(Control):
    """``NonUniform`` with the bond stiffness ``c_i w_ij``, with one ``w`` for all particles with equal families.

    Parameters
    ----------
    lattice : LatticeStencils
        Patterns of families.
    irregular : NonUniform
        The control of the particles with unique families, and of one particle of each pattern.
    scale : (n_owned,) float64
        ``c_i`` [-], 1 at the particle that represents a pattern.
    listed : callable
        Builds the control with all bonds listed, to assemble its matrix (collective).
    """

    def __init__(
        self, lattice: LatticeStencils, irregular: NonUniform, scale: Float, listed: Callable[[], Control]
    ) -> None:
        self._lattice, self._irregular, self._scale, self._make = lattice, irregular, scale, listed
        self._all: Control | None = None
        own, of_bonds = lattice.irregular, irregular.bond_stiffness
        # The rows of a pattern contain the forces of the particle that represents it.
        alone = np.where(np.arange(len(of_bonds)) < own.indptr[own.n], of_bonds, 0.0)
        self._alone = NonUniform(own.cloud, Families(own.indptr, own.neighbours), alone, irregular.K_inverse)
        K_inverse = irregular.K_inverse[own.n :]
        self._K = inverses(K_inverse) if K_inverse.any() else np.zeros_like(K_inverse)
        self._stiffness, points = [], []
        for number, steps in enumerate(lattice.steps):
            bonds = slice(int(own.indptr[own.n + number]), int(own.indptr[own.n + number + 1]))
            xi = own.cloud.x[own.neighbours[bonds]] - own.cloud.x[own.n + number]
            self._stiffness.append(of_bonds[bonds])
            points.append([(steps, of_bonds[bonds, None] * (xi @ K_inverse[number]))])
        self._weights = weights_of(points, lattice.cloud.dim)
        # Stiffness of the entries of some weights, which controls of other scales share.
        self._of_entries: dict[int, tuple[Weights, Float | None]] = {}
        found = self._of(self._weights, SameGradient())
        if found is None:
            raise ValueError("Opposite bonds of a family that repeats have different stiffnesses.")
        self._same = found

    def _of(self, weights: Weights, irregular: SameGradient) -> LatticeSharedGradient | None:
        """Return the arguments of loops over weights; None if opposite bonds of an entry differ."""
        if id(weights) not in self._of_entries:
            self._of_entries[id(weights)] = weights, weights.of_members(self._lattice.steps, self._stiffness)
        of_bonds = self._of_entries[id(weights)][1]
        return None if of_bonds is None else LatticeSharedGradient(irregular, of_bonds, self._K, self._scale)

    @property
    def _listed(self) -> Control:
        if self._all is None:
            self._all = self._make()
        return self._all

    @property
    def stencils(self) -> Stencil:
        """Return the families, all listed, with the centre first (collective the first time)."""
        return self._listed.stencils

    def matrix(self, sparsity: Sparsity) -> ControlMatrix:
        """Return the matrix of the listed control (collective)."""
        return self._listed.matrix(sparsity)

    def of_gradient(self, operator: GradientOperator) -> SameGradient | None:
        """Return the data for a loop over the gradient of the scheme, if the control has the same gradient."""
        if not isinstance(operator, LatticeGradient):
            return None
        irregular = self._irregular.of_gradient(operator.irregular)
        if not isinstance(irregular, BondGradient):
            return None
        return self._of(operator.weights, BondGradient(self._alone.bond_stiffness, irregular.K))

    def add_point_blocks(self, blocks: Float) -> bool:
        """Add multiples of the identity to the blocks of local particles (n_local, dim, dim)."""
        lattice, dim, same, weights = self._lattice, blocks.shape[-1], self._same, self._weights
        part, grid = lattice.whole, lattice.grid
        lattice.irregular.add(blocks, self._alone.add_point_blocks)
        diagonal, sums = np.zeros((1, len(grid.at))), np.zeros((len(blocks), 1))
        data = weights.arrays[0], weights.g, weights.centre, same.weight, same.scale, same.K
        rows_control_blocks_kernel(dim)(*part.loop, grid.at, *data, diagonal)
        add_from_cells(grid.cell, diagonal, sums)
        blocks += sums[:, :, None] * np.eye(dim)
        return True

    def force(self, u: Float, f: Float, particles: LocalIndex) -> float:
        """Add ``s_ij z_ij`` to ``j`` and its opposite to ``i``; return the energy."""
        lattice, same = self._lattice, self._same
        part, own = lattice.part(particles), lattice.irregular
        energy = 0.0
        if len(part.alone):
            energy = own.add(f, lambda forces: self._irregular.force(u[own.local], forces, part.alone))
        if part.rows.count:
            energies = self._row_energies(part, u)
            energy += float(energies.sum())
            add_row_forces(lattice, part, self._weights, None, same, u, f)
        return energy

    def _row_energies(self, part: Part, u: Float) -> Float:
        """Return the energies of the families in rows (n_owned,), zero for others."""
        lattice, same, energies = self._lattice, self._same, np.zeros(self._lattice.cloud.n_owned)
        data = lattice.grid.at, *self._weights.arrays, same.weight, same.scale, same.K, lattice.grid.onto(u)
        rows_energy_kernel(u.shape[1])(*part.loop, *data, energies)
        return energies

    def family_energy(self, u: Float) -> Float:
        """Return the energy of the family of every own particle."""
        lattice, own = self._lattice, self._lattice.irregular
        energies = self._row_energies(lattice.whole, u)
        energies[own.local[: own.n]] = self._irregular.family_energy(u[own.local])[: own.n]
        return energies

    def scaled(self, share: Float) -> LatticeControl:
        """Return the control with the stiffness of each own family times its share (n_owned,)."""
        own = self._lattice.irregular
        of_irregular = np.ones(own.cloud.n_owned)
        of_irregular[: own.n] = share[own.local[: own.n]]
        # The particles that represent patterns keep their stiffness, and so do the patterns.
        scaled = copy.copy(self)
        scaled._irregular, scaled._alone = self._irregular.scaled(of_irregular), self._alone.scaled(of_irregular)
        scaled._scale = np.where(self._lattice.shared, self._scale * share, self._scale)
        scaled._same = LatticeSharedGradient(SameGradient(), self._same.weight, self._K, scaled._scale)
        scaled._all, scaled._make = None, lambda: self._listed.scaled(share)
        scaled._shared = scaled._filled = None
        return scaled

    def families_at(self, particles: LocalIndex) -> StencilMembers:
        """Return the families of selected own particles, with the centre first."""
        return self._springs_at(particles)[0]

    def forces_at(self, u: Float, particles: LocalIndex) -> Float:
        """Return ``s_ij z_ij`` in the families of selected own particles, and minus their sum on ``i``."""
        return forces_on_members(*self._springs_at(particles), self._lattice.cloud.x, u)

    def _springs_at(self, particles: LocalIndex) -> tuple[StencilMembers, Float, Float]:
        """Return the families of selected own particles, ``s`` (n_entries,) of their members and ``K_i^-1``."""
        lattice = self._lattice
        families, s, K_inverse = self._irregular.springs_at(lattice.represented_by[particles])
        size, scale = np.diff(families.point_ptr), self._scale[particles]
        members = lattice.translated(particles, size, families.members)
        there = StencilMembers(particles, families.point_ptr, members)
        return there, np.repeat(scale, size) * s, K_inverse / scale[:, None, None]


def of_irregular(stiffness: Stiffness, lattice: LatticeStencils) -> Stiffness:
    """Return the stiffness of particles with unique families and of those that represent a pattern."""
    own = lattice.irregular.local[: lattice.irregular.cloud.n_owned]
    return Stiffness(stiffness.kappa[own], stiffness.moduli, stiffness.material_of[own], stiffness.factor[own])


def relative_scale(stiffness: Stiffness, lattice: LatticeStencils) -> Float:
    """Return ``kappa_i`` over that of the particle that represents its pattern (n_owned,) [-]; 1 without pattern."""
    own, scale = lattice.irregular, np.ones(lattice.cloud.n_owned)
    of_patterns = stiffness.kappa[own.local[own.n : own.n + lattice.n_patterns]]
    scale[lattice.shared] = stiffness.kappa[lattice.shared] / lattice.of_shared(of_patterns)
    return scale
