"""Supports of a side of a body, and of a patch in the mean."""

from __future__ import annotations

from abc import abstractmethod
from collections.abc import Callable, Sequence
from dataclasses import dataclass, field, replace
from typing import Any, ClassVar, Literal

import numpy as np

from pdpetsc.arrays import Float
from pdpetsc.declare.conditions import Condition, Displacement, VectorCondition, condition_name
from pdpetsc.declare.motion import RigidMotion
from pdpetsc.declare.particles import WHOLE_CELLS, Lattice, Particles
from pdpetsc.declare.region import Face, Region
from pdpetsc.declare.symmetry import Symmetry
from pdpetsc.declared import NonNegative, numbers_from
from pdpetsc.errors import CaseError


@dataclass(frozen=True)
class _Support(Condition):
    region: Region

    @abstractmethod
    def beyond(self, lattice: Lattice, horizon: float) -> tuple[Lattice, list[Symmetry]]:
        """Return the lattice with the layers that hold its side, and the mirror planes."""

    def _on(self, particles: Particles) -> Region:
        """Return the region of particles on the surface; raise CaseError if particles are behind the surface."""
        if not particles.on_surface:
            kind = type(particles).__name__
            raise CaseError(
                f"{type(self).__name__} holds the surface, and particles of {kind} are behind it. Use LatticeNodes or "
                "MeshNodes, or hold a region with Displacement."
            )
        return self.region

    def _side(self) -> Face:
        if not isinstance(self.region, Face):
            raise CaseError(
                f"{type(self).__name__} of a Lattice requires the name of a side, such as '-x', not {self.region}. For "
                "other regions use LatticeNodes."
            )
        return self.region


@dataclass(frozen=True)
class RigidRegion(RigidMotion, _Support):
    """Move a side or a region as a rigid body, with finite rotations.

    Particles are chosen as by ``Clamp``; of a ``Lattice`` also those of any region, which are then held themselves.
    ``Reaction`` and ``ReactionMoment`` of the region are the force and the moment that move it, in a motion less those
    of its inertia. With ``force`` or ``moment`` the motion follows from these loads, with ``Newton``,
    ``PathFollowing``, ``Implicit`` or ``Explicit``; with ``Modes`` the region is a rigid mass that moves in the free
    directions. In a motion the particles have their mass, and begin with the momentum and angular momentum of
    ``InitialVelocity``.

    With ``moment`` take a material for large rotations, such as ``NeoHookean``. Those of small strain resist the
    rotation of the region itself: of a beam with a region over its half the deflection is 6 % too small where it turns
    by 0.03 rad. They are refused in a motion, and a run warns of them where a region turns by more than 0.01 rad.

    Parameters
    ----------
    region : Region or str
        A side, ``"-x"`` to ``"+z"``, or the name of a set or a region.
    move, turn, about, force, moment, follows, schedule
        As for ``RigidMotion``.
    mass, inertia
        Beside those of the particles, at ``about``, as for ``RigidMotion``.

    Raises
    ------
    CaseError
        In a case: vectors of another dimension, or a rotation without ``about``. In a motion: the layers beyond a side
        of a ``Lattice``, particles on a line without ``inertia``, a moment with materials of small strain, or a
        rotation about another point than the centre of mass, with a force in some directions only.

    Examples
    --------
    >>> import pdpetsc as pd
    >>> rolled = pd.RigidRegion("+x", turn=3.0, move=(-2.0, 1.0), about=(10.0, 0.0))
    >>> twisted = pd.RigidRegion("+z", turn=(0.0, 0.0, 1.5), about=(0.0, 0.0, 5.0))
    >>> bent = pd.RigidRegion("+x", force=(0.0, 0.0), moment=2.0, about=(10.0, 0.0))
    >>> thrust = pd.RigidRegion("+x", force=(-5.0, 0.0), moment=0.0, about=(10.0, 0.0), follows=True)
    """

    def beyond(self, lattice: Lattice, horizon: float) -> tuple[Lattice, list[Symmetry]]:
        """Return the lattice with layers as deep as the horizon beyond a side, unless it has layers there."""
        return (_with_layers(lattice, self.region.side, horizon) if isinstance(self.region, Face) else lattice), []

    def put(self, onto: Any, name: str) -> None:
        free = isinstance(onto.particles, Lattice) or not isinstance(self.region, Face)
        onto.rigid_region(self, self.region if free else self._on(onto.particles), name)


