"""Interface of materials with forces along bonds: declaration and stiffness of bonds."""

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
from pdpetsc.discrete.cloud import Cloud
from pdpetsc.discrete.communicator import largest, total
from pdpetsc.discrete.families import Families
from pdpetsc.discrete.interior import interior
from pdpetsc.material.base import WithDensity
from pdpetsc.material.linear_elastic import LinearElastic

# Families count as largest if their moment is within this share of the largest moment.
LARGEST = 0.01
# Quadrature points of a moment of the influence function on each half of the horizon.
QUADRATURE = 40


@dataclass(frozen=True)
class Neighbourhood:
    """Bonds of the own particles as input of a material.

    Attributes
    ----------
    cloud, families
        Particles and bonds.
    omega : (n_bonds,) float64
        Influence of every bond [-]. It is zero if the first end is inside the horizon of the second, but not vice
        versa.
    influence : Influence
        The influence function of ``omega``.
    thickness : float
        Thickness of a plane body or cross-section of a bar, which the volumes contain [length^(3 - dim)].
    """

    cloud: Cloud
    families: Families
    omega: Float
    influence: Influence
    thickness: float

    @property
    def length(self) -> Float:
        """Return the reference length of every bond (n_bonds,) [length], computed on use."""
        return self.families.lengths(self.cloud.x)

    def moment(self, power: int) -> Float:
        """Return ``sum_j omega |xi|^power V_j`` of every own particle (n_owned,)."""
        values = self.omega * self.length**power * self.cloud.volume[self.families.neighbours]
        return np.asarray(np.bincount(self.families.centres, values, self.cloud.n_owned), dtype=float)

    def continuous_moment(self, power: int) -> Float:
        """Return the integral of ``omega |xi|^power`` over the full horizon ball of each particle (n_owned,)."""
        dim, horizon = self.cloud.dim, self.cloud.local_horizon[: self.cloud.n_owned]
        surface = {1: 2.0, 2: 2.0 * np.pi, 3: 4.0 * np.pi}[dim]
        points, weights = scipy.special.roots_legendre(QUADRATURE)
        s = np.concatenate([0.25 * (points + 1.0), 0.25 * (points + 3.0)])
        values = evaluate(self.influence, s) * s ** (power + dim - 1) * np.tile(0.25 * weights, 2)
        return np.asarray(surface * self.thickness * horizon ** (power + dim) * values.sum())

    def relative_size(self, power: int) -> Float:
        """Return moments of whole families over those of the largest horizon, ``(reach / horizon)^(power + dim)``."""
        cloud = self.cloud
        return np.asarray((cloud.local_horizon[: cloud.n_owned] / cloud.horizon) ** (power + cloud.dim))

    @cached_property
    def share_inside(self) -> Float:
        """Compute the weight of each own particle in the volume-weighted mean over the inner body (n_owned,).

        The mean is over the particles further than a horizon from the surface, or, in a thin body, over those with the
        largest families. On a lattice both are the same families (collective).
        """
        cloud = self.cloud
        found = None if cloud.stands_for is not None else interior(cloud, self.families)
        if found is not None and not found.thin:
            inside = found.along[:, 0]
        else:
            moment = self.moment(1) / self.relative_size(1)
            inside = moment >= (1.0 - LARGEST) * largest(cloud.comm, moment, initial=0.0)
        volume = np.where(inside, cloud.volume[: cloud.n_owned], 0.0)
        return np.asarray(volume / total(cloud.comm, float(volume.sum())))


@dataclass(frozen=True)
class BondStiffness:
    """Stiffness of bonds and particles of a material.

    The energy is ``sum_ij 1/2 k_ij e_ij^2 + sum_i 1/2 B_i (sum_j a_ij e_ij)^2`` over the bonds ``ij`` of every particle
    ``i``. A pair counts twice, once from each end.

    Attributes
    ----------
    k : (n_bonds,) float64
        Stiffness of every bond [force / length].
    a : (n_bonds,) float64 or None
        Derivative of the dilatation of a particle by the elongation of its bond [1 / length]; None without dilatation.
    B : (n_owned,) float64 or None
        Stiffness against dilatation [energy].
    """

    k: Float
    a: Float | None = None
    B: Float | None = None


@dataclass(frozen=True)
class BondMaterial(WithDensity, ABC):
    """A material whose forces act along bonds.

    Parameters
    ----------
    E : float
        Young's modulus [stress], positive.
    nu : float, optional
        Poisson's ratio [-]; in 1D it determines the lateral stretch only.
    plane : {"strain", "stress"}
        Plane strain or plane stress of a two-dimensional body: no strain or no stress out of plane.
    kinematics : {"small", "finite"}
        ``small``: bonds keep their direction and elongate by ``n . eta``; forces are linear in the displacement.
        ``finite``: bonds rotate and elongate by ``|xi + eta| - |xi|``.
    density : float, optional
        Mass per reference volume [mass / volume], given by keyword; needed for natural frequencies only.

    Attributes
    ----------
    of_family : bool
        True if the constants are bond stiffnesses that depend on the bonds of the family only, so that particles with
        equal bonds share them.
    """

    of_family: ClassVar[bool] = False
    # Duration of the load, as for materials of deformation gradients.
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
        """Return the equivalent linear elastic material in ``dim`` dimensions.

        Raises
        ------
        CaseError
            The material does not support the declared Poisson's ratio.
        """

    def uniform(self) -> BondMaterial:
        """Return the material itself: it does not depend on position."""
        return self

    @abstractmethod
    def stiffness(self, bonds: Neighbourhood) -> BondStiffness:
        """Compute the stiffness of all bonds of the own particles (collective)."""


def combine(
    bonds: Neighbourhood, materials: Sequence[BondMaterial], material_of: LocalIndex, factor: Float
) -> BondStiffness:
    """Compute the stiffness of each bond from the material of its first end, times the factor there (collective).

    Parameters
    ----------
    material_of : (n_owned,) int32
        Index into ``materials``.
    factor : (n_owned,) float64
        Factor of the moduli [-].
    """
    parts = [material.stiffness(bonds) for material in materials]
    if len(parts) == 1 and parts[0].a is None:
        k = np.array(parts[0].k)
        bonds.families.multiply(k, factor)
        return BondStiffness(k)
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
