"""How a bond loses its force as what drives its damage grows."""

from __future__ import annotations

import math
from abc import ABC, abstractmethod
from collections.abc import Callable
from dataclasses import dataclass, field, replace
from typing import Annotated, Any, TypeAlias

import numpy as np
import scipy

from pdpetsc.arrays import Float, GlobalIndex, Mask
from pdpetsc.damage.criterion import Criterion, DamageableBonds
from pdpetsc.damage.critical import ConstantCritical, FractureEnergy
from pdpetsc.damage.evolution import DamageEvolution, LargestStretch
from pdpetsc.declare.region import Region
from pdpetsc.declared import Bound, Declared, Fraction, Positive, shown
from pdpetsc.errors import CaseError
from pdpetsc.renamed import accept_old_methods

# Points of the quadrature of the dissipated energy.
QUADRATURE = 40

# A driving variable at which a softening bond fails further: above the one at which damage begins.
AboveOne: TypeAlias = Annotated[
    float, Bound(("a finite number above 1", "finite numbers above 1"), lambda x: math.isfinite(x) and x > 1.0)
]


# Marks the local particles in a region (n_local,); the text says what of (collective).
Marking: TypeAlias = Callable[[Region, str], Mask]


def bonds_at(region: Region | None, bonds: DamageableBonds, mark: Marking) -> Mask:
    """Return which bonds have an end in a protected region (n_bonds,), none without a region (collective)."""
    if region is None:
        return np.zeros(bonds.families.n_bonds, dtype=bool)
    marked = mark(region, "what damage is protected from")
    return np.asarray(marked[bonds.families.centres] | marked[bonds.families.neighbours])


@dataclass(frozen=True)
class BondDamage(Declared, ABC):
    """A bond keeps its force until the drive of its damage is 1 and loses it beyond; what it lost it does not regain.

    Its state is the degradation factor ``T``, what its force is multiplied with: 1 intact, 0 broken, a function of the
    largest drive ``x`` that the bond has had, unless ``effect`` says otherwise. The drive of a critical stretch is the
    stretch over it, ``x = s / s_c``: compression does no damage. What the laws below say of forces and critical
    stretches is for drives that are linear in the elongation; with another one ``T`` is the same function of x. Derive
    from it for another law.

    Parameters
    ----------
    criterion : Criterion
        What drives the damage, such as a critical stretch.
    protected : Region, optional
        Bonds with an end in it do not fail.
    effect : DamageEffect
        How the degradation factor enters the force states of deformation gradients; ``PresentStretch()`` as published
        by Hashim et al. Bodies of bonds take the default alone.
    closes : bool
        Whether cracks that close carry compression: a bond that is shorter than at the start has its whole stiffness,
        however damaged or broken it is. Of bond-based materials alone; the ends of the bond are those that it had, so
        that faces which slide past each other by more than a spacing need contact.
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
    def declared(self) -> list[BondDamage]:
        """Return the laws of bonds that fail: this one."""
        return [self]

    @property
    def onset(self) -> float:
        """Return x where the degradation factor begins to fall [-]: where the drive is 1."""
        return 1.0

    @property
    @abstractmethod
    def final(self) -> float:
        """Return x where the bond breaks [-]."""

    @abstractmethod
    def phi(self, x: Float) -> Float:
        """Return ``T`` (n,) [-] for x between onset and final."""

    @abstractmethod
    def slope(self, x: Float) -> Float:
        """Return ``dT/dx`` (n,) [-] for x between onset and final."""

    def dissipated(self, phi: Float, x: Float, energy: Float, degree: float = 2.0) -> Float:
        """Return what linear bonds that have reached x have dissipated (n,) [energy].

        ``-int W y^degree dT(y)`` up to x, with the jumps of T at its ends.

        Parameters
        ----------
        phi, x, energy : (n,) float64
            Degradation factor [-], largest drive [-], elastic energy ``W`` of the intact bond where the drive is 1
            [energy].
        degree : float
            With which power of the drive that energy grows [-].
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
        """Return the energy that breaking a bond takes over its elastic energy where the drive is 1 [-].

        Parameters
        ----------
        degree : float
            With which power of the drive the elastic energy grows [-].
        """
        one = np.ones(1)
        return float(self.dissipated(0.0 * one, self.final * one, one, degree)[0])

    @property
    def all_laws(self) -> list[BondDamage]:
        """Return the law itself, as ``DamageOf`` returns its laws."""
        return [self]

    @property
    def point_laws(self) -> list[Any]:
        """Return no laws: this is a law of bonds."""
        return []

    def rehearsed(self) -> BondDamage:
        """Return damage of another body with which its loops can be compiled."""
        return LinearSoftening(ConstantCritical(1.0), effect=self.effect)

    def assign(self, bonds: DamageableBonds, mark: Marking) -> GlobalIndex:
        """Return the number of the law of each bond (n_bonds,): 0, or -1 for a protected bond (collective)."""
        of_bond = np.zeros(bonds.families.n_bonds, dtype=np.int64)
        of_bond[bonds_at(self.protected, bonds, mark)] = -1
        return of_bond

    @property
    def places(self) -> list[tuple[str, Region]]:
        """Return its regions with what they are."""
        return [] if self.protected is None else [("What damage is protected from", self.protected)]

    def resolved(self, bonds: DamageableBonds) -> BondDamage:
        """Return the law whose criterion knows the bonds of the body (collective)."""
        criterion = self.criterion.resolve(bonds, self.toughness)
        return self if criterion is self.criterion else replace(self, criterion=criterion)

    @property
    def pieces(self) -> list[float]:
        """Return the ends of the parts of the law that are smooth, from onset to final [-]."""
        return [self.onset, self.final]


