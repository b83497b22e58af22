"""Hencky hyperelasticity: Kirchhoff stress linear in logarithmic strain."""

from __future__ import annotations

from dataclasses import dataclass
from functools import lru_cache
from typing import ClassVar, Literal

import numpy as np

from pdpetsc.arrays import Float
from pdpetsc.kernels.compile import compiled
from pdpetsc.kernels.principal import principal_tangent, right_axes
from pdpetsc.material.base import ElasticMaterial, PointKernels


@dataclass(frozen=True)
class Hencky(ElasticMaterial):
    r"""Hencky material, ``tau = lambda tr(eps) I + 2 mu eps`` with ``eps = 1/2 ln(F F^T)``.

    ``psi = lambda / 2 (tr eps)^2 + mu eps : eps``, ``P = tau F^-T``; the tangent is that of ``kernels.principal`` with
    moduli ``lambda + 2 mu delta_ab``.

    Parameters
    ----------
    E, nu, plane
        Young's modulus [stress], Poisson's ratio [-], and ``"strain"`` or ``"stress"`` for plane strain or stress, as
        for every ``Material``.

    References
    ----------
    Hashim, Eq. (5)-(8) and Appendix A, with the factor 1/2 that Eq. (5) lacks.

    Examples
    --------
    >>> import pdpetsc as pd
    >>> pd.Hencky(E=1000.0, nu=0.3)
    Hencky(E=1000.0, nu=0.3, plane='strain')
    """

    strain_measure: ClassVar[Literal["logarithmic"]] = "logarithmic"

    def kernels(self, dim: int) -> PointKernels:
        """Return the compiled loops for dimension ``dim``."""
        return _kernels(dim)

    def volumetric_strain(self, F: Float) -> Float:
        """Return ``ln J``."""
        return np.asarray(np.log(np.linalg.det(F)))

    def thickness_stretch(self, F: Float) -> Float:
        """Return ``exp(-c ln det F)``: the hidden logarithmic strain of the linear law."""
        stretch: Float = np.linalg.det(F) ** -self.lateral_strain_ratio(F.shape[-1])
        return stretch


@lru_cache
def _kernels(dim: int) -> PointKernels:
    @compiled
    def stress(F, select, constants, P):  # type: ignore[no-untyped-def]
        lam, mu = constants[0], constants[1]
        C = np.empty((dim, dim))
        N = np.empty((dim, dim))
        S = np.empty((dim, dim))
        squares = np.empty(dim)
        for p in select:
            right_axes(F[p], dim, C, squares, N)
            trace = 0.0
            for a in range(dim):
                trace += 0.5 * np.log(squares[a])
            S[:] = 0.0
            for a in range(dim):
                factor = (lam * trace + mu * np.log(squares[a])) / squares[a]
                for i in range(dim):
                    for j in range(dim):
                        S[i, j] += factor * N[i, a] * N[j, a]
            for i in range(dim):
                for j in range(dim):
                    value = 0.0
                    for k in range(dim):
                        value += F[p, i, k] * S[k, j]
                    P[p, i, j] = value

    @compiled
    def tangent(F, select, constants, A):  # type: ignore[no-untyped-def]
        lam, mu = constants[0], constants[1]
        C = np.empty((dim, dim))
        N = np.empty((dim, dim))
        n = np.empty((dim, dim))
        stretch = np.empty(dim)
        strain = np.empty(dim)
        tau = np.empty(dim)
        moduli = np.full((dim, dim), lam)
        for a in range(dim):
            moduli[a, a] += 2.0 * mu
        shear = np.full((dim, dim), 2.0 * mu)
        for p in select:
            right_axes(F[p], dim, C, stretch, N)
            trace = 0.0
            for a in range(dim):
                strain[a] = 0.5 * np.log(stretch[a])
                stretch[a] = np.sqrt(stretch[a])
                trace += strain[a]
            for a in range(dim):
                tau[a] = lam * trace + 2.0 * mu * strain[a]
                for i in range(dim):
                    value = 0.0
                    for k in range(dim):
                        value += F[p, i, k] * N[k, a]
                    n[i, a] = value / stretch[a]
            principal_tangent(dim, stretch, tau, moduli, shear, n, N, A[p])

    @compiled
    def energy(F, select, constants, psi):  # type: ignore[no-untyped-def]
        lam, mu = constants[0], constants[1]
        C = np.empty((dim, dim))
        N = np.empty((dim, dim))
        squares = np.empty(dim)
        for p in select:
            right_axes(F[p], dim, C, squares, N)
            trace = 0.0
            square = 0.0
            for a in range(dim):
                strain = 0.5 * np.log(squares[a])
                trace += strain
                square += strain * strain
            psi[p] = 0.5 * lam * trace * trace + mu * square

    return PointKernels(stress, tangent, energy)
