"""What a discrete body gives to loading, solvers and outputs, whatever its formulation."""

from __future__ import annotations

from abc import ABC, abstractmethod
from functools import cached_property

import numpy as np

from pdpetsc.arrays import Float, Mask
from pdpetsc.discrete.cloud import Cloud
from pdpetsc.discrete.communicator import total
from pdpetsc.discrete.families import Families
from pdpetsc.discrete.spread import Spread, start_displacements, start_forces
from pdpetsc.kernels.bonds import bond_force_kernel, elongation_kernel
from pdpetsc.model.assembler import Assembler
from pdpetsc.model.failure import BondFailure
from pdpetsc.model.linearised import Linearised


class Model(ABC):
    """A body: its internal forces, tangent and energy as functions of the unknowns of this rank.

    Unknowns ``u`` (n_rows, dim) are the displacements of the own particles and, on the last rank, the virtual rows of a
    periodic cell; forces have the same rows.

    Parameters
    ----------
    cloud, families
        Particles of this rank and their bonds.

    Attributes
    ----------
    coupling : int
        Horizons over which particles are coupled.
    version, breaks : int
        Grow whenever the constants of the forces change, as they do when bonds fail; and whenever bonds break or mend.
    failure : BondFailure or None
        State of the bonds where they can fail.
    finite : int
        Whether elongations of bonds are those of their current length, 1, or along their first direction, 0.
    n_detached : int
        Particles on all ranks that have too few bonds left for a gradient, and no stress.
    note : str
        What a user should know about how the body was built; the same on all ranks.

    Notes
    -----
    Every method is collective but where it says otherwise.
    """

    coupling: int = 2
    version: int = 0
    breaks: int = 0
    finite: int = 1
    n_detached: int = 0
    note: str = ""
    failure: BondFailure | None = None

    def __init__(self, cloud: Cloud, families: Families) -> None:
        self.cloud = cloud
        self.families = families
        self._u = np.zeros((cloud.n_local, cloud.dim))

    @cached_property
    def spread(self) -> Spread:
        """Return what applies work on families (not collective)."""
        return Spread(self.cloud, self.families)

    @property
    def dim(self) -> int:
        """Return the dimension (not collective)."""
        return self.cloud.dim

    def with_ghosts(self, u: Float) -> Float:
        """Return the displacements of all local particles (n_local, dim); the array is reused by the next call."""
        start_displacements(self.cloud, u, self._u)()
        return self._u

    def gather(self, f: Float) -> Float:
        """Return the forces on the unknowns (n_rows, dim) from those on local particles (n_local, dim), overwritten."""
        return start_forces(self.cloud, f)()

    @property
    @abstractmethod
    def linear(self) -> bool:
        """Return whether forces are linear in the unknowns now (not collective)."""

    @property
    @abstractmethod
    def n_points(self) -> int:
        """Return the gradient points of this rank, 0 for a body without (not collective)."""

    @property
    @abstractmethod
    def parts(self) -> list[str]:
        """Return what the body is made of, for the record (not collective)."""

    @abstractmethod
    def internal_force(self, u: Float) -> Float | None:
        """Return the internal forces (n_rows, dim) [force]; None on all ranks where u is inadmissible on any."""

    @abstractmethod
    def all_admissible(self, u: Float) -> bool:
        """Return whether forces are defined at u on every rank."""

    @abstractmethod
    def linearised(self, u: Float) -> Linearised:
        """Return the tangent at ``u``, which is applied without assembling it."""

    def tangent_times(self, u: Float, du: Float) -> Float:
        """Return ``K(u) du`` (n_rows, dim) [force]."""
        return self.linearised(u)(du)

    @abstractmethod
    def energy(self, u: Float) -> tuple[float, float]:
        """Return the strain energy of the body and that of its zero-energy control [energy]."""

    def commit(self, u: Float) -> None:
        """Take ``u`` as converged: what has a history remembers it."""
        if self.failure is not None:
            self.soften(u)
            self.failure.commit()

    def revert(self) -> None:
        """Take back what failed since the last ``commit``."""
        if self.failure is not None:
            intact = self.failure.intact
            self.failure.revert()
            mended = int(np.any(intact != self.failure.intact))
            self._changed(rebuild=int(total(self.cloud.comm, mended)) > 0)

    def break_bonds(self, u: Float, most: int | None = None) -> int:
        """Break bonds past their final stretch, about ``most`` at once, the worst first; return how many pairs."""
        if self.failure is None:
            return 0
        broken = self.failure.break_bonds(self.elongation(self.with_ghosts(u)), most)
        if broken:
            self._changed(rebuild=True)
        return broken

    @property
    def symmetric(self) -> bool:
        """Return whether the tangent is symmetric (not collective)."""
        return True

    @property
    def softens(self) -> bool:
        """Return whether bonds lose their force gradually (not collective)."""
        return self.failure is not None and self.failure.law.final > self.failure.law.onset

    @property
    def heals(self) -> bool:
        """Return whether bonds that have not broken may regain force (not collective)."""
        return self.failure is not None and self.failure.law.effect.heals

    def freeze(self, frozen: bool) -> None:
        """Let damage stay, or follow the displacement (not collective)."""
        if self.failure is not None and self.failure.frozen != frozen:
            self.failure.frozen = frozen
            self.version += 1

    def elongated(self, u_local: Float) -> tuple[Float, float]:
        """Return ``e`` (n_bonds,) [length] for displacements with ghosts, and the least current length of a bond."""
        family, e = self.families, np.empty(len(self.families.neighbours))
        kernel = elongation_kernel(self.dim, self.finite)
        least = kernel(family.indptr, family.neighbours, self.cloud.x, u_local, e)
        return e, float(least)

    def elongation(self, u_local: Float) -> Float:
        """Return the elongation of every bond (n_bonds,) [length] for displacements with ghosts (not collective)."""
        return self.elongated(u_local)[0]

    def fading(self, u: Float) -> float:
        """Return the largest integrity that a bond would lose at ``u`` [-]."""
        if self.failure is None:
            return 0.0
        return self.failure.fading(self.elongation(self.with_ghosts(u)))

    def soften(self, u: Float) -> float:
        """Take the damage at ``u`` for good; return the largest change of an integrity [-]."""
        if self.failure is None:
            return 0.0
        change = self.failure.soften(self.elongation(self.with_ghosts(u)))
        if change > 0.0:
            self._changed(rebuild=False)
        return change

    def damage(self) -> tuple[Float, Float]:
        """Return a copy of the state of the bonds, integrity and largest stretch, for ``take_damage``."""
        assert self.failure is not None
        return self.failure.integrity.copy(), self.failure.worst.copy()

    def take_damage(self, damage: tuple[Float, Float]) -> None:
        """Go back to a state of the bonds in which the same ones are broken."""
        assert self.failure is not None
        self.failure.integrity[:], self.failure.worst[:] = damage
        self._changed(rebuild=False)

    def most_stretched(self, u: Float, band: float) -> tuple[Float, float]:
        """Return how the largest stretch over the critical one grows with the unknowns, and that stretch.

        Returns
        -------
        gradient : (n_rows, dim) float64
            Of the mean over the bonds that have not failed and are within ``band`` of the largest, relatively
            [1 / length]; zero where none is stretched.
        largest : float
            [-]
        """
        f = np.zeros((self.cloud.n_local, self.dim))
        if self.failure is None:
            return self.gather(f), 0.0
        family, u_local = self.families, self.with_ghosts(u)
        weights, found = self.failure.most_stretched(self.elongation(u_local), band)
        bond_force_kernel(self.dim, self.finite)(family.indptr, family.neighbours, self.cloud.x, u_local, weights, f)
        return self.gather(f), found

    def local_damage(self) -> Float:
        """Return the lost share of the stiffness of each own particle's bonds (n_owned,) [-] (not collective)."""
        return np.zeros(self.cloud.n_owned)

    def lost_bonds(self) -> Float:
        """Return ``1 - sum_j mu V_j / sum_j V_j`` (n_owned,) [-], mu 0 for broken bonds, else 1 (not collective)."""
        if self.failure is None:
            return np.zeros(self.cloud.n_owned)
        centres, volume = self.families.centres, self.cloud.volume[self.families.neighbours]
        whole = np.bincount(centres, volume, self.cloud.n_owned)
        lost = np.bincount(centres, np.where(self.failure.intact, 0.0, volume), self.cloud.n_owned)
        return np.asarray(lost / np.where(whole > 0.0, whole, 1.0))

    def take_failure(self) -> None:
        """Follow the state of the bonds, set from outside, and keep it."""
        if self.failure is not None:
            self.failure.commit()
            self._changed(rebuild=True)

    def _changed(self, rebuild: bool) -> None:
        """Follow a change of the integrity of bonds, and of which are broken where ``rebuild``."""
        self.version += 1
        self.breaks += rebuild

    def broken_bonds(self) -> int:
        """Return how many pairs of particles have lost their bond."""
        return 0 if self.failure is None else self.failure.count_broken()

    def dissipated_energy(self) -> float | None:
        """Return what bonds have dissipated in failing [energy]; None where their laws alone do not tell."""
        return None if self.has_history else 0.0

    @property
    @abstractmethod
    def has_history(self) -> bool:
        """Return whether forces depend on converged steps; the same on all ranks (not collective)."""

    @property
    def restartable(self) -> bool:
        """Return whether unknowns and the state of bonds are all that a continued run needs (not collective)."""
        return not self.has_history

    @property
    @abstractmethod
    def kappa(self) -> float:
        """Return a typical modulus, ``lambda + 2 mu / dim`` [stress] (not collective)."""

    @property
    @abstractmethod
    def largest_modulus(self) -> float:
        """Return the largest modulus on this rank [stress] (not collective)."""

    @abstractmethod
    def assembler(self) -> Assembler:
        """Return what fills the tangent matrix."""

    @abstractmethod
    def deformation_gradient(self, u: Float) -> Float:
        """Return F of the own particles (n_owned, dim, dim) [-]."""

    @abstractmethod
    def first_piola_stress(self, u: Float) -> Float:
        """Return P of the own particles (n_owned, dim, dim) [stress]."""

    @abstractmethod
    def cauchy_stress(self, u: Float) -> Float:
        """Return the Cauchy stress of the own particles (n_owned, dim, dim) [stress]; P where the body is linear."""

    @abstractmethod
    def out_of_plane(self, u: Float) -> tuple[Float, Float, Float]:
        """Return what a line or plane body does across itself: stretch [-], P and Cauchy stress [stress], (n_owned,).

        All three are those of one direction; a line has two equal ones.
        """

    @abstractmethod
    def energy_density(self, u: Float) -> Float:
        """Return the strain energy density of the own particles (n_owned,) [energy / volume]."""

    @abstractmethod
    def plastic_strain(self) -> Float:
        """Return the accumulated plastic strain of the own particles (n_owned,) [-] (not collective)."""

    @abstractmethod
    def uniform_stress_force(self, P: Float) -> Float:
        """Return the forces that hold stresses ``P`` (n_owned, dim, dim) of the particles in balance (n_rows, dim).

        Raises
        ------
        CaseError
            The formulation has no such forces.
        """

    @abstractmethod
    def reach(self, marked: Float) -> Mask:
        """Return the own particles whose forces depend on a marked local particle: (n_local,) -> (n_owned,) bool."""