@dataclass(frozen=True)
class Clamp(_Support):
    """Clamp a side of the body: no displacement.

    Particles on the surface (``LatticeNodes``, ``MeshNodes``) are held themselves; the error is of second order with
    conforming weights. Particles of a ``Lattice`` are half a cell behind the side: layers of fictitious particles as
    deep as the horizon are added beyond it, and held. Other particles are refused.

    Parameters
    ----------
    region : Region or str
        A side, ``"-x"`` to ``"+z"``, or the name of a set or a region of particles on the surface.

    Raises
    ------
    CaseError
        In a case: the particles are behind the side, and it is not a side of a ``Lattice``.

    Examples
    --------
    >>> import pdpetsc as pd
    >>> conditions = [pd.Clamp("-x"), pd.Traction("+x", y=-2.0)]
    """

    def beyond(self, lattice: Lattice, horizon: float) -> tuple[Lattice, list[Symmetry]]:
        """Return the lattice with layers as deep as the horizon, unless it has layers there."""
        return _with_layers(lattice, self._side().side, horizon), []

    def put(self, onto: Any, name: str) -> None:
        region = self._side() if isinstance(onto.particles, Lattice) else self._on(onto.particles)
        dim = onto.body.dim
        held = Displacement(region, 0.0, 0.0 if dim > 1 else None, 0.0 if dim > 2 else None)
        onto.displacement(held, name)


@dataclass(frozen=True)
class Roller(_Support):
    """Hold a side along its normal; it slides freely in its plane.

    Particles on the surface (``LatticeNodes``, ``MeshNodes``) have no displacement along the normal, ``n . u = 0``. The
    side of a ``Lattice`` becomes a mirror plane, ``Symmetry``, which is exact to round-off; loads, reactions and
    energies are those of the body. Other particles are refused.

    Parameters
    ----------
    region : Region or str
        As for ``Clamp``.
    axis : {"x", "y", "z"}, optional
        The normal of a region that is not the side of a box.
    normal : sequence of float or callable, optional
        The normal instead of ``axis``, of any direction and length: (dim,), or a function of positions (n, dim) that
        returns the normals (n, dim) in the undeformed body.

    Raises
    ------
    CaseError
        In a case: as for ``Clamp``; ``axis`` or ``normal`` is missing for a set or region; a normal is zero; or another
        condition prescribes the largest component of a normal between the axes, or ties another one.

    Examples
    --------
    >>> import pdpetsc as pd
    >>> quarter = [pd.Roller("-x"), pd.Roller("-y"), pd.Traction("+x", x=2.0)]
    >>> wedge = pd.Roller("inclined", normal=(1.0, -1.0))
    >>> sleeve = pd.Roller("outside", normal=lambda x: x)
    """

    axis: Literal["x", "y", "z"] | None = None
    normal: Sequence[float] | Callable[[Float], Float] = field(default=(), kw_only=True)

    def __post_init__(self) -> None:
        super().__post_init__()
        given = (self.axis is not None) + (callable(self.normal) or len(self.normal) > 0)
        if given != (not isinstance(self.region, Face)):
            raise CaseError(
                "A Roller on a set or region requires either `axis`, the axis of its normal, or `normal`. A Roller on "
                "a side must have neither."
            )

    def normals(self, x: Float) -> Float:
        """Return the unit normals (n, dim) at positions (n, dim)."""
        if len(x) == 0:
            return np.zeros_like(x)
        if callable(self.normal):
            found = numbers_from("normal of a Roller", self.normal, x)
        else:
            found = np.asarray(self.normal, dtype=float)
        if found.shape not in (x.shape, x.shape[1:]):
            raise CaseError(f"The normal of a Roller has the shape {found.shape}, not {x.shape[1:]} or {x.shape}.")
        length = np.broadcast_to(np.linalg.norm(found, axis=-1, keepdims=True), (len(x), 1))
        if not np.all(np.isfinite(length) & (length > 0.0)):
            raise CaseError("The normal of a Roller must be finite and not zero.")
        return np.asarray(found / length)

    def beyond(self, lattice: Lattice, horizon: float) -> tuple[Lattice, list[Symmetry]]:
        """Return the lattice, and a mirror plane along the side."""
        face = self._side()
        low, high = lattice.box
        at = (low if face.side[0] == "-" else high)[face.axis]
        return lattice, [Symmetry("xyz"[face.axis], float(at))]  # type: ignore[arg-type]

    def put(self, onto: Any, name: str) -> None:
        """Prescribe zero for the normal component; a mirror plane needs no condition."""
        if isinstance(onto.particles, Lattice):
            return
        if self.axis is None and not isinstance(self.region, Face):
            onto.roller(self._on(onto.particles), self.normals, name)
            return
        across = self.axis if self.axis is not None else self._side().side[1]
        x, y, z = (0.0 if axis == across else None for axis in "xyz")
        onto.displacement(Displacement(self._on(onto.particles), x, y, z), name)


