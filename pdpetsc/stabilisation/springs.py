"""Springs on the bonds."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

from pdpetsc.arrays import Float
from pdpetsc.discrete.cloud import Cloud
from pdpetsc.discrete.families import Families
from pdpetsc.errors import CaseError
from pdpetsc.stabilisation.base import Control, Stabilisation, Stiffness
from pdpetsc.stabilisation.non_uniform import NonUniform


@dataclass(frozen=True)
class Springs(Stabilisation):
    """Linear springs, ``T_a = C1 omega eta``.

    They resist affine deformation and rotation as well, so the patch test fails and rotations must stay small. ``C1``
    carries a unit and its best value depends on the spacing: it is here for comparison.

    Parameters
    ----------
    C1 : float
        Spring constant [force / length^7; force / length^3 for a bar], not negative.

    References
    ----------
    Breitenfeld, Geubelle, Weckner, Silling (2014); Luo, Sundararaghavan (2018), Eq. (7) and Table 1.
    """

    C1: float

    def __post_init__(self) -> None:
        super().__post_init__()
        if not (math.isfinite(self.C1) and self.C1 >= 0.0):
            raise CaseError(f"Springs need C1 >= 0, not {self.C1}.")

    def build(self, cloud: Cloud, families: Families, omega: Float, stiffness: Stiffness) -> Control:
        """Return the control (collective)."""
        s = self.C1 * omega * cloud.volume[families.centres] * cloud.volume[families.neighbours]
        return NonUniform(cloud, families, s, np.zeros((cloud.n_owned, cloud.dim, cloud.dim)))
