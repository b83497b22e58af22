"""Conditions: prescribed displacements and dead loads on regions."""

from __future__ import annotations

import itertools
import math
from abc import ABC, abstractmethod
from collections.abc import Callable, Sequence
from dataclasses import dataclass, field
from typing import Any, ClassVar, Literal, TypeAlias

import numpy as np
import scipy

from pdpetsc.arrays import Float
from pdpetsc.declare.region import Region, accept_region_name
from pdpetsc.declare.schedule import Hold, Ramp, Schedule
from pdpetsc.declared import Declared, Finite, Positive, name_of, numbers_from, shown
from pdpetsc.errors import CaseError, SolveError

# Panels between the times of a schedule and points in each for integrals over time: velocities that are polynomials of
# degree seven between these times are integrated exactly, and accelerations of degree six.
PANELS, POINTS = 4, 4

# A number, multiplied by the schedule, or a function of positions (n, dim) and load parameter that returns (n,) values,
# multiplied by the schedule if one is declared.
Value: TypeAlias = Finite | Callable[[Float, float], Float]


@dataclass(frozen=True)
class Condition(Declared, ABC):
    """A prescribed displacement, a load, or the mean strain or stress of a cell. Derive your own from it.

    The ``region`` of a condition may be a name: of a side, ``"-x"`` to ``"+z"`` (``pd.region.Face``), or of a set.
    """

    def __post_init__(self) -> None:
        accept_region_name(self)
        super().__post_init__()

    @abstractmethod
    def put(self, onto: Any, name: str) -> None:
        """Apply the condition to ``onto`` (``terms.conditions.Applied``); messages call it ``name`` (collective).

        ``onto.body`` has the particles, ``onto.supports`` prescribes or ties unknowns, ``onto.loads`` adds forces.
        """


def condition_name(condition: object, number: int) -> str:
    """Return the name of a condition in messages, such as ``Traction condition 2``; numbers start at 1."""
    return f"{_kind(condition)} condition {number}"


def _kind(condition: object) -> str:
    """Return the name of a condition as a case writes it: ``Pressure`` makes a ``SurfacePressure``."""
    return "Pressure" if type(condition) is SurfacePressure else type(condition).__name__


@dataclass(frozen=True)
class VectorCondition(Condition):
    """A condition with components on a region. Derive your own from it."""

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
            No component is declared, or one is outside the dimension.
        """
        given = [(axis, value) for axis, value in enumerate((self.x, self.y, self.z)) if value is not None]
        name = type(self).__name__
        if not given:
            raise CaseError(f"A {name} condition needs at least one of its components x, y, z.")
        if given[-1][0] >= dim:
            raise CaseError(
                f"A {name} condition has component {'xyz'[given[-1][0]]}, and the body has {dim} dimensions. Leave the "
                "component out."
            )
        return given

    def value(self, component: Value, x: Float, t: float) -> Float:
        """Return the values of one component at positions ``x`` and load parameter ``t``, (n,).

        Numbers are multiplied by the schedule, by default the ramp. Functions are multiplied by a declared schedule
        only.

        Raises
        ------
        SolveError
            A function or the schedule fails or does not return numbers.
        """
        return values_of(type(self).__name__, component, self.schedule, x, t)


def schedule_of(schedule: Schedule | None, value: object) -> Schedule:
    """Return the schedule of a value: if none is declared, a ramp for numbers, and the factor 1 for a function."""
    return schedule or (Hold() if callable(value) else Ramp())


def values_of(name: str, component: Value, schedule: Schedule | None, x: Float, t: float) -> Float:
    """Return the component of the condition ``name`` at positions ``x`` and load parameter ``t`` (n,)."""
    if len(x) == 0:  # functions may not support empty arrays
        return np.zeros(0)
    factor = evaluated(f"schedule of a {name} condition", schedule_of(schedule, component), (), t, t)
    if not callable(component):
        return np.full(len(x), component * factor)
    return np.asarray(factor * evaluated(f"value of a {name} condition", component, (len(x),), t, x, t))


def evaluated(what: str, function: Callable[..., object], shape: tuple[int, ...], t: float, *arguments: Any) -> Float:
    """Evaluate a function of the case at load parameter ``t`` and return finite numbers of a shape.

    Raises
    ------
    SolveError
        The function fails, or returns something else.
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
    """Prescribed displacement of a region; components that are not declared are free.

    Parameters
    ----------
    region : Region
        The particles.
    x, y, z : float or callable, optional
        Components [length]: numbers, or functions of positions (n, dim) and load parameter that return (n,) values.
    schedule : callable, optional
        Factor on the components as a function of the load parameter; by default ``Ramp`` for numbers and 1 for
        functions.

    Examples
    --------
    >>> import pdpetsc as pd
    >>> clamped = pd.Displacement(pd.region.Slab("x", high=1.0), x=0.0, y=0.0)
    >>> sheared = pd.Displacement(pd.region.Slab("x", low=9.0), y=lambda x, t: 0.1 * t * x[:, 0])
    """

    def put(self, onto: Any, name: str) -> None:
        onto.displacement(self, name)


