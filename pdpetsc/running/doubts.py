"""Numbers of a converged run that may be wrong, such as J, G and K that depend on the path."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

from pdpetsc.output.observer import Observer, StepRecords
from pdpetsc.post.quantities import Quantity
from pdpetsc.post.solution import Solution
from pdpetsc.solvers.protocol import Converged


class Doubts(Observer):
    """Records why quantities of a step may be wrong."""

    def __init__(self, quantities: Mapping[str, Quantity]) -> None:
        self._quantities = quantities

    def step(self, solution: Solution, converged: Converged) -> Mapping[str, Any]:
        """Return the doubts of a step."""
        doubts = {name: quantity.doubt(solution) for name, quantity in self._quantities.items()}
        return {"doubts": {name: why for name, why in doubts.items() if why}} if any(doubts.values()) else {}

    def summary(self, steps: StepRecords) -> Mapping[str, Any]:
        """Return the first doubt of each number, and the number of steps with a doubt."""
        first: dict[str, dict[str, Any]] = {}
        for step in steps:
            for name, why in step.get("doubts", {}).items():
                first.setdefault(name, {"t": step["t"], "why": why, "steps": 0})["steps"] += 1
        return {"doubts": first}

    def warnings(self, steps: StepRecords) -> list[str]:
        """Return a warning for each doubtful number."""
        found = []
        for name, doubt in self.summary(steps)["doubts"].items():
            when = f"step time {doubt['t']:.6g}" + (f", the first of {doubt['steps']}," if doubt["steps"] > 1 else "")
            found.append(f"{name} of the history at {when} {doubt['why']}.")
        return found
