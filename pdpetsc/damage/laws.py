"""Damage laws of bonds: degradation factor as a function of the driving variable."""

from __future__ import annotations

import math
from abc import ABC, abstractmethod
from collections.abc import Callable, Sequence
from dataclasses import dataclass, field, replace
from typing import Annotated, Any, TypeAlias, TypeVar

import numpy as np
import scipy

from pdpetsc.arrays import Float, GlobalIndex, LocalIndex, Mask
from pdpetsc.damage.criterion import Criterion, DamageableBonds
from pdpetsc.damage.critical import ConstantCritical, FractureEnergy
from pdpetsc.damage.evolution import DamageEvolution, LargestStretch
from pdpetsc.declare.region import Region
from pdpetsc.declared import Bound, Declared, Fraction, Positive, shown
from pdpetsc.errors import CaseError
from pdpetsc.renamed import accept_old_methods

# Points of the quadrature of the dissipated energy.
QUADRATURE = 40

# Smallest driving variable at which a softening bond fails further: above the onset.
AboveOne: TypeAlias = Annotated[
    float, Bound(("a finite number above 1", "finite numbers above 1"), lambda x: math.isfinite(x) and x > 1.0)
]


Law = TypeVar("Law")

Index = TypeVar("Index", GlobalIndex, LocalIndex)
# Name of protected regions in messages.
PROTECTED = "what damage is protected from"

# Marks the local particles in a region (n_local,); the text names the region in messages (collective).
Marking: TypeAlias = Callable[[Region, str], Mask]


def spare(
    number: Index, laws: Sequence[Any], protected: Region | None, mark: Marking, of: Callable[[Mask], Mask]
) -> Index:
    """Return the numbers of the laws of bonds or particles (n,) with -1 in protected regions (collective).

    Parameters
    ----------
    number : (n,) int
        The law of each, -1 for none; changed in place.
    laws : sequence
        Laws, each with its own protected region.
    protected : Region or None
        Region in which no law applies.
    mark : callable
        Marks the local particles in a region (n_local,).
    of : callable
        Returns which bonds or particles (n,) belong to marked local particles.
    """
    for law_number, law in enumerate(laws):
        if law.protected is not None:
            number[(number == law_number) & of(mark(law.protected, PROTECTED))] = -1
    if protected is not None:
        number[of(mark(protected, PROTECTED))] = -1
    return number


def by_law(
    laws: Sequence[Law], number: GlobalIndex | LocalIndex, function: Callable[[Law, GlobalIndex], Float]
) -> Float:
    """Return numbers of bonds, points or particles (n,) by their laws, 0 without a law.

    Parameters
    ----------
    laws : sequence
        The laws, or one object for each.
    number : (n,) int
        The law of each, -1 for none.
    function : callable
        Returns the numbers for a law and those with that law.
    """
    found = np.zeros(len(number))
    for law_number, law in enumerate(laws):
        at = np.flatnonzero(number == law_number)
        if len(at):
            found[at] = function(law, at)
    return found


