"""Critical stretch of a bond as a function of its length and place: damage is driven by ``x = s / s_c``."""

from __future__ import annotations

import math
from abc import abstractmethod
from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from pdpetsc.arrays import Float
from pdpetsc.damage.criterion import Criterion, DrivenBonds, LinearDrive
from pdpetsc.declared import numbers_from
from pdpetsc.discrete.communicator import largest
from pdpetsc.errors import CaseError

# Families whose energy is this close to the largest one are whole.
WHOLE = 0.05


class CriticalStretch(Criterion):
    """The stretch at which a bond fails: the drive is the stretch over it, ``x = s / s_c``, negative in compression."""

    def build(self, bonds: DrivenBonds) -> LinearDrive:
        """Return ``e / (s_c |xi|)``.

        Raises
        ------
        CaseError
            A critical stretch is not positive.
        """
        stretch = self(bonds.length, bonds.middle)
        bad = np.flatnonzero(~(np.isfinite(stretch) & (stretch > 0.0)))
        if len(bad):
            length, value = bonds.length[bad[0]], stretch[bad[0]]
            raise CaseError(f"The critical stretch of a bond of length {length:g} is {value:g}, not positive.")
        return LinearDrive(bonds, stretch * bonds.length)

    @abstractmethod
    def __call__(self, length: Float, middle: Float) -> Float:
        """Return the critical stretch (n_bonds,) [-].

        Parameters
        ----------
        length : (n_bonds,) float64
            Reference length of the bonds [length].
        middle : (n_bonds, dim) float64
            Their middles [length].
        """


@dataclass(frozen=True)
class ConstantCritical(CriticalStretch):
    """The same critical stretch ``value`` [-] for every bond.

    Examples
    --------
    >>> import pdpetsc as pd
    >>> damage = pd.Brittle(pd.ConstantCritical(0.01))
    """

    value: float

    def __post_init__(self) -> None:
        super().__post_init__()
        if not (math.isfinite(self.value) and self.value > 0.0):
            raise CaseError(f"A critical stretch must be positive, not {self.value}.")

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

    start: float
    end: float
    length: float

    def __post_init__(self) -> None:
        super().__post_init__()
        if not (min(self.start, self.end) >= 0.0 and max(self.start, self.end) > 0.0 and self.length > 0.0) or not (
            math.isfinite(self.start + self.end + self.length)
        ):
            raise CaseError(
                f"A linear critical stretch needs values that are not negative and a positive length, "
                f"not {self.start}, {self.end} and {self.length}."
            )

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

    def __call__(self, length: Float, middle: Float) -> Float:
        """Return what the function returns."""
        if len(length) == 0:
            return np.zeros(0)
        values = numbers_from("critical stretch", self.function, length, middle)
        if values.shape != length.shape:
            raise CaseError(
                f"The critical stretch must be one number per bond, {length.shape}, the function gave {values.shape}."
            )
        return values


@dataclass(frozen=True)
class CriticalByReach(CriticalStretch):
    """The critical stretches of a fracture energy where horizons differ, ``scale / sqrt((reach_i + reach_j) / 2)``.

    Parameters
    ----------
    scale : float
        Critical stretch times the square root of the horizon [length^(1/2)].
    """

    scale: float

    def build(self, bonds: DrivenBonds) -> LinearDrive:
        """Return ``e / (s_c |xi|)``."""
        cloud, families = bonds.cloud, bonds.families
        reach = 0.5 * (cloud.reach[families.centres] + cloud.reach[families.neighbours])
        return LinearDrive(bonds, self.scale / np.sqrt(reach) * bonds.length)

    def __call__(self, length: Float, middle: Float) -> Float:
        """Refuse: lengths and places do not tell the horizons."""
        raise CaseError("The critical stretches of a fracture energy follow the horizons, where these differ.")


@dataclass(frozen=True)
class FractureEnergy(CriticalStretch):
    """The critical stretch with which breaking every bond across a unit area takes the energy ``Gc``.

    The energy is the discrete sum over the bonds of the body, for its influence function, horizon and law of damage;
    for deformation gradients, whose bonds have no energy of their own, that of the bond-based material with the same E.
    Where the horizon differs from particle to particle a bond has the stretch for the mean horizon of its ends,
    proportional to ``1 / sqrt(horizon)``.

    Parameters
    ----------
    Gc : float
        Fracture energy [energy / area], positive.

    Examples
    --------
    >>> import pdpetsc as pd
    >>> damage = pd.Brittle(pd.FractureEnergy(Gc=0.05))
    """

    Gc: float

    of_one_material = True

    def __post_init__(self) -> None:
        super().__post_init__()
        if not (math.isfinite(self.Gc) and self.Gc > 0.0):
            raise CaseError(f"A fracture energy must be positive, not {self.Gc}.")

    def resolve(self, bonds: DrivenBonds, toughness: Callable[[float], float]) -> CriticalStretch:
        """Return the critical stretch for the bonds of the body (collective).

        Breaking all bonds across a unit area with normal ``n`` takes ``G = 1 / V_i sum_j w_ij |xi . n|`` with the
        energy ``w_ij`` of a bond from one end, averaged over the axes; of the whole families of the body the median,
        over the horizon where that differs.
        """
        cloud, families = bonds.cloud, bonds.families
        share = 0.5 * toughness(2.0)
        energy = share * bonds.k * bonds.length**2 * np.abs(families.bonds(cloud.x)).mean(axis=1)
        G = np.bincount(families.centres, energy, cloud.n_owned) / cloud.volume[: cloud.n_owned]
        if cloud.varies:
            G /= cloud.reach[: cloud.n_owned]
        whole = (1.0 - WHOLE) * largest(cloud.comm, float(G.max(initial=0.0))) <= G
        # Families that are cut by little count as whole; most are not, so that the median is not theirs.
        middle = float(np.median(np.concatenate(cloud.comm.allgather(G[whole]))))
        found = float(np.sqrt(self.Gc / middle))
        return CriticalByReach(found) if cloud.varies else ConstantCritical(found)

    def __call__(self, length: Float, middle: Float) -> Float:
        """Refuse: it is resolved into a number once the stiffness of the bonds is known."""
        raise CaseError("A fracture energy gives a critical stretch in a case only, where the bonds are known.")
