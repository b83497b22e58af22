"""Temperature, heat conduction and eigenstrain in a case."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import Any, ClassVar, Literal, TypeAlias

import numpy as np
from numpy.typing import NDArray

from pdpetsc.arrays import Float, GlobalIndex
from pdpetsc.declare.conditions import Condition, evaluated, schedule_of, values_of
from pdpetsc.declare.region import Region
from pdpetsc.declare.schedule import Hold, Ramp, Schedule
from pdpetsc.declared import Declared, Finite, NonNegative, Positive, numbers_from, real_numbers, shown
from pdpetsc.errors import CaseError

# A number, a function of positions (n, dim) and load parameter that returns (n,) values, or one number per particle of
# the body in the order of creation.
ThermalValue: TypeAlias = float | Callable[[Float, float], Float] | NDArray[Any]


@dataclass(frozen=True)
class Temperature(Condition):
    """Prescribed temperature of the particles of a region.

    For a number or an array, ``T = T_0 + s(t) (value - T_0)`` with the schedule ``s``, by default the ramp. A function
    defines ``T`` itself, or ``value`` if a schedule is declared. ``T_0`` is the stress-free temperature of the material
    of the particle, or the initial temperature of ``HeatConduction``.

    Parameters
    ----------
    region : Region
        The particles.
    value : float, callable or (n,) array
        Temperature: a number, a function of positions (n, dim) and load parameter that returns (n,) values, or one
        number per particle of the body in the order of creation.
    schedule : callable, optional
        ``s`` as a function of the load parameter: 0 at the initial temperature, 1 at the value. Transient heat
        conduction requires it for numbers and arrays, because a ramp and a jump are different problems.

    Examples
    --------
    >>> import pdpetsc as pd
    >>> heated = pd.Temperature(pd.region.All(), 120.0)
    >>> graded = pd.Temperature(pd.region.All(), lambda x, t: 20.0 + 80.0 * t * x[:, 1])
    """

    region: Region
    value: ThermalValue
    schedule: Schedule | None = None

    def __post_init__(self) -> None:
        super().__post_init__()
        if callable(self.value):
            return
        values = real_numbers(self.value)
        if values is None or values.ndim > 1 or not np.isfinite(values).all():
            raise CaseError(
                f"A Temperature takes a finite number, a function, or one finite number per particle, not "
                f"{shown(self.value)}."
            )

    def put(self, onto: Any, name: str) -> None:
        """Apply it to ``onto`` (``terms.conditions.Applied``); messages call it ``name`` (collective)."""
        onto.temperature(self, name)

    @property
    def timed(self) -> bool:
        """Return True if its course in time is declared."""
        return callable(self.value) or self.schedule is not None

    def values(self, start: Float, x: Float, gid: GlobalIndex, n_global: int, t: float) -> Float:
        """Return the temperatures (n,) of particles ``gid`` at ``x`` with initial temperature ``start``.

        Raises
        ------
        CaseError
            An array does not have one number per particle of the body.
        SolveError
            A function or the schedule fails or does not return numbers.
        """
        if len(x) == 0:  # functions may not support empty arrays
            return np.zeros(0)
        if callable(self.value):
            value = evaluated("value of a Temperature condition", self.value, (len(x),), t, x, t)
        elif np.ndim(self.value):
            given = np.asarray(self.value, dtype=float)
            if len(given) != n_global:
                raise CaseError(
                    f"A Temperature has {len(given)} numbers for {n_global} particles; give one for each particle of "
                    f"the body, in the order of creation."
                )
            value = given[gid]
        else:
            value = np.full(len(x), float(self.value))
        chosen = schedule_of(self.schedule, self.value)
        s = float(evaluated("schedule of a Temperature condition", chosen, (), t, t))
        return np.asarray(start + s * (value - start))


@dataclass(frozen=True)
class Eigenstrain(Condition):
    """Eigenstrain of a region: the strain of its material if it could deform freely.

    At finite strain the stress-free deformation is ``I + s(t) eps``, with the thermal strain included; for linear
    elasticity it is subtracted from the strain. Use it for prestrain, swelling, shrinkage or phase changes.

    Parameters
    ----------
    region : Region
        The particles.
    xx, yy, zz, xy, yz, xz : float
        Components [-]. Plane bodies also accept zz, the eigenstrain across the plane; bars accept yy and zz.
    schedule : callable
        ``s``, the factor on the components as a function of the load parameter; by default the ramp.

    Raises
    ------
    CaseError
        No component is declared.

    Examples
    --------
    >>> import pdpetsc as pd
    >>> swollen = pd.Eigenstrain(pd.region.Slab("y", low=1.0), xx=0.01, yy=0.01, zz=0.01, schedule=pd.Hold())
    """

    region: Region
    xx: Finite = 0.0
    yy: Finite = 0.0
    zz: Finite = 0.0
    xy: Finite = 0.0
    yz: Finite = 0.0
    xz: Finite = 0.0
    schedule: Schedule = Ramp()  # noqa: RUF009 (frozen)

    def __post_init__(self) -> None:
        super().__post_init__()
        if not self.tensor.any():
            raise CaseError("An Eigenstrain requires at least one component that is not zero.")

    def put(self, onto: Any, name: str) -> None:
        """Apply it to ``onto`` (``terms.conditions.Applied``); messages call it ``name`` (collective)."""
        onto.eigenstrain(self, name)

    @property
    def tensor(self) -> Float:
        """Return the strain at factor 1 (3, 3) [-]."""
        return np.array(
            [[self.xx, self.xy, self.xz], [self.xy, self.yy, self.yz], [self.xz, self.yz, self.zz]], dtype=float
        )

    def strain(self, t: float) -> Float:
        """Return the strain at load parameter ``t`` (3, 3) [-]; raises SolveError if the schedule fails."""
        return np.asarray(
            float(evaluated("schedule of an Eigenstrain condition", self.schedule, (), t, t)) * self.tensor
        )

    def refuse_beyond(self, dim: int, name: str) -> None:
        """Raise CaseError if a component is a shear out of the plane of a body of ``dim`` dimensions."""
        bad = [key for key in ("yz", "xz", *(("xy",) if dim == 1 else ())) if dim < 3 and getattr(self, key) != 0.0]
        if bad:
            raise CaseError(f"{name} gives {bad[0]}, which a {dim}-dimensional body cannot have; leave it out.")


@dataclass(frozen=True)
class _Heat(Condition):
    """Heat that enters a region or its surface."""

    region: Region
    value: Finite | Callable[[Float, float], Float]
    schedule: Schedule | None = None

    @property
    def timed(self) -> bool:
        """Return True if its course in time is declared."""
        return callable(self.value) or self.schedule is not None

    def values(self, x: Float, t: float) -> Float:
        """Return the heat (n,) at positions (n, dim) and load parameter ``t``, or raise SolveError."""
        return values_of(type(self).__name__, self.value, self.schedule, x, t)


@dataclass(frozen=True)
class HeatFlux(_Heat):
    """Heat that flows into the body through its surface.

    Parameters
    ----------
    region : Region
        The facets of the surface in the region, or their tag.
    value : float or callable
        Heat flux into the body [power / area]: a number, multiplied by the schedule, or a function of positions (n,
        dim) and load parameter that returns (n,) values.
    schedule : callable, optional
        By default ``Ramp`` for numbers and 1 for functions; required for a number in transient conduction.

    Examples
    --------
    >>> import pdpetsc as pd
    >>> burner = pd.HeatFlux(pd.region.Slab("y", high=0.0), 5e4, schedule=pd.Hold())
    """

    on_surface: ClassVar[bool] = True

    def put(self, onto: Any, name: str) -> None:
        """Apply it to ``onto`` (``terms.conditions.Applied``); messages call it ``name`` (collective)."""
        onto.heat_flux(self, name)


@dataclass(frozen=True)
class HeatSource(_Heat):
    """Heat source in the particles of a region.

    Parameters
    ----------
    region : Region
        The particles.
    value : float or callable
        Heat [power / volume]: a number, multiplied by the schedule, or a function of positions (n, dim) and load
        parameter that returns (n,) values.
    schedule : callable, optional
        By default ``Ramp`` for numbers and 1 for functions; required for a number in transient conduction.

    Examples
    --------
    >>> import pdpetsc as pd
    >>> hydration = pd.HeatSource(pd.region.All(), lambda x, t: 500.0 * (1.0 - t) + 0.0 * x[:, 0])
    """

    def put(self, onto: Any, name: str) -> None:
        """Apply it to ``onto`` (``terms.conditions.Applied``); messages call it ``name`` (collective)."""
        onto.heat_source(self, name)


@dataclass(frozen=True)
class Convection(Condition):
    """Heat exchange of the surface with its surroundings, ``q . n = h (T - T_s)``.

    Parameters
    ----------
    region : Region
        The facets of the surface in the region, or their tag.
    coefficient : float
        ``h`` [power / area / temperature], positive.
    surroundings : float or callable
        ``T_s``: a temperature, or a function of positions (n, dim) and load parameter that returns (n,) values.

    Examples
    --------
    >>> import pdpetsc as pd
    >>> water = pd.Convection(pd.region.Slab("y", low=10.0), coefficient=2e3, surroundings=20.0)
    """

    region: Region
    coefficient: Positive
    surroundings: Finite | Callable[[Float, float], Float]

    on_surface: ClassVar[bool] = True

    def put(self, onto: Any, name: str) -> None:
        """Apply it to ``onto`` (``terms.conditions.Applied``); messages call it ``name`` (collective)."""
        onto.heat_flux(self, name)

    def values(self, x: Float, t: float) -> Float:
        """Return ``h T_s`` (n,) at positions (n, dim) and load parameter ``t``, or raise SolveError."""
        return self.coefficient * values_of("Convection", self.surroundings, Hold(), x, t)


@dataclass(frozen=True)
class HeatConduction(Declared):
    """Heat conduction, solved before the equilibrium of every load step.

    ``c dT/dt = div (k grad T) + heat`` with the gradient of the scheme, and ``k`` and ``c`` of the materials
    (``Thermal``). In materials of bonds, heat flows along bonds.

    Broken bonds, cracks, contact and the surface without conditions insulate; ``Tied`` surfaces conduct. Bonds that
    break in a step insulate from the next step on. Use ``Conforming`` weights for heat through the surface; other
    weights have an error of first order in the spacing there. The Crank-Nicolson rule oscillates if a temperature or
    its surroundings jump.

    Parameters
    ----------
    duration : float, optional
        Physical time from load parameter 0 to 1 [time]: a load step of ``dt`` lasts ``dt duration``, also if it is
        halved. Without it the temperature is steady at every load parameter.
    rule : {"backward_euler", "crank_nicolson"}
        Time integration: of first order and without oscillation, or of second order.
    start : float or callable, optional
        Initial temperature: a number, or a function of positions (n, dim) that returns (n,) values; by default the
        stress-free temperature of the materials.
    control : float, optional
        Strength ``G`` of the control of temperature modes that the gradient of a family does not resolve, as of
        ``Silling`` [-]. By default 0.5 for schemes with one gradient point per particle, otherwise 0.
    coupling : {"staggered", "monolithic"}
        ``staggered`` solves the temperature of a step before its equilibrium; ``monolithic`` solves both in one Newton
        iteration, with PETSc's PCFIELDSPLIT (options ``-fieldsplit_temperature_...`` and
        ``-fieldsplit_displacement_...``) and the solver ``Newton``. Results are equal, because heat conduction does not
        depend on the displacement.

    Examples
    --------
    >>> import pdpetsc as pd
    >>> quenching = pd.HeatConduction(duration=2.0, start=300.0)  # with Steps(100) in steps of 0.02 s
    """

    duration: Positive | None = None
    rule: Literal["backward_euler", "crank_nicolson"] = "backward_euler"
    start: Finite | Callable[[Float], Float] | None = None
    control: NonNegative | None = None
    coupling: Literal["staggered", "monolithic"] = "staggered"

    @property
    def theta(self) -> float:
        """Return the weight of the end of a step [-]: 1 for steady conduction."""
        return 0.5 if self.rule == "crank_nicolson" and self.duration is not None else 1.0

    def at_start(self, x: Float, otherwise: Float) -> Float:
        """Return the initial temperature (n,) at positions ``x``, or raise CaseError if a function fails."""
        if self.start is None:
            return otherwise.copy()
        if not callable(self.start) or len(x) == 0:
            return np.full(len(x), 0.0 if callable(self.start) else float(self.start))
        found = numbers_from("start of HeatConduction", self.start, x)
        if found.shape != (len(x),) or not np.isfinite(found).all():
            raise CaseError(
                f"The start of HeatConduction must return one finite number per particle, not {found.shape}."
            )
        return found


ThermalCondition: TypeAlias = Temperature | Eigenstrain | HeatFlux | HeatSource | Convection
