"""How equilibrium of a load step is found."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import TypeAlias

from pdpetsc.errors import CaseError


@dataclass(frozen=True)
class Newton:
    """Newton's method with the analytic tangent, on PETSc's SNES; its options come with ``Case.options``."""


@dataclass(frozen=True)
class DynamicRelaxation:
    """Adaptive dynamic relaxation: damped motion in time until the body is at rest, without a matrix.

    Parameters
    ----------
    tolerance : float
        What residual and change of displacement, each over its first value in the step, must both fall below [-].
    most : int
        Largest number of time steps in a load step.
    """

    tolerance: float = 1e-6
    most: int = 1_000_000

    def __post_init__(self) -> None:
        if not (math.isfinite(self.tolerance) and 0.0 < self.tolerance < 1.0):
            raise CaseError(f"The tolerance of dynamic relaxation lies between 0 and 1, not {self.tolerance}.")
        if self.most < 1:
            raise CaseError(f"Dynamic relaxation needs at least one time step, not {self.most}.")


@dataclass(frozen=True)
class EventDriven:
    """From one failing bond to the next, without iterations: for bodies whose laws are piecewise linear.

    Between events everything is linear in the step time, so the time of the next failure is known exactly. A failing
    bond releases its force while the load goes up or down as equilibrium demands: the step time, to which all
    conditions must be proportional, need not grow, and snap-back is followed.

    Parameters
    ----------
    updates : int, optional
        Changed bonds at which the matrix is factored anew; until then they are corrections to the old factor. By
        default their number grows with the square root of the number of unknowns.
    most : int
        Largest number of events.
    fields_every : int
        Fields are written every so many events, and at the end; 0 for the end only.
    """

    updates: int | None = None
    most: int = 1_000_000
    fields_every: int = 0

    def __post_init__(self) -> None:
        if self.updates is not None and self.updates < 1:
            raise CaseError(f"The event-driven solver needs updates >= 1, not {self.updates}.")
        if self.most < 1 or self.fields_every < 0:
            raise CaseError("The event-driven solver needs most >= 1 and fields_every >= 0.")


AnySolver: TypeAlias = Newton | DynamicRelaxation | EventDriven

# The ways to equilibrium by the word that the command line uses.
SOLVERS: dict[str, AnySolver] = {"newton": Newton(), "relaxation": DynamicRelaxation(), "events": EventDriven()}
