"""Higher-order weights: plain correspondence with an influence whose higher moments vanish."""

from __future__ import annotations

from dataclasses import dataclass
from typing import ClassVar

import numpy as np

from pdpetsc.arrays import Float
from pdpetsc.discrete.cloud import Cloud
from pdpetsc.discrete.families import Families
from pdpetsc.errors import CaseError
from pdpetsc.gradient.base import (
    GradientOperator,
    Scheme,
    correspondence_weights,
    operator,
    regular_shape_tensors,
    whole_families,
)
from pdpetsc.gradient.moments import GAIN, MET, MOST_ORDER, Conditions, blocks, conditioning_note, largest_gain, solve
from pdpetsc.kernels.gradient import inverses


@dataclass(frozen=True)
class HigherOrder(Scheme):
    """Higher-order correspondence: scalar weights ``omega C(xi)`` whose moments of degree 3 to N + 1 vanish.

    ``F_i = I + sum_j omega C_ij V_j eta_ij (x) K_i^-1 xi_ij`` as in plain correspondence and with its shape tensor, but
    the terms of degree 2 to N of a Taylor series of u vanish from the sum. ``C = 1 + c . q(xi)``, with monomials q of
    degrees 2 to N + 1, is as near to 1 as possible. Weights may be negative. If the family is too small for the
    conditions, the particle uses the next lower order. Order 1 is plain correspondence.

    Parameters
    ----------
    order : int
        Degree N of the Taylor series, at least 1. On a symmetric lattice an even order is equal to the odd order below
        it.

    References
    ----------
    Yaghoobi2017, title, abstract and sections 1-2; the conditions on the moments follow from these.

    Examples
    --------
    >>> import pdpetsc as pd
    >>> pd.HigherOrder(order=5)
    HigherOrder(order=5)
    """

    of_family: ClassVar[bool] = True
    horizon_ratio: ClassVar[float] = 3.015

    order: int = 3

    def __post_init__(self) -> None:
        super().__post_init__()
        if not 1 <= self.order <= MOST_ORDER:
            raise CaseError(f"The order of higher-order weights lies between 1 and {MOST_ORDER}, not {self.order}.")

    def build(self, cloud: Cloud, families: Families, omega: Float) -> GradientOperator:
        """Build the gradient operator (collective); raise CaseError if a family is too small or flat."""
        weight = omega * cloud.volume[families.neighbours]
        K = regular_shape_tensors(cloud, families, weight, "higher-order weights")
        xi = families.bonds(cloud.x)
        plain = correspondence_weights(families, cloud.x, weight, inverses(K))
        C = np.ones(len(weight))
        left = np.arange(cloud.n_owned)
        worst, lowered = 1.0, np.zeros(cloud.n_owned)
        for order in range(self.order, 1, -1):
            conditions = Conditions.of_degrees(cloud.dim, 2, order + 1)
            higher = conditions.exponents.sum(axis=1) > 2
            remaining = [left[:0]]
            for part, bonds, first, owner in blocks(families.indptr, left, len(conditions.exponents)):
                q = conditions.values(xi[bonds] / cloud.local_horizon[part][owner][:, None])
                moments = np.add.reduceat(weight[bonds, None] * q, first, axis=0)
                target = np.where(higher, -moments, 0.0)[:, :, None]
                c, unmet, condition = solve(q, weight[bonds], first, target)
                size = np.abs(moments).max(axis=1)
                correction = 1.0 + np.einsum("bq,bqm->b", q, c[owner])
                met = unmet * np.abs(target).max(axis=(1, 2)) <= MET * size
                met &= largest_gain(plain[bonds] * correction[:, None], first, cloud.local_horizon[part]) <= GAIN
                remaining.append(part[~met])
                worst = max(worst, float(condition[met].max(initial=1.0)))
                C[bonds] = np.where(met[owner], correction, 1.0)
            left = np.concatenate(remaining)
            lowered[left] += 1.0
        note = conditioning_note(cloud, worst, lowered)
        return operator(cloud, whole_families(cloud, families, C * weight), note)
