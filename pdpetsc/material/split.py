"""Splits of an energy into the part that damage reduces and the part that a closed crack retains."""

from __future__ import annotations

from abc import ABC, abstractmethod
from dataclasses import dataclass
from typing import ClassVar

import numpy as np

from pdpetsc.arrays import Float
from pdpetsc.declared import Declared, NonNegative
from pdpetsc.errors import CaseError
from pdpetsc.material.base import IsotropicMaterial, Material
from pdpetsc.material.closed import ClosedPart, GreenClosed, LogarithmicClosed, Principal, SmallClosed
from pdpetsc.material.closed_sliding import SlidingPart

# Strain below which a crack counts as closed: faces that just touch do so despite round-off.
TOUCHING = 1e-13


@dataclass(frozen=True)
class Split(Declared, ABC):
    """Split of the energy of a point into open part and closed part.

    It applies to an isotropic energy ``lambda / 2 (tr eps)^2 + mu eps : eps`` of the strain of the material. In plane
    stress it uses the in-plane strains and the moduli of plane stress.
    """

    # True if it depends on more than the dilatation. It then requires materials with such an energy, and no shared
    # dilatations.
    exact: ClassVar[bool] = True

    def closed_part(self, material: Material) -> ClosedPart | SlidingPart | None:
        """Return the law of the closed part, None if it is zero.

        Raises
        ------
        CaseError
            The material has another energy.
        """
        return self._without_slip(material)

    def _without_slip(self, material: Material) -> ClosedPart:
        """Return the law of the closed part of faces that do not slide; raise CaseError as ``closed_part``."""
        measure = material.strain_measure
        if not isinstance(material, IsotropicMaterial):
            raise CaseError(
                f"{type(self).__name__} is made of the Young's modulus and Poisson's ratio of a material, and "
                f"{type(material).__name__} has none; take split=pd.split.Whole()."
            )
        if measure is None and self.exact:
            raise CaseError(
                f"{type(self).__name__} splits an isotropic energy of a strain, as that of LinearElastic, Hencky or "
                f"SaintVenantKirchhoff, and {type(material).__name__} has another; take split=pd.split.Volumetric() "
                f"or pd.split.Whole()."
            )
        laws: dict[str | None, type[ClosedPart]]
        laws = {None: LogarithmicClosed, "logarithmic": LogarithmicClosed, "small": SmallClosed, "green": GreenClosed}
        return laws[measure](material.E, material.nu, material.plane, closed=self.closed)

    @abstractmethod
    def closed(self, strain: Float, lam: float, mu: float) -> Principal:
        """Compute the closed part for principal strains (n, k) [-] and moduli [stress]."""


@dataclass(frozen=True)
class Whole(Split):
    """No closed part: a closed crack has no stress.

    Examples
    --------
    >>> import pdpetsc as pd
    >>> damage = pd.PointDamage(pd.softening.Linear(), Gc=0.1, strength=3.0, split=pd.split.Whole())
    """

    exact: ClassVar[bool] = False

    def closed_part(self, material: Material) -> None:
        """Return None, for every material."""
        return

    def closed(self, strain: Float, lam: float, mu: float) -> Principal:
        n, k = strain.shape
        return Principal(np.zeros(n), np.zeros((n, k)), np.zeros((n, k, k)))


@dataclass(frozen=True)
class Volumetric(Split):
    """Closed part ``K / 2 <tr eps>-^2``: pressure in compression, and no shear.

    For materials without own strain measure the trace is that of the logarithmic strain.

    References
    ----------
    Amor2009, section 3.2.

    Examples
    --------
    >>> import pdpetsc as pd
    >>> damage = pd.PointDamage(pd.softening.Linear(), Gc=0.1, strength=3.0, split=pd.split.Volumetric())
    """

    exact: ClassVar[bool] = False

    def closed(self, strain: Float, lam: float, mu: float) -> Principal:
        """Return the energy of the negative trace."""
        k = strain.shape[1]
        trace = np.minimum(strain.sum(axis=1), 0.0)
        K = lam + 2.0 * mu / k
        moduli = np.where(trace < 0.0, K, 0.0)[:, None, None] * np.ones((k, k))
        return Principal(0.5 * K * trace**2, np.repeat(K * trace[:, None], k, axis=1), moduli)


