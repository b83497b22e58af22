"""Silling's control of the non-uniform part of the deformation of a family."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

from pdpetsc.arrays import Float
from pdpetsc.discrete.cloud import Cloud
from pdpetsc.discrete.families import Families
from pdpetsc.errors import CaseError
from pdpetsc.gradient.base import regular_shape_tensors
from pdpetsc.stabilisation.base import Control, Stabilisation, Stiffness
from pdpetsc.stabilisation.non_uniform import NonUniform


@dataclass(frozen=True)
class Silling(Stabilisation):
    """Silling's control, ``T_z = G kappa / (sum_j omega |xi|^2 V_j) omega z`` with ``z = eta - (F - I) xi``.

    ``kappa = lambda + 2 mu / dim`` is the modulus of the material, so ``G`` is a pure number: the same case in other
    units has the same answer. It acts on what a uniform gradient of the whole family leaves unexplained and leaves
    every affine displacement alone.

    Parameters
    ----------
    G : float
        Strength [-], not negative; about 0.5 suppresses zero-energy modes and costs little stiffness.

    Raises
    ------
    CaseError
        ``G`` is negative or not finite.

    References
    ----------
    Silling (2017), section 5; Hashim et al., Eq. (37)-(44). There G C / omega_0 with the micromodulus C of a bond-based
    solid stands for the factor above; it has other dimensions, so that paper's values of G depend on the length unit.
    """

    G: float = 0.5

    def __post_init__(self) -> None:
        super().__post_init__()
        if not (math.isfinite(self.G) and self.G >= 0.0):
            raise CaseError(f"Silling's control needs G >= 0, not {self.G}.")

    def build(self, cloud: Cloud, families: Families, omega: Float, stiffness: Stiffness) -> Control:
        """Return the control (collective); raises CaseError where a family is too small or flat."""
        weight = omega * cloud.volume[families.neighbours]
        K = regular_shape_tensors(cloud, families, weight, "Silling's control")
        factor = self.G * stiffness.kappa * cloud.volume[: cloud.n_owned] / np.einsum("pii->p", K)
        bond_stiffness = factor[families.centres] * weight
        K_inverse = np.linalg.inv(K * factor[:, None, None]) if self.G > 0.0 else np.zeros_like(K)
        return NonUniform(cloud, families, bond_stiffness, K_inverse)
