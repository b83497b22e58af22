"""How equilibrium of a load step is found."""

from __future__ import annotations

import math
from dataclasses import dataclass

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


# The ways to equilibrium by the word that the command line uses.
SOLVERS: dict[str, Newton | DynamicRelaxation] = {"newton": Newton(), "relaxation": DynamicRelaxation()}