@dataclass(frozen=True)
class Spectral(Split):
    """Closed part ``lambda / 2 <tr eps>-^2 + mu sum <eps_a>-^2`` of the negative principal strains.

    References
    ----------
    Miehe2010, section 2.

    Examples
    --------
    >>> import pdpetsc as pd
    >>> damage = pd.PointDamage(pd.softening.Linear(), Gc=0.1, strength=3.0, split=pd.split.Spectral())
    """

    def closed(self, strain: Float, lam: float, mu: float) -> Principal:
        """Return the energy of negative strains."""
        k = strain.shape[1]
        trace, part = np.minimum(strain.sum(axis=1), 0.0), np.minimum(strain, 0.0)
        moduli = np.where(trace < 0.0, lam, 0.0)[:, None, None] * np.ones((k, k))
        moduli = moduli + 2.0 * mu * np.eye(k) * (part < 0.0)[:, None, :]
        psi = 0.5 * lam * trace**2 + mu * (part**2).sum(axis=1)
        return Principal(psi, lam * trace[:, None] + 2.0 * mu * part, moduli)


@dataclass(frozen=True)
class NoTension(Split):
    """Closed part of a no-tension material: ``min psi(eps - p)`` over strains p of open cracks.

    Cracks open along the largest principal strains until no principal stress is tensile. The faces of the crack of a
    point, normal to the direction n at onset, slide: the energy is that of ``F (1 - s (x) n)`` for the slip s of the
    faces over the width of the family. Faces that move apart have no stress, faces that touch a pressure and Coulomb
    friction. The slip and the work of friction are stored.

    Parameters
    ----------
    friction : float or None
        Coefficient of friction [-]. With None, faces do not slide: a closed crack carries shear as long as no principal
        stress is tensile. An open crack then keeps stress in families that it cuts unevenly, as at surfaces, and if its
        faces move along each other.

    References
    ----------
    FreddiRoyerCarfagni2010, section 3; DelPiero1989; Fei2020 (friction of cracks that are fields).

    Examples
    --------
    >>> import pdpetsc as pd
    >>> damage = pd.PointDamage(pd.softening.Linear(), Gc=0.1, strength=3.0, split=pd.split.NoTension())
    >>> sliding = pd.PointDamage(
    ...     pd.softening.Linear(), Gc=0.1, strength=3.0, split=pd.split.NoTension(friction=0.3)
    ... )
    """

    friction: NonNegative | None = 0.0

    def closed_part(self, material: Material) -> ClosedPart | SlidingPart | None:
        """Return the law of the closed part, whose faces slide if there is a coefficient of friction."""
        part = self._without_slip(material)
        return part if self.friction is None else SlidingPart.of(part, self.friction)

    def closed(self, strain: Float, lam: float, mu: float) -> Principal:
        """Return the energy of the remaining compressive stresses."""
        n, k = strain.shape
        order = np.argsort(-strain, axis=1, kind="stable")
        eps = np.take_along_axis(strain, order, axis=1)
        psi, stress, moduli = np.zeros(n), np.zeros((n, k)), np.zeros((n, k, k))
        found = np.zeros(n, dtype=bool)
        stiff = lam
        for free in range(k):
            # The other directions have the stiffness of a body with zero stress across the open cracks.
            left = eps[:, free:]
            tau = stiff * left.sum(axis=1)[:, None] + 2.0 * mu * left
            here = ~found & (tau[:, 0] <= TOUCHING * (lam + 2.0 * mu))
            psi[here] = 0.5 * (tau * left).sum(axis=1)[here]
            stress[here, free:] = tau[here]
            moduli[here, free:, free:] = stiff + 2.0 * mu * np.eye(k - free)
            found |= here
            stiff = 2.0 * mu * stiff / (stiff + 2.0 * mu)
        back = np.argsort(order, axis=1)
        moduli = np.take_along_axis(np.take_along_axis(moduli, back[:, :, None], 1), back[:, None, :], 2)
        return Principal(psi, np.take_along_axis(stress, back, axis=1), moduli)
