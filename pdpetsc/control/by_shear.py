"""A zero-energy control scaled with the shear modulus."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from pdpetsc.arrays import Float
from pdpetsc.control.base import Control, Stiffness, ZeroEnergyControl
from pdpetsc.discrete.cloud import Cloud
from pdpetsc.discrete.families import Families


@dataclass(frozen=True)
class ByShear(ZeroEnergyControl):
    """A control scaled with twice the shear modulus instead of ``kappa``, for nearly incompressible bodies.

    ``kappa = lambda + 2 mu / dim`` is unbounded as nu approaches 1/2, and a control in proportion to it locks the body:
    families bend at constant volume, but the control resists bending with the bulk modulus. Here the control is built
    for a material with the same shear moduli and ``kappa = 2 mu``. In the plane it is unchanged at nu = 1/4, and 0.77
    times as stiff at nu = 0.3. A bar has no shear modulus, and its control is unchanged.

    Parameters
    ----------
    control : ZeroEnergyControl
        The control that is scaled.

    References
    ----------
    Silling2017, section 5, for the control; the scale is that of this package.

    Examples
    --------
    >>> import pdpetsc as pd
    >>> pd.ByShear(pd.Silling(0.5))
    ByShear(control=Silling(G=0.5))
    """

    control: ZeroEnergyControl

    @property
    def of_kappa(self) -> bool:  # type: ignore[override]
        """Return the value of the control."""
        return self.control.of_kappa

    @property
    def elastic(self) -> ZeroEnergyControl:
        """Return ``ByShear`` of the elastic control."""
        return ByShear(self.control.elastic)

    @property
    def least_share(self) -> float | None:
        """Return the value of the control."""
        return self.control.least_share

    def sees(self, stiffness: Stiffness) -> Stiffness:
        """Return the stiffness with ``kappa = 2 mu``."""
        dim = stiffness.moduli.shape[-1]
        if dim == 1:
            return self.control.sees(stiffness)
        twice = np.array([twice_shear(A) for A in stiffness.moduli])
        kappa = np.einsum("aiikk->a", stiffness.moduli) / dim**2
        one = np.eye(dim)
        moduli = stiffness.moduli + np.einsum("a,im,kn->aimkn", twice - kappa, one, one)
        of = stiffness.material_of
        return self.control.sees(replace(stiffness, kappa=twice[of] * stiffness.factor, moduli=moduli))

    def build(self, cloud: Cloud, families: Families, omega: Float, stiffness: Stiffness) -> Control:
        """Build the control (collective)."""
        return self.control.build(cloud, families, omega, stiffness)


def twice_shear(A: Float) -> float:
    """Return the mean of ``d : A : d`` over deviatoric strains d of norm 1 [stress]: ``2 mu`` of an isotropic law.

    Parameters
    ----------
    A : (dim, dim, dim, dim) float64
        Tangent at F = I [stress]; for a bar its modulus.
    """
    dim = A.shape[-1]
    if dim == 1:
        return float(A[0, 0, 0, 0])
    trace = 0.5 * (np.einsum("ijij->", A) + np.einsum("ijji->", A))
    return float((trace - np.einsum("iikk->", A) / dim) / (0.5 * dim * (dim + 1) - 1))
