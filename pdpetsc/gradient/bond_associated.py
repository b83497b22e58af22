"""Bond-associated gradients: one gradient point per bond."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import ClassVar

import numpy as np

from pdpetsc.arrays import Float, starts_of
from pdpetsc.declared import Positive
from pdpetsc.discrete.cloud import HORIZON_TOLERANCE, Cloud
from pdpetsc.discrete.families import Families
from pdpetsc.gradient.base import (
    THIN,
    GradientOperator,
    Scheme,
    flat,
    operator,
    regular_shape_tensors,
    with_centres,
)
from pdpetsc.kernels.gradient import bond_families_kernel, bond_family_sizes_kernel

# Radii of the family of a bond that are tried in turn, as multiples of ``radius``. The last is the whole family.
GROWTH = (1.0, 1.25, 1.5, 1.75, 2.0, math.inf)


@dataclass(frozen=True)
class BondAssociated(Scheme):
    """Bond-associated correspondence: a gradient point for every bond of a particle, over the family of the bond.

    The family of bond ``ij`` contains the members of the family of ``i`` within ``radius`` horizons of ``j``. The
    points of a particle share its volume in equal parts. If the family of a bond is too flat, as on a lattice of
    nearest neighbours, the radius increases to 1.25, 1.5, 1.75 and 2 times its value. The last choice is the whole
    family. The forces derive from the energy of the points. Forces and moments therefore balance and the tangent is
    symmetric; Chen2019 sums force states bond by bond.

    Parameters
    ----------
    radius : float
        Radius of the family of a bond, in horizons.

    References
    ----------
    Chen2019.

    Examples
    --------
    >>> import pdpetsc as pd
    >>> pd.BondAssociated(radius=1.25)
    BondAssociated(radius=1.25)
    """

    of_family: ClassVar[bool] = True
    horizon_ratio: ClassVar[float] = 2.015
    points_of_bonds: ClassVar[bool] = True

    radius: Positive = 1.0

    def memory(self, dim: int, family: float) -> float:
        """Return the memory of the family of a bond, which is about a third of that of its particle [bytes]."""
        return 8.0 * family

    def build(self, cloud: Cloud, families: Families, omega: Float) -> GradientOperator:
        """Build the gradient operator (collective); raise CaseError if a family is too small or flat."""
        weight = omega * cloud.volume[families.neighbours]
        regular_shape_tensors(cloud, families, weight, "bond-associated gradients")
        centres = families.centres
        radius = self.radius * cloud.local_horizon[centres] * (1.0 + HORIZON_TOLERANCE)
        wider = np.zeros(cloud.n_owned)
        for factor, following in zip(GROWTH, (*GROWTH[1:], None), strict=True):
            size = np.empty(len(centres), dtype=np.int64)
            bond_family_sizes_kernel(cloud.dim)(families.indptr, families.neighbours, cloud.x, radius, size)
            point_ptr = starts_of(size)
            bonds = np.empty(point_ptr[-1], dtype=np.int64)
            fill = bond_families_kernel(cloud.dim)
            fill(families.indptr, families.neighbours, cloud.x, radius, point_ptr, bonds)
            stencils = with_centres(centres, point_ptr, families.neighbours[bonds], weight[bonds])
            if following is None:
                break
            bad = flat(stencils.shape_tensors(cloud.x), THIN)
            if factor == 1.0:
                wider = np.bincount(centres[bad], minlength=cloud.n_owned).astype(float)
            if not bad.any():
                break
            radius[bad] *= following / factor
        number, every = cloud.counted(wider), cloud.counted(np.diff(families.indptr))
        note = f"{number} of {every} bonds have a wider family, their own is too flat" if number else ""
        return operator(cloud, stencils, note)
