"""What drives the damage of bonds: a number for each of them that is 1 where it fails, and how it grows.

A criterion is declared (``Criterion``) and becomes the driving variable of the bonds of one rank
(``DrivingVariable``). Laws act on the driving variable and do not know how it is computed.
"""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Callable, Hashable, Mapping, Sequence
from dataclasses import dataclass
from functools import cached_property
from typing import Any, ClassVar, Protocol, TypeVar

import numpy as np

from pdpetsc.arrays import Float, GlobalIndex, LocalIndex, Mask
from pdpetsc.clock import Clock
from pdpetsc.declared import Declared
from pdpetsc.discrete.cloud import Cloud
from pdpetsc.discrete.families import Families
from pdpetsc.discrete.opposite import OppositeBonds
from pdpetsc.gradient.base import GradientOperator
from pdpetsc.material.point_laws import PointLaws
from pdpetsc.renamed import accept_old_methods

T = TypeVar("T")


# Selects all bonds.
EVERY = slice(None)


@dataclass(frozen=True)
class DamageableBonds:
    """The bonds of the own particles as a criterion reads them, each from one end.

    Attributes
    ----------
    cloud, families
        Particles and bonds.
    omega : (n_bonds,) float64
        Influence [-].
    stiffness : (n_bonds,) float64 or None
        ``k``, None where no criterion says that it reads it.
    finite : bool
        Whether elongations are those of the current length, or along the first direction of a bond.
    length : (n_bonds,) float64
        Reference length [length].
    material_of : (n_local,) int32
        Number of the material of each particle.
    factor : (n_local,) float64
        What grading multiplies the moduli of each particle with [-].
    """

    cloud: Cloud
    families: Families
    omega: Float
    stiffness: Float | None
    finite: bool
    length: Float
    material_of: LocalIndex
    factor: Float

    @classmethod
    def of(
        cls, cloud: Cloud, families: Families, omega: Float, k: Float | None, finite: bool,
        material_of: LocalIndex | None = None, factor: Float | None = None,
    ) -> DamageableBonds:  # fmt: skip
        """Return the bonds of a body with what follows from the places of their ends (collective).

        ``material_of`` and ``factor`` are those of the own particles (n_owned,); one material that is not graded where
        absent.
        """
        length = np.linalg.norm(families.bonds(cloud.x), axis=1)
        number, scale = np.zeros(cloud.n_local), np.ones(cloud.n_local)
        if material_of is not None:
            number[: cloud.n_owned] = material_of
        if factor is not None:
            scale[: cloud.n_owned] = factor
        cloud.halo.forward(number)
        cloud.halo.forward(scale)
        return cls(cloud, families, omega, k, finite, length, number.astype(np.int32), scale)

    @property
    def k(self) -> Float:
        """Return the elastic stiffness of every bond from one end (n_bonds,) [force / length].

        Of a body of deformation gradients, whose bonds have none of their own, it is that of the bond-based material
        with the same Young's modulus.
        """
        if self.stiffness is None:
            raise TypeError("The criterion has reads_stiffness = False, and reads the stiffness of bonds.")
        return self.stiffness

    @cached_property
    def opposite(self) -> OppositeBonds:
        """Return who has the other direction of every bond (collective the first time)."""
        return OppositeBonds(self.cloud, self.families, self.keys())

    def keys(self, bonds: GlobalIndex | Mask | slice = EVERY) -> GlobalIndex:
        """Return the keys of some bonds (n, 3), which are the same from both ends of a bond and on any ranks.

        A key is made of the global ids of both ends, the lower first, and the place of the second seen from the first.
        A bond to the own mirror image has one end only, in the part of the body that is computed.
        """
        gid, (one, other, place) = self.cloud.gid, self._ends(bonds)
        return np.stack([gid[one], gid[other], place], axis=1)

    def middle(self, bonds: GlobalIndex | Mask | slice = EVERY) -> Float:
        """Return the middle of some bonds, with the first end at home (n, dim) [length]."""
        x, (one, other, _) = self.cloud.x, self._ends(bonds)
        return self.cloud.places.at_home(self.cloud.place[one], 0.5 * (x[one] + x[other]))

    def _ends(self, bonds: GlobalIndex | Mask | slice) -> tuple[LocalIndex, LocalIndex, GlobalIndex]:
        """Return both ends of some bonds, the one with the lower key first, and the place of the second from there."""
        centres, neighbours = self.families.centres[bonds], self.families.neighbours[bonds]
        gid, place = self.cloud.gid, self.cloud.place[neighbours]
        back = self.cloud.places.opposite(place)
        i, j = gid[centres], gid[neighbours]
        low = (i < j) | ((i == j) & (back <= place))
        return np.where(low, centres, neighbours), np.where(low, neighbours, centres), np.where(low, place, back)


class Displaced(Protocol):
    """A displaced body as a driving variable reads it; a ``State`` is one."""

    @property
    def clock(self) -> Clock:
        """Return load parameter and physical time."""

    @property
    def u_local(self) -> Float:
        """Return the displacements with ghosts (n_local, dim) [length] (collective on first use)."""

    def elongated(self, finite: bool) -> tuple[Float, float]:
        """Return the elongations (n_bonds,) and the least current length of a bond on this rank [length]."""

    def kept(self, key: Hashable, make: Callable[[], T]) -> T:
        """Return what was kept under ``key`` since this state was first evaluated, or make and keep it."""


