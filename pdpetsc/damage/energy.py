"""Damage criterion of the energy of a bond, and the energy of breaking all bonds across a plane."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

import numpy as np

from pdpetsc.arrays import Float, GlobalIndex
from pdpetsc.damage.criterion import Criterion, DamageableBonds, LinearDrivingVariable, LocalDrivingVariable
from pdpetsc.declared import Positive
from pdpetsc.discrete.communicator import total
from pdpetsc.discrete.interior import interior
from pdpetsc.errors import CaseError


def plane_weights(bonds: DamageableBonds, power: int = 1) -> Float:
    """Compute the weights of bonds in the energy of breaking all bonds across a unit area (n_bonds,).

    ``G = sum_i sum_j a_ij w_ij`` over all ranks with the energy ``w_ij`` of a bond from one end and the weight
    ``a_ij = |xi_a| / sum_i V_i`` of the particles inside along an axis ``a``: the mean over all planes normal to the
    axis. Weights are means over the axes, in a thin body over its long axes (``Interior``) [1 / length^2]. With the
    power 2 they contain ``|xi_a|^2``: the contribution of bond stiffness to the traction at a stretch of 1.

    Raises
    ------
    CaseError
        The body is shorter than two horizons along every axis, or thin and inclined against the axes.

    Notes
    -----
    Collective.
    """
    cloud, families, n = bonds.cloud, bonds.families, bonds.cloud.n_owned
    inside = interior(cloud, families)
    if not (inside.axes and inside.aligned):
        why = "it is thin and not along a coordinate axis" if inside.axes else "it is too short along every axis"
        raise CaseError(
            f"Gc cannot be converted to critical stretches for this body, no particle of which is further than its "
            f"horizon from the surface: {why}; use a smaller horizon, or a critical stretch (ConstantCritical) instead "
            f"of Gc."
        )
    here = inside.along[:, inside.axes]
    volume = total(cloud.comm, cloud.volume[:n] @ here)
    found = np.zeros(families.n_bonds)
    for number, of_axis in enumerate(cloud.x.T[inside.axes]):
        distance = np.abs(of_axis[families.neighbours] - of_axis[families.centres])
        distance **= power
        families.multiply(distance, here[:, number] / volume[number])
        found += distance
    found /= len(inside.axes)
    return found


class _EitherWay(LocalDrivingVariable):
    """``x = |e| / limit``."""

    def __init__(self, bonds: DamageableBonds, limit: Float) -> None:
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
    """A bond fails by its stored energy: ``x = sqrt(w / w_c)``, ``w = 1/2 (k_ij + k_ji) e^2 / (V_i V_j)``.

    ``w`` is the energy of the bond over the volumes of both ends. The driving variable is its root, so that damage laws
    are functions of the elongation as with a critical stretch. Declare ``w_c`` as ``w``, or the fracture energy ``Gc``:
    breaking all bonds across a unit area then requires Gc, summed over the bonds of the body with their influence,
    horizon and damage law. Bonds of deformation gradients, and bonds with a dilatation, have the energy of the
    bond-based material with the same E. Shortened bonds do not fail unless ``compression`` is True.

    Parameters
    ----------
    w : float, optional
        Critical energy density of a bond [energy / length^6], positive.
    Gc : float, optional
        Fracture energy [energy / area], positive; exactly one of ``w`` and ``Gc``.
    compression : bool
        True if shortened bonds fail as well.
    share : float, optional
        Energy of a propagating crack over that of a plane of bonds [-], as in ``FractureEnergy``; 1 by default.

    References
    ----------
    Foster2011.

    Examples
    --------
    >>> import pdpetsc as pd
    >>> damage = pd.LinearSoftening(pd.BondEnergy(Gc=0.05), ratio=3.0)
    """

    w: Positive | None = None
    Gc: Positive | None = None
    compression: bool = False
    share: Positive | None = None

    def __post_init__(self) -> None:
        super().__post_init__()
        if (self.w is None) == (self.Gc is None):
            raise CaseError(f"BondEnergy takes w or Gc, not w={self.w} and Gc={self.Gc}.")
        if self.w is not None and self.share is not None:
            raise CaseError("BondEnergy takes a share of Gc; leave it out beside w.")

    @property
    def assumes_share(self) -> bool:
        """Return True if ``Gc`` is declared without a share."""
        return self.Gc is not None and self.share is None

    def resolve(self, bonds: DamageableBonds, toughness: Callable[[float], float]) -> Criterion:
        """Compute the elongations of failure of the bonds (collective)."""
        both = bonds.k + bonds.opposite.of(bonds.k)
        volume, i, j = bonds.cloud.volume, bonds.families.centres, bonds.families.neighbours
        pair = np.where(both > 0.0, volume[i] * volume[j], 0.0)
        if self.w is not None:
            w = np.full(len(both), self.w)
        else:
            assert self.Gc is not None
            # Each end contributes half of the energy of a bond, for any stiffness, or nothing if the bond is outside
            # its horizon. G is proportional to this power of the horizon.
            reach, power = bonds.cloud.local_horizon, bonds.cloud.dim + 1.0
            half = np.where(bonds.k > 0.0, 0.5 / reach[i] ** power, 0.0)
            G = float(total(bonds.cloud.comm, plane_weights(bonds) @ (toughness(2.0) * pair * half)))
            w = self.Gc / (self.share or 1.0) / G * (half + bonds.opposite.of(half))
        # A bond without stiffness stores no energy and does not fail.
        square = np.divide(2.0 * w * pair, both, out=np.full(len(both), np.inf), where=both > 0.0)
        return _Limited(np.sqrt(square), self.compression)

    def build(self, bonds: DamageableBonds) -> LocalDrivingVariable:
        """Raise an error: ``resolve`` is called first, with the stiffness of both ends."""
        raise CaseError("A bond energy is known in a case only, where the bonds are.")


@dataclass(frozen=True, eq=False)
class _Limited(Criterion):
    """Elongations of failure (n_bonds,) [length] of the bonds for which it was resolved."""

    limit: Any
    compression: bool

    def build(self, bonds: DamageableBonds) -> LocalDrivingVariable:
        """Return ``e / limit``, or its absolute value."""
        return (_EitherWay if self.compression else LinearDrivingVariable)(bonds, self.limit)