@dataclass(frozen=True)
class InitialVelocity(VectorCondition):
    """Velocity of the particles of a region at the start of a motion (``Implicit``, ``Explicit``).

    Where several hold the same particle, the last one counts. Held components move as they are held.

    Parameters
    ----------
    region : Region
        The particles.
    x, y, z : float or callable, optional
        Components [length / time]: numbers, or functions of positions (n, dim) and step time 0; 0 if not declared.
    schedule : callable, optional
        Not allowed: the velocity is that at the start.

    Examples
    --------
    >>> import pdpetsc as pd
    >>> thrown = pd.InitialVelocity(pd.region.All(), x=100.0)
    """

    def put(self, onto: Any, name: str) -> None:
        onto.initial_velocity(self, name)

    def __post_init__(self) -> None:
        super().__post_init__()
        if self.schedule is not None:
            raise CaseError("An InitialVelocity has no schedule, because it is the velocity at the start.")


@dataclass(frozen=True)
class DrivenMotion(VectorCondition):
    """A prescribed derivative of the displacement of a region by time, in a motion.

    Attributes
    ----------
    order : int
        Order of the derivative.
    """

    order: ClassVar[int]

    def put(self, onto: Any, name: str) -> None:
        onto.driven_motion(self, name)

    def moved(self, component: Value, duration: float) -> Callable[[Float, float], Float]:
        """Return the displacement (n,) [length] as a function of positions and step time.

        ``duration`` is the time of the whole motion [time]. The displacement is the integral of ``(t - s)^(order - 1)``
        times the prescribed values over the times ``s`` up to ``t``.
        """
        schedule, name, power = self.schedule or Hold(), type(self).__name__, self.order - 1
        breaks = np.asarray(getattr(schedule, "times", ()), dtype=float)
        points = list(zip(*scipy.special.roots_legendre(POINTS), strict=True))

        def displacement(x: Float, t: float) -> Float:
            ends = np.concatenate([[0.0], breaks[(breaks > 0.0) & (breaks < t)], [t]])
            whole = np.zeros(len(x))
            for begin, end in itertools.pairwise(ends.tolist()):
                panels = np.linspace(begin, end, PANELS + 1)
                half = 0.5 * (panels[1] - panels[0])
                for s, weight in points:
                    for middle in (panels[:-1] + half).tolist():
                        at = middle + half * float(s)
                        whole += weight * half * (t - at) ** power * values_of(name, component, schedule, x, at)
            return duration**self.order * whole

        return displacement


@dataclass(frozen=True)
class Velocity(DrivenMotion):
    """Prescribed velocity of a region in a motion (``Implicit``, ``Explicit``); the region moves with it from t = 0 on.

    The displacement is the integral of the velocity over time, so that it does not drift.

    Parameters
    ----------
    region : Region
        The particles.
    x, y, z : float or callable, optional
        Components [length / time]: numbers, or functions of positions (n, dim) and step time that return (n,) values.
    schedule : callable, optional
        Factor on the components as a function of the step time; by default 1. A jump or kink within a motion is
        integrated exactly if it is one of the times of a ``Table``.

    Examples
    --------
    >>> import pdpetsc as pd
    >>> struck = pd.Velocity("-x", x=16.5, schedule=pd.Table([0.0, 0.01, 1.0], [0.0, 1.0, 1.0]))
    """

    order: ClassVar[int] = 1


@dataclass(frozen=True)
class Acceleration(DrivenMotion):
    """Prescribed acceleration of a region in a motion (``Implicit``, ``Explicit``), which is at rest before t = 0.

    The displacement is the double integral of the acceleration over time, so that it does not drift. The region has no
    inertia: ``Reaction`` and ``ExternalWork`` contain the force and work of the rest of the body, not those that
    accelerate the region itself.

    Parameters
    ----------
    region, schedule
        As for ``Velocity``.
    x, y, z : float or callable, optional
        Components [length / time^2]: numbers, or functions of positions (n, dim) and step time that return (n,) values.

    Examples
    --------
    >>> import pdpetsc as pd
    >>> shaken = pd.Acceleration("-y", x=3.0, schedule=pd.Table([0.0, 0.1, 0.2, 1.0], [0.0, 1.0, -1.0, 0.0]))
    """

    order: ClassVar[int] = 2


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
        onto.body_force(self, name)


