"""What every material declares and what a body asks of it."""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Callable
from dataclasses import dataclass
from typing import Annotated, ClassVar, Literal, NamedTuple, TypeAlias

import numpy as np

from pdpetsc.arrays import Float, GlobalIndex
from pdpetsc.declared import Bound, Declared

# What a body shows of a solid: all, a plane without strain or without stress across it, or a line.
Kind = Literal["solid", "strain", "stress", "bar"]

# Moduli outside of these bounds overflow in products, and factorisations of such matrices crash [stress].
LEAST_MODULUS, LARGEST_MODULUS = 1e-100, 1e100
Modulus: TypeAlias = Annotated[
    float, Bound(("a modulus from 1e-100 to 1e+100", "such moduli"), lambda x: LEAST_MODULUS <= x <= LARGEST_MODULUS)
]
PoissonRatio: TypeAlias = Annotated[
    float, Bound(("a number above -1 and below 0.5", "numbers above -1 and below 0.5"), lambda x: -1.0 < x < 0.5)
]


class PointKernels(NamedTuple):
    """Loops over the points ``select`` (int64 indices into F), compiled or plain numpy.

    ``stress(F, select, constants, P)`` and ``tangent(F, select, constants, A)`` write (n, d, d) and (n, d, d, d, d)
    arrays [stress]; ``energy(F, select, constants, psi)`` writes (n,) [energy / volume]. The rows of the results at
    ``select`` are theirs, the others belong to other materials. A material defined for ``det F > 0`` only is never
    called elsewhere: that is checked first.
    """

    stress: Callable[..., None]
    tangent: Callable[..., None]
    energy: Callable[..., None]


class HistoryKernels(NamedTuple):
    """As ``PointKernels``, with ``history`` (len(select), n_history) before the result, which they only read.

    ``commit(F, select, constants, history)`` overwrites the history: it makes the state at F the one that the next step
    starts from. The stress is the derivative of the energy at a given history, stored and lost energy together.
    """

    stress: Callable[..., None]
    tangent: Callable[..., None]
    energy: Callable[..., None]
    commit: Callable[..., None]


