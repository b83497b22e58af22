"""What a zero-energy control declares and what a body asks of it."""

from __future__ import annotations

import math
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
        What grading multiplies the moduli by [-]; already in ``kappa``.
    """

    kappa: Float
    moduli: Float
    material_of: LocalIndex
    factor: Float


def relative_factor(cloud: Cloud, families: Families, omega: Float, stiffness: Stiffness) -> Float:
    """Return ``kappa_i / sum_j omega |xi|^2 V_j`` (n_owned,) [force / length^7], 0 for a particle without family.

    Bond forces ``C`` times it times ``omega eta`` have the share ``C`` of the stiffness of the material, whatever the
    units, the spacing and the horizon (not collective).
    """
    xi = families.bonds(cloud.x)
    moment = omega * np.einsum("bm,bm->b", xi, xi) * cloud.volume[families.neighbours]
    trace = np.bincount(families.centres, moment, minlength=cloud.n_owned)
    return np.divide(stiffness.kappa, trace, out=np.zeros(cloud.n_owned), where=trace > 0.0)


def refuse_negative(what: str, value: float) -> None:
    """Raise CaseError where the coefficient of a control is negative or not finite."""
    if not (math.isfinite(value) and value >= 0.0):
        raise CaseError(f"{what} >= 0, not {value}.")


class ControlMatrix(ABC):
    """The constant matrix of a control in the layout of the tangent."""

    @abstractmethod
    def add(self, diag: Float, off: Float) -> None:
        """Add it to the values of the own rows."""


@dataclass(frozen=True)
class IsotropicMatrix(ControlMatrix):
    """One scalar per block, times the identity; beside mirror planes one for each component.

    Attributes
    ----------
    diag, off : (1 or dim, n_blocks) float64
        Own columns and others.
    """

    sparsity: Sparsity
    diag: Float
    off: Float

    def add(self, diag: Float, off: Float) -> None:
        """Add it to the values of the own rows."""
        kernel = add_diagonal_kernel(self.sparsity.cloud.dim)
        kernel(self.sparsity.owned.diag_ptr, self.diag, diag)
        kernel(self.sparsity.owned.off_ptr, self.off, off)


@dataclass(frozen=True)
class BlockMatrix(ControlMatrix):
    """Full blocks, in scalar CSR layout."""

    diag: Float
    off: Float

    def add(self, diag: Float, off: Float) -> None:
        """Add it to the values of the own rows."""
        diag += self.diag
        off += self.off


def isotropic(sparsity: Sparsity, kernel: Callable[..., None], stencils: Stencil, *data: Float) -> IsotropicMatrix:
    """Return the matrix whose blocks a kernel fills with a scalar for each pair of local particles (collective).

    Arguments as for ``fill``. A component turns its sign behind some mirror planes and not behind others.
    """
    components = sparsity.cloud.dim if len(sparsity.cloud.places.mirrors[0]) > 1 else 1
    parts = [fill(sparsity, kernel, stencils, *data, component=c) for c in range(components)]
    return IsotropicMatrix(sparsity, np.array([diag for diag, _ in parts]), np.array([off for _, off in parts]))


def fill(
    sparsity: Sparsity, kernel: Callable[..., None], stencils: Stencil, *data: Float, component: int | None = None
) -> tuple[Float, Float]:
    """Return the values of the own rows, own columns and others, of the matrix of a control.

    Parameters
    ----------
    sparsity : Sparsity
        Where its blocks are.
    kernel : callable
        Row-wise loop, as ``Entries.add`` takes it.
    stencils : (point_ptr, members)
        What the matrix couples.
    data
        What the kernel reads after the stencils.
    component : int, optional
        The component that blocks of one value have; whole blocks if absent.

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
    """A control built for one cloud: forces linear in u, so that its matrix is constant."""

    _filled: tuple[Sparsity, ControlMatrix] | None = None
    _shared: tuple[GradientOperator, SameGradient | None] | None = None

    @property
    @abstractmethod
    def stencils(self) -> Stencil:
        """Return what its matrix couples: the families with their centre first."""

    @abstractmethod
    def force(self, u: Float, f: Float, particles: LocalIndex) -> float:
        """Add the forces of ``u`` (n_local, dim) in the families of some own particles; return the energy there."""

    def of_gradient(self, operator: GradientOperator) -> SameGradient | None:
        """Return what its forces take in the loop over ``operator`` where its gradient is that one, else None.

        One pass over the families can then compute the forces of the material and of the control (not collective).
        """
        return None

    @abstractmethod
    def matrix(self, sparsity: Sparsity) -> ControlMatrix:
        """Return the matrix for ``sparsity`` (collective)."""

    def add_product(self, du: Float, f: Float, particles: LocalIndex) -> None:
        """Add the forces of ``du`` in the families of some own particles."""
        self.force(du, f, particles)

    def add_rows(self, entries: Entries) -> None:
        """Add the matrix, which is computed once."""
        if self._filled is None or self._filled[0] is not entries.sparsity:
            self._filled = entries.sparsity, self.matrix(entries.sparsity)
        self._filled[1].add(entries.diag, entries.off)

    def shared_gradient(self, operator: GradientOperator) -> SameGradient | None:
        """Return ``of_gradient``, computed once for an operator."""
        if self._shared is None or self._shared[0] is not operator:
            self._shared = operator, self.of_gradient(operator)
        return self._shared[1]

    def scaled(self, share: Float) -> Control:
        """Return the control with the stiffness of the family of each own particle times a positive share (n_owned,).

        Raises
        ------
        CaseError
            It has no such form.
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
            It has no such form.
        """
        raise CaseError(_NOT_FOLLOWING)

    def families_at(self, particles: LocalIndex) -> StencilMembers:
        """Return the families of some own particles (n,) with their centre first, ascending (not collective)."""
        ptr, members = self.stencils
        entries, first = entries_of(ptr, particles)
        return StencilMembers(particles, first, members[entries])

    def forces_at(self, u: Float, particles: LocalIndex) -> Float:
        """Return those of ``family_forces`` that are of some own particles, in the order of ``families_at``."""
        return np.asarray(self.family_forces(u)[entries_of(self.stencils[0], particles)[0]])

    def family_energy(self, u: Float) -> Float:
        """Return the energy of the family of every own particle (n_owned,) [energy] (not collective)."""
        (ptr, members), m = self.stencils, self.family_forces(u)
        # Relative to the centre, so that what moves the family as a whole does not round.
        eta = u[members] - np.repeat(u[members[ptr[:-1]]], np.diff(ptr), axis=0)
        return np.asarray(0.5 * np.add.reduceat(np.einsum("ei,ei->e", m, eta), ptr[:-1]))

    def damaged(self, phi: Float) -> Control:
        """Return the control with the stiffness of every bond times its degradation factor (n_bonds,).

        Raises
        ------
        CaseError
            It has no such form.
        """
        raise CaseError(_NO_DAMAGE)

    def faded(self, phi: Float) -> Control:
        """Return the control with the force of every bond times its ``phi`` (n_bonds,), and its gradient as it is.

        Its matrix takes the degradation factor as constant.

        Raises
        ------
        CaseError
            It has no such form.
        """
        raise CaseError(_NO_DAMAGE)

    def bond_forces(self, u: Float) -> Float:
        """Return the force of every bond on its second end (n_bonds, dim) [force] for displacements with ghosts.

        The degradation factor that ``faded`` multiplies them with is not in them (not collective).

        Raises
        ------
        CaseError
            It has no such form.
        """
        raise CaseError(_NO_DAMAGE)