@dataclass(frozen=True)
class Centrifugal(Condition):
    """Centrifugal force of a body that spins, ``rho w^2 P (x + u - c)`` per reference volume.

    The body is seen from axes that turn with it; P projects onto the plane normal to the axis. The force follows the
    deformation, with its exact tangent; ``w`` is the schedule times ``speed``. Materials need a ``density``.

    Parameters
    ----------
    region : Region
        The particles.
    speed : float
        Angular speed at the end of the load [rad / time].
    about : sequence of float
        A point c of the axis (dim,) [length].
    axis : sequence of float
        Direction of the axis in space (3,); the axis is normal to bodies of one or two dimensions.
    schedule : callable, optional
        Factor on ``speed`` as a function of the load parameter; ``Ramp()`` by default.

    Examples
    --------
    >>> import pdpetsc as pd
    >>> spun = pd.Centrifugal(pd.region.All(), speed=300.0, about=(0.0, 0.0))
    """

    region: Region
    speed: Positive
    about: Sequence[float]
    axis: Sequence[float] = (0.0, 0.0, 1.0)
    schedule: Schedule = field(default_factory=Ramp)

    def put(self, onto: Any, name: str) -> None:
        onto.centrifugal(self, name)


@dataclass(frozen=True)
class Traction(VectorCondition):
    """Dead traction on a face of the body.

    Parameters
    ----------
    region : Region
        The facets of the surface in the region, or their tag; for ``layer`` and ``consistent`` the outer particles of
        the face.
    x, y, z : float or callable, optional
        Components [stress]: numbers or functions, as for ``Displacement``.
    schedule : callable, optional
        As for ``Displacement``.
    normal : sequence of float, optional
        Outward normal of the face; its length does not matter. ``layer`` and ``consistent`` require it; for ``surface``
        it excludes facets whose normals differ by more than 45 degrees.
    distribution : {"surface", "layer", "consistent"}, optional
        ``surface``, the default without a normal, distributes the traction of every facet to the particles near it,
        ``f_k = sum_f N_f(x_k) t |a_f|`` with linear-exact weights ``N_f``. Faces may be flat or curved; resultant and
        moment are those of the traction. ``layer``, the default with a normal, applies ``t`` times the free face of the
        particle to every particle of the region; particles without a free face get none. ``consistent`` applies ``f =
        G^T W (t (x) n)`` near the face, in equilibrium with a uniform stress ``t (x) n``: a uniform traction yields a
        uniform gradient. Its forces extend two horizons into the body. All sum to the traction times the area of the
        face.
    area : float, optional
        Area of the face [area; length times thickness in 2D, cross-section in 1D], required if it does not follow from
        the particles: an irregular cloud of arrays or of a text file. ``layer`` divides it in proportion to ``V^((d -
        1) / d)``.

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
        onto.surface_traction(self, name) if self.on_surface else onto.traction(self, name)

    def __post_init__(self) -> None:
        super().__post_init__()
        if self.area is not None and self.on_surface:
            raise _has_area("Traction")

    @property
    def on_surface(self) -> bool:
        """Return True if the traction acts on facets of the surface."""
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
    """Dead pressure on facets of the surface, ``t = -p n`` with the reference normal of each; created by ``Pressure``.

    Parameters
    ----------
    region : Region
        The facets of the surface in the region, or their tag.
    value : float or callable
        ``p`` [stress]: a number, multiplied by the schedule, or a function of positions (n, dim) and load parameter.
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
        onto.surface_pressure(self, name)

    def values(self, x: Float, t: float) -> Float:
        """Return ``p`` (n,) [stress] at facets ``x`` (n, dim) and load parameter ``t``, or raise SolveError."""
        return values_of(_kind(self), self.value, self.schedule, x, t)


