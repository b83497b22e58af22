"""What the degradation factor of bonds does to the force states of deformation gradients."""

from __future__ import annotations

from abc import ABC, abstractmethod
from dataclasses import dataclass

import numpy as np

from pdpetsc.arrays import Float, Mask
from pdpetsc.declared import Declared
from pdpetsc.renamed import accept_old_methods


class DamageEvolution(Declared, ABC):
    """How force states ``T_s omega P K^-1 xi`` and the zero-energy control fade with their bonds, and when these break.

    A bond has the degradation factor ``T_s`` of the law at its present drive or the one that was kept at the last
    equilibrium. Whatever the effect, no bond breaks while equilibrium is sought, and a broken bond leaves shape tensor
    and gradient.
    """

    def __init_subclass__(cls) -> None:
        super().__init_subclass__()
        accept_old_methods(cls, {"heals": "reversible", "tears": "breaks_by_family_strain"})

    @property
    @abstractmethod
    def reversible(self) -> bool:
        """Return whether a bond that has not broken regains force as it is driven less."""

    @property
    @abstractmethod
    def breaks_by_family_strain(self) -> bool:
        """Return whether bonds also break with the strain of a gradient that has lost some, besides their drive."""

    @abstractmethod
    def follows(self, present: Float, kept: Float) -> Mask:
        """Return which bonds have the degradation factor of the present drive (n_bonds,), not the kept one."""

    @abstractmethod
    def reached(self, x: Float, kappa: Float) -> Float:
        """Return the drive by which a bond is judged to break (n_bonds,) [-].

        Parameters
        ----------
        x, worst : (n_bonds,) float64
            The present one, and the largest that was kept at an equilibrium.
        """

    @abstractmethod
    def volume_left(self, share: Float) -> Float:
        """Return the share of the volume of a particle that has ``share`` (n,) of its family left [-]."""

    @abstractmethod
    def of_control(self, kept: Float) -> Float:
        """Return what the stiffness of the control's bonds is multiplied with (n_bonds,) [-], in its gradient too.

        It follows from the degradation factors ``kept`` at the last equilibrium, and stays until the next one.
        """

    @abstractmethod
    def fading(self, phi: Float) -> Float | None:
        """Return what multiplies the control's forces besides, now (n_bonds,) [-]; None for nothing."""


@dataclass(frozen=True)
class LargestStretch(DamageEvolution):
    """The degradation factor is that of the largest drive so far: what a bond has lost it does not regain.

    The control has the degradation factor of the last equilibrium in its stiffness and in the gradient that it measures
    from. A bond that breaks takes its share of the particle's volume with it, so that the force states of the others
    stay as they were, and bonds that lie across the pull break with the strain of the gradient.

    Examples
    --------
    >>> import pdpetsc as pd
    >>> damage = pd.LinearSoftening(pd.ConstantCritical(0.01), effect=pd.LargestStretch())
    """

    @property
    def reversible(self) -> bool:
        """Return False."""
        return False

    @property
    def breaks_by_family_strain(self) -> bool:
        """Return True."""
        return True

    def follows(self, present: Float, kept: Float) -> Mask:
        """Return where the present degradation factor is below the kept one."""
        return np.asarray(present < kept)

    def reached(self, x: Float, kappa: Float) -> Float:
        """Return the larger of the two."""
        return np.maximum(x, kappa)

    def volume_left(self, share: Float) -> Float:
        """Return the share of the family."""
        return share

    def of_control(self, kept: Float) -> Float:
        """Return the degradation factor."""
        return kept

    def fading(self, phi: Float) -> Float | None:
        """Return None."""
        return None


@dataclass(frozen=True)
class PresentStretch(DamageEvolution):
    """As published: ``T = T_s (omega P K^-1 xi + omega T_z)`` with the ``phi`` of the present drive everywhere.

    The control fades with its bonds at once, with the derivative of that in the tangent, and measures from the gradient
    of the bonds that have not broken. Bonds break at their critical stretch and for no other reason. Particles keep
    their whole volume, so the stress of those that have lost bonds is carried by the bonds that are left. Until it
    breaks a bond regains what it had lost when it shortens.

    Examples
    --------
    >>> import pdpetsc as pd
    >>> as_published = pd.SmoothDegradation(pd.ConstantCritical(0.01), effect=pd.PresentStretch())

    References
    ----------
    Hashim, Eq. (45)-(54), with ``T_s omega P K^-1 xi`` for ``T_s omega P^T K xi`` and the derivative of
    ``1 - tanh n`` as ``tanh(n)^2 - 1``.
    """

    @property
    def reversible(self) -> bool:
        """Return True."""
        return True

    @property
    def breaks_by_family_strain(self) -> bool:
        """Return False."""
        return False

    def follows(self, present: Float, kept: Float) -> Mask:
        """Return True for all."""
        return np.ones(len(present), dtype=bool)

    def reached(self, x: Float, kappa: Float) -> Float:
        """Return the present drive."""
        return x

    def volume_left(self, share: Float) -> Float:
        """Return 1: all of it."""
        return np.ones_like(share)

    def of_control(self, kept: Float) -> Float:
        """Return 1 where bonds are not broken."""
        return np.asarray(kept > 0.0, dtype=np.float64)

    def fading(self, phi: Float) -> Float | None:
        """Return the degradation factor."""
        return phi
