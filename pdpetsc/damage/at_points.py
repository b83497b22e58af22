"""Damage criteria of strain, stress or plastic flow at gradient points, averaged over both ends of a bond."""

from __future__ import annotations

from abc import abstractmethod
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from typing import ClassVar

import numpy as np

from pdpetsc.arrays import Float, GlobalIndex, LocalIndex
from pdpetsc.damage.criterion import (
    Criterion,
    DamageableBonds,
    Displaced,
    DrivingVariable,
    EndpointMean,
    Gradient,
    Solid,
)
from pdpetsc.declared import Finite, NonNegative, Positive
from pdpetsc.errors import CaseError
from pdpetsc.gradient.base import GradientOperator
from pdpetsc.material.at_points import MaterialLaw
from pdpetsc.material.point_laws import PointLaws

# Step of central differences by a deformation gradient [-], for criteria without analytical derivative.
STEP = 1e-6


class PointCriterion(Criterion):
    """A criterion at gradient points; the driving variable of a bond is the mean of both ends.

    Attributes
    ----------
    reads_flow : bool
        True if the criterion requires materials that flow.
    adds_up : bool
        True if the value is the growth since the last converged state; the sum of the growth is stored.
    timed : bool
        True if it depends on the time of the step.
    """

    reads_stiffness: ClassVar[bool] = False
    reads_flow: ClassVar[bool] = False
    adds_up: ClassVar[bool] = False

    @property
    def timed(self) -> bool:
        """Return False."""
        return False

    @abstractmethod
    def at_points(self, moment: Moment, F: Float) -> Float:
        """Compute the value at every point (n_points,) [-] for ``F`` (n_points, dim, dim); damage begins at 1."""

    def by_deformation(self, moment: Moment, F: Float) -> Float:
        """Compute its derivative by F (n_points, dim, dim) [-], by default from central differences."""
        return differences(lambda G: self.at_points(moment, G), F)

    def build(self, bonds: DamageableBonds) -> DrivingVariable:
        """Return the driving variable, the mean of both ends."""
        return PointDrivingVariable(bonds, self)


@dataclass(frozen=True)
class Moment:
    """Material laws of all points at a state, time since the last converged state, and temperature.

    Attributes
    ----------
    laws : PointLaws
        Laws of the points.
    dt : float
        Time since the last converged state [time].
    temperature : (n_points,) float64 or None
        Temperature of the points; None if the body has none.
    """

    laws: PointLaws
    dt: float
    temperature: Float | None


class PointDrivingVariable(DrivingVariable):
    """``x_ij = (x_i + x_j) / 2`` with ``x_i`` the mean over the gradient points of a particle.

    Parameters
    ----------
    bonds : DamageableBonds
        The bonds.
    criterion : PointCriterion
        Criterion at a point.
    """

    is_nonlocal = True
    reads_points = True

    def __init__(self, bonds: DamageableBonds, criterion: PointCriterion) -> None:
        self._bonds, self._criterion = bonds, criterion
        self.reads_flow, self.timed = criterion.reads_flow, criterion.timed
        self._grown = np.zeros(bonds.cloud.n_owned)

    def take(self, solid: Solid) -> None:
        self._solid = solid

    def at(self, state: Displaced) -> Float:
        """Return the mean of both ends (n_bonds,) (collective)."""
        cloud, families = self._bonds.cloud, self._bonds.families
        x = cloud.halo.with_ghosts(self._of_particles(state))
        return np.asarray(0.5 * (x[families.centres] + x[families.neighbours]))

    def gradient(self, state: Displaced, bonds: GlobalIndex, by: Float) -> Gradient:
        """Return the derivative over the families of the ends (collective)."""
        solid, families, n = self._solid, self._bonds.families, self._bonds.cloud.n_owned
        operator, F = solid.gradients, solid.deformation(state)
        # No derivative at points of particles whose bonds do not change.
        D = np.where(solid.lost[:, None, None], 0.0, self._criterion.by_deformation(_moment(solid, state), F))
        point_of = np.repeat(np.arange(operator.n_points), np.diff(operator.point_ptr))
        count = np.bincount(operator.owner, minlength=n)
        each = np.einsum("emn,en->em", D[point_of], operator.g) / count[operator.owner[point_of]][:, None]
        found = _by_member(operator, point_of, each, families.indptr, families.neighbours, self._bonds.cloud.n_local)
        return Gradient(bonds, np.zeros(len(bonds)), None, (EndpointMean(by, found),))

    def commit(self, state: Displaced) -> None:
        """Store the growth of the value (collective)."""
        if self._criterion.adds_up:
            self._grown[:] = self._of_particles(state)

    def arrays(self) -> Mapping[str, Float]:
        """Return the sum of the growth, if the criterion adds up."""
        return {"grown": self._grown} if self._criterion.adds_up else {}

    def _of_particles(self, state: Displaced) -> Float:
        solid, n = self._solid, self._bonds.cloud.n_owned
        F = solid.deformation(state)
        x = np.where(solid.lost, 0.0, self._criterion.at_points(_moment(solid, state), F))
        return self._grown + solid.gradients.mean_over_points(x, n)