@dataclass(frozen=True)
class FollowerPressure(SurfacePressure):
    """Pressure on the deformed surface: on each facet ``-p a`` with its deformed vector area ``a = cof(F) A``.

    The tangent includes the change of the areas. It is not symmetric unless the surface is closed or its edge is held,
    and of a discrete surface only nearly; the solver treats it as unsymmetric. The thickness of a plane body does not
    change.

    Parameters
    ----------
    region : Region
        The facets of the surface in the region, or their tag.
    value : float or callable
        ``p`` [stress]: a number, multiplied by the schedule, or a function of reference positions (n, dim) and load
        parameter.
    schedule : callable, optional
        As for ``Displacement``.

    References
    ----------
    Bonet2008, section 8.5 (pressure, and its tangent).

    Examples
    --------
    >>> import pdpetsc as pd
    >>> inflated = pd.FollowerPressure(pd.region.Sphere((0.0, 0.0), 1.01), 0.3)
    """

    def put(self, onto: Any, name: str) -> None:
        onto.follower_pressure(self, name)


@dataclass(frozen=True)
class CrackPressure(SurfacePressure):
    """Pressure of a fluid on the faces of cracks of ``PointDamage``.

    With the degradation factor phi and the normal n of the crack a point carries the stress
    ``-(1 - phi) p (m (x) m) cof F``, ``m = cof(F) n / |cof(F) n|``, besides its own; at small strain
    ``-(1 - phi) p n (x) n``. It presses the faces of the crack apart and follows the deformation, with its exact
    tangent, which is not symmetric while points fail. It does not enter the drive of the damage, so that strength and
    Gc are those of the dry body. Its resultant is zero. The thickness of a plane body does not change.

    Parameters
    ----------
    region : Region
        The particles whose points it acts on.
    value, schedule
        As for ``FollowerPressure``.

    Raises
    ------
    CaseError
        In a case: damage is not ``PointDamage``.

    References
    ----------
    Bourdin2012, section 2 (pressure in a crack that is a field).

    Examples
    --------
    >>> import pdpetsc as pd
    >>> inside = pd.CrackPressure(pd.region.All(), 0.2)
    """

    on_surface: ClassVar[bool] = False

    def put(self, onto: Any, name: str) -> None:
        onto.crack_pressure(self, name)


def _has_area(kind: str) -> CaseError:
    """Return the error for an area of a load on facets."""
    return CaseError(
        f"A {kind} on the surface has no `area`, because its facets have areas. Leave area out, or give a normal for a "
        "layer of particles."
    )


def Pressure(
    region: Region,
    value: Value,
    normal: Sequence[float] = (),
    distribution: Literal["surface", "layer", "consistent"] | None = None,
    schedule: Schedule | None = None,
    area: float | None = None,
) -> Traction | SurfacePressure:
    """Return the dead traction ``-value n`` of a pressure [stress] on a surface; see also ``FollowerPressure``.

    Without a normal it acts on every facet of the region along the normal of the facet, on any surface. With a normal
    ``n`` it is a ``Traction`` with these other arguments.

    Examples
    --------
    >>> import pdpetsc as pd
    >>> top = pd.Pressure(pd.region.Slab("y", low=9.0), 2.0, normal=(0.0, 1.0))
    >>> top.y
    -2.0
    >>> hole = pd.Pressure(pd.region.Named("hole"), 2.0)
    """
    if np.size(normal) == 0 and distribution in (None, "surface"):
        if area is not None:
            raise _has_area("Pressure")
        return SurfacePressure(region, value, schedule)
    if callable(value):
        raise CaseError("A Pressure that is a function acts on the surface; leave its normal out.")
    try:
        n = np.asarray(normal, dtype=float)
    except (TypeError, ValueError):
        n = np.zeros(0)
    length = float(np.linalg.norm(n))
    if n.ndim != 1 or len(n) > 3 or not (length > 0.0 and math.isfinite(length)):
        raise CaseError(f"A Pressure needs an outward normal of up to three numbers, not {shown(normal)}.")
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
            No component is declared, or the cell lacks one.
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

    At finite deformation it is the mean stretch minus the identity, ``U - I``, in axes that do not rotate.

    Examples
    --------
    >>> import pdpetsc as pd
    >>> stretched = pd.MeanStrain(xx=0.01)
    """

    def put(self, onto: Any, name: str) -> None:
        onto.mean_strain(self, name)


@dataclass(frozen=True)
class MeanStress(_Tensor):
    """Mean stress of a periodic cell [stress], per reference volume; by default 0 unless the strain is declared.

    At finite deformation it is the symmetric part of the mean first Piola-Kirchhoff stress.

    Examples
    --------
    >>> import pdpetsc as pd
    >>> sheared = pd.MeanStress(xy=5.0)
    """

    def put(self, onto: Any, name: str) -> None:
        onto.mean_stress(self, name)
