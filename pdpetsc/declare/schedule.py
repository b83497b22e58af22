"""Schedules: the factor on the value of a condition at load parameter ``t`` in [0, 1]."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import TypeAlias

import numpy as np

from pdpetsc.declared import Declared, Finite
from pdpetsc.errors import CaseError

Schedule: TypeAlias = Callable[[float], float]
# Changes of slope below this share of the largest slope are rounding.
FLAT = 1e-9


@dataclass(frozen=True)
class Ramp:
    """Factor ``t``: 0 at the start of the run, 1 at its end, linear in between.

    Examples
    --------
    >>> import pdpetsc as pd
    >>> pd.Ramp()(0.25)
    0.25
    """

    def __call__(self, t: float) -> float:
        """Return ``t``."""
        return t


@dataclass(frozen=True)
class Hold:
    """Factor 1 at every load parameter.

    Examples
    --------
    >>> import pdpetsc as pd
    >>> pd.Hold()(0.25)
    1.0
    """

    def __call__(self, t: float) -> float:
        """Return 1."""
        return 1.0


@dataclass(frozen=True)
class Table(Declared):
    """Factors at given load parameters: linear in between, constant before the first and after the last.

    Parameters
    ----------
    times : sequence of float
        At least two load parameters, ascending [-].
    factors : sequence of float
        The factor at each [-].

    Examples
    --------
    >>> import pdpetsc as pd
    >>> pd.Table(times=[0.0, 0.5, 1.0], factors=[0.0, 1.0, 0.0])(0.75)
    0.5
    """

    times: Sequence[Finite]
    factors: Sequence[Finite]

    def __post_init__(self) -> None:
        super().__post_init__()
        if len(self.times) != len(self.factors) or len(self.times) < 2 or np.any(np.diff(self.times) <= 0.0):
            raise CaseError("A schedule Table needs at least two ascending times and as many factors.")

    @property
    def corners(self) -> list[float]:
        """Return the times at which the factor begins or ceases to rise or to fall, ascending [-]."""
        slopes = np.concatenate([[0.0], np.diff(self.factors) / np.diff(self.times), [0.0]])
        direction = np.where(np.abs(slopes) > FLAT * np.abs(slopes).max(), np.sign(slopes), 0.0)
        return [float(t) for t in np.asarray(self.times)[np.diff(direction) != 0.0]]

    def __call__(self, t: float) -> float:
        """Return the interpolated factor; factors (n,) for an array (n,), for example of temperatures."""
        found = np.interp(t, self.times, self.factors)
        return float(found) if np.ndim(found) == 0 else found  # type: ignore[return-value]


def tables_of(declared: object) -> list[Table]:
    """Return the tables among the schedules of a condition and of its tool."""
    found = []
    for part in (declared, getattr(declared, "tool", None)):
        schedule = getattr(part, "schedule", None)
        schedules = schedule if isinstance(schedule, Sequence) else [schedule]
        found += [one for one in schedules if isinstance(one, Table)]
    return found