def _moment(solid: Solid, state: Displaced) -> Moment:
    return Moment(solid.laws(state), state.clock.dt, solid.temperature(state))


def _by_member(
    operator: GradientOperator, point_of: GlobalIndex, each: Float, indptr: GlobalIndex, neighbours: LocalIndex,
    n_local: int,
) -> Float:  # fmt: skip
    """Sum numbers of entries over the points of each particle, by members of its family.

    The entries ``each`` (n_entries, dim) of an operator become those of families with the centre first.
    """
    n = len(indptr) - 1
    centres = np.repeat(np.arange(n, dtype=np.int64), np.diff(indptr))
    # A centre is in front of its neighbours, whose keys follow in the order of the bonds.
    key = np.insert(centres * n_local + neighbours, indptr[:-1], np.arange(n, dtype=np.int64) * n_local + np.arange(n))
    order = np.argsort(key, kind="stable")
    asked = operator.owner[point_of].astype(np.int64) * n_local + operator.members
    at = order[np.searchsorted(key[order], asked)]
    columns = [np.bincount(at, column, len(key)) for column in each.T]
    return np.stack(columns, axis=1)


def _strains(laws: PointLaws, F: Float) -> tuple[Float, Float]:
    """Compute principal strains (n_points, 3) and their derivatives by F (n_points, 3, dim, dim).

    They are those of ``U - I``, or of the symmetric part of ``F - I`` for linear materials. Directions outside F come
    last, with the strain of the material there; it is zero in plane strain.
    """
    n, dim = len(F), F.shape[-1]
    strain, by = np.zeros((n, 3)), np.zeros((n, 3, dim, dim))
    for one in laws.materials:
        part = F[one.points]
        if one.material.linear:
            values, axes = np.linalg.eigh(0.5 * (part + part.transpose(0, 2, 1)))
            left = axes
        else:
            squares, axes = np.linalg.eigh(np.einsum("pki,pkj->pij", part, part))
            values = np.sqrt(np.maximum(squares, 0.0))
            left = np.einsum("pij,pja->pia", part, axes) / np.maximum(values, np.finfo(float).tiny)[:, None, :]
        strain[one.points, :dim] = values - 1.0
        by[one.points, :dim] = np.einsum("pia,pja->paij", left, axes)
        if dim < 3 and _thins(one):
            across, slope = _across(one, part)
            strain[one.points, dim:] = (across - 1.0)[:, None]
            by[one.points, dim:] = slope[:, None]
    return strain, by


def _thins(one: MaterialLaw) -> bool:
    return one.dim == 1 or one.material.plane == "stress"


def _across(one: MaterialLaw, F: Float) -> tuple[Float, Float]:
    """Return the stretch in each direction outside F (n,), and its derivative (n, dim, dim)."""

    def stretch(G: Float) -> Float:
        hidden = one.hidden_stretch(G)
        return np.asarray(np.sqrt(hidden) if one.dim == 1 else hidden)

    return stretch(F), differences(stretch, F)


def differences(function: Callable[[Float], Float], F: Float) -> Float:
    """Return the derivative of numbers of points (n,) by F (n, dim, dim), by central differences."""
    dim, by = F.shape[-1], np.empty_like(F)
    for i in range(dim):
        for j in range(dim):
            step = np.zeros((dim, dim))
            step[i, j] = STEP
            by[:, i, j] = (function(F + step) - function(F - step)) / (2.0 * STEP)
    return by


