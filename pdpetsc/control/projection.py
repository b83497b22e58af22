"""Weights of the uniform gradient of a family, which a control does not resist."""

from __future__ import annotations

from pdpetsc.arrays import Float
from pdpetsc.discrete.cloud import Cloud
from pdpetsc.discrete.families import Families
from pdpetsc.gradient.base import correspondence_weights, regular_shape_tensors
from pdpetsc.kernels.gradient import inverses


def gradient_weights(cloud: Cloud, families: Families, omega: Float, name: str) -> tuple[Float, Float]:
    """Return the weights ``g_ij = omega V_j K_i^-1 xi_ij`` (n_bonds, dim) and ``K_i^-1`` (n_owned, dim, dim).

    Raises
    ------
    CaseError
        A family is too small or flat, on every rank.

    Notes
    -----
    Collective.
    """
    weight = omega * cloud.volume[families.neighbours]
    K_inverse = inverses(regular_shape_tensors(cloud, families, weight, name))
    return correspondence_weights(families, cloud.x, weight, K_inverse), K_inverse
