"""Interface of zero-energy controls: declaration, and forces and matrix on a body."""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Callable
from dataclasses import dataclass
from typing import ClassVar, TypeAlias

import numpy as np

from pdpetsc.arrays import Float, GlobalIndex, LocalIndex, entries_of
from pdpetsc.declared import Declared
from pdpetsc.discrete.cloud import Cloud
from pdpetsc.discrete.families import Families
from pdpetsc.discrete.sparsity import Sparsity
from pdpetsc.errors import CaseError
from pdpetsc.gradient.base import GradientOperator, SameGradient, StencilMembers
from pdpetsc.gradient.products import Entries, Product
from pdpetsc.kernels.assembly import add_diagonal_kernel

Stencil: TypeAlias = tuple[GlobalIndex, LocalIndex]
_NO_DAMAGE = (
    "This zero-energy control cannot follow bonds that fade with their present stretch; take Silling, springs, the "
    "penalty or none, or let damage keep the largest stretch (effect=LargestStretch())."
)
_NOT_FOLLOWING = (
    "This zero-energy control has no form that follows the material: it gives neither its forces family by family nor "
    "itself with the stiffness of each family scaled; take one without TangentScaled, or give it scaled and "
    "family_forces."
)


@dataclass(frozen=True)
class Stiffness:
    """Small-strain stiffness of the own particles, which scales a control.

    Attributes
    ----------
    kappa : (n_owned,) float64
        ``lambda + 2 mu / dim`` [stress].
    moduli : (n_materials, dim, dim, dim, dim) float64
        ``dP/dF`` at F = I of each material [stress].
    material_of : (n_owned,) int32
        Index into ``moduli``.
    factor : (n_owned,) float64
        Factor of the moduli of a graded material [-]; already in ``kappa``.
    """

    kappa: Float
    moduli: Float
    material_of: LocalIndex
    factor: Float


def relative_factor(cloud: Cloud, families: Families, omega: Float, stiffness: Stiffness) -> Float:
    """Return ``kappa_i / sum_j omega |xi|^2 V_j`` (n_owned,) [force / length^7], 0 for a particle without family.

    Bond forces of ``C`` times this factor times ``omega eta`` have the share ``C`` of the stiffness of the material,
    for any units, spacing and horizon (not collective).
    """
    xi = families.bonds(cloud.x)
    moment = omega * np.einsum("bm,bm->b", xi, xi) * cloud.volume[families.neighbours]
    trace = np.bincount(families.centres, moment, minlength=cloud.n_owned)
    return np.divide(stiffness.kappa, trace, out=np.zeros(cloud.n_owned), where=trace > 0.0)


class ControlMatrix(ABC):
    """Constant matrix of a control in the layout of the tangent."""

    @abstractmethod
    def add(self, diag: Float, off: Float) -> None:
        """Add the matrix to the values of the own rows."""


@dataclass(frozen=True)
class IsotropicMatrix(ControlMatrix):
    """One scalar per block, times the identity; at mirror planes one scalar for each component.

    Attributes
    ----------
    diag, off : (1 or dim, n_blocks) float64
        Values in own and in other columns.
    """

    sparsity: Sparsity
    diag: Float
    off: Float

    def add(self, diag: Float, off: Float) -> None:
        """Add the matrix to the values of the own rows."""
        kernel = add_diagonal_kernel(self.sparsity.cloud.dim)
        kernel(self.sparsity.owned.diag_ptr, self.diag, diag)
        kernel(self.sparsity.owned.off_ptr, self.off, off)


@dataclass(frozen=True)
class BlockMatrix(ControlMatrix):
    """Full blocks, in scalar CSR layout."""

    diag: Float
    off: Float

    def add(self, diag: Float, off: Float) -> None:
        """Add the matrix to the values of the own rows."""
        diag += self.diag
        off += self.off


def isotropic(sparsity: Sparsity, kernel: Callable[..., None], stencils: Stencil, *data: Float) -> IsotropicMatrix:
    """Compute the matrix with one scalar per pair of local particles (collective).

    Arguments as for ``fill``. A component changes its sign behind some mirror planes only.
    """
    components = sparsity.cloud.dim if len(sparsity.cloud.places.mirrors[0]) > 1 else 1
    parts = [fill(sparsity, kernel, stencils, *data, component=c) for c in range(components)]
    return IsotropicMatrix(sparsity, np.array([diag for diag, _ in parts]), np.array([off for _, off in parts]))


def fill(
    sparsity: Sparsity, kernel: Callable[..., None], stencils: Stencil, *data: Float, component: int | None = None
) -> tuple[Float, Float]:
    """Compute the values of the matrix of a control in the own rows, in own and in other columns.

    Parameters
    ----------
    sparsity : Sparsity
        Blocks of the matrix.
    kernel : callable
        Row-wise loop, as for ``Entries.add``.
    stencils : (point_ptr, members)
        Particles that the matrix couples.
    data
        Arguments of the kernel after the stencils.
    component : int, optional
        Component if blocks have one value; whole blocks by default.

    Notes
    -----
    Collective.
    """
    ptr, members = stencils
    own = np.arange(len(ptr) - 1, dtype=np.int32)
    entries = Entries.zeros(sparsity, component)
    entries.add(kernel, StencilMembers(own, ptr, members), ptr, members, *data)
    sparsity.complete(entries.ghost, entries.diag, entries.off, sparsity.cloud.dim if component is None else 1)
    return entries.diag, entries.off