@dataclass(frozen=True)
class StrainCriterion(PointCriterion):
    """Bonds fail if the equivalent strain, the mean of both ends, reaches a critical value.

    The strain is ``U - I`` at gradient points, or of the gradient of the family for bond materials. For linear
    materials it is the small strain. It is computed from the unbroken bonds and does not depend on their softening.

    Parameters
    ----------
    critical : float
        Equivalent strain at which damage begins [-], positive.
    """

    critical: Positive

    reads_strain: ClassVar[bool] = True

    @abstractmethod
    def equivalent(self, strain: Float) -> tuple[Float, Float]:
        """Compute the equivalent strain (n,) of principal strains (n, 3), and its derivative by these (n, 3)."""

    def at_points(self, moment: Moment, F: Float) -> Float:
        """Return the equivalent strain over the critical one."""
        return np.asarray(self.equivalent(_strains(moment.laws, F)[0])[0] / self.critical)

    def by_deformation(self, moment: Moment, F: Float) -> Float:
        strain, by = _strains(moment.laws, F)
        return np.asarray(np.einsum("pa,paij->pij", self.equivalent(strain)[1] / self.critical, by))


@dataclass(frozen=True)
class MazarsStrain(StrainCriterion):
    """``sqrt(sum <e_a>+^2)``: the positive principal strains.

    Under pressure these are the transverse strains due to Poisson's ratio.

    Parameters
    ----------
    critical : float
        Equivalent strain at which damage begins [-], positive: strength over modulus in uniaxial tension.

    References
    ----------
    Mazars1986.

    Examples
    --------
    >>> import pdpetsc as pd
    >>> damage = pd.ExponentialSoftening(pd.MazarsStrain(1e-4), ratio=50.0, rate=0.1)
    """

    def equivalent(self, strain: Float) -> tuple[Float, Float]:
        """Return ``sqrt(sum <e_a>+^2)`` and its derivative."""
        positive = np.maximum(strain, 0.0)
        size = np.linalg.norm(positive, axis=1)
        return size, np.divide(positive, size[:, None], out=np.zeros_like(strain), where=size[:, None] > 0.0)


@dataclass(frozen=True)
class VonMisesStrain(StrainCriterion):
    """The modified von Mises strain, for a compressive strength of ``ratio`` times the tensile strength.

    ``(k - 1) / (2 k (1 - 2 nu)) I1 + 1 / (2 k) sqrt(((k - 1) I1 / (1 - 2 nu))^2 + 12 k J2 / (1 + nu)^2)`` with the
    trace I1 of the strain and ``J2 = 1/2 dev : dev``: it is the strain in uniaxial tension, and 1 / k times the strain
    in uniaxial compression.

    Parameters
    ----------
    critical : float
        Equivalent strain at which damage begins [-], positive.
    ratio : float
        ``k``, compressive over tensile strength [-], at least 1.
    nu : float
        Poisson's ratio [-], between -1 and 0.5, both excluded.

    References
    ----------
    deVree1995.

    Examples
    --------
    >>> import pdpetsc as pd
    >>> concrete = pd.VonMisesStrain(1e-4, ratio=10.0, nu=0.2)
    """

    ratio: Finite = 10.0
    nu: float = 0.2

    def __post_init__(self) -> None:
        super().__post_init__()
        if not (self.ratio >= 1.0 and -1.0 < self.nu < 0.5):
            raise CaseError(f"VonMisesStrain needs ratio >= 1 and -1 < nu < 0.5, not {self.ratio} and {self.nu}.")

    def equivalent(self, strain: Float) -> tuple[Float, Float]:
        """Return the strain and its derivative."""
        k, a = self.ratio, (self.ratio - 1.0) / (1.0 - 2.0 * self.nu)
        trace = strain.sum(axis=1)
        dev = strain - trace[:, None] / 3.0
        b = 12.0 * k / (1.0 + self.nu) ** 2
        root = np.sqrt((a * trace) ** 2 + 0.5 * b * (dev**2).sum(axis=1))
        slope = np.zeros_like(strain)
        inner = (a * a * trace)[:, None] + 0.5 * b * dev
        np.divide(inner, root[:, None], out=slope, where=root[:, None] > 0.0)
        return 0.5 / k * (a * trace + root), 0.5 / k * (a + slope)


