"""Damage as a law at gradient points, with a declared strength and fracture energy."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, field, replace
from typing import Any, ClassVar

import numpy as np

from pdpetsc.arrays import Float, GlobalIndex, Mask
from pdpetsc.damage.laws import BondDamage
from pdpetsc.damage.softening import SofteningCurve
from pdpetsc.declare.region import Region
from pdpetsc.declared import Declared, Positive, name_of, numbers_from
from pdpetsc.errors import CaseError
from pdpetsc.material.base import LARGEST_MODULUS
from pdpetsc.material.split import NoTension, Split

# An onset that no fracture energy is too small for [-].
SMALL = 1e-6


@dataclass(frozen=True)
class PointDamage(Declared):
    r"""The energy of a gradient point is ``phi(x) (psi_open + psi_control) + psi_closed``.

    The drive ``x = sqrt(Y / Y_0)`` is that of ``Y = psi_open + psi_control``, the energy that damage takes away, and
    ``Y_0`` is ``psi_open`` in uniaxial tension of the strength. Stress falls by the curve as x grows from 1 to ``r``,
    ``phi = s(xi) / x`` with ``xi = (x - 1) / (r - 1)``, and damage does not heal. A crack fails every point whose
    family it cuts, so that a point takes ``g_f = Gc / w``, where w is the width of its family across the crack at
    onset: ``r = 1 + (g_f / Y_0 - 1) / (2 a)`` with the area a under s. No number is fitted. The normal of the crack is
    the direction in which the families about the point have the largest relative displacements.

    Gradients and weights stay those of the intact body. All forces derive from the energy, and the tangent is
    symmetric where that of the material is. The energy of a material that flows is what it stores and what flow has
    taken, together.

    Parameters
    ----------
    curve : SofteningCurve
        Shape of the stress over the strain, such as ``pd.softening.Linear()``.
    Gc : float or callable
        Energy of a crack per area [energy / area], positive. A function ``Gc(x, normal)`` of places (n, dim) and unit
        vectors across the crack (n, dim) returns numbers (n,).
    strength : float or callable, optional
        Stress at which a bar begins to fail [stress], positive; a function ``strength(x)`` returns numbers (n,). It is
        that of the moduli without a temperature: a ``Thermal`` factor f of the moduli makes it ``sqrt(f)`` times this.
    onset : float or callable, optional
        Instead of a strength, the strain at which a bar begins to fail [-], positive, or a function of places.
    split : Split
        Which part of the energy a crack that closes keeps: ``pd.split.NoTension()``, ``Volumetric()``, ``Spectral()``
        or ``Whole()``, which keeps nothing.
    protected : Region, optional
        Points of particles in it do not fail. A crack needs two horizons beside it: points that may not fail hold the
        faces of a crack that they reach across.

    Raises
    ------
    CaseError
        Not one of strength and onset is given; in a case, the strength is too high for Gc and the horizon, the split
        cannot be made of a material, or a function does not return positive numbers.

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

    all_laws: ClassVar[list[BondDamage]] = []

    def __post_init__(self) -> None:
        super().__post_init__()
        if (self.strength is None) == (self.onset is None):
            raise CaseError("PointDamage needs one of strength and onset.")

    @property
    def places(self) -> list[tuple[str, Region]]:
        """Return its regions with what they are."""
        return [] if self.protected is None else [("What damage is protected from", self.protected)]

    def rehearsed(self) -> PointDamage:
        """Return damage of another body with which its loops can be compiled."""
        return replace(self, Gc=LARGEST_MODULUS, strength=None, onset=SMALL, protected=None)

    def onset_energy(self, E: Float, x: Float) -> Float:
        """Return the energy of uniaxial tension at the onset (n,) [energy / volume] at places x (n, dim).

        ``E`` (n,) are Young's moduli there [stress].
        """
        if self.onset is not None:
            return np.asarray(0.5 * E * _numbers("onset of PointDamage", self.onset, x) ** 2)
        return np.asarray(0.5 * _numbers("strength of PointDamage", self.strength, x) ** 2 / E)

    def crack_energy(self, x: Float, normal: Float) -> Float:
        """Return Gc (n,) [energy / area] at places for cracks across unit vectors, both (n, dim)."""
        return _numbers("Gc of PointDamage", self.Gc, x, normal)


