"""Small-strain linear elasticity."""

from __future__ import annotations

from dataclasses import dataclass
from functools import lru_cache
from typing import ClassVar, Literal

import numpy as np

from pdpetsc.arrays import Float
from pdpetsc.kernels.compile import compiled
from pdpetsc.material.base import HistoryKernels, IsotropicMaterial, remember_nothing


@dataclass(frozen=True)
class LinearElastic(IsotropicMaterial):
    """Linear elastic material at small strain, ``P = lambda tr(eps) I + 2 mu eps``, ``eps = sym(F - I)``.

    Its tangent is constant: the matrix of a body of this material only is assembled and factored once.

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
    strain_measure: ClassVar[Literal["small"]] = "small"

    def constants(self, dim: int) -> Float:
        """Return the stiffness (dim^4)."""
        return self.moduli(dim).ravel()

    def history_kernels(self, dim: int) -> HistoryKernels:
        """Return the compiled loops for dimension ``dim``."""
        return linear_loops(dim)

    def out_of_plane_stress(self, F: Float, history: Float, dt: float = 0.0) -> Float:
        """Return ``P_zz = lambda tr(eps)`` (n,) [stress] in plane strain."""
        return self.lame(2)[0] * np.asarray(np.einsum("pii->p", F) - F.shape[-1])

    def thickness_stretch(self, F: Float) -> Float:
        """Return ``1 + eps_lateral``, twice for a bar, to first order."""
        dim = F.shape[-1]
        return np.asarray(1.0 - self.lateral_strain_ratio(dim) * (np.einsum("pii->p", F) - dim))


@lru_cache
def linear_loops(dim: int) -> HistoryKernels:
    """Return the compiled loops of ``P = C : (F - I)`` for dimension ``dim``.

    ``C`` (dim^4) is the row of a point in ``history``, or ``constants`` if ``history`` has no columns.
    """

    @compiled
    def stress(F, select, constants, history, P):  # type: ignore[no-untyped-def]
        for row in range(select.size):
            p = select[row]
            C = history[row] if history.shape[1] > 0 else constants
            for i in range(dim):
                for m in range(dim):
                    value = 0.0
                    for k in range(dim):
                        for n in range(dim):
                            one = 1.0 if k == n else 0.0
                            value += C[((i * dim + m) * dim + k) * dim + n] * (F[p, k, n] - one)
                    P[p, i, m] = value

    @compiled
    def tangent(F, select, constants, history, A):  # type: ignore[no-untyped-def]
        for row in range(select.size):
            p = select[row]
            C = history[row] if history.shape[1] > 0 else constants
            for i in range(dim):
                for m in range(dim):
                    for k in range(dim):
                        for n in range(dim):
                            A[p, i, m, k, n] = C[((i * dim + m) * dim + k) * dim + n]

    @compiled
    def energy(F, select, constants, history, psi):  # type: ignore[no-untyped-def]
        for row in range(select.size):
            p = select[row]
            C = history[row] if history.shape[1] > 0 else constants
            value = 0.0
            for i in range(dim):
                for m in range(dim):
                    left = F[p, i, m] - (1.0 if i == m else 0.0)
                    for k in range(dim):
                        for n in range(dim):
                            right = F[p, k, n] - (1.0 if k == n else 0.0)
                            value += 0.5 * C[((i * dim + m) * dim + k) * dim + n] * left * right
            psi[p] = value

    return HistoryKernels(stress, tangent, energy, remember_nothing)