@dataclass(frozen=True)
class PrincipalStress(PointCriterion):
    """Bonds fail if the largest principal stress, the mean of both ends, reaches the strength.

    The stress is the Cauchy stress of the undamaged material at gradient points, or of the gradient of the family for
    bond materials. In a plane body only the principal stresses in the plane count.

    Parameters
    ----------
    strength : float
        [stress], positive.

    Examples
    --------
    >>> import pdpetsc as pd
    >>> damage = pd.LinearSoftening(pd.PrincipalStress(3.5), ratio=20.0)
    """

    strength: Positive

    def at_points(self, moment: Moment, F: Float) -> Float:
        """Return the largest principal Cauchy stress over the strength."""
        sigma = moment.laws.cauchy(F)
        return np.asarray(np.linalg.eigvalsh(0.5 * (sigma + sigma.transpose(0, 2, 1)))[:, -1] / self.strength)

    def by_deformation(self, moment: Moment, F: Float) -> Float:
        laws = moment.laws
        sigma = laws.cauchy(F)
        values, axes = np.linalg.eigh(0.5 * (sigma + sigma.transpose(0, 2, 1)))
        n, largest = axes[:, :, -1], values[:, -1]
        A = laws.moduli(F)
        D = np.empty_like(F)
        for one in laws.materials:
            at = one.points
            if one.material.linear:
                D[at] = np.einsum("pi,pm,pimkn->pkn", n[at], n[at], A[at])
                continue
            part = F[at]
            hidden = one.hidden_stretch(part)
            J = np.linalg.det(part) * hidden
            inverse = np.linalg.inv(part)
            P = J[:, None, None] * np.einsum("pij,pkj->pik", sigma[at], inverse)
            m = np.einsum("pji,pj->pi", part, n[at])  # F^T n
            D[at] = np.einsum("pi,pm,pimkn->pkn", n[at], m, A[at]) / J[:, None, None]
            D[at] += np.einsum("pi,pim,pj->pjm", n[at], P, n[at]) / J[:, None, None]
            D[at] -= largest[at, None, None] * inverse.transpose(0, 2, 1)
            if _thins(one):
                D[at] -= (largest[at] / hidden)[:, None, None] * differences(one.hidden_stretch, part)
        return D / self.strength


@dataclass(frozen=True)
class PlasticStrain(PointCriterion):
    """Bonds fail if the accumulated plastic strain, the mean of both ends, reaches a critical value.

    It is the plastic strain of the current state, not of the last converged step. Materials that do not flow do not
    fail.

    Parameters
    ----------
    critical : float
        [-], positive.

    Examples
    --------
    >>> import pdpetsc as pd
    >>> ductile = pd.LinearSoftening(pd.PlasticStrain(0.2), ratio=1.5)
    """

    critical: Positive

    reads_flow: ClassVar[bool] = True

    def at_points(self, moment: Moment, F: Float) -> Float:
        """Return the accumulated plastic strain over the critical one."""
        x = np.zeros(len(F))
        for one in moment.laws.materials:
            if one.has_history:
                x[one.points] = one.plastic_strain_after(F) / self.critical
        return x


def _triaxiality(one: MaterialLaw, F: Float, sigma: Float) -> Float:
    """Return mean stress over von Mises stress at the points of a material (n,) [-], 0 without stress."""
    dim, part = F.shape[-1], F[one.points]
    full = np.zeros((len(part), 3, 3))
    full[:, :dim, :dim] = sigma[one.points]
    if dim == 2:
        P = one.out_of_plane_stress(part)
        full[:, 2, 2] = P if one.material.linear else P / np.linalg.det(part)
    mean = np.einsum("pii->p", full) / 3.0
    dev = full - mean[:, None, None] * np.eye(3)
    q = np.sqrt(1.5 * np.einsum("pij,pij->p", dev, dev))
    return np.asarray(np.divide(mean, q, out=np.zeros_like(q), where=q > 0.0))


NO_TEMPERATURE = (
    "JohnsonCookFailure with D5 reads the temperature, and the body has none; wrap its materials in Thermal and give a "
    "Temperature or HeatConduction, or leave D5 out."
)


