"""The part of an energy that a closed crack keeps, as a law of its own."""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Callable
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np

from pdpetsc.arrays import Float, GlobalIndex
from pdpetsc.declared import Declared
from pdpetsc.errors import CaseError
from pdpetsc.kernels.logarithmic import logarithmic_loops
from pdpetsc.material.base import ElasticMaterial, IsotropicMaterial, Material, PointKernels
from pdpetsc.material.logarithmic import shear_factors


class Principal(NamedTuple):
    """An energy in principal strains: its value (n,), gradient (n, k) and second derivative (n, k, k) [stress]."""

    psi: Float
    stress: Float
    moduli: Float


@dataclass(frozen=True)
class Split(Declared, ABC):
    """How the energy of a point divides into what a crack takes and what it keeps when it closes.

    It is made for an isotropic energy ``lambda / 2 (tr eps)^2 + mu eps : eps`` of the strain of the material. A plane
    body without stress across it counts with its strains in the plane and the moduli of plane stress.
    """

    # Whether only materials with such an energy can have it.
    exact = True

    def closed_part(self, material: Material) -> ClosedPart | None:
        """Return the law of what a closed crack keeps, None for nothing.

        Raises
        ------
        CaseError
            The material has another energy.
        """
        measure = material.strain_measure
        if (measure is None and self.exact) or not isinstance(material, IsotropicMaterial):
            raise CaseError(
                f"{type(self).__name__} splits an isotropic energy of a strain, as that of LinearElastic, Hencky or "
                f"SaintVenantKirchhoff, and {type(material).__name__} has another; take split=pd.split.Volumetric() "
                f"where the material is isotropic, or pd.split.Whole()."
            )
        laws: dict[str | None, type[ClosedPart]]
        laws = {None: LogarithmicClosed, "logarithmic": LogarithmicClosed, "small": SmallClosed, "green": GreenClosed}
        return laws[measure](material.E, material.nu, material.plane, self)

    @abstractmethod
    def closed(self, strain: Float, lam: float, mu: float) -> Principal:
        """Return the energy of the closed crack in principal strains (n, k) [-], for moduli [stress]."""


@dataclass(frozen=True)
class Whole(Split):
    """Nothing is kept: a crack that closes has no stress either.

    Examples
    --------
    >>> import pdpetsc as pd
    >>> damage = pd.PointDamage(pd.softening.Linear(), Gc=0.1, strength=3.0, split=pd.split.Whole())
    """

    def closed_part(self, material: Material) -> None:
        """Return None, for every material."""
        return

    def closed(self, strain: Float, lam: float, mu: float) -> Principal:
        """Return zeros."""
        n, k = strain.shape
        return Principal(np.zeros(n), np.zeros((n, k)), np.zeros((n, k, k)))


@dataclass(frozen=True)
class Volumetric(Split):
    """``K / 2 <tr eps>-^2`` is kept: the pressure of volumes that shrink, and no shear.

    The trace is that of the logarithmic strain in materials that have none of their own.

    References
    ----------
    Amor2009, section 3.2.
    """

    exact = False

    def closed(self, strain: Float, lam: float, mu: float) -> Principal:
        """Return the energy of the negative trace."""
        k = strain.shape[1]
        trace = np.minimum(strain.sum(axis=1), 0.0)
        K = lam + 2.0 * mu / k
        moduli = np.where(trace < 0.0, K, 0.0)[:, None, None] * np.ones((k, k))
        return Principal(0.5 * K * trace**2, np.repeat(K * trace[:, None], k, axis=1), moduli)


@dataclass(frozen=True)
class Spectral(Split):
    """``lambda / 2 <tr eps>-^2 + mu sum <eps_a>-^2`` is kept, of the negative principal strains.

    References
    ----------
    Miehe2010, section 2.
    """

    def closed(self, strain: Float, lam: float, mu: float) -> Principal:
        """Return the energy of negative strains."""
        k = strain.shape[1]
        trace, part = np.minimum(strain.sum(axis=1), 0.0), np.minimum(strain, 0.0)
        moduli = np.where(trace < 0.0, lam, 0.0)[:, None, None] * np.ones((k, k))
        moduli = moduli + 2.0 * mu * np.eye(k) * (part < 0.0)[:, None, :]
        psi = 0.5 * lam * trace**2 + mu * (part**2).sum(axis=1)
        return Principal(psi, lam * trace[:, None] + 2.0 * mu * part, moduli)


