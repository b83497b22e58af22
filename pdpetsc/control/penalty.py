"""The penalty on the non-uniform part of the deformation, with one constant for the whole body."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from pdpetsc.arrays import Float
from pdpetsc.control.base import Control, Stiffness, ZeroEnergyControl
from pdpetsc.control.non_uniform import NonUniform
from pdpetsc.declared import NonNegative
from pdpetsc.discrete.cloud import Cloud
from pdpetsc.discrete.families import Families
from pdpetsc.gradient.base import regular_shape_tensors


@dataclass(frozen=True)
class Penalty(ZeroEnergyControl):
    """Penalty with one constant for the whole body, ``T_a = C3 omega z`` with ``z = eta - (F - I) xi``.

    Affine displacements have no force. ``C3`` has a unit and its best value depends on the spacing and the material.
    Use it to compare with papers. Scaled with the modulus and the family of each particle it is ``Silling``,
    ``G kappa = C3 sum_j omega |xi|^2 V_j``.

    Parameters
    ----------
    C3 : float
        Constant [force / length^7; force / length^3 for a bar], not negative.

    References
    ----------
    Breitenfeld2014, third method, as described in Luo2018, section 5.1, and Silling2017, section 5.

    Examples
    --------
    >>> import pdpetsc as pd
    >>> pd.Penalty(C3=2.0)
    Penalty(C3=2.0)
    """

    C3: NonNegative

    def build(self, cloud: Cloud, families: Families, omega: Float, stiffness: Stiffness) -> Control:
        """Build the control (collective); raise CaseError if a family is too small or flat."""
        weight = families.weights(omega, cloud.volume)
        K = regular_shape_tensors(cloud, families, weight, "the penalty")
        return NonUniform.proportional(cloud, families, omega, K, np.full(cloud.n_owned, self.C3))
