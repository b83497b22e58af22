"""How a bond loses its force: piecewise linear laws."""

from __future__ import annotations

import math
from abc import ABC, abstractmethod
from dataclasses import dataclass

import numpy as np

from pdpetsc.arrays import Float
from pdpetsc.damage.critical import CriticalStretch
from pdpetsc.errors import CaseError


@dataclass(frozen=True)
class BondDamage(ABC):
    """A bond is elastic up to its critical stretch; what it has lost it does not regain.

    Its state is the integrity ``mu``, force over elastic force: 1 intact, 0 broken. Unloading goes along the secant.
    Compression does no damage.

    Parameters
    ----------
    critical : CriticalStretch
        Where damage begins.
    """

    critical: CriticalStretch

    @property
    @abstractmethod
    def final_ratio(self) -> float:
        """Return the stretch without force over the critical one [-]: 1 for a bond that snaps."""

    def reached(self, integrity: Float) -> Float:
        """Return the elongation over the critical one at which bonds of this integrity fail further (n,) [-].

        On the envelope ``q = k l (r - x) / (r - 1)``, with ``x = e / l`` and the final ratio ``r``, ``q = mu k l x``.
        """
        r = self.final_ratio
        return np.asarray(r / (1.0 + integrity * (r - 1.0)))

    def dissipated(self, integrity: Float, k: Float, limit: Float) -> Float:
        """Return what bonds have dissipated (n,) [energy].

        Parameters
        ----------
        integrity, k, limit : (n,) float64
            Integrity [-], stiffness [force / length] and critical elongation [length].
        """
        x = self.reached(integrity)
        force = integrity * x
        return np.asarray(0.5 * k * limit**2 * (1.0 + (1.0 + force) * (x - 1.0) - force * x))


@dataclass(frozen=True)
class Brittle(BondDamage):
    """The force drops to zero at the critical stretch.

    References
    ----------
    Silling, Askari (2005), Eq. (24); Mikes, Jirasek, Zeman, Rokos, Peerlings, Eq. (7).
    """

    @property
    def final_ratio(self) -> float:
        """Return 1."""
        return 1.0


@dataclass(frozen=True)
class LinearSoftening(BondDamage):
    """The force falls linearly from the critical stretch to zero at ``ratio`` times that.

    Parameters
    ----------
    ratio : float
        Above 1.
    """

    ratio: float = 2.0

    def __post_init__(self) -> None:
        if not (math.isfinite(self.ratio) and self.ratio > 1.0):
            raise CaseError(f"Softening bonds need a ratio of final to critical stretch above 1, not {self.ratio}.")

    @property
    def final_ratio(self) -> float:
        """Return the ratio."""
        return self.ratio