@dataclass(frozen=True)
class PiecewiseLinear(BondDamage):
    """A law whose force falls linearly to zero at the drive ``final``, 1 for a bond that snaps; events can follow it.

    The drive is linear in the elongation of the bond.
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
        """Return what linear bonds have dissipated (n,) [energy]; from their degradation factor alone for degree 2."""
        if degree != 2.0:
            return super().dissipated(phi, x, energy, degree)
        y = reached(phi, self.final)
        force = phi * y
        return np.asarray(energy * (1.0 + (1.0 + force) * (y - 1.0) - force * y))


def reached(phi: Float, final: Float | float) -> Float:
    """Return x at which bonds of ``PiecewiseLinear`` laws with this degradation factor fail further (n,) [-].

    On the envelope ``q = k l (r - x) / (r - 1)``, with the final drive ``r``, ``q = T k l x``.
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

    @property
    def final(self) -> float:
        """Return 1."""
        return 1.0


@dataclass(frozen=True)
class LinearSoftening(PiecewiseLinear):
    """The force falls linearly from the critical stretch to zero at ``ratio`` times that.

    Parameters
    ----------
    ratio : float, optional
        Above 1; 2 by default.
    strength : float, optional
        Instead of a ratio, the largest traction of a plane that opens [stress], of bond-based materials with
        ``FractureEnergy``. The critical stretch follows from the strength, the ratio then from the fracture energy.
        Bonds across the plane reach their largest forces together only if they soften slowly: on a square lattice
        with a horizon of 3 spacings the traction is .78 of the strength at a ratio of 3, .92 at 10, .98 at 60.

    Raises
    ------
    CaseError
        Ratio and strength are both given, or a strength without ``FractureEnergy``. In a case: the strength is too
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
        """Return the ratio; infinite if a strength decides about it that no bonds are known for."""
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
    """The force falls as ``exp(-rate (x - 1))``, shifted to be zero at ``ratio`` times the critical stretch.

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
        """Return the ratio."""
        return self.ratio

    def phi(self, x: Float) -> Float:
        """Return force over elastic force."""
        rest = math.exp(-self.rate * (self.ratio - 1.0))
        return np.asarray((np.exp(-self.rate * (x - 1.0)) - rest) / (1.0 - rest) / x)

    def slope(self, x: Float) -> Float:
        """Return its derivative."""
        rest = math.exp(-self.rate * (self.ratio - 1.0))
        softening = np.exp(-self.rate * (x - 1.0))
        return np.asarray(-(self.rate * softening + (softening - rest) / x) / (1.0 - rest) / x)


@dataclass(frozen=True)
class BilinearSoftening(BondDamage):
    """The force falls linearly to ``share`` of its largest value at ``kink``, then linearly to zero at ``ratio``.

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
        """Return the ratio."""
        return self.ratio

    def phi(self, x: Float) -> Float:
        """Return force over elastic force."""
        return np.asarray(np.interp(x, [1.0, self.kink, self.ratio], [1.0, self.share, 0.0]) / x)

    def slope(self, x: Float) -> Float:
        """Return its derivative."""
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
        Rescale it to go from 1 to 0; as published it jumps by ``1/2 (1 - tanh beta)`` at both ends, 0.0025 for beta 3.

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

    @property
    def final(self) -> float:
        """Return 1."""
        return 1.0

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