class Material(Declared, ABC):
    """A law that gives the stress at a point from the deformation gradient there.

    Attributes
    ----------
    plane : {"strain", "stress"}
        Plane strain or plane stress of a two-dimensional body: no strain or no stress across it.
    """

    plane: Literal["strain", "stress"]

    # Whether the stress is linear in F, so that the tangent is constant.
    linear: ClassVar[bool] = False
    has_history: ClassVar[bool] = False
    # Of which strain its energy is lambda / 2 (tr eps)^2 + mu eps : eps; None for another energy.
    strain_measure: ClassVar[Literal["small", "logarithmic", "green"] | None] = None
    # Whether its local iteration may find no stress, which is NaN then; a step that leads there is cut back.
    may_fail: ClassVar[bool] = False

    def kind(self, dim: int) -> Kind:
        """Return what a body of ``dim`` dimensions shows of the solid."""
        if dim == 2:
            return self.plane
        return "bar" if dim == 1 else "solid"

    @property
    def small_strain(self) -> bool:
        """Return whether its P is the stress of a small strain, which is also the Cauchy stress."""
        return self.linear or self.strain_measure == "small"

    @property
    def symmetric(self) -> bool:
        """Return whether its tangent is symmetric, ``A_imkn = A_knim``."""
        return True

    @property
    def timed(self) -> bool:
        """Return True if it has a ``duration``; the last of its constants is then the time of the step."""
        return self.duration is not None

    @property
    def duration(self) -> float | None:
        """Return the time from step time 0 to 1 [time], which all of a case share; None where rates do not count."""
        return None

    def spread(self, step: float) -> float:
        """Return the error of the stress at the end of a step over which a jump of the strain is spread [-].

        It is a share of the stress of the jump itself; 0 for a material that does not relax.

        Parameters
        ----------
        step : float
            Length of the step, a share of the whole load [-].
        """
        return 0.0

    @abstractmethod
    def history_kernels(self, dim: int) -> HistoryKernels:
        """Return the loops for dimension ``dim``."""

    @abstractmethod
    def constants(self, dim: int) -> Float:
        """Return the constants that the compiled loops read."""

    @abstractmethod
    def moduli(self, dim: int) -> Float:
        """Return ``dP/dF`` at F = I (dim, dim, dim, dim) [stress], with hidden strains where those are free."""

    @abstractmethod
    def young_modulus(self) -> float:
        """Return Young's modulus at small strain [stress].

        Raises
        ------
        CaseError
            The material has another one in every direction.
        """

    @abstractmethod
    def hidden_stretch(self, F: Float, history: Float, dt: float = 0.0) -> Float:
        """Return the product of the stretches that F does not show: out of plane, or lateral of a bar (n,) [-].

        ``dt`` is the time since the last converged step [time], given to laws that are ``timed``.
        """

    @abstractmethod
    def out_of_plane_stress(self, F: Float, history: Float, dt: float = 0.0) -> Float:
        """Return ``P_zz`` (n,) [stress] in plane strain, for ``F`` (n, 2, 2) and ``history`` (n, n_history).

        ``dt`` is as for ``hidden_stretch``.
        """

    def history_at(self, dim: int, x: Float) -> Float:
        """Return what undeformed points of particles at ``x`` (n, dim) keep (n, n_history): nothing by default.

        That is the start of its history, or numbers of the place that its loops read, as the direction of fibres.
        """
        return np.empty((len(x), 0))

    def history_in_space(self, x: Float) -> Float:
        """Return ``history_at`` of a solid for points of a plane body at ``x`` (n, 2), in the plane of x and y."""
        return self.history_at(3, np.pad(x, ((0, 0), (0, 1))))

    def defined(self, F: Float, select: GlobalIndex, history: Float) -> bool:
        """Return whether it has a stress at the points ``select`` of F, whose determinants are positive already."""
        return True

    def plastic_strain(self, history: Float) -> Float:
        """Return the accumulated plastic strain (n,) [-], 0 for a material that does not flow."""
        return np.zeros(len(history))

    def uniform(self) -> Material:
        """Return it without what depends on place, to compile its loops on another body."""
        return self

    def bulk_like_modulus(self, dim: int) -> float:
        """Return ``A_iikk / dim^2`` at F = I [stress], the scale of a zero-energy control."""
        return float(np.einsum("iikk", self.moduli(dim))) / dim**2

    def largest_modulus(self, dim: int) -> float:
        """Return the largest entry of the small-strain stiffness [stress]."""
        return float(np.abs(self.moduli(dim)).max())


