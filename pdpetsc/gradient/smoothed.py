"""Gradients of the averaged displacement."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from pdpetsc.arrays import Float
from pdpetsc.declared import Fraction
from pdpetsc.discrete.cloud import HORIZON_TOLERANCE, Cloud
from pdpetsc.discrete.families import Families
from pdpetsc.gradient.base import FLAT, GradientOperator, Scheme, from_bond_weights, refuse_flat
from pdpetsc.kernels.gradient import smoothed_moments_kernel


@dataclass(frozen=True)
class SmoothedDisplacement(Scheme):
    """Correspondence with the averaged displacement, ``F_i = I + sum_j omega V_j (ubar_j - ubar_i) (x) xi_ij B_i^-1``.

    ``ubar_j`` is the mean of u over the particles within ``radius`` horizons of j, including j. The sum is over the
    neighbours within the rest of the horizon, so that no family exceeds its horizon. With ``B_i = sum_j omega V_j
    (xbar_j - xbar_i) (x) xi_ij`` affine displacements are exact up to the surface. There is no coefficient. The average
    removes the shortest waves from F but does not resist them: they remain in u. For comparison only.

    Parameters
    ----------
    radius : float
        Radius of the average, in horizons; the average and the rest of the horizon must both contain neighbours, so
        horizons below two spacings are refused.

    References
    ----------
    Wu2015, as described in Yaghoobi2017, section 1.

    Examples
    --------
    >>> import pdpetsc as pd
    >>> pd.SmoothedDisplacement(radius=0.5)
    SmoothedDisplacement(radius=0.5)
    """

    radius: Fraction = 0.5

    def build(self, cloud: Cloud, families: Families, omega: Float) -> GradientOperator:
        """Build the gradient operator (collective); raise CaseError if a family is too small or flat."""
        weight = omega * cloud.volume[families.neighbours]
        reach = cloud.local_horizon[: cloud.n_owned] * (1.0 + HORIZON_TOLERANCE)
        moments = np.empty((len(weight), cloud.dim))
        kernel = smoothed_moments_kernel(cloud.dim)
        radii = self.radius * reach, (1.0 - self.radius) * reach
        kernel(families.indptr, families.neighbours, cloud.x, cloud.volume, weight, *radii, moments)
        xi = families.bonds(cloud.x)
        B = np.zeros((cloud.n_owned, cloud.dim, cloud.dim))
        np.add.at(B, families.centres, xi[:, :, None] * moments[:, None, :])
        singular = np.linalg.svd(B, compute_uv=False)
        bad = singular[:, -1] <= FLAT * singular.mean(axis=1)
        refuse_flat(cloud, np.flatnonzero(bad), "gradients of the averaged displacement")
        g = np.einsum("bn,bnm->bm", moments, np.linalg.inv(B)[families.centres])
        return from_bond_weights(cloud, families, g)