@dataclass(frozen=True)
class NoTension(Split):
    """What a material without tensile strength stores is kept: ``min psi(eps - p)`` over strains p of open cracks.

    Cracks open along the largest principal strains, as many as it takes until no principal stress is tensile.

    References
    ----------
    FreddiRoyerCarfagni2010, section 3; DelPiero1989.
    """

    def closed(self, strain: Float, lam: float, mu: float) -> Principal:
        """Return the energy of the compressive stresses that are left."""
        n, k = strain.shape
        order = np.argsort(-strain, axis=1, kind="stable")
        eps = np.take_along_axis(strain, order, axis=1)
        psi, stress, moduli = np.zeros(n), np.zeros((n, k)), np.zeros((n, k, k))
        found = np.zeros(n, dtype=bool)
        stiff = lam
        for free in range(k):
            # With so many cracks open the others have the stiffness of a body whose stress vanishes across them.
            left = eps[:, free:]
            tau = stiff * left.sum(axis=1)[:, None] + 2.0 * mu * left
            here = ~found & (tau[:, 0] <= 0.0)
            psi[here] = 0.5 * (tau * left).sum(axis=1)[here]
            stress[here, free:] = tau[here]
            moduli[here, free:, free:] = stiff + 2.0 * mu * np.eye(k - free)
            found |= here
            stiff = 2.0 * mu * stiff / (stiff + 2.0 * mu)
        back = np.argsort(order, axis=1)
        moduli = np.take_along_axis(np.take_along_axis(moduli, back[:, :, None], 1), back[:, None, :], 2)
        return Principal(psi, np.take_along_axis(stress, back, axis=1), moduli)


@dataclass(frozen=True)
class ClosedPart(ElasticMaterial):
    """A law whose energy is what a closed crack keeps of that of an isotropic material.

    Parameters
    ----------
    E, nu, plane
        As of the material.
    split : Split
        What is kept.
    """

    split: Split = Whole()

    def kernels(self, dim: int) -> PointKernels:
        """Return loops in numpy."""

        def write(quantity: Callable[[Float, Principal], Float]) -> Callable[..., None]:
            def loop(F: Float, select: GlobalIndex, constants: Float, result: Float) -> None:
                part = F[select]
                result[select] = quantity(part, self.principal(part, dim))

            return loop

        return PointKernels(write(self._stress), write(self._tangent), write(lambda F, kept: kept.psi))

    def principal(self, F: Float, dim: int) -> Principal:
        """Return the energy that is kept in the principal strains of F (n, dim, dim)."""
        strain = self._axes(F)[0]
        if dim == 2 and self.plane == "strain":
            strain = np.pad(strain, ((0, 0), (0, 1)))
        return self.split.closed(strain, *self.lame(dim))

    def open_share(self, dim: int) -> float:
        """Return which share of its energy a body in uniaxial tension loses with a crack [-]."""
        k = 3 if self.kind(dim) in ("solid", "strain") else dim
        strain = np.array([[1.0, -self.nu, -self.nu]])[:, :k]
        return 1.0 - float(self.split.closed(strain, *self.lame(dim)).psi[0]) / (0.5 * self.E)

    def out_of_plane_stress(self, F: Float, history: Float, dt: float = 0.0) -> Float:
        """Return the third principal stress (n,) [stress] of a body in plane strain."""
        return self.principal(F, 2).stress[:, 2]

    def volumetric_strain(self, F: Float) -> Float:
        """Return the trace of the strain."""
        return np.asarray(self._axes(F)[0].sum(axis=1))

    def thickness_stretch(self, F: Float) -> Float:
        """Return 1: the law of what is whole gives the thickness."""
        return np.ones(len(F))

    @abstractmethod
    def _axes(self, F: Float) -> tuple[Float, Float]:
        """Return principal strains (n, dim) and their directions, columns of (n, dim, dim)."""

    @abstractmethod
    def _stress(self, F: Float, kept: Principal) -> Float:
        """Return P (n, dim, dim)."""

    @abstractmethod
    def _tangent(self, F: Float, kept: Principal) -> Float:
        """Return dP/dF (n, dim, dim, dim, dim)."""


