"""The ordinary state-based linear solid."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from pdpetsc.bond_based.base import BondMaterial, BondStiffness, Neighbourhood
from pdpetsc.errors import CaseError
from pdpetsc.material.linear_elastic import LinearElastic


@dataclass(frozen=True)
class LinearSolid(BondMaterial):
    """Ordinary state-based linear solid: bond-based forces and a pressure from the dilatation of the family.

    ``W_i = 1/2 kappa theta_i^2 + 1/2 alpha_i sum_j omega (e_ij - theta_i |xi| / d)^2 V_j`` with
    ``theta_i = d / m_i sum_j omega |xi| e_ij V_j``, ``m_i = sum_j omega |xi|^2 V_j``, ``kappa = lambda + 2 mu / d`` and
    ``alpha_i = d (d + 2) mu / m_i`` in d dimensions. Uniform dilation is exact for every family, whole or cut. Shear is
    exact in the limit of many bonds. In 1D the second term is zero in uniform strain and controls the zero-energy mode.

    Parameters
    ----------
    E, plane, kinematics
        Young's modulus [stress], ``"strain"`` or ``"stress"`` for plane strain or plane stress, and ``"small"`` or
        ``"finite"`` displacements, as for every ``BondMaterial``.
    nu : float
        Poisson's ratio [-], between -1 and 0.5, both excluded.

    References
    ----------
    Silling2007, section 15; in 2D Le2014.

    Examples
    --------
    >>> import pdpetsc as pd
    >>> concrete = pd.LinearSolid(E=30e3, nu=0.2, plane="stress")
    """

    def __post_init__(self) -> None:
        super().__post_init__()
        if self.nu is None:
            raise CaseError("LinearSolid needs Poisson's ratio nu.")

    def elastic(self, dim: int) -> LinearElastic:
        """Return the linear elastic material with the same constants."""
        assert self.nu is not None
        return LinearElastic(self.E, self.nu, self.plane)

    def stiffness(self, bonds: Neighbourhood) -> BondStiffness:
        """Return ``k = alpha omega V_i V_j``, ``a = d / m omega |xi| V_j``, ``B = (kappa - alpha m / d^2) V_i``."""
        cloud, families = bonds.cloud, bonds.families
        dim, n = cloud.dim, cloud.n_owned
        elastic = self.elastic(dim)
        mu = elastic.lame(dim)[1]
        # A particle with an empty horizon may have bonds to particles with a larger horizon, without influence.
        m = np.where((m := bonds.moment(2)) > 0.0, m, 1.0)[families.centres]
        ours, theirs = cloud.volume[families.centres], cloud.volume[families.neighbours]
        k = dim * (dim + 2) * mu / m * bonds.omega * ours * theirs
        a = dim / m * bonds.omega * bonds.length * theirs
        B = (elastic.bulk_like_modulus(dim) - mu * (dim + 2) / dim) * cloud.volume[:n]
        return BondStiffness(k, a, np.asarray(B))
