"""What a case says of temperature and of strains without stress."""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass
from typing import Any, TypeAlias

import numpy as np
from numpy.typing import NDArray

from pdpetsc.arrays import Float, GlobalIndex
from pdpetsc.declare.conditions import evaluated
from pdpetsc.declare.region import Region
from pdpetsc.declare.schedule import Hold, Ramp, Schedule
from pdpetsc.declared import Declared, real_numbers, shown
from pdpetsc.errors import CaseError

# A number, a function of positions (n, dim) and step time that returns (n,) values, or one number per particle of the
# body in the order of creation.
ThermalValue: TypeAlias = float | Callable[[Float, float], Float] | NDArray[Any]


@dataclass(frozen=True)
class Temperature(Declared):
    """Prescribed temperature of the particles of a region.

    A number or an array is reached from the temperature at the start, ``T = T_0 + s(t) (value - T_0)``, with a schedule
    that is the ramp by default; a function is taken as it is, or as ``value`` there where a schedule is given. ``T_0``
    is the stress-free temperature of the material of the particle, or the one at the start of ``HeatConduction``.

    Parameters
    ----------
    region : Region
        Which particles.
    value : float, callable or (n,) array
        Temperature: a number, a function of positions (n, dim) and step time that returns (n,) values, or one number
        per particle of the body in the order of creation.
    schedule : callable, optional
        ``s``, from 0 at the temperature at the start to 1 at the value, as a function of the step time. Without a
        function it must be given where heat conduction takes time: a ramp and a jump are two different problems there.

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
        """Hand it to ``onto`` (``terms.conditions.Applied``), which calls it ``name`` in messages (collective)."""
        onto.temperature(self, name)

    def values(self, start: Float, x: Float, gid: GlobalIndex, n_global: int, t: float) -> Float:
        """Return the temperatures (n,) of particles ``gid`` at ``x`` whose temperature at the start is ``start``.

        Raises
        ------
        CaseError
            An array has not one number per particle of the body.
        SolveError
            A function or the schedule fails or does not return numbers.
        """
        if len(x) == 0:  # a function need not know what to do with no particles
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
        chosen = self.schedule or (Hold() if callable(self.value) else Ramp())
        s = float(evaluated("schedule of a Temperature condition", chosen, (), t, t))
        return np.asarray(start + s * (value - start))


@dataclass(frozen=True)
class Eigenstrain(Declared):
    """Strain without stress of a region: what its material would have if nothing held it.

    At finite strain the stress-free deformation is ``I + s(t) eps``, together with the thermal strain; the linear
    material has the strain less it. It is a prestrain, swelling, shrinkage or the strain of a phase change.

    Parameters
    ----------
    region : Region
        Which particles.
    xx, yy, zz, xy, yz, xz : float
        Components [-]. Plane bodies take zz as well, for what is held or free across the plane, bars yy and zz.
    schedule : callable
        ``s``, what multiplies the components as a function of the step time; the ramp by default.

    Raises
    ------
    CaseError
        No component is given or one is not finite.

    Examples
    --------
    >>> import pdpetsc as pd
    >>> swollen = pd.Eigenstrain(pd.region.Slab("y", low=1.0), xx=0.01, yy=0.01, zz=0.01, schedule=pd.Hold())
    """

    region: Region
    xx: float = 0.0
    yy: float = 0.0
    zz: float = 0.0
    xy: float = 0.0
    yz: float = 0.0
    xz: float = 0.0
    schedule: Schedule = Ramp()  # noqa: RUF009 (frozen)

    def __post_init__(self) -> None:
        super().__post_init__()
        given = self.tensor
        if not np.isfinite(given).all() or not given.any():
            raise CaseError("An Eigenstrain takes finite components, at least one of them not zero.")

    def put(self, onto: Any, name: str) -> None:
        """Hand it to ``onto`` (``terms.conditions.Applied``), which calls it ``name`` in messages (collective)."""
        onto.eigenstrain(self, name)

    @property
    def tensor(self) -> Float:
        """Return the strain at factor 1 (3, 3) [-]."""
        return np.array(
            [[self.xx, self.xy, self.xz], [self.xy, self.yy, self.yz], [self.xz, self.yz, self.zz]], dtype=float
        )

    def strain(self, t: float) -> Float:
        """Return the strain at step time ``t`` (3, 3) [-]; raises SolveError where the schedule fails."""
        return np.asarray(
            float(evaluated("schedule of an Eigenstrain condition", self.schedule, (), t, t)) * self.tensor
        )

    def refuse_beyond(self, dim: int, name: str) -> None:
        """Raise CaseError where a body of ``dim`` dimensions cannot have a component, sheared out of its plane."""
        bad = [key for key in ("yz", "xz", *(("xy",) if dim == 1 else ())) if dim < 3 and getattr(self, key) != 0.0]
        if bad:
            raise CaseError(f"{name} gives {bad[0]}, which a {dim}-dimensional body cannot have; leave it out.")


def refuse_not_positive(what: str, value: float) -> None:
    """Raise CaseError unless a number is positive and finite; ``what`` begins the sentence."""
    if not (math.isfinite(value) and value > 0.0):
        raise CaseError(f"{what} a positive number, not {value}.")


ThermalCondition: TypeAlias = Temperature | Eigenstrain