class _OfStrain(ClosedPart):
    """A law of a symmetric strain: its stress and moduli are those of the strain, brought to F by a derived class."""

    def _of_strain(self, F: Float, kept: Principal) -> tuple[Float, Float]:
        """Return ``S = dpsi/dE`` (n, dim, dim) and ``dS/dE`` (n, dim, dim, dim, dim)."""
        strain, N = self._axes(F)
        dim = F.shape[-1]
        S = np.einsum("pa,pia,pja->pij", kept.stress[:, :dim], N, N)
        shear = shear_factors(strain, kept.stress, kept.moduli, dim)
        C = np.einsum("pab,pia,pma,pkb,pnb->pimkn", kept.moduli[:, :dim, :dim], N, N, N, N)
        C += 0.5 * np.einsum("pab,pia,pmb,pka,pnb->pimkn", shear, N, N, N, N)
        C += 0.5 * np.einsum("pab,pia,pmb,pkb,pna->pimkn", shear, N, N, N, N)
        return S, C


class SmallClosed(_OfStrain):
    """Of the small strain ``sym(F - I)``."""

    def _axes(self, F: Float) -> tuple[Float, Float]:
        return np.linalg.eigh(0.5 * (F + F.transpose(0, 2, 1)) - np.eye(F.shape[-1]))

    def _stress(self, F: Float, kept: Principal) -> Float:
        return self._of_strain(F, kept)[0]

    def _tangent(self, F: Float, kept: Principal) -> Float:
        return self._of_strain(F, kept)[1]


class GreenClosed(_OfStrain):
    """Of Green's strain ``(F^T F - I) / 2``."""

    def _axes(self, F: Float) -> tuple[Float, Float]:
        return np.linalg.eigh(0.5 * (np.einsum("pki,pkj->pij", F, F) - np.eye(F.shape[-1])))

    def _stress(self, F: Float, kept: Principal) -> Float:
        return np.asarray(F @ self._of_strain(F, kept)[0])

    def _tangent(self, F: Float, kept: Principal) -> Float:
        S, C = self._of_strain(F, kept)
        A = np.einsum("pia,pambn,pkb->pimkn", F, C, F, optimize=True)
        return np.asarray(A + np.einsum("ik,pmn->pimkn", np.eye(F.shape[-1]), S))


class LogarithmicClosed(ClosedPart):
    """Of the logarithmic strain."""

    def _axes(self, F: Float) -> tuple[Float, Float]:
        _, _, strain, _, N, _ = _frame(F)
        return strain[:, : F.shape[-1]], N

    def _stress(self, F: Float, kept: Principal) -> Float:
        P = np.empty_like(F)
        select, history, _, stretch, N, n = _frame(F)
        logarithmic_loops(F.shape[-1]).stress(select, history, kept.stress, stretch, N, n, P)
        return P

    def _tangent(self, F: Float, kept: Principal) -> Float:
        dim = F.shape[-1]
        A = np.empty((len(F), *(dim,) * 4))
        select, history, strain, stretch, N, n = _frame(F)
        shear = shear_factors(strain[:, : kept.stress.shape[1]], kept.stress, kept.moduli, dim)
        moduli = np.ascontiguousarray(kept.moduli[:, :dim, :dim])
        logarithmic_loops(dim).tangent(select, history, kept.stress, moduli, shear, stretch, N, n, A)
        return A


def _frame(F: Float) -> tuple[GlobalIndex, Float, Float, Float, Float, Float]:
    """Return points, inverse plastic parts, strains (n, 3), stretches and both sets of principal directions."""
    n, dim = len(F), F.shape[-1]
    select, history = np.arange(n), np.tile(np.eye(dim).ravel(), (n, 1))
    found = np.empty((n, 3)), np.empty((n, dim)), np.empty((n, dim, dim)), np.empty((n, dim, dim))
    logarithmic_loops(dim).trial(np.ascontiguousarray(F), select, history, *found)
    return select, history, *found
