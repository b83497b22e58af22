"""Damage that is driven by the energy of a bond, and what breaking the bonds across a plane takes."""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

import numpy as np

from pdpetsc.arrays import Float, GlobalIndex
from pdpetsc.damage.criterion import Criterion, DrivenBonds, LinearDrive, LocalDrive
from pdpetsc.discrete.communicator import largest
from pdpetsc.errors import CaseError

# Families whose energy is this close to the largest one are whole.
WHOLE = 0.05


def refuse_share(share: float | None) -> None:
    """Raise CaseError where the share that a crack takes of a fracture energy is not positive."""
    if share is not None and not (math.isfinite(share) and share > 0.0):
        raise CaseError(f"The share of a fracture energy that a crack takes must be positive, not {share}.")


def plane_energies(bonds: DrivenBonds, energy: Float, power: float, by_material: bool = True) -> Float:
    """Return what breaking all bonds across a unit area takes, between materials of both ends of every bond (n_bonds,).

    ``G = 1 / V_i sum_j w_ij |xi . n|`` with the energy ``w_ij`` of a bond from one end, averaged over the axes; of the
    whole families of each material the median, times what grading multiplies it with, and of a bond the mean of both of
    its ends: in a body of the two materials on both sides of a plane each has its half [energy / length^2].

    Parameters
    ----------
    bonds : DrivenBonds
        The bonds.
    energy : (n_bonds,) float64
        What breaking a bond takes from one end [energy].
    power : float
        With which power of the horizon G grows, where that differs.
    by_material : bool
        Whether the energy of a bond follows the material; else all families count together.

    Notes
    -----
    Collective.
    """
    cloud, families, n = bonds.cloud, bonds.families, bonds.cloud.n_owned
    each = energy * np.abs(families.bonds(cloud.x)).mean(axis=1)
    number = bonds.material_of if by_material else np.zeros_like(bonds.material_of)
    factor = bonds.factor if by_material else np.ones_like(bonds.factor)
    G = np.bincount(families.centres, each, n) / cloud.volume[:n] / factor[:n]
    if cloud.varies:
        G /= cloud.reach[:n] ** power
    found = np.zeros(1 + int(largest(cloud.comm, float(number.max(initial=0)))))
    for one in range(len(found)):
        mine = G[number[:n] == one]
        whole = (1.0 - WHOLE) * largest(cloud.comm, float(mine.max(initial=0.0))) <= mine
        # Families that are cut by little count as whole; most are not, so that the median is not theirs.
        every = np.concatenate(cloud.comm.allgather(mine[whole]))
        found[one] = float(np.median(every)) if len(every) else 0.0
    of_particle = found[number] * factor
    i, j = families.centres, families.neighbours
    middle = 0.5 * (of_particle[i] + of_particle[j])
    if cloud.varies:
        middle *= (0.5 * (cloud.reach[i] + cloud.reach[j])) ** power
    return np.asarray(middle)


class _EitherWay(LocalDrive):
    """``x = |e| / limit``."""

    def __init__(self, bonds: DrivenBonds, limit: Float) -> None:
        super().__init__(bonds)
        self._limit = limit

    def of(self, e: Float) -> Float:
        return np.asarray(np.abs(e) / self._limit)

    def along(self, e: Float, bonds: GlobalIndex, by: Float) -> Float:
        return np.asarray(by * np.sign(e[bonds]) / self._limit[bonds])

    def elastic_energy(self, bonds: GlobalIndex, k: Float) -> tuple[Float, float]:
        return np.asarray(0.5 * k * self._limit[bonds] ** 2), 2.0


@dataclass(frozen=True)
class BondEnergy(Criterion):
    """A bond fails with the energy that it stores: ``x = sqrt(w / w_c)``, ``w = 1/2 (k_ij + k_ji) e^2 / (V_i V_j)``.

    ``w`` is the energy of the bond over the volumes of both ends; the drive is its root, so that laws mean forces over
    elongations as with a critical stretch. Give ``w`` itself, or the fracture energy ``Gc`` from which it follows:
    breaking all bonds across a unit area takes Gc, summed over the bonds of the body with their influence, horizon and
    law. Bonds of deformation gradients, and those with a dilatation, have the energy of the bond-based material with
    the same E. Shortened bonds do not fail unless ``compression`` is asked for.

    Parameters
    ----------
    w : float, optional
        Critical energy density of a bond [energy / length^6], positive.
    Gc : float, optional
        Fracture energy [energy / area], positive; one of the two.
    compression : bool
        Whether bonds that shorten fail as well.
    share : float, optional
        What a crack takes of Gc with the forces of the case [-], as in ``FractureEnergy``; none was measured for this
        criterion, so that it is 1 where it is not given.

    References
    ----------
    Foster2011.

    Examples
    --------
    >>> import pdpetsc as pd
    >>> damage = pd.LinearSoftening(pd.BondEnergy(Gc=0.05), ratio=3.0)
    """

    w: float | None = None
    Gc: float | None = None
    compression: bool = False
    share: float | None = None

    def __post_init__(self) -> None:
        super().__post_init__()
        given = [value for value in (self.w, self.Gc) if value is not None]
        if len(given) != 1 or not (math.isfinite(given[0]) and given[0] > 0.0):
            raise CaseError(f"BondEnergy takes a positive w or a positive Gc, not w={self.w} and Gc={self.Gc}.")
        refuse_share(self.share)
        if self.w is not None and self.share is not None:
            raise CaseError("BondEnergy takes a share of Gc; leave it out beside w.")

    @property
    def assumes_share(self) -> bool:
        """Return whether Gc was given, and no share of it."""
        return self.Gc is not None and self.share is None

    def resolve(self, bonds: DrivenBonds, toughness: Callable[[float], float]) -> Criterion:
        """Return the criterion with the elongations of failure of the bonds (collective)."""
        both = bonds.k + bonds.opposite.of(bonds.k)
        volume, i, j = bonds.cloud.volume, bonds.families.centres, bonds.families.neighbours
        pair = np.where(both > 0.0, volume[i] * volume[j], 0.0)
        if self.w is not None:
            w = np.full(len(both), self.w)
        else:
            assert self.Gc is not None
            # Either end has half of what breaking a bond takes, whatever its stiffness.
            w = (
                self.Gc
                / (self.share or 1.0)
                / plane_energies(bonds, 0.5 * toughness(2.0) * pair, bonds.cloud.dim + 1.0, by_material=False)
            )
        # A bond without stiffness stores nothing and does not fail.
        square = np.divide(2.0 * w * pair, both, out=np.full(len(both), np.inf), where=both > 0.0)
        return _Limited(np.sqrt(square), self.compression)

    def build(self, bonds: DrivenBonds) -> LocalDrive:
        """Refuse: it is resolved first, with the stiffness of both ends."""
        raise CaseError("A bond energy is known in a case only, where the bonds are.")


@dataclass(frozen=True, eq=False)
class _Limited(Criterion):
    """Elongations of failure (n_bonds,) [length] of the bonds that it was resolved for."""

    limit: Any
    compression: bool

    def build(self, bonds: DrivenBonds) -> LocalDrive:
        """Return ``e / limit``, or its size."""
        return (_EitherWay if self.compression else LinearDrive)(bonds, self.limit)