@dataclass(frozen=True)
class IsotropicMaterial(Material):
    """A material with Young's modulus and Poisson's ratio.

    Parameters
    ----------
    E : float
        Young's modulus [stress], positive.
    nu : float
        Poisson's ratio [-], between -1 and 0.5, both excluded. A bar in 1D needs it for its lateral stretch only.
    plane : {"strain", "stress"}
        Plane strain or plane stress of a two-dimensional body: no strain or no stress across it.

    Raises
    ------
    CaseError
        A constant is out of range.
    """

    E: Modulus
    nu: PoissonRatio
    plane: Literal["strain", "stress"] = "strain"

    def constants(self, dim: int) -> Float:
        """Return the constants that the compiled loops read."""
        return np.array(self.lame(dim))

    def lame(self, dim: int) -> tuple[float, float]:
        """Return ``(lambda, mu)`` of the ``dim``-dimensional law ``sigma = lambda tr(eps) I + 2 mu eps`` [stress].

        Plane stress has ``lambda = 2 lambda_3 mu / (lambda_3 + 2 mu)``, the uniaxial bar ``lambda = 0, mu = E / 2``.
        """
        if dim == 1:
            return 0.0, 0.5 * self.E
        mu = 0.5 * self.E / (1.0 + self.nu)
        lam = self.E * self.nu / ((1.0 + self.nu) * (1.0 - 2.0 * self.nu))
        if dim == 2 and self.plane == "stress":
            lam = 2.0 * lam * mu / (lam + 2.0 * mu)
        return lam, mu

    def lateral_strain_ratio(self, dim: int) -> float:
        """Return ``c`` in ``eps_lateral_total = -c tr(eps)``: the sum of the hidden strains of the linear law [-]."""
        if dim == 1:
            return 2.0 * self.nu
        return self.nu / (1.0 - self.nu) if dim == 2 and self.plane == "stress" else 0.0

    def bulk_like_modulus(self, dim: int) -> float:
        """Return ``kappa = lambda + 2 mu / dim`` [stress], the scale of a zero-energy control (E in 1D)."""
        lam, mu = self.lame(dim)
        return lam + 2.0 * mu / dim

    @abstractmethod
    def thickness_stretch(self, F: Float) -> Float:
        """Return the product of the stretches that F does not show: out of plane, or lateral of a bar (n,) [-]."""

    def hidden_stretch(self, F: Float, history: Float, dt: float = 0.0) -> Float:
        """Return ``thickness_stretch``."""
        return self.thickness_stretch(F)

    def young_modulus(self) -> float:
        """Return E."""
        return self.E

    def moduli(self, dim: int) -> Float:
        """Return ``lambda delta_im delta_kn + mu (delta_ik delta_mn + delta_in delta_mk)``."""
        return isotropic_moduli(*self.lame(dim), dim)


def isotropic_moduli(lam: float, mu: float, dim: int) -> Float:
    """Return ``lambda delta_im delta_kn + mu (delta_ik delta_mn + delta_in delta_mk)``."""
    one = np.eye(dim)
    symmetric = np.einsum("ik,mn->imkn", one, one) + np.einsum("in,mk->imkn", one, one)
    return np.asarray(lam * np.einsum("im,kn->imkn", one, one) + mu * symmetric)


@dataclass(frozen=True)
class ElasticMaterial(IsotropicMaterial):
    """An isotropic material whose stress depends on F alone."""

    def out_of_plane_stress(self, F: Float, history: Float, dt: float = 0.0) -> Float:
        """Return ``P_zz`` (n,) [stress] of a body in plane strain with ``F`` (n, 2, 2)."""
        return self.lame(2)[0] * self.volumetric_strain(F)

    @abstractmethod
    def volumetric_strain(self, F: Float) -> Float:
        """Return the trace of the strain measure of the law (n,) [-], whose other directions have no strain.

        In plane strain ``P_zz`` is lambda times it, because the strain across the plane vanishes.
        """

    @abstractmethod
    def kernels(self, dim: int) -> PointKernels:
        """Return the loops for dimension ``dim``."""

    def history_kernels(self, dim: int) -> HistoryKernels:
        """Return the loops of ``kernels`` with a history that they do not read."""
        stress, tangent, energy = (_without_history(loop) for loop in self.kernels(dim))
        return HistoryKernels(stress, tangent, energy, remember_nothing)


def _without_history(loop: Callable[..., None]) -> Callable[..., None]:
    def with_history(F: Float, select: GlobalIndex, constants: Float, history: Float, result: Float) -> None:
        loop(F, select, constants, result)

    return with_history


def remember_nothing(F: Float, select: GlobalIndex, constants: Float, history: Float) -> None:
    """Commit nothing: the loop of a law without history."""


@dataclass(frozen=True)
class HistoryMaterial(IsotropicMaterial):
    """An isotropic material whose stress depends on what converged steps left at a point."""

    has_history: ClassVar[bool] = True

    def history_at(self, dim: int, x: Float) -> Float:
        """Return ``initial_history`` of as many points."""
        return self.initial_history(dim, len(x))

    @abstractmethod
    def initial_history(self, dim: int, n: int) -> Float:
        """Return the history of ``n`` undeformed points (n, n_history)."""