@dataclass(frozen=True)
class JohnsonCookFailure(PointCriterion):
    """Bonds fail if plastic strain reaches the failure strain of Johnson and Cook, ``D = sum d_alpha / e_f``.

    ``e_f = (D1 + D2 exp(D3 s)) (1 + D4 ln(r / rate_0)) (1 + D5 T*)`` with the triaxiality ``s``, mean stress over von
    Mises stress. ``r`` is the rate of plastic strain in the step, at least ``rate_0``.
    ``T* = (T - room) / (melting - room)``, between 0 and 1, is that of the temperature of the body. The driving
    variable of a bond is the mean of D at both ends. D accumulates over converged steps.

    Parameters
    ----------
    D1, D2, D3 : float
        [-]; failure strains must be positive.
    D4 : float
        Logarithmic sensitivity to the rate [-], not negative; it requires ``duration``.
    D5 : float
        Sensitivity to the temperature [-], above -1; it requires ``melting`` and a body with a temperature.
    rate_0 : float
        Rate of the tests for D1 to D3 [1 / time].
    duration : float, optional
        Time from load parameter 0 to 1 [time], equal for all laws of the case. The load parameter is then proportional
        to time, and solvers that compute the load are refused.
    room, melting : float
        Temperature of these tests, and of melting [temperature].

    Raises
    ------
    CaseError
        A constant is out of range or missing. In a case: laws have different durations, or a material has no
        temperature.

    References
    ----------
    JohnsonCook1985.

    Examples
    --------
    >>> import pdpetsc as pd
    >>> steel_4340 = pd.Brittle(pd.JohnsonCookFailure(D1=0.05, D2=3.44, D3=-2.12))
    >>> fast_and_hot = pd.JohnsonCookFailure(
    ...     D1=0.05, D2=3.44, D3=-2.12, D4=0.002, D5=0.61, rate_0=1.0, duration=1e-3, room=293.0, melting=1793.0
    ... )
    """

    D1: NonNegative
    D2: NonNegative
    D3: Finite
    D4: NonNegative = 0.0
    D5: Finite = 0.0
    rate_0: Positive = 1.0
    duration: Positive | None = None
    room: Finite = 293.0
    melting: Finite | None = None

    reads_flow: ClassVar[bool] = True
    adds_up: ClassVar[bool] = True

    def __post_init__(self) -> None:
        super().__post_init__()
        if self.D1 == self.D2 == 0.0:
            raise CaseError("JohnsonCookFailure has D1 0 and D2 0; give one of them a positive value.")
        if self.D5 <= -1.0:
            raise CaseError(f"JohnsonCookFailure needs D5 > -1, not {self.D5}.")
        if self.D4 and self.duration is None:
            raise CaseError(
                "JohnsonCookFailure with D4 reads the rate of flow, and step times are no times; give the duration of "
                "the load from step time 0 to 1."
            )
        if self.D5 and self.melting is None:
            raise CaseError("JohnsonCookFailure with D5 needs the temperature of melting; give melting.")
        if self.melting is not None and self.room >= self.melting:
            raise CaseError(
                f"JohnsonCookFailure takes a room temperature below that of melting, not {self.room} and "
                f"{self.melting}."
            )

    @property
    def timed(self) -> bool:
        """Return True if ``D4`` is used."""
        return self.D4 != 0.0

    @property
    def reads_temperature(self) -> bool:
        """Return True if ``D5`` is used."""
        return self.D5 != 0.0

    def failure_strain(self, triaxiality: Float) -> Float:
        """Return ``D1 + D2 exp(D3 s)`` (n,) [-], with an exponent between -50 and 50."""
        return np.asarray(self.D1 + self.D2 * np.exp(np.clip(self.D3 * triaxiality, -50.0, 50.0)))

    def of_rate(self, rate: Float) -> Float:
        """Return ``1 + D4 ln(r / rate_0)`` (n,) [-], 1 up to ``rate_0``."""
        return np.asarray(1.0 + self.D4 * np.log(np.maximum(rate / self.rate_0, 1.0)))

    def of_temperature(self, temperature: Float) -> Float:
        """Return ``1 + D5 T*`` (n,) [-]."""
        assert self.melting is not None
        return np.asarray(1.0 + self.D5 * np.clip((temperature - self.room) / (self.melting - self.room), 0.0, 1.0))

    def at_points(self, moment: Moment, F: Float) -> Float:
        """Return the growth of the plastic strain since the last converged step over the present failure strain."""
        x, sigma = np.zeros(len(F)), moment.laws.cauchy(F)
        time = 0.0 if self.duration is None else moment.dt
        factor = np.ones(len(F))
        if self.D5:
            if moment.temperature is None:
                raise CaseError(NO_TEMPERATURE)
            factor = self.of_temperature(moment.temperature)
        for one in moment.laws.materials:
            if one.has_history and len(one.points):
                grown = one.plastic_strain_after(F) - one.plastic_strain()
                failure = self.failure_strain(_triaxiality(one, F, sigma)) * factor[one.points]
                rate = grown / time if time > 0.0 else np.zeros_like(grown)
                x[one.points] = grown / (failure * self.of_rate(rate))
        return x
