"""Corrected gradients: exact for polynomials up to a given degree."""

from __future__ import annotations

from dataclasses import dataclass
from typing import ClassVar

import numpy as np

from pdpetsc.arrays import Float
from pdpetsc.discrete.cloud import Cloud
from pdpetsc.discrete.families import Families
from pdpetsc.errors import CaseError
from pdpetsc.gradient.base import GradientOperator, Scheme, from_bond_weights, refuse_flat
from pdpetsc.gradient.moments import GAIN, MET, MOST_ORDER, Conditions, blocks, conditioning_note, largest_gain, solve


@dataclass(frozen=True)
class Corrected(Scheme):
    """Corrected gradient of order N, ``g_ij = omega V_j (c_i . q(xi_ij))`` with all monomials q of degrees 1 to N.

    The coefficients make the gradient exact for polynomials of degree N (order 1 is plain correspondence):
    ``sum_j g_ij q(xi_ij)`` is 1 for the linear monomial of its component and 0 for every other. The moment matrix is
    scaled by the horizon, and its near-zero eigenvalues are dropped. If a condition then fails, or the weights nearly
    cancel, the particle uses the next lower order.

    Parameters
    ----------
    order : int
        Degree N, at least 1; order N requires about N / 2 shells of neighbours.

    References
    ----------
    Chowdhury2018, section 3, Eq. (8)-(15), there in one dimension.

    Examples
    --------
    >>> import pdpetsc as pd
    >>> pd.Corrected(order=3)
    Corrected(order=3)
    """

    of_family: ClassVar[bool] = True

    order: int = 2

    def __post_init__(self) -> None:
        super().__post_init__()
        if not 1 <= self.order <= MOST_ORDER:
            raise CaseError(f"The order of a corrected gradient lies between 1 and {MOST_ORDER}, not {self.order}.")

    def build(self, cloud: Cloud, families: Families, omega: Float) -> GradientOperator:
        """Build the gradient operator (collective); raise CaseError if a family is too small or flat."""
        weight = omega * cloud.volume[families.neighbours]
        reach = cloud.local_horizon[families.centres]
        xi = families.bonds(cloud.x) / reach[:, None]
        g = np.zeros((len(weight), cloud.dim))
        left = np.flatnonzero(np.diff(families.indptr) > 0)
        alone = np.flatnonzero(np.diff(families.indptr) == 0)
        worst, lowered = 1.0, np.zeros(cloud.n_owned)
        for order in range(self.order, 0, -1):
            conditions = Conditions.of_degrees(cloud.dim, 1, order)
            target = np.eye(len(conditions.exponents), cloud.dim)
            remaining = [alone[:0]]
            for part, bonds, first, owner in blocks(families.indptr, left, len(conditions.exponents)):
                q = conditions.values(xi[bonds])
                c, unmet, condition = solve(
                    q, weight[bonds], first, np.broadcast_to(target, (len(part), *target.shape))
                )
                g[bonds] = np.einsum("bq,bqm->bm", q, c[owner]) * weight[bonds, None] / reach[bonds, None]
                met = unmet <= MET
                if order > 1:
                    met &= largest_gain(g[bonds], first, cloud.local_horizon[part]) <= GAIN
                remaining.append(part[~met])
                worst = max(worst, float(condition[met].max(initial=1.0)))
            left = np.concatenate(remaining)
            lowered[left] += order > 1
        failed = np.concatenate([left, alone])
        refuse_flat(cloud, failed, "a corrected gradient")
        return from_bond_weights(cloud, families, g, conditioning_note(cloud, worst, lowered))