class Control(Product, ABC):
    """A control built for one cloud: forces linear in u, with a constant matrix."""

    _filled: tuple[Sparsity, ControlMatrix] | None = None
    _shared: tuple[GradientOperator, SameGradient | None] | None = None

    @property
    @abstractmethod
    def stencils(self) -> Stencil:
        """Return the stencils of the matrix: the families, with the centre first."""

    @abstractmethod
    def force(self, u: Float, f: Float, particles: LocalIndex) -> float:
        """Add the forces of ``u`` (n_local, dim) in the families of selected own particles; return the energy there."""

    def of_gradient(self, operator: GradientOperator) -> SameGradient | None:
        """Return the data of the control for the loop over ``operator`` if both have the same gradient, else None.

        One pass over the families then computes the forces of material and control (not collective).
        """
        return None

    @abstractmethod
    def matrix(self, sparsity: Sparsity) -> ControlMatrix:
        """Return the matrix for ``sparsity`` (collective)."""

    def add_product(self, du: Float, f: Float, particles: LocalIndex) -> None:
        """Add the forces of ``du`` in the families of selected own particles."""
        self.force(du, f, particles)

    def add_rows(self, entries: Entries) -> None:
        """Add the rows of the matrix, which is computed once."""
        if self._filled is None or self._filled[0] is not entries.sparsity:
            self._filled = entries.sparsity, self.matrix(entries.sparsity)
        self._filled[1].add(entries.diag, entries.off)

    def shared_gradient(self, operator: GradientOperator) -> SameGradient | None:
        """Return ``of_gradient``, computed once per operator."""
        if self._shared is None or self._shared[0] is not operator:
            self._shared = operator, self.of_gradient(operator)
        return self._shared[1]

    def scaled(self, share: Float) -> Control:
        """Return the control with the stiffness of each own family times a positive share (n_owned,).

        Raises
        ------
        CaseError
            The control has no such form.
        """
        raise CaseError(_NOT_FOLLOWING)

    def family_forces(self, u: Float) -> Float:
        """Return the force of every family on each of its members (n_entries, dim) [force].

        Parameters
        ----------
        u : (n_local, dim) float64
            Displacements with ghosts [length].

        Returns
        -------
        forces : (n_entries, dim) float64
            In the order of ``stencils``; those of a family sum to zero (not collective).

        Raises
        ------
        CaseError
            The control has no such form.
        """
        raise CaseError(_NOT_FOLLOWING)

    def energy(self, u: Float, particles: LocalIndex) -> float:
        """Return the energy of the families of selected own particles [energy] (not collective)."""
        return self.force(u, np.zeros_like(u), particles)

    def families_at(self, particles: LocalIndex) -> StencilMembers:
        """Return the families of selected own particles (n,), ascending, with the centre first (not collective)."""
        ptr, members = self.stencils
        entries, first = entries_of(ptr, particles)
        return StencilMembers(particles, first, members[entries])

    def forces_at(self, u: Float, particles: LocalIndex) -> Float:
        """Return ``family_forces`` of selected own particles, in the order of ``families_at``."""
        return np.asarray(self.family_forces(u)[entries_of(self.stencils[0], particles)[0]])

    def family_energy(self, u: Float) -> Float:
        """Return the energy of the family of every own particle (n_owned,) [energy] (not collective)."""
        (ptr, members), m = self.stencils, self.family_forces(u)
        # Relative to the centre: a translation of the family causes no round-off.
        eta = u[members] - np.repeat(u[members[ptr[:-1]]], np.diff(ptr), axis=0)
        return np.asarray(0.5 * np.add.reduceat(np.einsum("ei,ei->e", m, eta), ptr[:-1]))

    def damaged(self, phi: Float) -> Control:
        """Return the control with the stiffness of every bond times its degradation factor (n_bonds,).

        Raises
        ------
        CaseError
            The control has no such form.
        """
        raise CaseError(_NO_DAMAGE)

    def faded(self, phi: Float) -> Control:
        """Return the control with the force of every bond times its ``phi`` (n_bonds,), with the same gradient.

        The degradation factor is constant in its matrix.

        Raises
        ------
        CaseError
            The control has no such form.
        """
        raise CaseError(_NO_DAMAGE)

    def bond_forces(self, u: Float) -> Float:
        """Return the force of every bond on its second end (n_bonds, dim) [force] for displacements with ghosts.

        They do not contain the degradation factor of ``faded`` (not collective).

        Raises
        ------
        CaseError
            The control has no such form.
        """
        raise CaseError(_NO_DAMAGE)


@dataclass(frozen=True)
class ZeroEnergyControl(Declared, ABC):
    """Declaration of a zero-energy control in a case.

    Attributes
    ----------
    of_kappa : bool
        True if the control is ``NonUniform`` and in proportion to ``kappa`` of each particle, so that particles with
        equal families share its bond stiffness.
    """

    of_kappa: ClassVar[bool] = False

    @property
    def elastic(self) -> ZeroEnergyControl:
        """Return the control for materials without history: itself."""
        return self

    def sees(self, stiffness: Stiffness) -> Stiffness:
        """Return the stiffness that ``build`` uses, by default that of the material (not collective)."""
        return stiffness

    @property
    def least_share(self) -> float | None:
        """Return the smallest stiffness ratio of a tangent-scaled control [-]; None for other controls."""
        return None

    @abstractmethod
    def build(self, cloud: Cloud, families: Families, omega: Float, stiffness: Stiffness) -> Control:
        """Build the control for influence ``omega`` (n_bonds,) and the stiffness of the own particles.

        Notes
        -----
        Collective.
        """


def with_centre_forces(indptr: GlobalIndex, forces: Float) -> Float:
    """Return forces on members of families, centre first, from forces on second ends of bonds (n_bonds, dim)."""
    found = np.insert(forces, indptr[:-1], 0.0, axis=0)
    first = indptr[:-1] + np.arange(len(indptr) - 1)
    found[first] = -np.add.reduceat(found, first, axis=0)
    return np.asarray(found)
