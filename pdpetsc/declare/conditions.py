"""Conditions: prescribed displacements and dead loads on regions."""

from __future__ import annotations

import math
from abc import ABC, abstractmethod
from collections.abc import Callable, Sequence
from dataclasses import dataclass, field
from typing import Any, ClassVar, Literal, TypeAlias

import numpy as np

from pdpetsc.arrays import Float
from pdpetsc.declare.region import Region, accept_region_name
from pdpetsc.declare.schedule import Hold, Ramp, Schedule
from pdpetsc.declared import Declared, Finite, Positive, name_of, numbers_from
from pdpetsc.errors import CaseError, SolveError

# A number, which is multiplied by the schedule, or a function of positions (n, dim) and step time that returns (n,)
# values, which are multiplied by the schedule where one is given.
Value: TypeAlias = Finite | Callable[[Float, float], Float]


@dataclass(frozen=True)
class Condition(Declared, ABC):
    """A prescribed displacement, a load, or the mean strain or stress of a cell; derive from it for another one.

    A condition that has a ``region`` takes a name in its place: that of a side, ``"-x"`` to ``"+z"``
    (``pd.region.Face``), or that of a set.
    """

    def __post_init__(self) -> None:
        accept_region_name(self)
        super().__post_init__()

    @abstractmethod
    def put(self, onto: Any, name: str) -> None:
        """Apply it to ``onto`` (``terms.conditions.Applied``), which calls it ``name`` in messages (collective).

        ``onto.body`` has the particles, ``onto.supports`` prescribes or ties unknowns, ``onto.loads`` adds forces.
        """


def condition_name(condition: object, number: int) -> str:
    """Return the name of a condition in messages, such as ``Traction condition 2``; numbers start at 1."""
    return f"{type(condition).__name__} condition {number}"


@dataclass(frozen=True)
class VectorCondition(Condition):
    """A condition with components on a region; derive from it for another one."""

    region: Region
    x: Value | None = None
    y: Value | None = None
    z: Value | None = None
    schedule: Schedule | None = None

    def components(self, dim: int) -> list[tuple[int, Value]]:
        """Return the declared components as (axis, value).

        Raises
        ------
        CaseError
            None is declared, or one lies outside the dimension.
        """
        given = [(axis, value) for axis, value in enumerate((self.x, self.y, self.z)) if value is not None]
        name = type(self).__name__
        if not given:
            raise CaseError(f"A {name} condition needs at least one of its components x, y, z.")
        if given[-1][0] >= dim:
            raise CaseError(f"A {name} condition gives component {'xyz'[given[-1][0]]} of a {dim}-dimensional body.")
        return given

    def value(self, component: Value, x: Float, t: float) -> Float:
        """Return the values of one component at positions ``x`` and step time ``t``, (n,).

        Numbers follow the schedule, by default the ramp; functions are taken as they are, times the schedule where one
        is given.

        Raises
        ------
        SolveError
            A function or the schedule fails or does not return numbers.
        """
        return values_of(type(self).__name__, component, self.schedule, x, t)


def values_of(name: str, component: Value, schedule: Schedule | None, x: Float, t: float) -> Float:
    """Return what a component of a condition called ``name`` is at positions ``x`` and step time ``t`` (n,)."""
    if len(x) == 0:  # a function need not know what to do with no particles
        return np.zeros(0)
    chosen = schedule or (Hold() if callable(component) else Ramp())
    factor = evaluated(f"schedule of a {name} condition", chosen, (), t, t)
    if not callable(component):
        return np.full(len(x), component * factor)
    return np.asarray(factor * evaluated(f"value of a {name} condition", component, (len(x),), t, x, t))


def evaluated(what: str, function: Callable[..., object], shape: tuple[int, ...], t: float, *arguments: Any) -> Float:
    """Return what a function of the case gives at step time ``t``, as finite numbers of a shape.

    Raises
    ------
    SolveError
        It fails, or gives something else.
    """
    when = f"At step time {t:.6g}: "
    try:
        values = numbers_from(what, function, *arguments)
    except CaseError as error:
        raise SolveError(f"{when}{error}") from error
    try:
        values = np.broadcast_to(values, shape)
    except ValueError:
        raise SolveError(
            f"{when}The {what} {name_of(function)} must return {shape or 'one'} numbers, not {values.shape}."
        ) from None
    bad = np.flatnonzero(~np.isfinite(values.ravel()))
    if len(bad):
        raise SolveError(
            f"{when}The {what} {name_of(function)} is {values.ravel()[bad[0]]} for {len(bad)} of {values.size} "
            f"particles; it must return a number for each."
        )
    return values