@dataclass(frozen=True)
class ZeroEnergyControl(Declared, ABC):
    """A zero-energy control as a case declares it.

    Attributes
    ----------
    of_kappa : bool
        Whether it is a ``NonUniform`` control in proportion to ``kappa`` of each particle, so that particles whose
        families repeat share its bond stiffness.
    """

    of_kappa: ClassVar[bool] = False

    @property
    def elastic(self) -> ZeroEnergyControl:
        """Return the control of a body whose materials have no history: itself."""
        return self

    def sees(self, stiffness: Stiffness) -> Stiffness:
        """Return the stiffness that ``build`` is given for that of the material: the same (not collective)."""
        return stiffness

    @property
    def least_share(self) -> float | None:
        """Return down to which share of its stiffness it follows a material that yields [-]; None where it does not."""
        return None

    @abstractmethod
    def build(self, cloud: Cloud, families: Families, omega: Float, stiffness: Stiffness) -> Control:
        """Return the control for influence ``omega`` (n_bonds,) and the stiffness of the own particles.

        Notes
        -----
        Collective.
        """


def with_centre_forces(indptr: GlobalIndex, forces: Float) -> Float:
    """Return forces on the members of families, centre first, from those on the second ends of bonds (n_bonds, dim)."""
    found = np.insert(forces, indptr[:-1], 0.0, axis=0)
    first = indptr[:-1] + np.arange(len(indptr) - 1)
    found[first] = -np.add.reduceat(found, first, axis=0)
    return np.asarray(found)
