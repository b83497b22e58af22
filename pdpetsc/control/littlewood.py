"""Littlewood's penalty on the difference between the elongation of a bond and that of the family gradient."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Literal

import numpy as np

from pdpetsc.arrays import Float
from pdpetsc.control.base import Control, Stiffness, ZeroEnergyControl
from pdpetsc.control.non_uniform import Directed
from pdpetsc.control.projection import gradient_weights
from pdpetsc.declared import NonNegative
from pdpetsc.discrete.cloud import Cloud
from pdpetsc.discrete.families import Families
from pdpetsc.errors import CaseError


@dataclass(frozen=True)
class Littlewood(ZeroEnergyControl):
    """Littlewood's penalty, ``T_h = C c_i omega (n . z) n / |xi|`` with ``z = eta - (F - I) xi``, ``n = xi / |xi|``.

    ``c_i = 2 dim^2 kappa / sum_j omega |xi| V_j`` is the micromodulus of a bond-based solid on this family
    (``18 kappa / pi horizon^4`` in 3D with many neighbours), so ``C`` is a pure number. Bonds have their reference
    direction and the forces derive from an energy, so that the matrix is constant and symmetric. In Littlewood2010 the
    direction rotates with the bond, and the force acts on both ends of the bond only.

    Parameters
    ----------
    C : float
        Strength [-], not negative.
    micromodulus : {"family", "ball"}
        Origin of the micromodulus. ``"family"``: as above. ``"ball"``: the hourglass coefficient of Peridigm, ``T_h = C
        (18 kappa / pi horizon^4) (n . z) n / |xi|``, for a whole ball, without influence, in 3D only.

    Raises
    ------
    CaseError
        C is negative or not finite, or ``micromodulus`` is unknown. When built: ``"ball"`` in 1D or 2D.

    References
    ----------
    Littlewood2010; Tupek2014.

    Examples
    --------
    >>> import pdpetsc as pd
    >>> pd.Littlewood(C=0.05)
    Littlewood(C=0.05, micromodulus='family')
    """

    C: NonNegative = 0.1
    micromodulus: Literal["family", "ball"] = "family"

    def build(self, cloud: Cloud, families: Families, omega: Float, stiffness: Stiffness) -> Control:
        """Build the control (collective); raise CaseError if a family is too small or flat."""
        g, _ = gradient_weights(cloud, families, omega, "Littlewood's penalty")
        xi = families.bonds(cloud.x)
        length = np.linalg.norm(xi, axis=1)
        n = xi / length[:, None]
        centres, volume = families.centres, cloud.volume[families.neighbours]
        if self.micromodulus == "ball":
            if cloud.dim != 3:
                raise CaseError('Littlewood(micromodulus="ball") is for bodies in 3D; take "family" elsewhere.')
            c = 18.0 * stiffness.kappa / (math.pi * cloud.local_horizon[: cloud.n_owned] ** 4)
        else:
            volume = omega * volume
            c = 2.0 * cloud.dim**2 * stiffness.kappa / np.bincount(centres, volume * length, minlength=cloud.n_owned)
        s = self.C * c[centres] * volume * cloud.volume[centres] / length
        return Directed(cloud, families, s[:, None, None] * n[:, :, None] * n[:, None, :], g)
