"""Closed parts of energies: the energy that a closed crack retains."""

from __future__ import annotations

from abc import abstractmethod
from collections.abc import Callable
from dataclasses import dataclass, field
from typing import ClassVar, Literal, NamedTuple

import numpy as np

from pdpetsc.arrays import Float, GlobalIndex
from pdpetsc.kernels.logarithmic import Trial, stress, tangent, trial
from pdpetsc.kernels.of_strain import strain_loops
from pdpetsc.kernels.principal_rows import symmetric_axes
from pdpetsc.material.base import ElasticMaterial, PointKernels
from pdpetsc.material.logarithmic import shear_factors


class Principal(NamedTuple):
    """An energy in principal strains: its value (n,), gradient (n, k) and second derivative (n, k, k) [stress]."""

    psi: Float
    stress: Float
    moduli: Float


@dataclass(frozen=True)
class ClosedPart(ElasticMaterial):
    """A law with the closed part of the energy of an isotropic material.

    Parameters
    ----------
    E, nu, plane
        Constants of the material.
    closed : callable
        Returns the closed part, a ``Principal``, for principal strains (n, k), lambda and mu.
    """

    closed: Callable[[Float, float, float], Principal] = field(kw_only=True)

    def kernels(self, dim: int) -> PointKernels:

        def write(quantity: Callable[[Float, Principal], Float]) -> Callable[..., None]:
            def loop(F: Float, select: GlobalIndex, constants: Float, result: Float) -> None:
                part = F[select]
                result[select] = quantity(part, self.principal(part, dim))

            return loop

        return PointKernels(write(self._stress), write(self._tangent), write(lambda F, principal: principal.psi))

    def principal(self, F: Float, dim: int) -> Principal:
        """Return the closed part for the principal strains of F (n, dim, dim)."""
        strain = self._axes(F)[0]
        if dim == 2 and self.plane == "strain":
            strain = np.pad(strain, ((0, 0), (0, 1)))
        return self.closed(strain, *self.lame(dim))

    def open_share(self, dim: int) -> float:
        """Return the open share of the energy in uniaxial tension [-]."""
        k = 3 if self.kind(dim) in ("solid", "strain") else dim
        strain = np.array([[1.0, -self.nu, -self.nu]])[:, :k]
        return 1.0 - float(self.closed(strain, *self.lame(dim)).psi[0]) / (0.5 * self.E)

    def out_of_plane_stress(self, F: Float, history: Float, dt: float = 0.0) -> Float:
        """Return the third principal stress (n,) [stress] of a body in plane strain."""
        return self.principal(F, 2).stress[:, 2]

    def volumetric_strain(self, F: Float) -> Float:
        """Return the trace of the strain."""
        return np.asarray(self._axes(F)[0].sum(axis=1))

    def thickness_stretch(self, F: Float) -> Float:
        """Return 1: the law of the intact material determines the thickness."""
        return np.ones(len(F))

    @abstractmethod
    def _axes(self, F: Float) -> tuple[Float, Float]:
        """Return principal strains (n, dim) and their directions, columns of (n, dim, dim)."""

    @abstractmethod
    def _stress(self, F: Float, principal: Principal) -> Float:
        """Return P (n, dim, dim)."""

    @abstractmethod
    def _tangent(self, F: Float, principal: Principal) -> Float:
        """Return dP/dF (n, dim, dim, dim, dim)."""


class _OfStrain(ClosedPart):
    """A law of a symmetric strain; derived classes transform stress and moduli to F."""

    def _of_strain(self, F: Float, principal: Principal) -> Float:
        """Return ``S = dpsi/dE`` (n, dim, dim)."""
        S = np.empty_like(F)
        strain_loops(F.shape[-1]).stress(principal.stress, self._axes(F)[1], S)
        return S

    def _by_strain(self, F: Float, principal: Principal) -> Float:
        """Return ``dS/dE`` (n, dim, dim, dim, dim)."""
        strain, N = self._axes(F)
        dim = F.shape[-1]
        C = np.empty((len(F), *(dim,) * 4))
        shear = shear_factors(strain, principal.stress, principal.moduli, dim)
        strain_loops(dim).tangent(principal.moduli, shear, N, C)
        return C


class SmallClosed(_OfStrain):
    """Closed part for the small strain ``sym(F - I)``."""

    strain_measure: ClassVar[Literal["small"]] = "small"

    def _axes(self, F: Float) -> tuple[Float, Float]:
        return symmetric_axes(0.5 * (F + F.transpose(0, 2, 1)) - np.eye(F.shape[-1]))

    def _stress(self, F: Float, principal: Principal) -> Float:
        return self._of_strain(F, principal)

    def _tangent(self, F: Float, principal: Principal) -> Float:
        return self._by_strain(F, principal)


class GreenClosed(_OfStrain):
    """Closed part for Green's strain ``(F^T F - I) / 2``."""

    def _axes(self, F: Float) -> tuple[Float, Float]:
        return symmetric_axes(0.5 * (np.einsum("pki,pkj->pij", F, F) - np.eye(F.shape[-1])))

    def _stress(self, F: Float, principal: Principal) -> Float:
        return np.asarray(F @ self._of_strain(F, principal))

    def _tangent(self, F: Float, principal: Principal) -> Float:
        S, C = self._of_strain(F, principal), self._by_strain(F, principal)
        A = np.einsum("pia,pambn,pkb->pimkn", F, C, F, optimize=True)
        return np.asarray(A + np.einsum("ik,pmn->pimkn", np.eye(F.shape[-1]), S))


class LogarithmicClosed(ClosedPart):
    """Closed part for the logarithmic strain."""

    def _axes(self, F: Float) -> tuple[Float, Float]:
        found = _trial(F)
        return found.strain[:, : F.shape[-1]], found.M

    def _stress(self, F: Float, principal: Principal) -> Float:
        P = np.empty_like(F)
        stress(np.arange(len(F)), principal.stress, _trial(F), P)
        return P

    def _tangent(self, F: Float, principal: Principal) -> Float:
        found, dim = _trial(F), F.shape[-1]
        A = np.empty((len(F), *(dim,) * 4))
        shear = shear_factors(found.strain[:, : principal.stress.shape[1]], principal.stress, principal.moduli, dim)
        tangent(np.arange(len(F)), principal.stress, principal.moduli, shear, found, A)
        return A


def _trial(F: Float) -> Trial:
    return trial(np.ascontiguousarray(F), np.arange(len(F)), np.empty((len(F), 0)))
