"""Hencky hyperelasticity: Kirchhoff stress linear in logarithmic strain."""

from __future__ import annotations

from dataclasses import dataclass
from typing import ClassVar, Literal

import numpy as np

from pdpetsc.arrays import Float
from pdpetsc.kernels.compile import compiled
from pdpetsc.kernels.principal_rows import BLOCK, new_frame, open_frame, write_stress, write_tangent
from pdpetsc.material.base import ElasticMaterial, PointKernels


@dataclass(frozen=True)
class Hencky(ElasticMaterial):
    r"""Hencky material, ``tau = lambda tr(eps) I + 2 mu eps`` with ``eps = 1/2 ln(F F^T)``.

    ``psi = lambda / 2 (tr eps)^2 + mu eps : eps``, ``P = tau F^-T``; the tangent is that of
    ``kernels.principal_rows`` with moduli ``lambda + 2 mu delta_ab``.

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
        return PointKernels(_stress, _tangent, _energy)

    def volumetric_strain(self, F: Float) -> Float:
        """Return ``ln J``."""
        return np.asarray(np.log(np.linalg.det(F)))

    def thickness_stretch(self, F: Float) -> Float:
        """Return ``exp(-c ln det F)``: the hidden logarithmic strain of the linear law."""
        return np.asarray(np.linalg.det(F) ** -self.lateral_strain_ratio(F.shape[-1]))


@compiled
def _stress(F, select, constants, P):  # type: ignore[no-untyped-def]
    lam, mu, none, frame = constants[0], constants[1], np.empty((0, 0)), new_frame(F.shape[1])
    trace = np.empty(BLOCK)
    for first in range(0, select.size, BLOCK):
        points = select[first : first + BLOCK]
        open_frame(F, points, none, frame)
        _kirchhoff(frame, lam, mu, trace, points.size)
        write_stress(frame.strain, points, frame, P)


@compiled
def _tangent(F, select, constants, A):  # type: ignore[no-untyped-def]
    lam, mu, none, frame = constants[0], constants[1], np.empty((0, 0)), new_frame(F.shape[1])
    trace, moduli, shear = np.empty(BLOCK), np.empty_like(frame.H), np.full_like(frame.H, 2.0 * mu)
    for first in range(0, select.size, BLOCK):
        points = select[first : first + BLOCK]
        open_frame(F, points, none, frame)
        _kirchhoff(frame, lam, mu, trace, points.size)
        moduli[:] = lam
        for a in range(F.shape[1]):
            moduli[a, a] = lam + 2.0 * mu
        write_tangent(frame.strain, moduli, shear, points, frame, A)


@compiled
def _kirchhoff(frame, lam, mu, trace, n):  # type: ignore[no-untyped-def]
    """Turn logarithmic strains into principal Kirchhoff stresses."""
    dim = frame.stretch.shape[0]
    trace[:n] = 0.0
    for a in range(dim):
        e = frame.strain[a]
        for r in range(n):
            trace[r] += e[r]
    for a in range(dim):
        e = frame.strain[a]
        for r in range(n):
            e[r] = lam * trace[r] + 2.0 * mu * e[r]


@compiled
def _energy(F, select, constants, psi):  # type: ignore[no-untyped-def]
    lam, mu, none, frame = constants[0], constants[1], np.empty((0, 0)), new_frame(F.shape[1])
    for first in range(0, select.size, BLOCK):
        points = select[first : first + BLOCK]
        open_frame(F, points, none, frame)
        one, two, three = frame.strain
        for r in range(points.size):
            trace, square = one[r] + two[r] + three[r], one[r] ** 2 + two[r] ** 2 + three[r] ** 2
            psi[points[r]] = 0.5 * lam * trace * trace + mu * square