@dataclass(frozen=True)
class BondDamage(Declared, ABC):
    """Damage law of bonds: the force of a bond decreases if its driving variable exceeds 1.

    The degradation factor ``phi`` multiplies the force of a bond: 1 intact, 0 broken. By default it is a function of
    the largest driving variable ``x`` so far, so that damage is irreversible; ``effect`` can change this. For a
    critical stretch ``x = s / s_c``: compression causes no damage. The laws below describe forces and critical
    stretches for driving variables that are linear in the elongation. For other driving variables ``phi`` is the same
    function of x. Derive from this class for a new law.

    Parameters
    ----------
    criterion : Criterion
        Criterion of the damage, such as a critical stretch.
    protected : Region, optional
        Bonds with an end in this region do not fail.
    effect : DamageEvolution
        Evolution of damage, and its effect on the force states of deformation gradients. ``PresentStretch()`` is that
        of Hashim et al. Bond materials support the default only.
    closes : bool
        True if closed cracks carry compression: a shortened bond has its full stiffness, even if it is damaged or
        broken. For bond materials only. The ends of the bond do not change, so faces that slide past each other by more
        than a spacing require contact.
    """

    criterion: Criterion
    protected: Region | None = field(default=None, kw_only=True)
    effect: DamageEvolution = field(default_factory=LargestStretch, kw_only=True)
    closes: bool = field(default=False, kw_only=True)

    def __init_subclass__(cls) -> None:
        super().__init_subclass__()
        accept_old_methods(cls, {"integrity": "phi"})

    def __post_init__(self) -> None:
        if not isinstance(self.criterion, Criterion):
            raise CaseError(
                f"{type(self).__name__} needs a criterion, a critical stretch such as ConstantCritical(0.01), "
                f"not {shown(self.criterion)}."
            )
        super().__post_init__()

    @property
    def onset(self) -> float:
        """Return the driving variable at which the degradation factor begins to decrease [-]: 1."""
        return 1.0

    @property
    @abstractmethod
    def final(self) -> float:
        """Return the driving variable at which the bond breaks [-]."""

    @abstractmethod
    def phi(self, x: Float) -> Float:
        """Compute the degradation factor (n,) [-] for x between onset and final."""

    @abstractmethod
    def slope(self, x: Float) -> Float:
        """Compute ``dphi/dx`` (n,) [-] for x between onset and final."""

    def dissipated(self, phi: Float, x: Float, energy: Float, degree: float = 2.0) -> Float:
        """Compute the energy that linear bonds have dissipated up to x (n,) [energy].

        ``-int W y^degree dphi(y)`` up to x, with the jumps of ``phi`` at onset and final.

        Parameters
        ----------
        phi, x, energy : (n,) float64
            Degradation factor [-], largest driving variable [-], elastic energy ``W`` of the intact bond at driving
            variable 1 [energy].
        degree : float
            Power of the driving variable in that energy [-].
        """
        points, weights = scipy.special.roots_legendre(QUADRATURE)
        one, last = np.array([self.onset]), np.array([self.final])
        lost = np.where(x > self.onset, self.onset**degree * (1.0 - self.phi(one)[0]), 0.0)
        lost += np.where(x >= self.final, self.final**degree * self.phi(last)[0], 0.0)
        for begin, end in zip(self.pieces[:-1], self.pieces[1:], strict=True):
            half = 0.5 * (np.clip(x, begin, end) - begin)
            y = begin + (points[:, None] + 1.0) * half
            slope = self.slope(y.ravel()).reshape(y.shape)
            lost -= half * (weights[:, None] * slope * y**degree).sum(axis=0)
        return np.asarray(energy * lost)

    def toughness(self, degree: float) -> float:
        """Compute the energy of breaking a bond over its elastic energy at driving variable 1 [-].

        Parameters
        ----------
        degree : float
            Power of the driving variable in the elastic energy [-].
        """
        one = np.ones(1)
        return float(self.dissipated(0.0 * one, self.final * one, one, degree)[0])

    @property
    def all_laws(self) -> list[BondDamage]:
        """Return a list of this law, as ``DamageOf`` returns its laws."""
        return [self]

    @property
    def point_laws(self) -> list[Any]:
        """Return an empty list: this is a law of bonds."""
        return []

    def rehearsed(self) -> BondDamage:
        """Return the law for a small body on which its loops are compiled."""
        return LinearSoftening(ConstantCritical(1.0), effect=self.effect)

    def assign(self, bonds: DamageableBonds, mark: Marking) -> LocalIndex:
        """Return the number of the law of each bond (n_bonds,): 0, or -1 for a protected bond (collective)."""
        if self.protected is None:  # one number for all bonds
            return np.broadcast_to(np.int32(0), bonds.families.n_bonds)
        return spare(np.zeros(bonds.families.n_bonds, dtype=np.int32), [self], None, mark, bonds.with_end)

    @property
    def places(self) -> list[tuple[str, Region]]:
        """Return its regions with their descriptions."""
        return [] if self.protected is None else [("What damage is protected from", self.protected)]

    def resolved(self, bonds: DamageableBonds) -> BondDamage:
        """Return the law with the criterion resolved for the bonds of the body (collective)."""
        criterion = self.criterion.resolve(bonds, self.toughness)
        return self if criterion is self.criterion else replace(self, criterion=criterion)

    @property
    def pieces(self) -> list[float]:
        """Return the ends of the smooth parts of the law, from onset to final [-]."""
        return [self.onset, self.final]


