"""Energy balance of load steps in which points fail."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

from pdpetsc.case import Case
from pdpetsc.output.observer import Observer, StepRecords
from pdpetsc.post.solution import Solution
from pdpetsc.problem.problem import Problem
from pdpetsc.solvers.protocol import Converged

# A run warns if work and energies differ by more than this share of the largest work.
OFF = 0.05


class EnergyBalance(Observer):
    """Warns if the external work is not the stored and dissipated energy, since damage jumped within a load step.

    For damage at points of elastic bodies without inertia, temperature, friction and terms of their own, whose energies
    are all known.
    """

    def __init__(self, case: Case, problem: Problem) -> None:
        damage, inert = problem.damage, problem.inertia is None and not problem.touches and problem.symmetric
        of_points = damage is not None and damage.forces_have_energy and not case.of_bonds
        elastic = of_points and not case.expands and not case.terms and not any(law.has_history for law in case.laws)
        self._applies = inert and elastic

    def step(self, solution: Solution, converged: Converged) -> Mapping[str, Any]:
        """Return work, and work less energies [energy]."""
        if not self._applies:
            return {}
        dissipated = solution.problem.material_term.dissipated_energy()
        assert dissipated is not None
        work = solution.work
        return {"work": work, "unbalanced_work": work - sum(solution.energies.values()) - dissipated}

    def warnings(self, steps: StepRecords) -> list[str]:
        """Return a warning if work and energies differ."""
        known = [(step["t"], step["work"], step["unbalanced_work"]) for step in steps if "unbalanced_work" in step]
        most = max((abs(work) for _, work, _ in known), default=0.0)
        off = max((abs(lost) for _, _, lost in known), default=0.0)
        if not off > OFF * most:
            return []
        before = [0.0, *(lost for _, _, lost in known)]
        rises = [(abs(lost - last), t) for last, (t, _, lost) in zip(before, known, strict=False)]
        return [
            f"Work and energies differ by {100.0 * off / most:.0f} %, most of it in the step to {max(rises)[1]:.6g}, "
            f"where damage jumped. Use shorter steps, or follow a path (pd.PathFollowing)."
        ]