@dataclass(frozen=True)
class NonlocalPart:
    """Derivatives of numbers of bonds by the displacements of particles, other than through the own elongation.

    Attributes
    ----------
    ptr : (n + 1,) int64
        Those of the b-th bond are ``ptr[b]`` to ``ptr[b + 1]``.
    particles : (n_entries,) int32
        Local particles, of the family of the first end of the bond or that end itself. Of a number that is the mean of
        one of each end, either direction of the bond has the part of its own end, twice.
    by : (n_entries, dim) float64
        Derivative by the displacement of each [1 / length].
    """

    ptr: GlobalIndex
    particles: LocalIndex
    by: Float


@dataclass(frozen=True)
class EndpointMean:
    """Derivatives of numbers of bonds that are the mean of one of each end.

    Attributes
    ----------
    factor : (n,) float64
        What multiplies the mean, for each bond [-]; the same from both ends.
    by : (n_entries, dim) float64
        Derivative of the number of every own particle by the displacement of the members of its family, its centre
        first [1 / length].
    """

    factor: Float
    by: Float


@dataclass(frozen=True)
class Gradient:
    """How numbers of some bonds change with the displacement, ``d = along de + sum_m by_m . du_m``.

    Attributes
    ----------
    bonds : (n,) int64
        The bonds, ascending.
    along : (n,) float64
        Derivative by the elongation of the bond itself [1 / length].
    nonlocal_part : NonlocalPart or None
        What is left; None where the elongation of the bond says all.
    ends : tuple of EndpointMean
        What is left besides, of means of both ends, each of all bonds.
    """

    bonds: GlobalIndex
    along: Float
    nonlocal_part: NonlocalPart | None = None
    ends: tuple[EndpointMean, ...] = ()


class Solid(Protocol):
    """The gradient points of a body with their materials, as drives of strain and stress read them.

    Stresses are those without damage. The points change when bonds break, which they do at equilibrium only.
    """

    @property
    def gradients(self) -> GradientOperator:
        """Return the gradients of the bonds that are left."""

    @property
    def lost(self) -> Mask:
        """Return which points are of particles that have no gradient any more (n_points,)."""

    def deformation(self, state: Any) -> Float:
        """Return the deformation gradients (n_points, dim, dim) [-] (collective)."""

    def laws(self, state: Any) -> PointLaws:
        """Return the laws of the points at a state (collective)."""

    def temperature(self, state: Any) -> Float | None:
        """Return the temperature of the points (n_points,), None where the body has none (collective)."""


class DrivingVariable(ABC):
    """What drives the damage of the bonds of one rank: a number for each bond, 1 where it fails.

    It does not depend on the damage itself, and is the same from both ends of a bond, on whichever ranks they are.

    Attributes
    ----------
    is_nonlocal : bool
        Whether its gradient depends on more than the elongation of the bond; the same at every state.
    limit : (n_bonds,) float64 or None
        Elongations of failure [length] if the driving variable is ``e / limit``, else None. The event-driven solver
        takes such driving variables alone.
    reads_points : bool
        Whether it reads strain or stress at gradient points, which ``take`` gives it before it is used.
    reads_flow : bool
        Whether it reads how materials flow, which needs deformation gradients and a material with history.
    timed : bool
        Whether it depends on time, for which step times must stand.
    """

    is_nonlocal: bool = False
    limit: Float | None = None
    reads_points: bool = False
    reads_flow: bool = False
    timed: bool = False

    def __init_subclass__(cls) -> None:
        super().__init_subclass__()
        accept_old_methods(cls, {"reaches": "is_nonlocal"})

    def take(self, solid: Solid) -> None:  # noqa: B027
        """Read the gradient points of a body from now on (not collective)."""

    def commit(self, state: Displaced) -> None:  # noqa: B027
        """Remember a converged state, before materials do (collective)."""

    def arrays(self) -> Mapping[str, Float]:
        """Return what it remembers of the own particles, (n_owned, ...) by name, overwritten where a run goes on."""
        return {}

    @abstractmethod
    def at(self, state: Displaced) -> Float:
        """Return the drive of every bond (n_bonds,) [-] as a new array (collective)."""

    @abstractmethod
    def gradient(self, state: Displaced, bonds: GlobalIndex, by: Float) -> Gradient:
        """Return how ``by`` times the drive of some bonds changes with the displacement (collective).

        Parameters
        ----------
        state
            Where.
        bonds : (n,) int64
            The bonds, ascending.
        by : (n,) float64
            What multiplies the derivative of each, such as that of the degradation factor by the drive [-].
        """

    def mean_gradient(self, state: Displaced, bonds: GlobalIndex, count: float) -> Gradient:
        """Return how the drive of some bonds over their number on all ranks changes with the displacement (collective).

        Summed over bonds and ranks it is the gradient of their mean drive, which paths of equilibria follow.
        """
        return self.gradient(state, bonds, np.full(len(bonds), 1.0 / count))

    def at_strain(self, strain: Float) -> Float | None:
        """Return the drive of bonds that had these tensile strains (n_bonds,) [-] as a new array (not collective).

        By it bonds break with the strain of a gradient that has lost some, which they themselves do not show. None, for
        drives that see that strain anyway or cannot tell, lets none break so.
        """
        return None

    def elastic_energy(self, bonds: GlobalIndex, k: Float) -> tuple[Float, float] | None:
        """Return the energy of linear bonds where the drive is 1 (n,) [energy], and its degree in the drive [-].

        What laws dissipate follows from it, ``-int W y^degree dT(y)``. None where the drive does not tell the energy of
        a bond: dissipated energies are then differences of work and energy.

        Parameters
        ----------
        bonds : (n,) int64
            The bonds.
        k : (n,) float64
            Their stiffness [force / length].
        """
        return None


