"""Interface of materials: declaration, compiled loops and history."""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Callable
from dataclasses import dataclass, field
from typing import Annotated, ClassVar, Literal, NamedTuple, TypeAlias

import numpy as np

from pdpetsc.arrays import Float, GlobalIndex
from pdpetsc.declared import Bound, Declared, Positive

# Kinds of bodies: solid, plane strain, plane stress, bar.
Kind = Literal["solid", "strain", "stress", "bar"]

# Bounds of moduli [stress]: outside these bounds products overflow and matrix factorisations crash.
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
    arrays [stress]; ``energy(F, select, constants, psi)`` writes (n,) [energy / volume]. They write the rows of
    ``select`` only; other rows belong to other materials. The sign of ``det F`` is checked before, so a material
    defined for ``det F > 0`` is never called outside.
    """

    stress: Callable[..., None]
    tangent: Callable[..., None]
    energy: Callable[..., None]


class HistoryKernels(NamedTuple):
    """As ``PointKernels``, with a read-only ``history`` (len(select), n_history) before the result.

    ``commit(F, select, constants, history)`` overwrites the history with the state at F, the start of the next step.
    The stress is the derivative of the energy, stored plus dissipated, at constant history.
    """

    stress: Callable[..., None]
    tangent: Callable[..., None]
    energy: Callable[..., None]
    commit: Callable[..., None]


@dataclass(frozen=True)
class WithDensity(Declared):
    """What has a density, given by keyword.

    Parameters
    ----------
    density : float, optional
        Mass per reference volume [mass / volume]; needed for natural frequencies only.
    """

    density: Positive | None = field(default=None, kw_only=True, repr=False)


class Material(WithDensity, ABC):
    """A material law: stress at a point as a function of the deformation gradient.

    Attributes
    ----------
    density : float or None
        Mass per reference volume [mass / volume], given by keyword; needed for natural frequencies only.
    plane : {"strain", "stress"}
        Plane strain or plane stress of a two-dimensional body: no strain or no stress out of plane.
    """

    plane: Literal["strain", "stress"]

    # True if the stress is linear in F, so that the tangent is constant.
    linear: ClassVar[bool] = False
    has_history: ClassVar[bool] = False
    # Strain measure of the energy lambda / 2 (tr eps)^2 + mu eps : eps; None for another energy.
    strain_measure: ClassVar[Literal["small", "logarithmic", "green"] | None] = None
    # True if the local iteration may fail; the stress is then NaN, and the step is cut back.
    may_fail: ClassVar[bool] = False

    def kind(self, dim: int) -> Kind:
        """Return the kind of a body of ``dim`` dimensions."""
        if dim == 2:
            return self.plane
        return "bar" if dim == 1 else "solid"

    @property
    def small_strain(self) -> bool:
        """Return True if P is the stress of a small strain, equal to the Cauchy stress."""
        return self.linear or self.strain_measure == "small"

    @property
    def symmetric(self) -> bool:
        """Return True if the tangent is symmetric, ``A_imkn = A_knim``."""
        return True

    @property
    def timed(self) -> bool:
        """Return True if it has a ``duration``."""
        return self.duration is not None

    @property
    def reads_step(self) -> bool:
        """Return True if the last of its constants is the duration of the step [time]: 0 between two steps."""
        return self.timed

    @property
    def duration(self) -> float | None:
        """Return the time from load parameter 0 to 1 [time], equal for a whole case; None without rate dependence."""
        return None

    def spread(self, step: float) -> float:
        """Return the error of the stress if a jump of the strain is applied over a step [-].

        It is relative to the stress of the jump; 0 for a material without relaxation.

        Parameters
        ----------
        step : float
            Length of the step in the load parameter [-].
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
        """Return ``dP/dF`` at F = I (dim, dim, dim, dim) [stress], with condensed hidden strains if these are free."""

    @abstractmethod
    def young_modulus(self) -> float:
        """Return Young's modulus at small strain [stress].

        Raises
        ------
        CaseError
            The modulus depends on the direction.
        """

    @abstractmethod
    def hidden_stretch(self, F: Float, history: Float, dt: float = 0.0) -> Float:
        """Return the product of the hidden stretches: out of plane, or lateral for a bar (n,) [-].

        ``dt`` is the time since the last converged step [time], for laws that are ``timed``.
        """

    @abstractmethod
    def out_of_plane_stress(self, F: Float, history: Float, dt: float = 0.0) -> Float:
        """Return ``P_zz`` (n,) [stress] in plane strain, for ``F`` (n, 2, 2) and ``history`` (n, n_history).

        ``dt`` is as for ``hidden_stretch``.
        """

    def history_at(self, dim: int, x: Float) -> Float:
        """Return the initial history of points of particles at ``x`` (n, dim), as (n, n_history); empty by default.

        It contains history variables, or position-dependent data of the loops such as fibre directions.
        """
        return np.empty((len(x), 0))

    def history_in_space(self, x: Float) -> Float:
        """Return ``history_at`` of a solid for points of a plane body at ``x`` (n, 2), in the plane of x and y."""
        return self.history_at(3, np.pad(x, ((0, 0), (0, 1))))

    def defined(self, F: Float, select: GlobalIndex, history: Float) -> bool:
        """Return True if it has a stress at the points ``select`` of F, for positive determinants."""
        return True

    def plastic_strain(self, history: Float) -> Float:
        """Return the accumulated plastic strain (n,) [-], 0 for a material that does not flow."""
        return np.zeros(len(history))

    def uniform(self) -> Material:
        """Return the material without dependence on position, to compile its loops on another body."""
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
        Poisson's ratio [-], between -1 and 0.5, both excluded. In 1D it determines the lateral stretch only.
    plane : {"strain", "stress"}
        Plane strain or plane stress of a two-dimensional body: no strain or no stress out of plane.

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
        """Return the product of the hidden stretches: out of plane, or lateral for a bar (n,) [-]."""

    def hidden_stretch(self, F: Float, history: Float, dt: float = 0.0) -> Float:
        """Return ``thickness_stretch``."""
        return self.thickness_stretch(F)

    def young_modulus(self) -> float:
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
        """Return the trace of the strain measure of the law (n,) [-], with zero hidden strain.

        In plane strain ``P_zz`` is lambda times this trace, because the out-of-plane strain is zero.
        """

    @abstractmethod
    def kernels(self, dim: int) -> PointKernels:
        """Return the loops for dimension ``dim``."""

    def history_kernels(self, dim: int) -> HistoryKernels:
        """Return the loops of ``kernels`` with an unused history argument."""
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
    """An isotropic material with history variables."""

    has_history: ClassVar[bool] = True

    def history_at(self, dim: int, x: Float) -> Float:
        """Return ``initial_history`` for the number of points."""
        return self.initial_history(dim, len(x))

    @abstractmethod
    def initial_history(self, dim: int, n: int) -> Float:
        """Return the history of ``n`` undeformed points (n, n_history)."""