@dataclass(frozen=True)
class Displacement(VectorCondition):
    """Prescribed displacement of a region; components that are not given are free.

    Parameters
    ----------
    region : Region
        Which particles.
    x, y, z : float or callable, optional
        Components [length]: numbers, or functions of positions (n, dim) and step time that return (n,) values.
    schedule : callable, optional
        Factor on the components as a function of the step time; by default ``Ramp`` for numbers and 1 for functions.

    Examples
    --------
    >>> import pdpetsc as pd
    >>> clamped = pd.Displacement(pd.region.Slab("x", high=1.0), x=0.0, y=0.0)
    >>> sheared = pd.Displacement(pd.region.Slab("x", low=9.0), y=lambda x, t: 0.1 * t * x[:, 0])
    """

    def put(self, onto: Any, name: str) -> None:
        """Prescribe the displacement."""
        onto.displacement(self, name)


@dataclass(frozen=True)
class Force(VectorCondition):
    """Total dead force on a region, shared by its particles in proportion to their volumes.

    Parameters
    ----------
    region, schedule
        As for ``Displacement``.
    x, y, z : float or callable, optional
        Components [force]: numbers or functions.

    Examples
    --------
    >>> import pdpetsc as pd
    >>> tip = pd.Force(pd.region.Nearest((10.0, 1.0)), y=-50.0)
    """

    def put(self, onto: Any, name: str) -> None:
        """Add the force."""
        onto.force(self, name)


@dataclass(frozen=True)
class BodyForce(VectorCondition):
    """Dead force per reference volume on the particles of a region.

    Parameters
    ----------
    region, schedule
        As for ``Displacement``.
    x, y, z : float or callable, optional
        Components [force / volume]: numbers or functions.

    Examples
    --------
    >>> import pdpetsc as pd
    >>> weight = pd.BodyForce(pd.region.All(), y=-9.81 * 2400.0)  # [N / m^3]
    """

    def put(self, onto: Any, name: str) -> None:
        """Add the force per volume."""
        onto.body_force(self, name)


@dataclass(frozen=True)
class Traction(VectorCondition):
    """Dead traction on a face of the body.

    Parameters
    ----------
    region : Region
        The facets of the surface in it, or a tag of them; with ``layer`` and ``consistent`` the outer particles of the
        face.
    x, y, z : float or callable, optional
        Components [stress]: numbers or functions, as for ``Displacement``.
    schedule : callable, optional
        As for ``Displacement``.
    normal : sequence of float, optional
        Outward normal of the face; its length does not matter. ``layer`` and ``consistent`` need it; of ``surface`` it
        leaves out facets that do not look in its direction, within 45 degrees.
    distribution : {"surface", "layer", "consistent"}, optional
        ``surface``, the default without a normal, puts the traction on every facet and that on the particles near it,
        ``f_k = sum_f N_f(x_k) t |a_f|`` with linear-exact weights ``N_f``: on any face, flat or curved, with the
        resultant and the moment of the traction. ``layer``, the default with a normal, puts ``t`` times the free face
        of the particle on every particle of the region; particles without a free face get none. ``consistent`` applies
        ``f = G^T W (t (x) n)`` near the face, the forces that hold a uniform stress ``t (x) n`` in equilibrium: a
        uniform traction then gives a uniform gradient. It reaches two horizons into the body. All add up to the
        traction times the area of the face.
    area : float, optional
        Area of the face [area; length times thickness in 2D, cross-section in 1D], where it does not follow from the
        particles: a cloud of arrays or of a text file that is no lattice. ``layer`` divides it as ``V^((d - 1) / d)``.

    Examples
    --------
    >>> import pdpetsc as pd
    >>> pulled = pd.Traction(pd.region.Slab("x", low=10.0), x=5.0)
    >>> as_in_papers = pd.Traction(pd.region.Slab("x", low=9.0), x=5.0, normal=(1.0, 0.0), distribution="layer")
    """

    normal: Sequence[float] = ()
    distribution: Literal["surface", "layer", "consistent"] | None = None
    area: Positive | None = field(default=None, kw_only=True)

    def put(self, onto: Any, name: str) -> None:
        """Add the traction."""
        onto.surface_traction(self, name) if self.on_surface else onto.traction(self, name)

    def __post_init__(self) -> None:
        super().__post_init__()
        if self.area is not None and self.on_surface:
            raise CaseError(
                "A Traction on the surface takes no area: it is that of its facets; give a normal for a layer."
            )

    @property
    def on_surface(self) -> bool:
        """Return whether it acts on facets of the surface."""
        return self.distribution == "surface" or (self.distribution is None and not len(self.normal))

    def unit_normal(self, dim: int) -> Float:
        """Return the outward unit normal (dim,)."""
        normal = np.asarray(self.normal, dtype=float)
        length = float(np.linalg.norm(normal)) if normal.shape == (dim,) else 0.0
        if not (math.isfinite(length) and length > 0.0):
            raise CaseError(f"A Traction needs an outward normal of {dim} numbers, not {list(np.ravel(normal))}.")
        return normal / length


