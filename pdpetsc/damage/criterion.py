"""Damage criteria and driving variables of bonds; a bond begins to fail if its driving variable is 1.

A criterion is declared (``Criterion``) and is built into the driving variable of the bonds of one rank
(``DrivingVariable``). Damage laws use the driving variable only, not the way it is computed.
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
    """Bonds of the own particles as input of a criterion, each from one end.

    Attributes
    ----------
    cloud, families
        Particles and bonds.
    omega : (n_bonds,) float64
        Influence [-].
    stiffness : (n_bonds,) float64 or None
        ``k``; None if no criterion reads it.
    finite : bool
        True if elongations are changes of the current length, False if they are along the reference direction.
    material_of : (n_local,) int32
        Number of the material of each particle.
    factor : (n_local,) float64
        Factor of the moduli of each particle in a graded material [-].
    """

    cloud: Cloud
    families: Families
    omega: Float
    stiffness: Float | None
    finite: bool
    material_of: LocalIndex
    factor: Float

    @classmethod
    def of(
        cls, cloud: Cloud, families: Families, omega: Float, k: Float | None, finite: bool,
        material_of: LocalIndex | None = None, factor: Float | None = None,
    ) -> DamageableBonds:  # fmt: skip
        """Build the bonds of a body with data of both ends (collective).

        ``material_of`` and ``factor`` are those of the own particles (n_owned,); by default one material without
        grading.
        """
        one = np.ones(cloud.n_owned)
        number = cloud.halo.with_ghosts(0.0 * one if material_of is None else material_of.astype(float))
        scale = cloud.halo.with_ghosts(one if factor is None else factor)
        return cls(cloud, families, omega, k, finite, number.astype(np.int32), scale)

    @property
    def length(self) -> Float:
        """Return the reference length of every bond (n_bonds,) [length], computed on use."""
        return self.families.lengths(self.cloud.x)

    def lengths_of(self, bonds: GlobalIndex) -> Float:
        """Return the reference length of selected bonds (n,) [length]."""
        return self.families.lengths_of(self.cloud.x, bonds)

    @property
    def k(self) -> Float:
        """Return the elastic stiffness of every bond from one end (n_bonds,) [force / length].

        In a body with gradient points it is that of the bond-based material with the same Young's modulus.
        """
        if self.stiffness is None:
            raise TypeError("The criterion has reads_stiffness = False, and reads the stiffness of bonds.")
        return self.stiffness

    def with_end(self, marked: Mask) -> Mask:
        """Return a mask of bonds (n_bonds,) with an end among marked local particles (n_local,)."""
        return np.asarray(marked[self.families.centres] | marked[self.families.neighbours])

    @cached_property
    def opposite(self) -> OppositeBonds:
        """Return the location of the opposite direction of every bond (collective the first time)."""
        return OppositeBonds(self.cloud, self.families, self.keys)

    def keys(self, bonds: GlobalIndex | Mask | slice = EVERY) -> GlobalIndex:
        """Return the keys of selected bonds (n, 3), equal from both ends of a bond and on all ranks.

        A key contains the global ids of both ends, the lower first, and the place of the second relative to the first.
        A bond of a particle with its own mirror image has one end only, in the computed part of the body.
        """
        gid, (one, other, place) = self.cloud.gid, self._ends(bonds)
        return np.stack([gid[one], gid[other], place], axis=1)

    def middle(self, bonds: GlobalIndex | Mask | slice = EVERY) -> Float:
        """Return the middle of selected bonds, for the first end in its own cell (n, dim) [length]."""
        x, (one, other, _) = self.cloud.x, self._ends(bonds)
        return self.cloud.places.at_home(self.cloud.place[one], 0.5 * (x[one] + x[other]))

    def _ends(self, bonds: GlobalIndex | Mask | slice) -> tuple[LocalIndex, LocalIndex, GlobalIndex]:
        """Return both ends of selected bonds, lower key first, and the place of the second relative to the first."""
        centres, neighbours = self.families.centres[bonds], self.families.neighbours[bonds]
        gid, place = self.cloud.gid, self.cloud.place[neighbours]
        back = self.cloud.places.opposite(place)
        i, j = gid[centres], gid[neighbours]
        low = (i < j) | ((i == j) & (back <= place))
        return np.where(low, centres, neighbours), np.where(low, neighbours, centres), np.where(low, place, back)


class Displaced(Protocol):
    """Displaced body as input of a driving variable, such as a ``State``."""

    @property
    def clock(self) -> Clock:
        """Return load parameter and physical time."""

    @property
    def u_local(self) -> Float:
        """Return the displacements with ghosts (n_local, dim) [length] (collective on first use)."""

    def elongated(self, finite: bool) -> tuple[Float, float]:
        """Return the elongations (n_bonds,) and the smallest current length of a bond on this rank [length]."""

    def kept(self, key: Hashable, make: Callable[[], T]) -> T:
        """Return the value cached for ``key`` and this state; compute it with ``make`` if it is missing."""


@dataclass(frozen=True)
class NonlocalPart:
    """Derivatives of bond values by displacements, without the part of the own elongation.

    Attributes
    ----------
    ptr : (n + 1,) int64
        The entries of the b-th bond are ``ptr[b]`` to ``ptr[b + 1]``.
    particles : (n_entries,) int32
        Local particles: the first end of the bond or members of its family. For a mean of both ends, each direction of
        the bond contains the part of its own end, twice.
    by : (n_entries, dim) float64
        Derivative by the displacement of each [1 / length].
    """

    ptr: GlobalIndex
    particles: LocalIndex
    by: Float


@dataclass(frozen=True)
class EndpointMean:
    """Derivatives of bond values that are the mean of both ends.

    Attributes
    ----------
    factor : (n,) float64
        Factor of the mean for each bond [-], equal from both ends.
    by : (n_entries, dim) float64
        Derivative of the value of every own particle by the displacement of the members of its family, centre first
        [1 / length].
    """

    factor: Float
    by: Float


@dataclass(frozen=True)
class Gradient:
    """Derivative of values of bonds by the displacement, ``d = along de + sum_m by_m . du_m``.

    Attributes
    ----------
    bonds : (n,) int64
        The bonds, ascending.
    along : (n,) float64
        Derivative by the elongation of the bond itself [1 / length].
    nonlocal_part : NonlocalPart or None
        The remaining part; None if the value depends on the elongation of the bond only.
    ends : tuple of EndpointMean
        Remaining parts of means of both ends, each for all bonds.
    """

    bonds: GlobalIndex
    along: Float
    nonlocal_part: NonlocalPart | None = None
    ends: tuple[EndpointMean, ...] = ()


class Solid(Protocol):
    """Gradient points of a body with their materials, as input of strain and stress criteria.

    Stresses are those without damage. The points change if bonds break, at equilibrium only.
    """

    @property
    def gradients(self) -> GradientOperator:
        """Return the gradient operator of the unbroken bonds."""

    @property
    def lost(self) -> Mask:
        """Return a mask of points whose particle has no gradient any more (n_points,)."""

    def deformation(self, state: Any) -> Float:
        """Return the deformation gradients (n_points, dim, dim) [-] (collective)."""

    def laws(self, state: Any) -> PointLaws:
        """Return the laws of the points at a state (collective)."""

    def temperature(self, state: Any) -> Float | None:
        """Return the temperature of the points (n_points,); None if the body has none (collective)."""


class DrivingVariable(ABC):
    """Driving variable of the damage of the bonds of one rank; damage of a bond begins at 1.

    It does not depend on the damage, and is equal from both ends of a bond, on all ranks.

    Attributes
    ----------
    is_nonlocal : bool
        True if its gradient depends on more than the elongation of the bond; constant for all states.
    limit : (n_bonds,) float64 or None
        Elongations of failure [length] if the driving variable is ``e / limit``, else None. The event-driven solver
        requires such driving variables.
    reads_points : bool
        True if it reads strain or stress at gradient points, which ``take`` sets before use.
    reads_flow : bool
        True if it reads plastic flow, which requires deformation gradients and a material with history.
    timed : bool
        True if it depends on time; the load parameter is then proportional to time.
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
        """Set the gradient points of a body (not collective)."""

    def commit(self, state: Displaced) -> None:  # noqa: B027
        """Commit a converged state, before the materials commit (collective)."""

    def arrays(self) -> Mapping[str, Float]:
        """Return the history arrays of the own particles (n_owned, ...) by name; a restart overwrites them."""
        return {}

    @abstractmethod
    def at(self, state: Displaced) -> Float:
        """Compute the driving variable of every bond (n_bonds,) [-] as a new array (collective)."""

    @abstractmethod
    def gradient(self, state: Displaced, bonds: GlobalIndex, by: Float) -> Gradient:
        """Compute the derivative of ``by`` times the driving variable of bonds by the displacement (collective).

        Parameters
        ----------
        state
            State of the body.
        bonds : (n,) int64
            The bonds, ascending.
        by : (n,) float64
            Factor of each derivative, such as the derivative of the degradation factor by the driving variable [-].
        """

    def mean_gradient(self, state: Displaced, bonds: GlobalIndex, count: float) -> Gradient:
        """Compute the derivative of the driving variable of bonds over their number on all ranks (collective).

        The sum over bonds and ranks is the gradient of the mean driving variable, which equilibrium paths follow.
        """
        return self.gradient(state, bonds, np.full(len(bonds), 1.0 / count))

    def at_strain(self, strain: Float) -> Float | None:
        """Compute the driving variable for tensile strains of bonds (n_bonds,) [-] as a new array (not collective).

        It is used to break bonds by the strain of a family that has lost bonds. Return None if the driving variable
        already contains this strain or is not a function of it; no bond then breaks this way.
        """
        return None

    def elastic_energy(self, bonds: GlobalIndex, k: Float) -> tuple[Float, float] | None:
        """Return the energy of linear bonds at driving variable 1 (n,) [energy], and its degree [-].

        Laws dissipate ``-int W y^degree dphi(y)``, with the degradation factor ``phi``. Return None if the driving
        variable does not determine the energy of a bond. Dissipated energies are then differences of work and energy.

        Parameters
        ----------
        bonds : (n,) int64
            The bonds.
        k : (n,) float64
            Their stiffness [force / length].
        """
        return None


