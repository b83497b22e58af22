"""Unstable equilibria, and equilibria with several branches."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

from pdpetsc.case import Case
from pdpetsc.errors import CaseError
from pdpetsc.output.observer import Observer, StepRecords
from pdpetsc.output.progress import Report
from pdpetsc.post.solution import Solution
from pdpetsc.running.modes import has_no_modes


class Stability(Observer):
    """Warns of unstable equilibria and of branches.

    If the solver computes the load factor, equilibria beyond the limit load are intended.
    """

    def __init__(self, case: Case) -> None:
        self._case, self._unsymmetric = case, False

    def rehearse(self, start: Solution, report: Report) -> None:
        """Refuse to switch branches if the tangent has no modes, or with contact."""
        self._unsymmetric = not start.problem.symmetric
        if self._case.steps.unstable != "switch":
            return
        wrong = has_no_modes(self._case, start.problem)
        if not wrong and start.problem.touches:
            wrong = "do not go with contact"
        if not wrong and start.problem.rigid_bodies:
            wrong = "do not go with rigid bodies whose motion follows from a load"
        if wrong:
            raise CaseError(
                f'Steps(unstable="switch") needs modes of the tangent, and modes {wrong}. Use unstable="shorten".'
            )

    def summary(self, steps: StepRecords) -> Mapping[str, Any]:
        """Return the number of steps that switched to another branch."""
        switched = sum("switched" in step for step in steps)
        return {"switched_steps": switched} if self._case.steps.unstable == "switch" else {}

    def warnings(self, steps: StepRecords) -> list[str]:
        """Return a warning for unstable equilibria and one for branches."""
        unstable = [step["t"] for step in steps if step["negative_pivots"]]
        branching = [step["t"] for step in steps if step.get("growth", 0.0) > 1.0 or step.get("crossed")]
        found = []
        if unstable and not self._case.solver.finds_load:
            found.append(
                f"{len(unstable)} of {len(steps)} equilibria are unstable, first at step time {unstable[0]:.6g}. "
                "Perturb the body, or use Steps(unstable='shorten') or 'switch'."
            )
        if self._case.solver.finds_load and self._unsymmetric and steps:
            found.append(
                "Nothing tells whether the equilibria of this path are stable: the tangent is unsymmetric. Repeat the "
                "steps with Newton and Steps(unstable='refuse'), or move the body with Implicit."
            )
        if branching:
            found.append(
                f"Damage grew through unstable states in {len(branching)} of {len(steps)} steps, first at step time "
                f"{branching[0]:.6g}; round-off may choose the equilibrium. Use smaller steps, perturb the body, or "
                "follow the path."
            )
        return found