@dataclass(frozen=True)
class PiecewiseLinear(BondDamage):
    """A law whose force decreases linearly to zero at ``final``, 1 for a bond that snaps; events support it.

    The driving variable is linear in the elongation of the bond.
    """

    def phi(self, x: Float) -> Float:
        """Return ``(r - x) / ((r - 1) x)``, 1 for a bond that snaps."""
        r = self.final
        return np.ones_like(x) if r == 1.0 else np.asarray((r - x) / ((r - 1.0) * x))

    def slope(self, x: Float) -> Float:
        """Return ``-r / ((r - 1) x^2)``, 0 for a bond that snaps."""
        r = self.final
        return np.zeros_like(x) if r == 1.0 else np.asarray(-r / ((r - 1.0) * x**2))

    def dissipated(self, phi: Float, x: Float, energy: Float, degree: float = 2.0) -> Float:
        """Compute the dissipated energy of linear bonds (n,) [energy]; closed form in ``phi`` for degree 2."""
        if degree != 2.0:
            return super().dissipated(phi, x, energy, degree)
        y = reached(phi, self.final)
        force = phi * y
        return np.asarray(energy * (1.0 + (1.0 + force) * (y - 1.0) - force * y))


def reached(phi: Float, final: Float | float) -> Float:
    """Compute x at which bonds of ``PiecewiseLinear`` laws with this degradation factor fail further (n,) [-].

    On the envelope ``q = k l (r - x) / (r - 1)``, with the final driving variable ``r``, ``q = T k l x``.
    """
    return np.asarray(final / (1.0 + phi * (final - 1.0)))


@dataclass(frozen=True)
class Brittle(PiecewiseLinear):
    """The force drops to zero at the critical stretch.

    Examples
    --------
    >>> import pdpetsc as pd
    >>> pd.Brittle(pd.ConstantCritical(0.01)).final
    1.0

    References
    ----------
    Silling2005, Eq. (24); Mikes2021, Eq. (7).
    """

    final = 1.0


@dataclass(frozen=True)
class LinearSoftening(PiecewiseLinear):
    """The force decreases linearly from the critical stretch to zero at ``ratio`` times that stretch.

    Parameters
    ----------
    ratio : float, optional
        Above 1; 2 by default.
    strength : float, optional
        Instead of a ratio, the largest traction of an opening plane [stress], for bond-based materials with
        ``FractureEnergy``. The strength determines the critical stretch, then the fracture energy the ratio. Bonds
        across the plane reach their largest forces together only if they soften slowly: on a square lattice with a
        horizon of 3 spacings the traction is .78 of the strength at a ratio of 3, .92 at 10, .98 at 60.

    Raises
    ------
    CaseError
        Ratio and strength are both declared, or a strength without ``FractureEnergy``. In a case: the strength is too
        high for the fracture energy and the horizon, or materials or horizons of the bonds differ.

    Examples
    --------
    >>> import pdpetsc as pd
    >>> softening = pd.LinearSoftening(pd.ConstantCritical(0.01), ratio=3.0)
    >>> concrete = pd.LinearSoftening(pd.FractureEnergy(0.1), strength=3.0)
    """

    ratio: AboveOne | None = None
    strength: Positive | None = field(default=None, kw_only=True)

    def __post_init__(self) -> None:
        super().__post_init__()
        if self.strength is not None and self.ratio is not None:
            raise CaseError(
                "LinearSoftening takes a ratio or a strength, not both: the ratio follows from strength and energy."
            )
        if self.strength is not None and not isinstance(self.criterion, FractureEnergy):
            kind = type(self.criterion).__name__
            raise CaseError(f"LinearSoftening with a strength needs FractureEnergy(Gc), not {kind}.")

    @property
    def final(self) -> float:
        """Return the ratio; infinite if a strength is declared and not resolved yet."""
        if self.strength is not None:
            return math.inf
        return 2.0 if self.ratio is None else self.ratio

    def resolved(self, bonds: DamageableBonds) -> BondDamage:
        """Return the law with a critical stretch and a ratio (collective)."""
        if self.strength is None:
            return super().resolved(bonds)
        assert isinstance(self.criterion, FractureEnergy)
        critical, ratio = self.criterion.at_strength(bonds, self.strength)
        return replace(self, criterion=critical, ratio=ratio, strength=None)


