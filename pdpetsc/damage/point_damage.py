"""Damage as a law at gradient points, with a declared strength and fracture energy."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, field, replace
from typing import Any, ClassVar, NamedTuple

import numpy as np

from pdpetsc.arrays import Float, GlobalIndex, LocalIndex, Mask
from pdpetsc.damage.laws import BondDamage, Marking, by_law, spare
from pdpetsc.damage.softening import SofteningCurve
from pdpetsc.declare.cracks import Crack
from pdpetsc.declare.region import Region
from pdpetsc.declared import Declared, Positive, name_of, numbers_from
from pdpetsc.discrete.cloud import Cloud
from pdpetsc.discrete.families import Families
from pdpetsc.errors import CaseError
from pdpetsc.material.base import LARGEST_MODULUS
from pdpetsc.material.split import NoTension, Split

# An onset that is admissible for every fracture energy [-].
SMALL = 1e-6
# Least and most that the way from the present drive to the final one becomes as a curve is stretched, over that before.
LEAST_LEFT, MOST_LEFT = 0.5, 10.0


@dataclass(frozen=True)
class PointDamage(Declared):
    r"""The energy of a gradient point is ``phi(x) (psi_open + psi_control) + psi_closed``.

    The driving variable is ``x = sqrt(Y / Y_0)`` with ``Y = psi_open + psi_control``, the energy that damage reduces.
    ``Y_0`` is ``psi_open`` in uniaxial tension at the strength. The stress follows the softening curve as x increases
    from 1 to ``r``, ``phi = s(xi) / x`` with ``xi = (x - 1) / (r - 1)``. Damage is irreversible. A crack fails every
    point whose family it cuts, so a point dissipates ``g_f = Gc / w``, with w the width of its family across the
    crack: ``r = 1 + (g_f / Y_0 - 1) / (2 a)`` with the area a under s. No parameter is fitted. The normal of the
    crack is the direction of the largest relative displacements in the families around the point. Its faces keep the
    normal at onset. Until the point has failed, Gc and w follow the direction from step to step, at constant stress
    and dissipated energy.

    Gradients and weights are those of the intact body. All forces derive from the energy, and the tangent is symmetric
    if that of the material is. The energy of a material that flows is stored energy plus plastic work.

    Parameters
    ----------
    curve : SofteningCurve
        Shape of the stress over the strain, such as ``pd.softening.Linear()``.
    Gc : float or callable
        Energy of a crack per area [energy / area], positive. A function ``Gc(x, normal)`` of positions (n, dim) and
        unit normals of the crack (n, dim) returns values (n,).
    strength : float or callable, optional
        Stress at which a bar begins to fail [stress], positive; a function ``strength(x)`` returns values (n,). It is
        valid for the moduli at the reference: a ``Thermal`` factor f of the moduli multiplies it by ``sqrt(f)``.
    onset : float or callable, optional
        Instead of a strength, the strain at which a bar begins to fail [-], positive, or a function of positions.
    split : Split
        Part of the energy that a closed crack retains: ``pd.split.NoTension()``, ``Volumetric()``, ``Spectral()``, or
        ``Whole()`` for no such part.
    protected : Region, optional
        Points of particles in this region do not fail. Leave two horizons beside a crack: protected points hold the
        faces of a crack within their families.
    cracks : sequence of Crack, optional
        Cracks at the start whose faces touch, such as ``pd.Segment``. Points have failed whose family crosses the
        crack, measured along its normal. ``Case(cracks=...)`` instead cuts bonds, and its faces do not touch.

    Raises
    ------
    CaseError
        Neither or both of strength and onset are declared. In a case: the strength is too high for Gc and the horizon,
        a material does not support the split, or a function does not return positive values.

    Examples
    --------
    >>> import pdpetsc as pd
    >>> damage = pd.PointDamage(pd.softening.Exponential(), Gc=0.1, strength=3.0)
    >>> layered = pd.PointDamage(
    ...     pd.softening.Linear(), Gc=lambda x, normal: 0.1 + 0.2 * normal[:, 0] ** 2, strength=3.0
    ... )
    """

    curve: SofteningCurve
    Gc: Positive | Callable[[Float, Float], Float] = field(kw_only=True)
    strength: Positive | Callable[[Float], Float] | None = field(default=None, kw_only=True)
    onset: Positive | Callable[[Float], Float] | None = field(default=None, kw_only=True)
    split: Split = field(default_factory=NoTension, kw_only=True)
    protected: Region | None = field(default=None, kw_only=True)
    cracks: Sequence[Crack] = field(default=(), kw_only=True)

    all_laws: ClassVar[list[BondDamage]] = []

    def __post_init__(self) -> None:
        super().__post_init__()
        if (self.strength is None) == (self.onset is None):
            raise CaseError("PointDamage needs one of strength and onset.")

    @property
    def places(self) -> list[tuple[str, Region]]:
        """Return its regions with their descriptions."""
        return [] if self.protected is None else [("What damage is protected from", self.protected)]

    @property
    def point_laws(self) -> list[PointDamage]:
        """Return a list of this law, as ``DamageOf`` returns its laws."""
        return [self]

    def assign_particles(self, cloud: Cloud, families: Families, mark: Marking) -> GlobalIndex:
        """Return the number of the law of each own particle (n_owned,): 0, -1 if it does not fail (collective)."""
        number = np.zeros(cloud.n_owned, dtype=np.int64)
        return spare(number, [self], None, mark, lambda marked: marked[: cloud.n_owned])

    def rehearsed(self) -> PointDamage:
        """Return the law for a small body on which its loops are compiled."""
        return replace(self, Gc=LARGEST_MODULUS, strength=None, onset=SMALL, protected=None, cracks=())

    def onset_energy(self, E: Float, x: Float) -> Float:
        """Compute the energy of uniaxial tension at the onset (n,) [energy / volume] at positions x (n, dim).

        ``E`` (n,) are Young's moduli there [stress].
        """
        if self.onset is not None:
            return np.asarray(0.5 * E * _numbers("onset of PointDamage", self.onset, x) ** 2)
        return np.asarray(0.5 * _numbers("strength of PointDamage", self.strength, x) ** 2 / E)

    def crack_energy(self, x: Float, normal: Float) -> Float:
        """Compute Gc (n,) [energy / area] at positions for cracks with unit normals, both (n, dim)."""
        return _numbers("Gc of PointDamage", self.Gc, x, normal)


@dataclass(frozen=True)
class CurvesAtPoints:
    """Softening curves of gradient points; ``points`` are numbers of gradient points (n,).

    Parameters
    ----------
    curves : sequence of SofteningCurve
        Curves of a body.
    of_point : (n_points,) int64
        Number of the curve of each point, -1 for a point that does not fail.
    """

    curves: Sequence[SofteningCurve]
    of_point: GlobalIndex

    def stress(self, xi: Float, points: GlobalIndex) -> Float:
        """Return ``s`` (n,) [-] for xi between 0 and 1."""
        return by_law(self.curves, self.of_point[points], lambda curve, at: curve.stress(xi[at]))

    def slope(self, xi: Float, points: GlobalIndex) -> Float:
        """Return ``ds/dxi`` (n,) [-]."""
        return by_law(self.curves, self.of_point[points], lambda curve, at: curve.slope(xi[at]))

    def integral(self, xi: Float, points: GlobalIndex) -> Float:
        """Return the integral of s from 0 to xi (n,) [-]."""
        return by_law(self.curves, self.of_point[points], lambda curve, at: curve.integral(xi[at]))

    def area(self, points: GlobalIndex) -> Float:
        """Return the integral of s from 0 to 1 (n,) [-], 1 at points that do not fail."""
        return np.asarray(np.array([*(curve.area for curve in self.curves), 1.0])[self.of_point[points]])


@dataclass(frozen=True)
class AssignedPointDamage:
    """Damage laws of gradient points, and the particles to whose points they apply.

    Attributes
    ----------
    laws : sequence of PointDamage
        Laws of a body, with one split.
    of_particle : (n_owned,) int64
        The number of the law of each own particle, -1 if its points do not fail.
    """

    laws: Sequence[PointDamage]
    of_particle: GlobalIndex

    @property
    def split(self) -> Split:
        """Return the split of all laws."""
        return self.laws[0].split

    @property
    def cracks(self) -> list[Crack]:
        """Return the cracks at the start of all laws."""
        return [crack for law in self.laws for crack in law.cracks]

    @property
    def varies(self) -> bool:
        """Return True if a fracture energy is a function of position and direction."""
        return any(callable(law.Gc) for law in self.laws)

    def curves(self, owner: LocalIndex) -> CurvesAtPoints:
        """Return the softening curves of points of these particles (n_points,)."""
        return CurvesAtPoints([law.curve for law in self.laws], self.of_particle[owner])

    def onset_energy(self, E: Float, x: Float) -> Float:
        """Return ``PointDamage.onset_energy`` of the particles (n_owned,), E for points that do not fail."""
        found = by_law(self.laws, self.of_particle, lambda law, at: law.onset_energy(E[at], x[at]))
        return np.where(self.of_particle < 0, E, found)

    def crack_energy(self, particles: LocalIndex, x: Float, normal: Float) -> Float:
        """Compute Gc (n,) at selected particles (n,) for cracks with unit normals (n, dim), 0 if they do not fail.

        ``x`` (n, dim) are their positions [length].
        """
        return by_law(self.laws, self.of_particle[particles], lambda law, at: law.crack_energy(x[at], normal[at]))


def _numbers(what: str, given: Any, *at: Float) -> Float:
    """Return positive values (n,) of a number or a function."""
    n = len(at[0])
    if not callable(given):
        return np.full(n, float(given))
    if n == 0:
        return np.zeros(0)
    values = numbers_from(what, given, *at)
    if values.shape != (n,) or not (np.isfinite(values) & (values > 0.0)).all():
        raise CaseError(f"The {what} must be one positive number for each place, {(n,)}; {name_of(given)} gave others.")
    return values


class Driven(NamedTuple):
    """Store drive and degradation factor of points.

    Attributes
    ----------
    x : (n_points,) float64
        Drive [-].
    phi, slope : (n_points,) float64
        Degradation factor, and its derivative by the drive at points that fail [-].
    fails : (n_points,) bool
        Points whose degradation factor decreases.
    """

    x: Float
    phi: Float
    slope: Float
    fails: Mask


class FailingPoints:
    """Degradation factor and largest drive of gradient points.

    ``x`` in the methods is the drive of every point (n_points,) [-].

    Parameters
    ----------
    curves : CurvesAtPoints
        Softening curves.
    onset_energy : (n_points,) float64
        ``Y_0`` [energy / volume].
    dim : int
        Dimension of the body.

    Attributes
    ----------
    spared : (n_points,) bool
        Points that do not fail.
    phi, kappa, final : (n_points,) float64
        Degradation factor, largest drive of converged steps, and final drive [-].
    start : (n_points,) float64
        Drive at which the softening curve begins, ``xi = (x - start) / (final - start)`` [-]: 1 until it is stretched.
    spent : (n_points,) float64
        ``-int Y dphi`` up to the last converged step, over the energy at the onset [-].
    largest : (n_points,) float64
        Largest drive including the state of the last update of damage; a later state of the same load step may reduce
        it [-].
    normal : (n_points, dim) float64
        Unit normal of the crack of each point whose damage has begun, zero at other points.
    released : (n_points,) float64
        Energy density that slip of the faces of this crack released at the onset, which drives no damage [energy /
        volume].
    frozen : bool
        True if the degradation factor is constant while the displacement changes.
    slack : float
        Points whose drive is below their largest drive by less than this share fail too: 0 except for a tangent for
        further loading [-].
    """

    def __init__(self, curves: CurvesAtPoints, onset_energy: Float, dim: int) -> None:
        n = len(onset_energy)
        self.curves, self.onset_energy, self.spared = curves, onset_energy, curves.of_point < 0
        self.phi, self.kappa, self.final, self.largest = np.ones(n), np.zeros(n), np.full(n, np.inf), np.zeros(n)
        self.normal, self.frozen, self.slack = np.zeros((n, dim)), False, 0.0
        self.released, self.start, self.spent = np.zeros(n), np.ones(n), np.zeros(n)
        self.commit()

    def start_failed(self, points: GlobalIndex, normal: Float) -> None:
        """Let points fail before the first step, without dissipation, with cracks of normals (n, dim)."""
        self.normal[points] = normal
        self.largest[points], self.phi[points] = self.final[points], 0.0
        self.commit()
        self.spent[points] = 0.0

    def final_of(self, points: GlobalIndex, energy: Float) -> Float:
        """Return the final drives (n,) of selected points before their onset.

        ``energy`` (n,) is their specific fracture energy [energy / volume].
        """
        return 1.0 + self._length(points, energy)

    def stretch(self, points: GlobalIndex, energy: Float) -> None:
        """Let points that fail dissipate other specific energies (n,) until they fail [energy / volume].

        The stress at the largest drive does not change, nor the energy dissipated up to it. The family may be wider
        than before, so that a point has dissipated too much already. It keeps half its way to failure, since its force
        would jump otherwise. At most, the way grows tenfold: a point that has nearly failed could dissipate more only
        far beyond all others.
        """
        kappa, before = self.kappa[points], self.final[points] - self.start[points]
        with np.errstate(divide="ignore", invalid="ignore"):  # just before failure nothing is left
            length = np.fmin(np.fmax(self._length(points, energy), LEAST_LEFT * before), MOST_LEFT * before)
        xi = self._xi(kappa, points)
        self.start[points], self.final[points] = kappa - xi * length, kappa + (1.0 - xi) * length
        self.commit()

    def _length(self, points: GlobalIndex, energy: Float) -> Float:
        """Return ``final - start`` (n,) [-] of selected points that dissipate specific energies (n,) until they fail.

        They have the present stress at the largest drive of converged steps, and have dissipated ``spent`` there.
        """
        kappa = np.maximum(self.kappa[points], 1.0)
        xi = self._xi(kappa, points)
        left = energy / self.onset_energy[points] - self.spent[points] - kappa * self.curves.stress(xi, points)
        return np.asarray(left / (2.0 * (self.curves.area(points) - self.curves.integral(xi, points))))

    def _xi(self, x: Float, points: GlobalIndex, final: Float | None = None) -> Float:
        """Return ``xi`` (n,) [-] of selected points at drives x (n,) between onset and final drive.

        ``final`` (n_points,) are other final drives.
        """
        start, end = self.start[points], (self.final if final is None else final)[points]
        return np.asarray((x - start) / (end - start))

    @property
    def gone(self) -> Mask:
        """Mark the points that had failed at the last converged step (n_points,)."""
        return np.asarray((self.kappa >= self.final) & ~self.spared)

    def commit(self) -> None:
        """Store the present state as that of a converged step."""
        self.spent[:] = self._spent()
        self.kappa[:] = self.largest
        self._forget()
        self._committed = self.phi.copy(), self.final.copy()

    def revert(self) -> None:
        """Restore the state of the last ``commit``."""
        self.phi[:], self.final[:] = self._committed
        self.largest[:] = self.kappa
        self._forget()

    def _forget(self) -> None:
        """Forget the cracks of points whose damage has not begun at the last converged step."""
        self.normal[self.kappa <= 1.0] = 0.0
        self.released[self.kappa <= 1.0] = 0.0

    def following(self, x: Float) -> Driven:
        """Return the damage at drives x, without updating it."""
        if self.frozen:
            return Driven(x, self.phi, np.zeros(len(x)), np.zeros(len(x), dtype=bool))
        largest = np.maximum(x, self.kappa)
        fails = (x > self.kappa * (1.0 - self.slack)) & (largest > 1.0) & (largest < self.final) & ~self.spared
        slope, at = np.zeros(len(x)), np.flatnonzero(fails)
        xi = self._xi(largest[at], at)
        by_x = self.curves.slope(xi, at) / (self.final[at] - self.start[at])
        slope[at] = (by_x - self.curves.stress(xi, at) / largest[at]) / largest[at]
        return Driven(x, self.phi_of(largest, self.final), slope, fails)

    def phi_of(self, x: Float, final: Float) -> Float:
        """Return ``phi`` (n_points,) for largest drives x and final drives."""
        phi = np.ones(len(x))
        phi[(x >= final) & ~self.spared] = 0.0
        begun = np.flatnonzero((x > 1.0) & (x < final) & ~self.spared)
        phi[begun] = self.curves.stress(self._xi(x[begun], begun, final), begun) / x[begun]
        return phi

    def dissipated(self) -> Float:
        """Return ``-int Y dphi`` since the start (n_points,) [energy / volume]."""
        return np.asarray(self._spent() * self.onset_energy)

    def _spent(self) -> Float:
        """Return ``-int Y dphi`` since the start over the energy at the onset (n_points,) [-]."""
        spent = self.spent.copy()
        begun = np.flatnonzero((self.largest > 1.0) & ~self.spared)
        for sign, x in ((1.0, self.largest[begun]), (-1.0, self.kappa[begun])):
            x = np.clip(x, 1.0, self.final[begun])
            xi, length = self._xi(x, begun), self.final[begun] - self.start[begun]
            spent[begun] += sign * (2.0 * length * self.curves.integral(xi, begun) - x * self.curves.stress(xi, begun))
        return spent
