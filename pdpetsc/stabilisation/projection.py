"""The uniform gradient that a control leaves alone."""

from __future__ import annotations

import numpy as np

from pdpetsc.arrays import Float
from pdpetsc.discrete.cloud import Cloud
from pdpetsc.discrete.families import Families
from pdpetsc.gradient.base import flat, refuse_flat, whole_families


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
    K = whole_families(cloud, families, weight).shape_tensors(cloud.x)
    refuse_flat(cloud.comm, cloud.gid[: cloud.n_owned][flat(K)], name, "widen the horizon or add particles there")
    K_inverse = np.linalg.inv(K)
    xi = families.bonds(cloud.x)
    return weight[:, None] * np.einsum("bmn,bn->bm", K_inverse[families.centres], xi), K_inverse
