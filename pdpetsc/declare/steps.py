"""Load steps from load parameter 0 to 1."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field, replace
from typing import Literal, TypeAlias

import numpy as np

from pdpetsc.declared import Count, Declared, Positive, shown
from pdpetsc.errors import CaseError

Unstable: TypeAlias = Literal["warn", "shorten", "refuse", "switch"]
# Files number steps with five digits.
MOST_STEPS = 99_999
# A shorter step is below the rounding of the load parameter.
LEAST_STEP = 1e-8


def checked_times(name: str, times: Sequence[float]) -> tuple[float, ...]:
    """Return the load parameters; raise CaseError unless they ascend from above 0 to 1, ``LEAST_STEP`` apart."""
    given = tuple(float(t) for t in times)
    if given and not (given[-1] == 1.0 and min(_lengths(given)) >= LEAST_STEP and len(given) <= MOST_STEPS):
        raise CaseError(
            f"{name} takes up to {MOST_STEPS} times that ascend from above 0 to 1, at least {LEAST_STEP:g} apart, not "
            f"{shown(list(given))}."
        )
    return given


def _lengths(times: Sequence[float]) -> list[float]:
    """Return the lengths of the steps that end at given times [-]."""
    return [later - earlier for earlier, later in zip([0.0, *times], times, strict=False)]


@dataclass(frozen=True)
class Steps(Declared):
    """Equal load steps, or steps to given load parameters; halved if Newton fails, enlarged after easy steps.

    Parameters
    ----------
    count : int
        Number of equal steps; omit it with ``times``.
    smallest : float
        Smallest step as a share of the whole load [-]; if it fails, the run ends with exit status 1. By default 1/64 of
        the shortest step.
    bonds_at_once : int, optional
        Number of bonds that break before equilibrium is solved again, in the order of their driving variables. By
        default one for bonds that snap, with those of equal driving variable, and all that have lost their force for
        bonds that soften.
    unstable : {"warn", "shorten", "refuse", "switch"}
        Action at an equilibrium whose tangent has negative pivots, such as of a column above its critical force. A
        direct linear solver counts them. An iterative one finds if there are any; with ``warn`` it may not look.
        ``warn`` continues with a warning. ``shorten`` treats the step as failed, so that the run ends within the
        smallest step of the critical load. ``refuse`` ends the run. ``switch`` moves an elastic body along the unstable
        eigenvector of its tangent to a stable equilibrium under the same load, for example from a straight column to a
        bent one. If it finds none, the step is shortened. The mean displacement of the eigenvector is positive. All but
        ``warn`` end a run if nothing tells whether an equilibrium is stable: damage was held during a jump, or the
        tangent is unsymmetric, of contact or pressure that follows. With such a tangent each step factors its symmetric
        part too. If that has no negative pivots, no other equilibrium is near, and the run continues; sliding with
        friction usually has some.
    plastic_growth : float, optional
        Largest growth of the accumulated plastic strain at any point in a step [-]. A step with a larger growth is
        repeated with a smaller size, and the size of the next step is limited accordingly.
    times : sequence of float, optional
        Load parameters at which the steps end [-], ascending from above 0 to 1. Use short steps after a jump of a load
        or displacement: materials that relax assume linear growth within each step.

    Examples
    --------
    >>> import pdpetsc as pd
    >>> pd.Steps(4).stops()
    [0.25, 0.5, 0.75, 1.0]
    >>> pd.Steps(times=(0.01, 0.1, 0.5, 1.0)).largest
    0.5
    """

    count: int = 1
    smallest: float | None = None
    bonds_at_once: Count | None = None
    unstable: Unstable = "warn"
    plastic_growth: Positive | None = None
    times: Sequence[float] = field(default=(), kw_only=True)

    def __post_init__(self) -> None:
        super().__post_init__()
        if not 1 <= self.count <= MOST_STEPS:
            raise CaseError(f"Steps needs a positive whole number up to {MOST_STEPS}, not {self.count}.")
        object.__setattr__(self, "times", checked_times("Steps", self.times))
        if self.times and self.count != 1:
            raise CaseError(f"Steps takes a number of steps or their times, not {self.count} and {self.times}.")
        if self.smallest is not None and not LEAST_STEP <= self.smallest <= self._shortest:
            raise CaseError(
                f"The smallest of {len(self.stops())} steps must lie between {LEAST_STEP:g} and the shortest of them, "
                f"{self._shortest:.6g}, not {self.smallest}."
            )

    @property
    def _shortest(self) -> float:
        """Return the shortest declared step [-]."""
        return min(_lengths(self.times), default=1.0 / self.count)

    @property
    def first(self) -> float:
        """Return the largest first step [-]; it ends at the first of the ``stops``."""
        return self.largest

    @property
    def largest(self) -> float:
        """Return the largest step [-]."""
        return max(_lengths(self.times), default=1.0 / self.count)

    @property
    def least(self) -> float:
        """Return the smallest step [-]."""
        return max(LEAST_STEP, self._shortest / 64.0) if self.smallest is None else self.smallest

    def stops(self) -> list[float]:
        """Return the load parameters at which steps must end, ascending to 1."""
        return list(self.times) or [(n + 1) / self.count for n in range(self.count)]


@dataclass(frozen=True)
class AdaptiveSteps(Declared):
    """Load steps that grow by half after an easy step and are halved after a failure.

    Steps also end where the factor of a ``Table`` schedule of a condition begins or ceases to rise or to fall, so that
    no step passes over a peak.

    Parameters
    ----------
    first, smallest, largest : float
        Step sizes as a share of the whole load.
    bonds_at_once, unstable, plastic_growth
        As in ``Steps``.
    times : sequence of float, optional
        Load parameters at which steps must end [-], ascending from above 0 to 1, for example at jumps of a load.

    Examples
    --------
    >>> import pdpetsc as pd
    >>> steps = pd.AdaptiveSteps(first=0.05, smallest=1e-3, largest=0.2)
    """

    first: float = 0.1
    smallest: float = 1e-4
    largest: float = 0.25
    bonds_at_once: Count | None = None
    unstable: Unstable = "warn"
    plastic_growth: Positive | None = None
    times: Sequence[float] = field(default=(), kw_only=True)

    def __post_init__(self) -> None:
        super().__post_init__()
        object.__setattr__(self, "times", checked_times("AdaptiveSteps", self.times))
        if not LEAST_STEP <= self.smallest <= self.first <= self.largest <= 1.0:
            raise CaseError(
                f"AdaptiveSteps needs {LEAST_STEP:g} <= smallest <= first <= largest <= 1, "
                f"not {self.smallest}, {self.first}, {self.largest}."
            )
        if self.largest < 1.0 / MOST_STEPS:
            raise CaseError(f"AdaptiveSteps needs a largest step of at least 1/{MOST_STEPS}, not {self.largest}.")

    @property
    def least(self) -> float:
        """Return the smallest step [-]."""
        return self.smallest

    def stops(self) -> list[float]:
        """Return the load parameters at which steps must end, ascending to 1."""
        return list(self.times) or [1.0]

    def ending_at(self, times: Sequence[float]) -> AdaptiveSteps:
        """Return these steps that also end at given load parameters between 0 and 1."""
        ends, apart = np.array([0.0, *self.stops()]), 2.0 * LEAST_STEP
        more: list[float] = []
        for t in sorted(times):
            if 0.0 < t < 1.0 and np.abs(ends - t).min() > apart and (not more or t - more[-1] > apart):
                more.append(float(t))
        return replace(self, times=tuple(sorted([*self.stops(), *more]))) if more else self