@dataclass(frozen=True)
class ExponentialSoftening(BondDamage):
    """The force decreases as ``exp(-rate (x - 1))``, shifted to zero at ``ratio`` times the critical stretch.

    Parameters
    ----------
    ratio : float
        Above 1.
    rate : float
        Positive.

    Examples
    --------
    >>> import pdpetsc as pd
    >>> softening = pd.ExponentialSoftening(pd.ConstantCritical(0.01), ratio=8.0, rate=0.5)
    """

    ratio: AboveOne = 5.0
    rate: Positive = 1.0

    @property
    def final(self) -> float:
        return self.ratio

    def phi(self, x: Float) -> Float:
        rest = math.exp(-self.rate * (self.ratio - 1.0))
        return np.asarray((np.exp(-self.rate * (x - 1.0)) - rest) / (1.0 - rest) / x)

    def slope(self, x: Float) -> Float:
        rest = math.exp(-self.rate * (self.ratio - 1.0))
        softening = np.exp(-self.rate * (x - 1.0))
        return np.asarray(-(self.rate * softening + (softening - rest) / x) / (1.0 - rest) / x)


@dataclass(frozen=True)
class BilinearSoftening(BondDamage):
    """The force decreases linearly to ``share`` of its largest value at ``kink``, then linearly to zero at ``ratio``.

    Parameters
    ----------
    kink, share, ratio : float
        Stretches over the critical one, ``1 < kink < ratio``, and the share of the force, between 0 and 1.

    Examples
    --------
    >>> import pdpetsc as pd
    >>> concrete = pd.BilinearSoftening(pd.FractureEnergy(0.1), kink=2.0, share=0.3, ratio=6.0)
    """

    kink: AboveOne = 2.0
    share: Fraction = 0.3
    ratio: AboveOne = 6.0

    def __post_init__(self) -> None:
        super().__post_init__()
        if self.kink >= self.ratio:
            raise CaseError(f"BilinearSoftening needs kink < ratio, not kink={self.kink} and ratio={self.ratio}.")

    @property
    def final(self) -> float:
        return self.ratio

    def phi(self, x: Float) -> Float:
        return np.asarray(np.interp(x, [1.0, self.kink, self.ratio], [1.0, self.share, 0.0]) / x)

    def slope(self, x: Float) -> Float:
        first, second = (self.share - 1.0) / (self.kink - 1.0), -self.share / (self.ratio - self.kink)
        return np.asarray((np.where(x < self.kink, first, second) - self.phi(x)) / x)

    @property
    def pieces(self) -> list[float]:
        """Return onset, kink and final [-]."""
        return [1.0, self.kink, self.ratio]


@dataclass(frozen=True)
class SmoothDegradation(BondDamage):
    """The factor ``T_s = 1/2 (1 - tanh n)``, ``n = beta (s_min + s_cr - 2 s) / (s_min - s_cr)``, from s_min to s_cr.

    Parameters
    ----------
    start : float
        ``s_min / s_cr``, between 0 and 1.
    beta : float
        Positive.
    continuous : bool
        True rescales the factor to go from 1 to 0; as published it jumps by ``1/2 (1 - tanh beta)`` at both ends,
        0.0025 for beta 3.

    Examples
    --------
    >>> import pdpetsc as pd
    >>> smooth = pd.SmoothDegradation(pd.ConstantCritical(0.02), start=0.75)

    References
    ----------
    Hashim, Eq. (48)-(54).
    """

    start: Fraction = 0.75
    beta: Positive = 3.0
    continuous: bool = True

    @property
    def onset(self) -> float:
        """Return ``s_min / s_cr``."""
        return self.start

    final = 1.0

    def phi(self, x: Float) -> Float:
        """Return ``T_s``."""
        T = 0.5 * (1.0 - np.tanh(self._n(x)))
        return np.asarray(0.5 + (T - 0.5) / math.tanh(self.beta) if self.continuous else T)

    def slope(self, x: Float) -> Float:
        """Return ``dT_s/dx``."""
        slope = (np.tanh(self._n(x)) ** 2 - 1.0) * self.beta / (1.0 - self.start)
        return np.asarray(slope / math.tanh(self.beta) if self.continuous else slope)

    def _n(self, x: Float) -> Float:
        return self.beta * (self.start + 1.0 - 2.0 * x) / (self.start - 1.0)
