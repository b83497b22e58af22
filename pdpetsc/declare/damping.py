"""Damping of a motion: proportional to mass in a region, of shocks, and boundaries that absorb waves."""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import Any, ClassVar

from pdpetsc.declare.conditions import Condition
from pdpetsc.declare.region import All, Region
from pdpetsc.declared import NonNegative
from pdpetsc.errors import CaseError


@dataclass(frozen=True)
class RayleighDamping(Condition):
    """Damping forces ``(mass M + stiffness K_0) v`` of a motion.

    ``K_0`` is the tangent of the undeformed body, material and zero-energy control; it is refused with damage. A wave
    of the circular frequency w has the damping ratio ``mass / (2 w) + stiffness w / 2``. Several of them add up.

    Parameters
    ----------
    mass : float
        [1 / time].
    stiffness : float
        [time]. It shortens the stable step of ``Explicit``; ``SnapThrough`` has a radius for short waves instead.
    region : Region
        Particles on which the first part acts; by default all. The second part acts on the whole body.

    References
    ----------
    Hughes1987, section 7.2.

    Examples
    --------
    >>> import pdpetsc as pd
    >>> damped = pd.RayleighDamping(mass=50.0)
    >>> layer = pd.RayleighDamping(mass=1e4, region=pd.region.Slab("x", low=9.0))
    """

    mass: NonNegative = 0.0
    stiffness: NonNegative = 0.0
    region: Region = field(default_factory=All)

    def put(self, onto: Any, name: str) -> None:
        onto.rayleigh_damping(self, name)

    def __post_init__(self) -> None:
        super().__post_init__()
        if self.mass == self.stiffness == 0.0:
            raise CaseError("RayleighDamping takes a positive mass or stiffness.")


@dataclass(frozen=True)
class BulkViscosity(Condition):
    """Viscous pressure that widens shocks to a few spacings and damps the oscillations behind them.

    ``sigma = rho h (c_1 c_d - c_2^2 h min(tr D, 0)) tr(D) 1`` with the rate of deformation ``D``, the spacing
    ``h = V^(1/dim)`` and the speed ``c_d`` of waves of compression in the undeformed material. It resists every change
    of volume, and compression more. For ``Explicit``, deformation gradients and bodies without a cell. The stable step
    shortens by ``sqrt(1 + x^2) - x`` with the largest ``x = c_1 - c_2^2 h min(tr D, 0) / c_d``.

    Parameters
    ----------
    linear, quadratic : float
        ``c_1``, ``c_2`` [-]; the defaults are usual.

    References
    ----------
    VonNeumann1950 (quadratic part); Landshoff1955 (linear part).

    Examples
    --------
    >>> import pdpetsc as pd
    >>> shock = pd.BulkViscosity()
    """

    linear: NonNegative = 0.06
    quadratic: NonNegative = 1.2

    def put(self, onto: Any, name: str) -> None:
        onto.bulk_viscosity(self, name)


@dataclass(frozen=True)
class AbsorbingBoundary(Condition):
    """Dashpots on a side of the body that let waves out: the traction ``-rho (c_d v_n + c_s v_t)``.

    It absorbs plane waves that hit the side at right angles; others are reflected in part. The speeds are those of the
    undeformed material, ``c_d = sqrt((lambda + 2 mu) / rho)`` and ``c_s = sqrt(mu / rho)``. Each facet brakes the
    particle whose cell it bounds.

    Parameters
    ----------
    region : Region or str
        Facets of the surface: a side, ``"-x"`` to ``"+z"``, a set or a region.

    References
    ----------
    Lysmer1969.

    Examples
    --------
    >>> import pdpetsc as pd
    >>> open_end = pd.AbsorbingBoundary("+x")
    """

    region: Region

    on_surface: ClassVar[bool] = True

    def put(self, onto: Any, name: str) -> None:
        onto.absorbing_boundary(self, name)