@dataclass(frozen=True)
class Foundation(Condition):
    """Springs between a side of the body and the ground, ``t = -(normal n (x) n + tangential (1 - n (x) n)) u``.

    ``t`` is the traction on a facet with the normal ``n`` in the undeformed body. The springs also pull; a foundation
    that the body may leave is a ``Contact`` with a ``RigidPlane`` of this ``stiffness``.

    Parameters
    ----------
    region : Region or str
        Facets of the surface: a side, ``"-x"`` to ``"+z"``, a set or a region.
    normal, tangential : float
        Stiffness along and across the normal [stress / length]; ``tangential`` is 0 by default.
    name : str
        Prefix of the columns ``NAME_x``, ``NAME_y`` (force of the ground on the body) in the history.

    Raises
    ------
    CaseError
        Both stiffnesses are 0; in a case: the surface of the particles is not known.

    References
    ----------
    Hetenyi1946, chapter 1.

    Examples
    --------
    >>> import pdpetsc as pd
    >>> bed = pd.Foundation("-y", normal=0.05)
    """

    region: Region
    normal: NonNegative
    tangential: NonNegative = 0.0
    name: str = "foundation"

    on_surface: ClassVar[bool] = True

    def __post_init__(self) -> None:
        super().__post_init__()
        if self.normal == self.tangential == 0.0:
            raise CaseError("A Foundation requires a positive stiffness `normal` or `tangential`.")

    def put(self, onto: Any, name: str) -> None:
        onto.foundation(self, name)


@dataclass(frozen=True)
class PointSupport(VectorCondition):
    """Prescribe the mean displacement of a patch that is free to rotate, such as a support or a load pad.

    The volume-weighted mean ``sum_i V_i u_i / sum_i V_i`` over the particles of a region has the declared components.
    The reaction acts on the particles in proportion to their volumes. ``Displacement`` would hold each particle, which
    prevents rotation already for two particles.

    Parameters
    ----------
    region : Region or str
        The patch, two to four spacings wide: the stress is then not singular. The support acts at the middle of the
        patch; let a beam overhang its supports by half a patch.
    x, y, z : float or callable, optional
        Components of the mean displacement [length]: numbers, or functions of the middle of the patch (1, dim) and the
        load parameter that return one value.
    schedule : callable, optional
        As for ``Displacement``.

    Raises
    ------
    CaseError
        In a case: a particle of the region is held or tied by another condition too.

    Examples
    --------
    >>> import pdpetsc as pd
    >>> left = pd.PointSupport(pd.region.Sphere((0.0, 0.0), 2.0), x=0.0, y=0.0)
    >>> pushed = pd.PointSupport(pd.region.Sphere((50.0, 20.0), 2.0), y=-1.0)
    """

    def put(self, onto: Any, name: str) -> None:
        """Constrain one particle of the patch by the others."""
        onto.mean_displacement(self, name)


def _with_layers(lattice: Lattice, side: str, horizon: float) -> Lattice:
    """Return a lattice with layers as deep as the horizon beyond a side, unless it has layers there."""
    if side in lattice.fictitious:
        return lattice
    depth = max(int(horizon / lattice.spacing * (1.0 + WHOLE_CELLS)), 1) * lattice.spacing
    return replace(lattice, fictitious={**lattice.fictitious, side: depth})


def beyond_sides(
    particles: Particles, conditions: Sequence[Condition], horizon: object
) -> tuple[Particles, list[Symmetry]]:
    """Return the particles with the layers that supports add beyond sides, and the mirror planes of supports.

    Raises
    ------
    CaseError
        A support cannot hold its side.
    """
    planes: list[Symmetry] = []
    for number, condition in enumerate(conditions, 1):
        if isinstance(condition, _Support) and isinstance(particles, Lattice):
            if not isinstance(horizon, float | int):
                raise CaseError(
                    f"{condition_name(condition, number)} requires one horizon for all particles. Use a number as "
                    "`horizon`, or layers with Lattice(fictitious=...) and Displacement."
                )
            condition.region.check(particles.dim)
            particles, more = condition.beyond(particles, float(horizon))
            planes += more
    return particles, planes