class LocalDrivingVariable(DrivingVariable):
    """A driving variable that is a function of the elongation of the bond.

    Parameters
    ----------
    bonds : DamageableBonds
        The bonds.
    """

    def __init__(self, bonds: DamageableBonds) -> None:
        self._bonds = bonds

    @abstractmethod
    def of(self, e: Float) -> Float:
        """Return the driving variable at elongations ``e`` (n_bonds,) [length] of all bonds as a new array."""

    @abstractmethod
    def along(self, e: Float, bonds: GlobalIndex, by: Float) -> Float:
        """Return ``by dx/de`` of selected bonds (n,) [1 / length], at elongations ``e`` (n_bonds,) of all bonds."""

    def at(self, state: Displaced) -> Float:
        """Return the driving variable at the elongations of a state."""
        return self.of(state.elongated(self._bonds.finite)[0])

    def gradient(self, state: Displaced, bonds: GlobalIndex, by: Float) -> Gradient:
        """Return ``by dx/de``."""
        return Gradient(bonds, self.along(state.elongated(self._bonds.finite)[0], bonds, by))

    def at_strain(self, strain: Float) -> Float | None:
        """Return the driving variable at the elongations of these strains."""
        return self.of(strain * self._bonds.length)


class LinearDrivingVariable(LocalDrivingVariable):
    """Elongation over elongation of failure, ``x = e / limit``.

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
        return np.asarray(by / self.limits_of(bonds))

    def mean_gradient(self, state: Displaced, bonds: GlobalIndex, count: float) -> Gradient:
        """Return ``1 / (limit count)``, rounded once."""
        return Gradient(bonds, np.asarray(1.0 / (self.limits_of(bonds) * count)))

    def elastic_energy(self, bonds: GlobalIndex, k: Float) -> tuple[Float, float]:
        """Return ``1/2 k limit^2``, and 2."""
        return np.asarray(0.5 * k * self.limits_of(bonds) ** 2), 2.0

    def limits_of(self, bonds: GlobalIndex) -> Float:
        """Return the elongations of failure of selected bonds (n,) [length]."""
        return np.asarray(self.limit[bonds])


class StretchDrivingVariable(LinearDrivingVariable):
    """Stretch over critical stretch, ``x = s / s_c``: elongations of failure are computed at the first evaluation.

    Parameters
    ----------
    bonds : DamageableBonds
        The bonds.
    stretch : (n_bonds,) float64
        Their critical stretches [-], positive.
    """

    def __init__(self, bonds: DamageableBonds, stretch: Float) -> None:
        LocalDrivingVariable.__init__(self, bonds)
        self._stretch = stretch

    @cached_property
    def limit(self) -> Float:  # type: ignore[override]
        """Return the elongations of failure (n_bonds,) [length]."""
        return np.asarray(self._stretch * self._bonds.length)

    def limits_of(self, bonds: GlobalIndex) -> Float:
        """Return the elongations of failure of selected bonds (n,) [length]."""
        return np.asarray(self._stretch[bonds] * self._bonds.lengths_of(bonds))


class Criterion(Declared, ABC):
    """Criterion of the damage of bonds; derive a frozen dataclass for a new criterion.

    Attributes
    ----------
    of_one_material : bool
        True if ``resolve`` supports bodies of one material only.
    reads_strain : bool
        True if it reads the total strain of the gradients, including thermal strain and eigenstrain.
    reads_stiffness : bool
        True if it reads the stiffness of bonds, which requires materials with a single Young's modulus.
    """

    of_one_material: ClassVar[bool] = False
    reads_stiffness: ClassVar[bool] = True
    reads_strain: ClassVar[bool] = False

    @property
    def assumes_share(self) -> bool:
        """Return True if a fracture energy is declared without a share."""
        return False

    @property
    def reads_temperature(self) -> bool:
        """Return True if it reads the temperature of the body."""
        return False

    @property
    def times(self) -> Sequence[float]:
        """Return the time from load parameter 0 to 1, if the criterion depends on it [time]."""
        duration = getattr(self, "duration", None)
        return () if duration is None else (float(duration),)

    @abstractmethod
    def build(self, bonds: DamageableBonds) -> DrivingVariable:
        """Build the driving variable of the bonds of this rank (not collective).

        Raises
        ------
        CaseError
            The criterion does not fit the bonds; all ranks raise if one rank does.
        """

    def resolve(self, bonds: DamageableBonds, toughness: Callable[[float], float]) -> Criterion:
        """Resolve the criterion from the bonds of the body, for example a fracture energy (collective).

        Parameters
        ----------
        bonds : DamageableBonds
            The bonds.
        toughness : callable
            Energy of breaking a linear bond over its elastic energy at driving variable 1 [-], as a function of the
            degree of the elastic energy in the driving variable (``BondDamage.toughness``).
        """
        return self
