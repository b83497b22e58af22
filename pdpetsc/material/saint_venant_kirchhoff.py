"""Saint Venant-Kirchhoff material: linear in the Green-Lagrange strain."""

from __future__ import annotations

from dataclasses import dataclass
from functools import lru_cache
from typing import ClassVar, Literal

import numpy as np

from pdpetsc.arrays import Float, GlobalIndex
from pdpetsc.kernels.compile import compiled
from pdpetsc.material.base import ElasticMaterial, PointKernels


@dataclass(frozen=True)
class SaintVenantKirchhoff(ElasticMaterial):
    """Saint Venant-Kirchhoff material, ``S = lambda tr(E) I + 2 mu E`` with ``E = (F^T F - I) / 2``.

    ``psi = lambda / 2 (tr E)^2 + mu E : E``, ``P = F S`` and
    ``A_imkn = delta_ik S_mn + lambda F_im F_kn + mu (F_in F_km + delta_mn (F F^T)_ik)``.

    Parameters
    ----------
    E, nu, plane
        Young's modulus [stress], Poisson's ratio [-], and ``"strain"`` or ``"stress"`` for plane strain or stress, as
        for every ``Material``.

    References
    ----------
    Bonet2008, section 6.3.

    Examples
    --------
    >>> import pdpetsc as pd
    >>> pd.SaintVenantKirchhoff(E=1000.0, nu=0.3)
    SaintVenantKirchhoff(E=1000.0, nu=0.3, plane='strain')
    """

    strain_measure: ClassVar[Literal["green"]] = "green"

    def kernels(self, dim: int) -> PointKernels:
        """Return the compiled loops for dimension ``dim``."""
        return _kernels(dim)

    def volumetric_strain(self, F: Float) -> Float:
        """Return ``tr E``."""
        return np.asarray(0.5 * (np.einsum("pij,pij->p", F, F) - F.shape[-1]))

    def thickness_stretch(self, F: Float) -> Float:
        """Return the hidden stretch ``sqrt(1 + 2 E_lateral)``, squared for a bar; NaN if it does not exist."""
        square = self._hidden_square(F)
        with np.errstate(invalid="ignore"):
            return np.where(square > 0.0, square, np.nan) if F.shape[-1] == 1 else np.sqrt(square)

    def defined(self, F: Float, select: GlobalIndex, history: Float) -> bool:
        """Return True if a stress-free hidden stretch exists at the points ``select``.

        The lateral strain decreases with the square of the stretch; the thickness becomes zero at a finite stretch.
        """
        if self.kind(F.shape[-1]) in ("solid", "strain"):
            return True
        return bool(np.all(self._hidden_square(F[select]) > 0.0))

    def _hidden_square(self, F: Float) -> Float:
        """Return ``1 + 2 E_lateral`` (n,) [-], the square of a hidden stretch."""
        dim = F.shape[-1]
        total = -self.lateral_strain_ratio(dim) * self.volumetric_strain(F)
        return np.asarray(1.0 + total * (1.0 if dim == 1 else 2.0))


@compiled
def _second_stress(F, dim, lam, mu, S):  # type: ignore[no-untyped-def]
    """Write the second Piola-Kirchhoff stress to S and return ``tr E``."""
    trace = 0.0
    for i in range(dim):
        for j in range(dim):
            value = -1.0 if i == j else 0.0
            for k in range(dim):
                value += F[k, i] * F[k, j]
            S[i, j] = mu * value
            if i == j:
                trace += 0.5 * value
    for i in range(dim):
        S[i, i] += lam * trace
    return trace


@lru_cache
def _kernels(dim: int) -> PointKernels:
    @compiled
    def stress(F, select, constants, P):  # type: ignore[no-untyped-def]
        S = np.empty((dim, dim))
        for p in select:
            _second_stress(F[p], dim, constants[0], constants[1], S)
            for i in range(dim):
                for j in range(dim):
                    value = 0.0
                    for k in range(dim):
                        value += F[p, i, k] * S[k, j]
                    P[p, i, j] = value

    @compiled
    def tangent(F, select, constants, A):  # type: ignore[no-untyped-def]
        lam, mu = constants[0], constants[1]
        S = np.empty((dim, dim))
        for p in select:
            _second_stress(F[p], dim, lam, mu, S)
            for i in range(dim):
                for k in range(dim):
                    left = 0.0
                    for m in range(dim):
                        left += F[p, i, m] * F[p, k, m]
                    for m in range(dim):
                        for n in range(dim):
                            value = lam * F[p, i, m] * F[p, k, n] + mu * F[p, i, n] * F[p, k, m]
                            if i == k:
                                value += S[m, n]
                            if m == n:
                                value += mu * left
                            A[p, i, m, k, n] = value

    @compiled
    def energy(F, select, constants, psi):  # type: ignore[no-untyped-def]
        lam, mu = constants[0], constants[1]
        S = np.empty((dim, dim))
        for p in select:
            trace = _second_stress(F[p], dim, 0.0, mu, S)
            square = 0.0
            for i in range(dim):
                for j in range(dim):
                    square += S[i, j] * S[i, j]
            psi[p] = 0.5 * lam * trace * trace + square / (4.0 * mu)

    return PointKernels(stress, tangent, energy)
