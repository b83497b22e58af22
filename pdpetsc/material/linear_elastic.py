"""Small-strain linear elasticity."""

from __future__ import annotations

from dataclasses import dataclass
from functools import lru_cache
from typing import ClassVar

import numpy as np

from pdpetsc.arrays import Float
from pdpetsc.kernels.compile import compiled
from pdpetsc.material.base import ElasticMaterial, PointKernels


@dataclass(frozen=True)
class LinearElastic(ElasticMaterial):
    """Linear elastic material at small strain, ``P = lambda tr(eps) I + 2 mu eps``, ``eps = sym(F - I)``.

    Its tangent is constant: the matrix of a body of this material alone is assembled and factored once.

    Parameters
    ----------
    E, nu, plane
        Young's modulus [stress], Poisson's ratio [-], and ``"strain"`` or ``"stress"`` for plane strain or stress, as
        for every ``Material``.

    Examples
    --------
    >>> import pdpetsc as pd
    >>> pd.LinearElastic(E=200.0, nu=0.25).lame(3)
    (80.0, 80.0)
    """

    linear: ClassVar[bool] = True

    def kernels(self, dim: int) -> PointKernels:
        """Return the compiled loops for dimension ``dim``."""
        return _kernels(dim)

    def volumetric_strain(self, F: Float) -> Float:
        """Return ``tr eps``."""
        return np.asarray(np.einsum("pii->p", F) - F.shape[-1])

    def thickness_stretch(self, F: Float) -> Float:
        """Return ``1 + eps_lateral``, twice for a bar, to first order."""
        dim = F.shape[-1]
        stretch: Float = 1.0 - self.lateral_strain_ratio(dim) * (np.einsum("pii->p", F) - dim)
        return stretch


@lru_cache
def _kernels(dim: int) -> PointKernels:
    @compiled
    def stress(F, select, constants, P):  # type: ignore[no-untyped-def]
        lam, mu = constants[0], constants[1]
        for p in select:
            trace = -float(dim)
            for i in range(dim):
                trace += F[p, i, i]
            for i in range(dim):
                for j in range(dim):
                    P[p, i, j] = mu * (F[p, i, j] + F[p, j, i])
                P[p, i, i] += lam * trace - 2.0 * mu

    @compiled
    def tangent(F, select, constants, A):  # type: ignore[no-untyped-def]
        lam, mu = constants[0], constants[1]
        for p in select:
            for i in range(dim):
                for m in range(dim):
                    for k in range(dim):
                        for n in range(dim):
                            value = 0.0
                            if i == m and k == n:
                                value += lam
                            if i == k and m == n:
                                value += mu
                            if i == n and m == k:
                                value += mu
                            A[p, i, m, k, n] = value

    @compiled
    def energy(F, select, constants, psi):  # type: ignore[no-untyped-def]
        lam, mu = constants[0], constants[1]
        for p in select:
            trace = -float(dim)
            square = 0.0
            for i in range(dim):
                trace += F[p, i, i]
                for j in range(dim):
                    strain = 0.5 * (F[p, i, j] + F[p, j, i])
                    if i == j:
                        strain -= 1.0
                    square += strain * strain
            psi[p] = 0.5 * lam * trace * trace + mu * square

    return PointKernels(stress, tangent, energy)
