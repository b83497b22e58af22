"""Critical stretch of a bond as a function of its length and position: driving variable ``x = s / s_c``."""

from __future__ import annotations

import math
from abc import abstractmethod
from collections.abc import Callable
from dataclasses import dataclass
from typing import Any, ClassVar

import numpy as np

from pdpetsc.arrays import Float
from pdpetsc.damage.criterion import Criterion, DamageableBonds, StretchDrivingVariable
from pdpetsc.damage.energy import plane_weights
from pdpetsc.declared import NonNegative, Positive, numbers_from
from pdpetsc.discrete.communicator import largest, smallest, total
from pdpetsc.errors import CaseError


class CriticalStretch(Criterion):
    """Critical stretch of a bond: the driving variable is ``x = s / s_c``, negative in compression.

    Attributes
    ----------
    reads_middle : bool
        Whether it depends on the middle of bonds.
    """

    reads_middle: ClassVar[bool] = True

    def build(self, bonds: DamageableBonds) -> StretchDrivingVariable:
        """Return ``e / (s_c |xi|)``.

        Raises
        ------
        CaseError
            A critical stretch is not positive.
        """
        length = bonds.length
        middle = bonds.middle() if self.reads_middle else np.empty((len(length), 0))
        stretch = self(length, middle)
        bad = np.flatnonzero(~(np.isfinite(stretch) & (stretch > 0.0)))
        if len(bad):
            raise CaseError(
                f"The critical stretch of a bond of length {length[bad[0]]:g} is {stretch[bad[0]]:g}, not positive."
            )
        return StretchDrivingVariable(bonds, stretch)

    @abstractmethod
    def __call__(self, length: Float, middle: Float) -> Float:
        """Compute the critical stretch (n_bonds,) [-].

        Parameters
        ----------
        length : (n_bonds,) float64
            Reference length of the bonds [length].
        middle : (n_bonds, dim) float64
            Their middles [length]; (n_bonds, 0) unless ``reads_middle``.
        """


@dataclass(frozen=True)
class ConstantCritical(CriticalStretch):
    """The same critical stretch ``value`` [-] for every bond.

    Examples
    --------
    >>> import pdpetsc as pd
    >>> damage = pd.Brittle(pd.ConstantCritical(0.01))
    """

    value: Positive

    reads_middle: ClassVar[bool] = False
    reads_stiffness: ClassVar[bool] = False

    def build(self, bonds: DamageableBonds) -> StretchDrivingVariable:
        """Return ``e / (s_c |xi|)``; the value is stored once for all bonds."""
        return StretchDrivingVariable(bonds, np.broadcast_to(np.float64(self.value), bonds.families.n_bonds))

    def __call__(self, length: Float, middle: Float) -> Float:
        """Return the value for every bond."""
        return np.full(len(length), self.value)


@dataclass(frozen=True)
class LinearCritical(CriticalStretch):
    """Critical stretch that changes linearly with the length of the bond.

    Parameters
    ----------
    start : float
        Value for a bond without length [-].
    end : float
        Value for a bond as long as ``length`` [-].
    length : float
        [length], usually the horizon.

    Examples
    --------
    >>> import pdpetsc as pd
    >>> longer_bonds_fail_first = pd.LinearCritical(start=0.02, end=0.01, length=3.0)
    """

    start: NonNegative
    end: NonNegative
    length: Positive

    reads_middle: ClassVar[bool] = False
    reads_stiffness: ClassVar[bool] = False

    def __post_init__(self) -> None:
        super().__post_init__()
        if self.start == self.end == 0.0:
            raise CaseError("LinearCritical has start 0 and end 0; give one of them a positive value.")

    def __call__(self, length: Float, middle: Float) -> Float:
        """Return ``start + (end - start) |xi| / length``."""
        return np.asarray(self.start + (self.end - self.start) * length / self.length)


@dataclass(frozen=True)
class CriticalFunction(CriticalStretch):
    """Critical stretch from a function of length (n_bonds,) and middle (n_bonds, dim) of the bonds.

    Examples
    --------
    >>> import pdpetsc as pd
    >>> weak_half = pd.CriticalFunction(lambda length, middle: 0.01 + 0.01 * (middle[:, 0] > 5.0))
    """

    function: Callable[[Float, Float], Float]

    reads_stiffness: ClassVar[bool] = False

    def __call__(self, length: Float, middle: Float) -> Float:
        """Return the values of the function."""
        if len(length) == 0:
            return np.zeros(0)
        values = numbers_from("critical stretch", self.function, length, middle)
        if values.shape != length.shape:
            raise CaseError(
                f"The critical stretch must be one number per bond, {length.shape}, the function gave {values.shape}."
            )
        return values


@dataclass(frozen=True, eq=False)
class CriticalOfBonds(Criterion):
    """Critical stretches of a fracture energy for different materials or horizons.

    Parameters
    ----------
    stretch : (n_bonds,) float64
        Critical stretch of every bond of the body for which it was resolved [-].
    """

    stretch: Any

    def build(self, bonds: DamageableBonds) -> StretchDrivingVariable:
        """Return ``e / (s_c |xi|)``."""
        return StretchDrivingVariable(bonds, self.stretch)


