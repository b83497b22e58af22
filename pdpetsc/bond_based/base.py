"""What a material of forces along bonds declares and what a body asks of it."""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property
from typing import ClassVar, Literal

import numpy as np
import scipy

from pdpetsc.arrays import Float, LocalIndex
from pdpetsc.declare.influence import Influence, evaluate
from pdpetsc.declared import Declared
from pdpetsc.discrete.cloud import Cloud
from pdpetsc.discrete.communicator import largest, total
from pdpetsc.discrete.families import Families
from pdpetsc.discrete.interior import interior
from pdpetsc.material.linear_elastic import LinearElastic

# Families whose moment is within this share of the largest one count as the largest.
LARGEST = 0.01
# Points of the quadrature of a moment of the influence on each half of the horizon.
QUADRATURE = 40


@dataclass(frozen=True)
class Neighbourhood:
    """The bonds of the own particles as a material reads them.

    Attributes
    ----------
    cloud, families
        Particles and bonds.
    omega, length : (n_bonds,) float64
        Influence [-] and reference length [length] of every bond. Influence is zero where only the second end reaches
        the first.
    influence : Influence
        The function that gave ``omega``.
    thickness : float
        Thickness of a plane body or cross-section of a bar, which the volumes contain [length^(3 - dim)].
    """

    cloud: Cloud
    families: Families
    omega: Float
    length: Float
    influence: Influence
    thickness: float

    def moment(self, power: int) -> Float:
        """Return ``sum_j omega |xi|^power V_j`` of every own particle (n_owned,)."""
        values = self.omega * self.length**power * self.cloud.volume[self.families.neighbours]
        return np.asarray(np.bincount(self.families.centres, values, self.cloud.n_owned), dtype=float)

    def continuous_moment(self, power: int) -> Float:
        """Return the integral of ``omega |xi|^power`` over a whole ball of the horizon of each particle (n_owned,)."""
        dim, horizon = self.cloud.dim, self.cloud.local_horizon[: self.cloud.n_owned]
        surface = {1: 2.0, 2: 2.0 * np.pi, 3: 4.0 * np.pi}[dim]
        points, weights = scipy.special.roots_legendre(QUADRATURE)
        s = np.concatenate([0.25 * (points + 1.0), 0.25 * (points + 3.0)])
        values = evaluate(self.influence, s) * s ** (power + dim - 1) * np.tile(0.25 * weights, 2)
        return np.asarray(surface * self.thickness * horizon ** (power + dim) * values.sum())

    def relative_size(self, power: int) -> Float:
        """Return moments of whole families over that of the largest horizon, ``(reach / horizon)^(power + dim)``."""
        cloud = self.cloud
        return np.asarray((cloud.local_horizon[: cloud.n_owned] / cloud.horizon) ** (power + cloud.dim))

    @cached_property
    def share_inside(self) -> Float:
        """Return the share of each own particle in a volume-weighted mean over the body inside (n_owned,) (collective).

        The mean is over the particles further than a horizon from the surface, or, in a thin body, over those with the
        largest families. On a lattice whose families repeat these are the same families.
        """
        cloud = self.cloud
        found = None if cloud.stands_for is not None else interior(cloud, self.families)
        if found is not None and not found.thin:
            inside = found.along[:, 0]
        else:
            moment = self.moment(1) / self.relative_size(1)
            inside = moment >= (1.0 - LARGEST) * largest(cloud.comm, float(moment.max(initial=0.0)))
        volume = np.where(inside, cloud.volume[: cloud.n_owned], 0.0)
        return np.asarray(volume / total(cloud.comm, float(volume.sum())))


@dataclass(frozen=True)
class BondStiffness:
    """Stiffness that a material gives to its bonds and particles.

    The energy is ``sum_ij 1/2 k_ij e_ij^2 + sum_i 1/2 B_i (sum_j a_ij e_ij)^2`` over the bonds ``ij`` of every particle
    ``i``, so that a pair counts twice, once from each end.

    Attributes
    ----------
    k : (n_bonds,) float64
        Stiffness of every bond [force / length].
    a : (n_bonds,) float64 or None
        What the elongation of a bond adds to the dilatation of its particle [1 / length]; None for no such term.
    B : (n_owned,) float64 or None
        Stiffness against dilatation [energy].
    """

    k: Float
    a: Float | None = None
    B: Float | None = None


@dataclass(frozen=True)
class BondMaterial(Declared, ABC):
    """A material whose forces act along bonds.

    Parameters
    ----------
    E : float
        Young's modulus [stress], positive.
    nu : float, optional
        Poisson's ratio [-]; a bar in 1D needs it for its lateral stretch only.
    plane : {"strain", "stress"}
        Plane strain or plane stress of a two-dimensional body: no strain or no stress across it.
    kinematics : {"small", "finite"}
        ``small``: bonds keep their direction and elongate by ``n . eta``, the forces are linear in the displacement.
        ``finite``: bonds turn, and elongate by ``|xi + eta| - |xi|``.

    Attributes
    ----------
    of_family : bool
        Whether its constants are stiffnesses of bonds alone that follow from the bonds of the family, so that particles
        with the same bonds share them.
    """

    of_family: ClassVar[bool] = False
    # The time that the load takes, as materials of deformation gradients may have it.
    duration: ClassVar[float | None] = None

    E: float
    nu: float | None = None
    plane: Literal["strain", "stress"] = "strain"
    kinematics: Literal["small", "finite"] = "small"

    def __post_init__(self) -> None:
        super().__post_init__()
        LinearElastic(self.E, 0.0 if self.nu is None else self.nu, self.plane)

    @abstractmethod
    def elastic(self, dim: int) -> LinearElastic:
        """Return the linear elastic material it stands for in ``dim`` dimensions.

        Raises
        ------
        CaseError
            It cannot have the declared Poisson's ratio.
        """

    def uniform(self) -> BondMaterial:
        """Return itself: nothing of it depends on place."""
        return self

    @abstractmethod
    def stiffness(self, bonds: Neighbourhood) -> BondStiffness:
        """Return its constants on all bonds of the own particles (collective)."""


def combine(
    bonds: Neighbourhood, materials: Sequence[BondMaterial], material_of: LocalIndex, factor: Float
) -> BondStiffness:
    """Return the constants of each bond from the material of its first end, times the factor there (collective).

    Parameters
    ----------
    material_of : (n_owned,) int32
        Index into ``materials``.
    factor : (n_owned,) float64
        What multiplies the moduli [-].
    """
    parts = [material.stiffness(bonds) for material in materials]
    centres = bonds.families.centres
    k = np.zeros(len(centres))
    a, B = np.zeros(len(centres)), np.zeros(bonds.cloud.n_owned)
    for number, part in enumerate(parts):
        mine, own = material_of[centres] == number, material_of == number
        k[mine] = part.k[mine] * factor[centres[mine]]
        if part.a is not None and part.B is not None:
            a[mine] = part.a[mine]
            B[own] = part.B[own] * factor[own]
    if all(part.a is None for part in parts):
        return BondStiffness(k)
    return BondStiffness(k, a, B)
