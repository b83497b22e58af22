"""Damage evolution: effect of the degradation factor of bonds on force states and control, and breaking of bonds."""

from __future__ import annotations

from abc import ABC, abstractmethod
from dataclasses import dataclass

import numpy as np

from pdpetsc.arrays import Float, Mask
from pdpetsc.declared import Declared
from pdpetsc.renamed import accept_old_methods


class DamageEvolution(Declared, ABC):
    """Degradation of force states ``T_s omega P K^-1 xi`` and of the zero-energy control, and breaking of bonds.

    The degradation factor ``T_s`` of a bond is that of the law at its present driving variable, or that of the last
    equilibrium. For every evolution, bonds break at equilibrium only, and a broken bond leaves shape tensor and
    gradient.
    """

    def __init_subclass__(cls) -> None:
        super().__init_subclass__()
        accept_old_methods(cls, {"heals": "reversible", "tears": "breaks_by_family_strain"})

    @property
    @abstractmethod
    def reversible(self) -> bool:
        """Return True if an unbroken bond regains force if its driving variable decreases."""

    @property
    @abstractmethod
    def breaks_by_family_strain(self) -> bool:
        """Return True if bonds also break by the strain of a family that has lost bonds."""

    @abstractmethod
    def follows(self, present: Float, kept: Float) -> Mask:
        """Return a mask of bonds with the present degradation factor (n_bonds,), not the committed one."""

    @abstractmethod
    def reached(self, x: Float, kappa: Float) -> Float:
        """Return the driving variable that decides whether a bond breaks (n_bonds,) [-].

        Parameters
        ----------
        x, kappa : (n_bonds,) float64
            Present driving variable, and the largest one of earlier equilibria.
        """

    @abstractmethod
    def volume_left(self, share: Float) -> Float:
        """Return the effective share of the volume of a particle with ``share`` (n,) of its family left [-]."""

    @abstractmethod
    def of_control(self, kept: Float) -> Float:
        """Return the factor of the stiffness of bonds in the control and its gradient (n_bonds,) [-].

        It depends on the degradation factors ``kept`` of the last equilibrium, and is constant until the next one.
        """

    @abstractmethod
    def fading(self, phi: Float) -> Float | None:
        """Return the present additional factor of the forces of the control (n_bonds,) [-]; None for no factor."""


@dataclass(frozen=True)
class LargestStretch(DamageEvolution):
    """Irreversible damage: the degradation factor is that of the largest driving variable so far.

    The stiffness of the control and its gradient contain the degradation factor of the last equilibrium. If a bond
    breaks, its share of the volume of the particle is lost, so that the force states of the other bonds do not change.
    Bonds transverse to the tension break by the strain of the family.

    Examples
    --------
    >>> import pdpetsc as pd
    >>> damage = pd.LinearSoftening(pd.ConstantCritical(0.01), effect=pd.LargestStretch())
    """

    reversible = False

    breaks_by_family_strain = True

    def follows(self, present: Float, kept: Float) -> Mask:
        """Return True for bonds whose present degradation factor is below the committed one."""
        return np.asarray(present < kept)

    def reached(self, x: Float, kappa: Float) -> Float:
        """Return the larger of the two."""
        return np.maximum(x, kappa)

    def volume_left(self, share: Float) -> Float:
        """Return the share of the family."""
        return share

    def of_control(self, kept: Float) -> Float:
        return kept

    def fading(self, phi: Float) -> Float | None:
        """Return None."""
        return None


@dataclass(frozen=True)
class PresentStretch(DamageEvolution):
    """Reversible damage as published: ``T = T_s (omega P K^-1 xi + omega T_z)``.

    ``T_s`` is the degradation factor of the present driving variable.

    The degradation factor multiplies the forces of the control immediately, and its derivative is part of the tangent.
    The gradient of the control contains the unbroken bonds. Bonds break by their critical stretch only. Particles keep
    their whole volume, so the remaining bonds of a particle carry its stress. An unbroken bond regains its force if it
    shortens.

    Examples
    --------
    >>> import pdpetsc as pd
    >>> as_published = pd.SmoothDegradation(pd.ConstantCritical(0.01), effect=pd.PresentStretch())

    References
    ----------
    Hashim, Eq. (45)-(54), with ``T_s omega P K^-1 xi`` for ``T_s omega P^T K xi`` and the derivative of
    ``1 - tanh n`` as ``tanh(n)^2 - 1``.
    """

    reversible = True

    breaks_by_family_strain = False

    def follows(self, present: Float, kept: Float) -> Mask:
        return np.ones(len(present), dtype=bool)

    def reached(self, x: Float, kappa: Float) -> Float:
        return x

    def volume_left(self, share: Float) -> Float:
        return np.ones_like(share)

    def of_control(self, kept: Float) -> Float:
        """Return 1 for unbroken bonds, else 0."""
        return np.asarray(kept > 0.0, dtype=np.float64)

    def fading(self, phi: Float) -> Float | None:
        return phi