@dataclass(frozen=True)
class FractureEnergy(CriticalStretch):
    """Critical stretch for which breaking every bond across a unit area requires the energy ``Gc``.

    The energy is the sum over the bonds of the body, with their influence function, horizon and damage law. It is a
    volume-weighted mean over the particles further than a horizon from the surface, and over planes normal to the
    coordinate axes. In a thin body no particle is that far inside; planes across its long axes are used, with the
    families that its faces cut. For deformation gradients, whose bonds have no energy, and for bonds with a dilatation,
    it is the energy of the bond-based material with the same E.

    The square of the critical stretch is proportional to 1 / horizon. A bond between different horizons or materials
    has the mean of the squares of both ends, weighted with its stiffness from each end. A plane between two materials
    requires Gc.

    Parameters
    ----------
    Gc : float
        Fracture energy [energy / area], positive.
    share : float, optional
        Energy of a propagating crack over that of a plane of bonds [-]: bonds have the energy ``Gc / share``. 1 by
        default. Without a share a run warns if the energy of cracks of its model is known to differ from Gc.

    Raises
    ------
    CaseError
        In a case: the body is shorter than two horizons along every axis, or thin and inclined against the axes.

    Examples
    --------
    >>> import pdpetsc as pd
    >>> damage = pd.Brittle(pd.FractureEnergy(Gc=0.05))
    """

    Gc: Positive
    share: Positive | None = None

    @property
    def assumes_share(self) -> bool:
        """Return True if no share is declared."""
        return self.share is None

    def resolve(self, bonds: DamageableBonds, toughness: Callable[[float], float]) -> Criterion:
        """Compute the critical stretch for the bonds of the body (collective).

        ``s_i^2 = Gc / (G m_i d_i)`` with the horizon ``d_i`` of the particle. ``G`` is the plane energy of bonds with
        the energy ``omega |xi| V_i V_j / d_i^(dim + 2)`` from one end. ``m_i`` is the ratio of the energies of its
        material at a stretch of 1 to ``omega |xi| V_i V_j / d_i^(dim + 1)``. A bond has the mean of the squares of both
        ends, weighted with its stiffness from each: each end contributes its part of the energy.
        """
        cloud, families = bonds.cloud, bonds.families
        reach = cloud.local_horizon[: cloud.n_owned]
        weight = plane_weights(bonds)
        families.multiply(weight, 1.0 / reach)
        unit = families.weights(bonds.omega, cloud.volume)
        unit *= bonds.length
        families.multiply(unit, cloud.volume[: cloud.n_owned] / reach ** (cloud.dim + 1))
        energy = bonds.length
        energy *= energy
        energy *= bonds.k
        energy *= 0.5 * toughness(2.0)
        G = float(total(cloud.comm, weight @ unit))
        families.multiply(unit, bonds.factor[: cloud.n_owned])
        material = _moduli(bonds, weight, energy, unit)[bonds.material_of] * bonds.factor
        square = self.Gc / (self.share or 1.0) / (G * material * cloud.local_horizon)
        comm = cloud.comm
        most = largest(comm, square, initial=0.0)
        if smallest(comm, square) == most:  # one number for all bonds
            return ConstantCritical(math.sqrt(most))
        both = bonds.k + bonds.opposite.of(bonds.k)
        ours = np.divide(bonds.k, both, out=np.full(len(both), 0.5), where=both > 0.0)
        i, j = families.centres, families.neighbours
        return CriticalOfBonds(np.sqrt(square[j] + ours * (square[i] - square[j])))

    def at_strength(self, bonds: DamageableBonds, strength: float) -> tuple[ConstantCritical, float]:
        """Compute critical stretch and ratio of linear softening from a strength (collective).

        A plane of bonds that all have their largest force ``k s_c |xi|`` carries the strength. Softening up to r times
        the critical stretch requires r times the energy of bonds that snap at the critical stretch.

        Raises
        ------
        CaseError
            Bonds that snap have the fracture energy at a lower stress, or their critical stretches differ.
        """
        snapping = self.resolve(bonds, lambda degree: 1.0)
        if not isinstance(snapping, ConstantCritical):
            raise CaseError(
                "A strength of bonds needs one material and one horizon; use ConstantCritical and a ratio instead."
            )
        traction = float(total(bonds.cloud.comm, plane_weights(bonds, 2) @ bonds.k))
        critical = strength / traction
        ratio = (snapping.value / critical) ** 2
        if ratio <= 1.0:
            horizon = bonds.cloud.horizon
            raise CaseError(
                f"The strength {strength:g} is too high for the fracture energy {self.Gc:g} and the horizon "
                f"{horizon:g}; use a horizon below {ratio * horizon:.3g}."
            )
        return ConstantCritical(critical), ratio

    def __call__(self, length: Float, middle: Float) -> Float:
        """Raise an error: ``resolve`` computes the number from the stiffness of the bonds."""
        raise CaseError("A fracture energy gives a critical stretch in a case only, where the bonds are known.")


def _moduli(bonds: DamageableBonds, weight: Float, energy: Float, unit: Float) -> Float:
    """Compute the energy of bonds over that of unit bonds for each material (collective).

    It is that of planes through inner particles, or of all bonds if a material has no inner particle.
    """
    count = 1 + int(largest(bonds.cloud.comm, bonds.material_of, initial=0))
    number = bonds.material_of[: bonds.cloud.n_owned]

    def by_material(of_bonds: Float) -> Float:
        return np.asarray(np.bincount(number, bonds.families.sums(of_bonds), count))

    sums = [by_material(weight * energy), by_material(weight * unit), by_material(energy), by_material(unit)]
    in_planes, of_unit, of_all, of_all_unit = total(bonds.cloud.comm, np.stack(sums))
    chosen, over = np.where(of_unit > 0.0, (in_planes, of_unit), (of_all, of_all_unit))
    return np.divide(chosen, over, out=np.ones(count), where=over > 0.0)
