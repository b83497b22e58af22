"""Critical stretch of a bond as a function of its length and place: damage is driven by ``x = s / s_c``."""

from __future__ import annotations

import math
from abc import abstractmethod
from collections.abc import Callable
from dataclasses import dataclass
from typing import Any, ClassVar

import numpy as np

from pdpetsc.arrays import Float
from pdpetsc.damage.criterion import Criterion, DrivenBonds, LinearDrive
from pdpetsc.damage.energy import plane_energies, refuse_share
from pdpetsc.declared import numbers_from
from pdpetsc.discrete.communicator import largest, smallest
from pdpetsc.errors import CaseError


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

    reads_stiffness: ClassVar[bool] = False

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

    reads_stiffness: ClassVar[bool] = False

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

    reads_stiffness: ClassVar[bool] = False

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


@dataclass(frozen=True, eq=False)
class CriticalOfBonds(CriticalStretch):
    """The critical stretches of a fracture energy where materials or horizons differ.

    Parameters
    ----------
    stretch : (n_bonds,) float64
        Critical stretch of every bond of the body that it was resolved for [-].
    """

    stretch: Any

    def build(self, bonds: DrivenBonds) -> LinearDrive:
        """Return ``e / (s_c |xi|)``."""
        return LinearDrive(bonds, np.asarray(self.stretch * bonds.length))

    def __call__(self, length: Float, middle: Float) -> Float:
        """Refuse: lengths and places do not tell the bonds."""
        raise CaseError("The critical stretches of a fracture energy follow materials and horizons, which differ.")


@dataclass(frozen=True)
class FractureEnergy(CriticalStretch):
    """The critical stretch with which breaking every bond across a unit area takes the energy ``Gc``.

    The energy is the discrete sum over the bonds of the body, for its influence function, horizon and law of damage;
    for deformation gradients, whose bonds have no energy of their own, and for those with a dilatation, that of the
    bond-based material with the same E. Where the horizon differs from particle to particle a bond has the stretch for
    the mean horizon of its ends, proportional to ``1 / sqrt(horizon)``. In a body of several materials, and a graded
    one, bonds have the stretch of their own material, and those between two that with which a plane between these takes
    Gc.

    Parameters
    ----------
    Gc : float
        Fracture energy [energy / area], positive.
    share : float, optional
        What a crack that runs takes of that energy with the forces of the case [-], so that bonds are given
        ``Gc / share``. Where it is not given a case takes the one that was measured for its model, law and horizon; the
        log says which, and how well it is known. Without a measurement it is 1, and a run with deformation gradients
        warns that its cracks take another energy. ``share=1.0`` is the energy of one plane of bonds,
        for bodies that come apart all at once.

    Examples
    --------
    >>> import pdpetsc as pd
    >>> damage = pd.Brittle(pd.FractureEnergy(Gc=0.05))
    """

    Gc: float
    share: float | None = None

    def __post_init__(self) -> None:
        super().__post_init__()
        if not (math.isfinite(self.Gc) and self.Gc > 0.0):
            raise CaseError(f"A fracture energy must be positive, not {self.Gc}.")
        refuse_share(self.share)

    @property
    def assumes_share(self) -> bool:
        """Return whether no share was given."""
        return self.share is None

    def resolve(self, bonds: DrivenBonds, toughness: Callable[[float], float]) -> CriticalStretch:
        """Return the critical stretch for the bonds of the body (collective).

        Breaking all bonds across a unit area takes ``plane_energies`` at a stretch of 1.
        """
        G = plane_energies(bonds, 0.5 * toughness(2.0) * bonds.k * bonds.length**2, 1.0)
        stretch = np.sqrt(self.Gc / (self.share or 1.0) / G)
        comm = bonds.cloud.comm
        least, most = (
            smallest(comm, float(stretch.min(initial=np.inf))), largest(comm, float(stretch.max(initial=0.0)))
        )  # fmt: skip
        return ConstantCritical(most) if least == most else CriticalOfBonds(stretch)

    def __call__(self, length: Float, middle: Float) -> Float:
        """Refuse: it is resolved into a number once the stiffness of the bonds is known."""
        raise CaseError("A fracture energy gives a critical stretch in a case only, where the bonds are known.")
