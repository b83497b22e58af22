"""Compressible neo-Hookean material."""

from __future__ import annotations

from dataclasses import dataclass
from functools import lru_cache

import numpy as np

from pdpetsc.arrays import Float
from pdpetsc.kernels.compile import compiled
from pdpetsc.kernels.principal import inverse
from pdpetsc.material.base import ElasticMaterial, PointKernels

# Largest number of Newton iterations for the lateral stretch, and tolerance of its logarithm.
NEWTON_STEPS, NEARLY = 60, 1e-9


@dataclass(frozen=True)
class NeoHookean(ElasticMaterial):
    r"""Neo-Hookean material, ``psi = mu / 2 (I_1 - 3 - 2 ln J) + lambda / 2 (ln J)^2``.

    F does not contain the lateral stretches ``b``: h = 1 in plane stress, h = 2 equal stretches in a bar. They follow
    from zero lateral stress, ``mu (b^2 - 1) + lambda (ln det F + h ln b) = 0``, and the tangent is condensed::

        P = mu (F - F^-T) + lambda ln J F^-T,                 J = det F b^h
        A = mu I + (mu - lambda ln J) F^-T (x) F^-1 + lambda_c F^-T (x) F^-T
        lambda_c = 2 lambda mu b^2 / (2 mu b^2 + h lambda)

    Parameters
    ----------
    E, nu, plane
        Young's modulus [stress], Poisson's ratio [-], and ``"strain"`` or ``"stress"`` for plane strain or stress, as
        for every ``Material``.

    References
    ----------
    Bonet2008, section 6.4.3.

    Examples
    --------
    >>> import pdpetsc as pd
    >>> rubber = pd.NeoHookean(E=1.0, nu=0.45, plane="stress")
    """

    def kernels(self, dim: int) -> PointKernels:
        """Return the compiled loops for dimension ``dim``."""
        return _kernels(dim)

    def constants(self, dim: int) -> Float:
        """Return ``lambda``, ``mu`` of the solid and the number of hidden lateral stretches."""
        hidden = 2 if dim == 1 else int(dim == 2 and self.plane == "stress")
        return np.array([*self.lame(3), hidden])

    def volumetric_strain(self, F: Float) -> Float:
        """Return ``ln J``."""
        return np.asarray(np.log(np.linalg.det(F)))

    def thickness_stretch(self, F: Float) -> Float:
        """Return ``b^h``."""
        lam, mu, hidden = self.constants(F.shape[-1])
        logs = np.log(np.linalg.det(F))
        b = np.array([lateral_stretch(lam, mu, hidden, value) for value in logs])
        return np.asarray(b**hidden)


@compiled
def lateral_stretch(lam, mu, hidden, log_det):  # type: ignore[no-untyped-def]
    """Solve ``mu (b^2 - 1) + lambda (log_det + hidden ln b) = 0`` for ``b`` by Newton's method in ``ln b``.

    The function of ``ln b`` is increasing and convex if lambda is not negative, so Newton converges from any start. NaN
    if it does not: with a negative Poisson's ratio there is no such stretch in strong compression.
    """
    if hidden == 0:
        return 1.0
    s, change = 0.0, np.inf
    for _ in range(NEWTON_STEPS):
        square = np.exp(2.0 * s)
        change = (mu * (square - 1.0) + lam * (log_det + hidden * s)) / (2.0 * mu * square + lam * hidden)
        s -= change
        if abs(change) < 1e-15:
            break
    return np.exp(s) if abs(change) < NEARLY else np.nan


@lru_cache
def _kernels(dim: int) -> PointKernels:
    @compiled
    def stress(F, select, constants, P):  # type: ignore[no-untyped-def]
        lam, mu, hidden = constants[0], constants[1], constants[2]
        G = np.empty((dim, dim))
        for p in select:
            log_det = np.log(inverse(F[p], dim, G))
            log_J = log_det + hidden * np.log(lateral_stretch(lam, mu, hidden, log_det))
            for i in range(dim):
                for j in range(dim):
                    P[p, i, j] = mu * F[p, i, j] + (lam * log_J - mu) * G[j, i]

    @compiled
    def tangent(F, select, constants, A):  # type: ignore[no-untyped-def]
        lam, mu, hidden = constants[0], constants[1], constants[2]
        G = np.empty((dim, dim))
        for p in select:
            log_det = np.log(inverse(F[p], dim, G))
            b = lateral_stretch(lam, mu, hidden, log_det)
            log_J = log_det + hidden * np.log(b)
            condensed = 2.0 * lam * mu * b * b / (2.0 * mu * b * b + hidden * lam)
            for i in range(dim):
                for m in range(dim):
                    for k in range(dim):
                        for n in range(dim):
                            value = condensed * G[m, i] * G[n, k] + (mu - lam * log_J) * G[n, i] * G[m, k]
                            if i == k and m == n:
                                value += mu
                            A[p, i, m, k, n] = value

    @compiled
    def energy(F, select, constants, psi):  # type: ignore[no-untyped-def]
        lam, mu, hidden = constants[0], constants[1], constants[2]
        G = np.empty((dim, dim))
        for p in select:
            log_det = np.log(inverse(F[p], dim, G))
            b = lateral_stretch(lam, mu, hidden, log_det)
            log_J = log_det + hidden * np.log(b)
            square = hidden * (b * b - 1.0) - dim
            for i in range(dim):
                for j in range(dim):
                    square += F[p, i, j] * F[p, i, j]
            psi[p] = 0.5 * mu * (square - 2.0 * log_J) + 0.5 * lam * log_J * log_J

    return PointKernels(stress, tangent, energy)