def _numbers(what: str, given: Any, *at: Float) -> Float:
    """Return positive numbers (n,) of a number or a function."""
    n = len(at[0])
    if not callable(given):
        return np.full(n, float(given))
    if n == 0:
        return np.zeros(0)
    values = numbers_from(what, given, *at)
    if values.shape != (n,) or not (np.isfinite(values) & (values > 0.0)).all():
        raise CaseError(f"The {what} must be one positive number for each place, {(n,)}; {name_of(given)} gave others.")
    return values


class FailingPoints:
    """Degradation factor of gradient points, and how far what drives their damage has been.

    What is called ``x`` in the methods is the drive of every point (n_points,) [-].

    Parameters
    ----------
    curve : SofteningCurve
        How stress falls.
    onset_energy : (n_points,) float64
        ``Y_0`` [energy / volume].
    spared : (n_points,) bool
        Points that do not fail.

    Attributes
    ----------
    phi, kappa, final : (n_points,) float64
        Degradation factor, largest drive so far, and the drive at which nothing is left [-].
    frozen : bool
        Whether the degradation factor stays while the displacement changes.
    slack : float
        Points whose drive is below their largest one by less than this share fail too: 0 but where a tangent for
        further loading is wanted [-].
    """

    def __init__(self, curve: SofteningCurve, onset_energy: Float, spared: Mask) -> None:
        n = len(onset_energy)
        self.curve, self.onset_energy, self.spared = curve, onset_energy, spared
        self.phi, self.kappa, self.final = np.ones(n), np.zeros(n), np.full(n, np.inf)
        self.frozen, self.slack = False, 0.0
        self.commit()

    def final_of(self, points: GlobalIndex, energy: Float) -> Float:
        """Return r (n,) of some points for what they take (n,) [energy / volume]."""
        return 1.0 + (energy / self.onset_energy[points] - 1.0) / (2.0 * self.curve.area)

    def commit(self) -> None:
        """Keep the present state."""
        self._committed = self.phi.copy(), self.kappa.copy(), self.final.copy()

    def revert(self) -> None:
        """Go back to the state of the last ``commit``."""
        self.phi[:], self.kappa[:], self.final[:] = self._committed

    def following(self, x: Float) -> tuple[Float, Mask, Float]:
        """Return ``phi`` at drives x, which points lose more with them, and ``dphi/dx`` there (n_points,)."""
        if self.frozen:
            return self.phi, np.zeros(len(x), dtype=bool), np.zeros(len(x))
        largest = np.maximum(x, self.kappa)
        fails = (x > self.kappa * (1.0 - self.slack)) & (largest > 1.0) & (largest < self.final) & ~self.spared
        slope = np.zeros(len(x))
        xi = (largest[fails] - 1.0) / (self.final[fails] - 1.0)
        by_x = self.curve.slope(xi) / (self.final[fails] - 1.0)
        slope[fails] = (by_x - self.curve.stress(xi) / largest[fails]) / largest[fails]
        return self.phi_of(largest, self.final), fails, slope

    def phi_of(self, x: Float, final: Float) -> Float:
        """Return ``phi`` (n_points,) of points whose largest drives are x, with the drives at which nothing is left."""
        phi = np.ones(len(x))
        phi[(x >= final) & ~self.spared] = 0.0
        begun = np.flatnonzero((x > 1.0) & (x < final) & ~self.spared)
        phi[begun] = self.curve.stress((x[begun] - 1.0) / (final[begun] - 1.0)) / x[begun]
        return phi

    def dissipated(self) -> Float:
        """Return ``-int Y dphi`` up to the largest drive (n_points,) [energy / volume]."""
        found = np.zeros(len(self.kappa))
        begun = np.flatnonzero((self.kappa > 1.0) & ~self.spared)
        x, r = np.minimum(self.kappa[begun], self.final[begun]), self.final[begun]
        xi = (x - 1.0) / (r - 1.0)
        found[begun] = 2.0 * (r - 1.0) * self.curve.integral(xi) + 1.0 - x * self.curve.stress(xi)
        return np.asarray(found * self.onset_energy)