class LocalDrivingVariable(DrivingVariable):
    """A drive that is a function of the elongation of the bond itself.

    Parameters
    ----------
    bonds : DamageableBonds
        The bonds.
    """

    def __init__(self, bonds: DamageableBonds) -> None:
        self._bonds = bonds

    @abstractmethod
    def of(self, e: Float) -> Float:
        """Return the drive at elongations ``e`` (n_bonds,) [length] of all bonds as a new array."""

    @abstractmethod
    def along(self, e: Float, bonds: GlobalIndex, by: Float) -> Float:
        """Return ``by dx/de`` of some bonds (n,) [1 / length], at elongations ``e`` (n_bonds,) of all."""

    def at(self, state: Displaced) -> Float:
        """Return the drive at the elongations of a state."""
        return self.of(state.elongated(self._bonds.finite)[0])

    def gradient(self, state: Displaced, bonds: GlobalIndex, by: Float) -> Gradient:
        """Return ``by dx/de``."""
        return Gradient(bonds, self.along(state.elongated(self._bonds.finite)[0], bonds, by))

    def at_strain(self, strain: Float) -> Float | None:
        """Return the drive at the elongations of such strains."""
        return self.of(strain * self._bonds.length)


class LinearDrivingVariable(LocalDrivingVariable):
    """The elongation over that of failure, ``x = e / limit``.

    Parameters
    ----------
    bonds : DamageableBonds
        The bonds.
    limit : (n_bonds,) float64
        Their elongations of failure [length], positive.
    """

    def __init__(self, bonds: DamageableBonds, limit: Float) -> None:
        super().__init__(bonds)
        self.limit: Float = limit

    def of(self, e: Float) -> Float:
        """Return ``e / limit``."""
        return np.asarray(e / self.limit)

    def along(self, e: Float, bonds: GlobalIndex, by: Float) -> Float:
        """Return ``by / limit``."""
        return np.asarray(by / self.limit[bonds])

    def mean_gradient(self, state: Displaced, bonds: GlobalIndex, count: float) -> Gradient:
        """Return ``1 / (limit count)``, rounded once."""
        return Gradient(bonds, np.asarray(1.0 / (self.limit[bonds] * count)))

    def elastic_energy(self, bonds: GlobalIndex, k: Float) -> tuple[Float, float]:
        """Return ``1/2 k limit^2``, and 2."""
        return np.asarray(0.5 * k * self.limit[bonds] ** 2), 2.0


class Criterion(Declared, ABC):
    """What drives the damage of a bond; derive a frozen dataclass from it for another one.

    Attributes
    ----------
    of_one_material : bool
        Whether what it resolves from the bonds fits a body of one material only.
    reads_strain : bool
        Whether it reads the whole strain of the gradients, with what a body expands by.
    reads_stiffness : bool
        Whether it reads the stiffness of bonds, which materials without one Young's modulus do not have.
    """

    of_one_material: ClassVar[bool] = False
    reads_stiffness: ClassVar[bool] = True
    reads_strain: ClassVar[bool] = False

    @property
    def assumes_share(self) -> bool:
        """Return True if it has a fracture energy without a share."""
        return False

    @property
    def reads_temperature(self) -> bool:
        """Return whether it reads the temperature of the body."""
        return False

    @property
    def times(self) -> Sequence[float]:
        """Return the time that it takes the load to last from step time 0 to 1, if it counts [time]."""
        duration = getattr(self, "duration", None)
        return () if duration is None else (float(duration),)

    @abstractmethod
    def build(self, bonds: DamageableBonds) -> DrivingVariable:
        """Return the drive of the bonds of this rank (not collective).

        Raises
        ------
        CaseError
            The criterion does not fit the bonds; what one rank raises all raise.
        """

    def resolve(self, bonds: DamageableBonds, toughness: Callable[[float], float]) -> Criterion:
        """Return the criterion with what only the bonds of the body tell, as from a fracture energy (collective).

        Parameters
        ----------
        bonds : DamageableBonds
            The bonds.
        toughness : callable
            Energy that breaking a linear bond takes over its elastic energy where the drive is 1 [-], for the degree of
            the elastic energy in the drive (``BondDamage.toughness``).
        """
        return self
