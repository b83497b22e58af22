"""Rigid tools that never touch the body."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

from pdpetsc.case import Case
from pdpetsc.declare.tools import Contact
from pdpetsc.output.observer import Observer, StepRecords
from pdpetsc.post.solution import Solution
from pdpetsc.running.held import named
from pdpetsc.solvers.protocol import Converged
from pdpetsc.terms.contact import ContactForces


class UntouchedTools(Observer):
    """Warns of rigid tools that touch the body in no step of a run."""

    def __init__(self, case: Case) -> None:
        # Terms have the order of the conditions.
        self._names = [name for name, _ in named(case, Contact)]

    def step(self, solution: Solution, converged: Converged) -> Mapping[str, Any]:
        """Return the smallest gaps up to this step of the tools that have not touched [length]."""
        tools = [term for term in solution.problem.terms if isinstance(term, ContactForces)]
        gaps = {name: term.untouched for name, term in zip(self._names, tools, strict=False) if term.untouched > 0.0}
        return {"gaps": gaps} if gaps else {}

    def warnings(self, steps: StepRecords) -> list[str]:
        """Return a warning for each tool that has a gap in all steps."""
        gaps = [step.get("gaps", {}) for step in steps]
        return [
            f"The tool of {name} never touched the body. The smallest gap was {min(gap[name] for gap in gaps):.4g}."
            for name in self._names
            if gaps and all(name in gap for gap in gaps)
        ]
