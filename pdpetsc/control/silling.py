"""Silling's control of the non-uniform part of the deformation of a family."""

from __future__ import annotations

import itertools
import math
from dataclasses import dataclass
from typing import ClassVar

import numpy as np

from pdpetsc.arrays import Float
from pdpetsc.control.base import Control, Stiffness, ZeroEnergyControl
from pdpetsc.control.non_uniform import NonUniform
from pdpetsc.declare.influence import Constant, Influence, evaluate
from pdpetsc.declared import NonNegative, Positive
from pdpetsc.discrete.cloud import HORIZON_TOLERANCE, Cloud
from pdpetsc.discrete.families import Families
from pdpetsc.errors import CaseError
from pdpetsc.gradient.base import regular_shape_tensors

# Micromodulus of a bond-based solid times horizon^4 over its stiffness, with a thickness of one in the plane.
MICROMODULUS = {2: 12.0 / math.pi, 3: 18.0 / math.pi}


@dataclass(frozen=True)
class Silling(ZeroEnergyControl):
    """Silling's control, ``T_z = G kappa / (sum_j omega |xi|^2 V_j) omega z`` with ``z = eta - (F - I) xi``.

    ``kappa = lambda + 2 mu / dim`` is the modulus of the material, so ``G`` is a pure number, independent of units. The
    control resists the non-uniform part of the deformation of a family; affine displacements have no force.

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
    Silling2017, section 5; Hashim, Eq. (37)-(44), with the coefficient of ``SillingMicromodulus``.

    Examples
    --------
    >>> import pdpetsc as pd
    >>> pd.Silling(G=0.2)
    Silling(G=0.2)
    """

    G: NonNegative = 0.5

    of_kappa: ClassVar[bool] = True

    def build(self, cloud: Cloud, families: Families, omega: Float, stiffness: Stiffness) -> Control:
        """Build the control (collective); raise CaseError if a family is too small or flat."""
        weight = families.weights(omega, cloud.volume)
        K = regular_shape_tensors(cloud, families, weight, "Silling's control")
        return NonUniform.proportional(cloud, families, omega, K, self.G * stiffness.kappa / np.einsum("pii->p", K))


@dataclass(frozen=True)
class SillingMicromodulus(ZeroEnergyControl):
    """Silling's control as published by Hashim, ``T_z = G C / omega_0 omega z`` with ``omega_0 = sum_j omega V_j``.

    ``C = 12 k' / (pi h horizon^4)`` is the micromodulus of a bond-based solid with ``k' = lambda + mu`` in plane strain
    or stress; the thickness h is one unit of length. In 3D ``C = 18 k / (pi horizon^4)`` with the bulk modulus k.
    ``C / omega_0`` times a length is not a force density: another unit of length multiplies ``G`` by the square of the
    ratio of the units. The ``G`` of a paper is therefore valid with the unit of the paper only. Use this class to
    reproduce such papers; ``Silling`` has a dimensionless ``G``.

    Parameters
    ----------
    G : float
        Strength, not negative, for one unit of length.
    unit_length : float
        This unit of length, in the unit of the case [length]: 1 if the case has the units of the paper, 1000 if the
        paper uses m and the case mm. Results for the same ``G`` and unit do not depend on the units of the case.

    Raises
    ------
    CaseError
        ``G`` is negative or not finite, or ``unit_length`` is not positive. When built: the body is in 1D.

    References
    ----------
    Hashim, Eq. (37)-(44); Silling2017, section 5.

    Examples
    --------
    >>> import pdpetsc as pd
    >>> printed = pd.SillingMicromodulus(G=0.002, unit_length=1000.0)  # of a paper in m, in a case in mm
    >>> same = pd.Silling(printed.unit_free(spacing=1.0, horizon=3.015))
    """

    G: NonNegative
    unit_length: Positive

    of_kappa: ClassVar[bool] = True

    def unit_free(
        self,
        spacing: float,
        horizon: float,
        dim: int = 2,
        influence: Influence = Constant(),  # noqa: B008 (frozen)
    ) -> float:
        """Return the ``G`` of ``Silling`` for the same control on whole families of a square or cubic lattice.

        It is ``G (unit_length / horizon)^2 c sum omega |xi|^2 / (horizon^2 sum omega)`` with c = 12 / pi in 2D and 18 /
        pi in 3D, sums over the lattice. Families that a boundary cuts have other sums and a different control. The
        result is proportional to ``G``: ``G / SillingMicromodulus(1.0, unit_length).unit_free(...)`` is the inverse.

        Parameters
        ----------
        spacing, horizon : float
            Spacing and horizon of the lattice [length].
        dim : int
            2 or 3.
        influence : Influence
            As in the case.

        Raises
        ------
        CaseError
            There is no such control in this dimension, or the horizon contains no neighbour.
        """
        c = _micromodulus(dim)
        if not (0.0 < spacing <= horizon * (1.0 + HORIZON_TOLERANCE) and math.isfinite(horizon)):
            raise CaseError(f"A lattice needs 0 < spacing <= horizon, not {spacing} and {horizon}.")
        reach = horizon * (1.0 + HORIZON_TOLERANCE) / spacing
        steps = range(-int(reach), int(reach) + 1)
        s = np.array([math.hypot(*n) for n in itertools.product(steps, repeat=dim) if 0.0 < math.hypot(*n) <= reach])
        s = np.minimum(s * spacing / horizon, 1.0)
        omega = evaluate(influence, s)
        return float(self.G * (self.unit_length / horizon) ** 2 * c * (omega @ s**2) / omega.sum())

    def build(self, cloud: Cloud, families: Families, omega: Float, stiffness: Stiffness) -> Control:
        """Build the control (collective); raise CaseError in 1D or if a family is too small or flat."""
        c = _micromodulus(cloud.dim)
        weight = families.weights(omega, cloud.volume)
        K = regular_shape_tensors(cloud, families, weight, "Silling's control")
        omega_0 = families.sums(weight)
        reach = cloud.local_horizon[: cloud.n_owned]
        modulus = c * (self.unit_length / reach) ** 2 * stiffness.kappa
        return NonUniform.proportional(cloud, families, omega, K, self.G * modulus / (reach**2 * omega_0))


def _micromodulus(dim: int) -> float:
    """Return the micromodulus times horizon^4 over the stiffness."""
    if dim not in MICROMODULUS:
        raise CaseError(f"No paper gives the micromodulus of SillingMicromodulus in {dim}D; take Silling there.")
    return MICROMODULUS[dim]