@dataclass(frozen=True)
class SurfacePressure(Condition):
    """Dead pressure on facets of the surface, ``t = -p n`` with the reference normal of each; ``Pressure`` makes it.

    Parameters
    ----------
    region : Region
        The facets of the surface in it, or a tag of them.
    value : float or callable
        ``p`` [stress]: a number, multiplied with the schedule, or a function of positions (n, dim) and step time.
    schedule : callable, optional
        As for ``Displacement``.

    Examples
    --------
    >>> import pdpetsc as pd
    >>> inside = pd.SurfacePressure(pd.region.Sphere((0.0, 0.0), 1.01), 3.0)
    """

    region: Region
    value: Value
    schedule: Schedule | None = None

    on_surface: ClassVar[bool] = True

    def put(self, onto: Any, name: str) -> None:
        """Add the pressure."""
        onto.surface_pressure(self, name)

    def values(self, x: Float, t: float) -> Float:
        """Return ``p`` (n,) [stress] at facets ``x`` (n, dim) and step time ``t``; raises SolveError where it fails."""
        return values_of(type(self).__name__, self.value, self.schedule, x, t)


def Pressure(
    region: Region,
    value: Value,
    normal: Sequence[float] = (),
    distribution: Literal["surface", "layer", "consistent"] | None = None,
    schedule: Schedule | None = None,
    area: float | None = None,
) -> Traction | SurfacePressure:
    """Return the dead traction ``-value n`` of a pressure [stress] on a surface.

    Without a normal it acts on every facet of the region along its own normal, on any surface. With one, ``n``, it is a
    ``Traction``, whose other arguments these are.

    Examples
    --------
    >>> import pdpetsc as pd
    >>> top = pd.Pressure(pd.region.Slab("y", low=9.0), 2.0, normal=(0.0, 1.0))
    >>> top.y
    -2.0
    >>> hole = pd.Pressure(pd.region.Named("hole"), 2.0)
    """
    if not len(normal) and distribution in (None, "surface"):
        if area is not None:
            raise CaseError("A Pressure on the surface takes no area: it is that of its facets.")
        return SurfacePressure(region, value, schedule)
    if callable(value):
        raise CaseError("A Pressure that is a function acts on the surface; leave its normal out.")
    n = np.asarray(normal, dtype=float)
    length = float(np.linalg.norm(n))
    if not (length > 0.0 and math.isfinite(length)):
        raise CaseError(f"A Pressure needs an outward normal, not {list(np.ravel(n))}.")
    x, y, z = [float(-value * c / length) for c in n] + [None] * (3 - len(n))
    return Traction(region, x, y, z, schedule, normal=tuple(normal), distribution=distribution, area=area)


@dataclass(frozen=True)
class _Tensor(Condition):
    xx: Finite | None = None
    yy: Finite | None = None
    zz: Finite | None = None
    xy: Finite | None = None
    yz: Finite | None = None
    xz: Finite | None = None
    schedule: Schedule = field(default_factory=Ramp)

    def components(self, available: Sequence[tuple[int, int]]) -> list[tuple[int, float]]:
        """Return the declared components as (position in ``available``, value).

        Raises
        ------
        CaseError
            None is declared, or the cell lacks one.
        """
        name = type(self).__name__
        letters = ["xyz"[a] + "xyz"[b] for a, b in available]
        declared = {key: getattr(self, key) for key in ("xx", "yy", "zz", "xy", "yz", "xz")}
        given = {key: value for key, value in declared.items() if value is not None}
        if not given:
            raise CaseError(f"A {name} condition needs at least one of the components {', '.join(letters)}.")
        for key in given:
            if key not in letters:
                raise CaseError(f"A {name} condition gives {key}; the periodic cell has {', '.join(letters)}.")
        return [(letters.index(key), value) for key, value in given.items()]


@dataclass(frozen=True)
class MeanStrain(_Tensor):
    """Prescribed components of the mean strain of a periodic cell [-], ``u(x + n L) = u(x) + strain n L``.

    At finite deformation it is the mean stretch less one, ``U - I``, in axes that do not rotate.

    Examples
    --------
    >>> import pdpetsc as pd
    >>> stretched = pd.MeanStrain(xx=0.01)
    """

    def put(self, onto: Any, name: str) -> None:
        """Prescribe the mean strain."""
        onto.mean_strain(self, name)


@dataclass(frozen=True)
class MeanStress(_Tensor):
    """Mean stress of a periodic cell [stress], per reference volume; 0 where neither it nor the strain is given.

    At finite deformation it is the symmetric part of the mean first Piola-Kirchhoff stress.

    Examples
    --------
    >>> import pdpetsc as pd
    >>> sheared = pd.MeanStress(xy=5.0)
    """

    def put(self, onto: Any, name: str) -> None:
        """Add the mean stress."""
        onto.mean_stress(self, name)
