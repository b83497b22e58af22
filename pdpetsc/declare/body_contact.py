"""Contact between the surfaces of bodies, of a body with itself, and between particles."""

from __future__ import annotations

from abc import ABC, abstractmethod
from dataclasses import dataclass, field
from typing import Any, ClassVar

from pdpetsc.declare.conditions import Condition
from pdpetsc.declare.region import All, Region, region_of_name
from pdpetsc.declared import Fraction, NonNegativeOrInfinite, Positive

# Reach of a contact by default, in horizons.
REACH = 4.0
# Distance from a facet to the particles that interpolate its displacement, at both ends, and to its owner [horizons].
AROUND = 3.0


@dataclass(frozen=True)
class TwoParts(Condition, ABC):
    """A condition between the facets of two parts of the surface.

    Parameters
    ----------
    region, other : Region or str
        Facets of both parts: the name of a body in ``Bodies``, its side (``"lower +y"``), a set or a region.
    """

    region: Region
    other: Region

    on_surface: ClassVar[bool] = True

    def __post_init__(self) -> None:
        if isinstance(self.other, str):
            object.__setattr__(self, "other", region_of_name(self.other))
        super().__post_init__()

    @abstractmethod
    def beyond(self, horizon: float) -> float:
        """Return the distance beyond a horizon at which ranks exchange particles at the surface [length]."""


@dataclass(frozen=True)
class BodyContact(TwoParts):
    """Contact of two parts of the surface, with Coulomb friction: of two bodies, or of a body with itself.

    Facets of both parts that face each other and overlap, seen along the mean of their normals, form pairs. Both
    facets of a pair feel opposite forces at the middle of the overlap: the pressure ``p = <p0 - stiffness g>``, and
    friction as for ``Contact``, times the area of the overlap. ``g`` is the mean gap over the overlaps of the facets of
    one particle. A uniform pressure is transferred exactly, whatever the spacings of both sides. Forces and moments of
    both bodies balance to round-off, and friction turns with the surfaces. The pairs are those of the deformed
    surfaces, with an exact tangent, which is not symmetric.

    Parameters
    ----------
    region : Region or str
        Facets of one part: the name of a body in ``Bodies``, its side (``"lower +y"``), a set or a region.
    other : Region or str
        Facets of the other part; the same region for the contact of a body with itself. Facets that face each other
        through the material do not touch.
    friction, stiffness, penetration, name
        As for ``Contact``, with the coarser spacing of both sides. The columns ``NAME_x``, ... are the force of the
        other part on the region. If facets belong to both parts, there is ``NAME_force`` instead, the sum of the
        pressures times their areas.
    reach : float, optional
        Largest distance in the undeformed bodies of points that come into contact [length]; by default four of the
        largest horizons. A run in which the parts have moved further, relative to each other, fails. On several ranks
        particles within this distance of each other are exchanged.

    Raises
    ------
    CaseError
        In a case: bodies overlap at the start, another contact has some pairs of facets too, in a periodic cell, or
        outlines of the facets of a solid are unknown.
    SolveError
        As for ``Contact``; or the bodies have moved further than ``reach``.

    References
    ----------
    Wriggers2006, sections 5.1 and 5.2 (penalty), 5.4 (augmented Lagrange), 10.5 (return mapping).

    Examples
    --------
    >>> import pdpetsc as pd
    >>> touching = pd.BodyContact("wheel", "rail +y", friction=0.3, name="wheel")
    """

    friction: NonNegativeOrInfinite = 0.0
    stiffness: Positive | None = None
    penetration: Fraction = 0.01
    reach: Positive | None = None
    name: str = "contact"

    def put(self, onto: Any, name: str) -> None:
        onto.body_contact(self, name)

    def beyond(self, horizon: float) -> float:
        """Return the distance beyond a horizon at which particles are exchanged [length]."""
        return self.reach_at(horizon) + AROUND * horizon

    def reach_at(self, horizon: float) -> float:
        """Return the reach for the largest horizon [length]."""
        return REACH * horizon if self.reach is None else self.reach


@dataclass(frozen=True)
class Tied(TwoParts):
    """Tie two parts of the surface that touch or nearly touch, so that bodies of different spacings move as one.

    Facets that overlap in the undeformed bodies form pairs. Both facets of a pair feel opposite tractions
    ``stiffness (u - u')`` of the displacements at the middle of the overlap, times its area. A uniform stress passes
    exactly; the displacements differ by the traction over the stiffness. Heat passes as through the body.

    Parameters
    ----------
    region, other : Region or str
        Facets of both parts, as for ``BodyContact``.
    stiffness : float, optional
        [stress / length]; by default 1000 times the modulus ``lambda + 2 mu / dim`` over the coarser mean spacing.
    gap : float
        Largest distance of facets that are tied, over the spacing [-].
    name : str
        Prefix of the columns ``NAME_x``, ... of the force of the other part on the region.

    Raises
    ------
    CaseError
        In a case: no facets overlap within the gap, or another tie has some of them too; conditions hold both sides
        apart; in a periodic cell; or outlines of the facets of a solid are unknown.

    Examples
    --------
    >>> import pdpetsc as pd
    >>> glued = pd.Tied("fine -y", "coarse +y")
    """

    stiffness: Positive | None = None
    gap: Positive = 0.1
    name: str = "tie"

    def put(self, onto: Any, name: str) -> None:
        onto.tied(self, name)

    def beyond(self, horizon: float) -> float:
        """Return the distance beyond a horizon at which particles are exchanged [length]."""
        return AROUND * horizon


@dataclass(frozen=True)
class ParticleContact(Condition):
    """Short-range repulsion of particles without a bond, for fragments and for the faces of cracks.

    Two particles without a bond, or with a broken bond, repel each other along their distance r with the force
    ``stiffness A (r0 - r)`` if ``r < r0``. ``r0`` is ``distance``, or their distance in the undeformed body if that is
    smaller, so that there is no force at the start. The area A is ``sqrt(V_i V_j)`` over the mean spacing. There is no
    friction. Facets of surfaces transfer a pressure better: use ``BodyContact`` if bodies do not break.

    Parameters
    ----------
    region : Region or str
        The particles; by default all.
    distance : float, optional
        [length]; by default the mean spacing.
    stiffness : float, optional
        [stress / length]; by default the modulus ``lambda + 2 mu / dim`` over the mean spacing.
    name : str
        Prefix of the columns ``NAME_pairs`` (number of pairs that are pressed) and ``NAME_depth`` (largest ``r0 - r``
        over the spacing) in the history.

    Raises
    ------
    CaseError
        In a case: with a periodic cell or mirror planes.
    SolveError
        With Newton's method or ``DynamicRelaxation`` on several ranks: particles touch that are further apart in the
        undeformed body than ranks exchange. ``Explicit`` has no such limit.

    References
    ----------
    Macek2007 (short-range force).

    Examples
    --------
    >>> import pdpetsc as pd
    >>> fragments = pd.ParticleContact()
    """

    region: Region = field(default_factory=All)
    distance: Positive | None = None
    stiffness: Positive | None = None
    name: str = "fragments"

    def put(self, onto: Any, name: str) -> None:
        onto.particle_contact(self, name)
