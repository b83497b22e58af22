"""Plain correspondence: one gradient point per particle over its whole family."""

from __future__ import annotations

from dataclasses import dataclass
from typing import ClassVar

import numpy as np

from pdpetsc.arrays import Float
from pdpetsc.discrete.cloud import Cloud
from pdpetsc.discrete.families import Families
from pdpetsc.gradient.base import GradientOperator, Scheme, flat, operator, refuse_flat, whole_families
from pdpetsc.gradient.broken_lattice import BrokenLatticeGradient
from pdpetsc.gradient.shared_steps import shared_steps
from pdpetsc.kernels.gradient import inverses

# Name in messages.
NAME = "plain correspondence"


@dataclass(frozen=True)
class Correspondence(Scheme):
    """Plain correspondence, ``F_i = I + sum_j omega V_j eta_ij (x) K_i^-1 xi_ij``.

    Displacements that alternate from particle to particle cancel in the sum and have no energy. Add a zero-energy
    control or use another scheme if the load can excite them.

    References
    ----------
    Silling2007, section 18; Hashim, Eq. (16).

    Examples
    --------
    >>> import pdpetsc as pd
    >>> scheme, control = pd.Correspondence(), pd.Silling(G=0.5)
    """

    of_family: ClassVar[bool] = True

    def memory(self, dim: int, family: float) -> float:
        """Return the memory of the weights of a bond on a lattice, which lists no gradients [bytes]."""
        return 16.0

    def build(self, cloud: Cloud, families: Families, omega: Float) -> GradientOperator:
        """Build the gradient operator (collective); raise CaseError if a family is too small or flat."""
        weight = families.weights(omega, cloud.volume)
        steps = shared_steps(families, weight)
        if steps is None:
            stencils = whole_families(cloud, families, weight)
            refuse_flat(cloud, np.flatnonzero(flat(stencils.shape_tensors(cloud.x))), NAME)
            return operator(cloud, stencils)
        K = steps.shape_tensors()
        refuse_flat(cloud, np.flatnonzero(flat(K)), NAME)
        return BrokenLatticeGradient(cloud, families, steps, inverses(K), cloud.volume[: cloud.n_owned].copy())
