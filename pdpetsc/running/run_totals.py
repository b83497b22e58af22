"""What a run has come across from its first step on, also where it was interrupted and goes on."""

from __future__ import annotations

import json
from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

from pdpetsc.output.checkpoint import Origin
from pdpetsc.solvers.protocol import Converged


@dataclass
class RunTotals:
    """What steps gave that is said at the end of a run; a checkpoint has it as numbers.

    Attributes
    ----------
    steps : int
        How many.
    largest_force, last_force : float
        What residuals are compared with, which is as large as the forces of supports and loads [force].
    unstable : int
        Steps that ended at an unstable equilibrium.
    first_unstable : float
        Step time of the first of them [-].
    branching : int
        Steps that ended where other branches may lead away.
    first_branching : float
        Step time of the first of them [-].
    whole : bool
        Whether it is known of all steps: not where a checkpoint did not tell of those before it.
    """

    steps: int = 0
    largest_force: float = 0.0
    last_force: float = 0.0
    unstable: int = 0
    first_unstable: float = 0.0
    branching: int = 0
    first_branching: float = 0.0
    whole: bool = True

    @classmethod
    def of(cls, origin: Origin | None) -> RunTotals:
        """Return what the checkpoint that a run goes on from tells; nothing of a run from the beginning."""
        if origin is None:
            return cls()
        told = dict(origin.record.so_far)
        return cls(
            int(told.get("steps", 0)), told.get("largest_force", 0.0), told.get("last_force", 0.0),
            int(told.get("unstable", 0)), told.get("first_unstable", 0.0),
            int(told.get("branching", 0)), told.get("first_branching", 0.0),
            bool(told.get("whole", 0.0)) or origin.start.step == 0,
        )  # fmt: skip

    def add(self, step: Converged) -> None:
        """Take the next step."""
        self.steps += 1
        self.last_force = float(step.result.reference)
        self.largest_force = max(self.largest_force, self.last_force)
        if step.result.negative_pivots:
            self.first_unstable = self.first_unstable if self.unstable else float(step.t)
            self.unstable += 1
        if step.result.growth > 1.0:
            self.first_branching = self.first_branching if self.branching else float(step.t)
            self.branching += 1

    @property
    def numbers(self) -> dict[str, float]:
        """Return it as numbers."""
        return {name: float(value) for name, value in vars(self).items()}


def steps_before(origin: Origin | None) -> list[Mapping[str, Any]]:
    """Return what the summary beside a checkpoint says of the steps up to it; none where it does not know all of them.

    Not collective. A run that was killed has no summary of its steps.
    """
    if origin is None:
        return []
    try:
        found = json.loads((origin.path.parent / "summary.json").read_text())
        steps = [step for step in found["steps"] if int(step["step"]) <= origin.start.step]
        numbers = [int(step["step"]) for step in steps]
        known = found["run"] == origin.record.run and numbers == list(range(1, len(steps) + 1))
        known = known and len(steps) == origin.start.step
    except (OSError, ValueError, KeyError, TypeError, AttributeError):
        return []
    return steps if known else []
