"""Fragments of a body with broken bonds, and particles without a gradient."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

from pdpetsc.arrays import Float
from pdpetsc.output.observer import Observed, Observer, StepRecords
from pdpetsc.output.records import Table
from pdpetsc.post.solution import Solution
from pdpetsc.problem.fragments import fragments_of, pieces_left
from pdpetsc.solvers.protocol import Converged


class DetachedParticles(Observer):
    """Counts particles with too few bonds for a gradient."""

    _count = 0

    def begin(self, observed: Observed) -> None:
        """Count particles already detached at a restart."""
        super().begin(observed)
        if observed.origin is not None:
            self._count = observed.problem.material_term.n_detached

    def step(self, solution: Solution, converged: Converged) -> Mapping[str, Any]:
        """Print a line if the number has increased."""
        lost = solution.problem.material_term.n_detached
        if lost > self._count:
            line = f"           {lost} particles have too few bonds left for a gradient, and no stress"
            self.observed.report.say(line)
        self._count = lost or self._count
        return {}

    def summary(self, steps: StepRecords) -> Mapping[str, Any]:
        """Return their number, if there are any."""
        return {"detached_particles": self._count} if self._count else {}


class Fragments(Observer):
    """Counts the fragments at the end of the run, lists them in ``fragments.csv``, and compares forces."""

    def __init__(self) -> None:
        self._pieces: dict[str, Any] = {}
        self._u: Float | None = None

    def step(self, solution: Solution, converged: Converged) -> Mapping[str, Any]:
        """Store the displacement for the centres of the fragments."""
        self._u = solution.state.own
        return {}

    def end(self) -> None:
        """Print the number of fragments if bonds are broken."""
        problem, steps = self.observed.problem, self.observed.steps
        if self._pieces or problem.bond_damage is None or not problem.bond_damage.bonds.count_broken():
            return
        pieces, lone = pieces_left(problem)
        if self._u is not None:
            names, rows = fragments_of(problem, self._u)
            table = [[f"{value:.12g}" for value in row] for row in rows.tolist()]
            Table(self.observed.comm, self.observed.folder / "fragments.csv", [names, *table]).flush()
        forces = [float(step["reference"] or 0.0) for step in steps]
        most = max(forces, default=0.0)
        left = forces[-1] / most if most > 0.0 else float("nan")
        self._pieces = {"pieces": {"pieces": pieces, "lone_particles": lone, "forces_left": left}}
        body = "the body is in one piece" if pieces == 1 else f"the body is in {pieces} pieces"
        beside = f" and {lone} lone particles" if lone else ""
        share = f"{100.0 * left:.3g} %" if left > 1e-4 else "less than 0.01 %"
        carried = f"; the last load is {share} of the largest of this run" if left == left else ""
        self.observed.report.say(f"{body}{beside}{carried}")

    def summary(self, steps: StepRecords) -> Mapping[str, Any]:
        """Return the number of fragments, once counted."""
        return self._pieces
