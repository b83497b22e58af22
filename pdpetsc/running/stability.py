"""Unstable equilibria, and equilibria with several branches."""

from __future__ import annotations

from pdpetsc.output.observer import Observer, StepRecords


class Stability(Observer):
    """Warns of unstable equilibria and of branches.

    Parameters
    ----------
    finds_load : bool
        True if the load factor is an unknown, so that equilibria beyond the limit load are intended.
    """

    def __init__(self, finds_load: bool) -> None:
        self._finds_load = finds_load

    def warnings(self, steps: StepRecords) -> list[str]:
        """Return a warning for unstable equilibria and one for branches."""
        unstable = [step["t"] for step in steps if step["negative_pivots"]]
        branching = [step["t"] for step in steps if step.get("growth", 0.0) > 1.0]
        found = []
        if unstable and not self._finds_load:
            found.append(
                f"{len(unstable)} of {len(steps)} equilibria are unstable, first at step time {unstable[0]:.6g}. "
                "Perturb the body, or use Steps(unstable='shorten')."
            )
        if branching:
            found.append(
                f"Damage jumped at a branching point in {len(branching)} of {len(steps)} steps, first at step time "
                f"{branching[0]:.6g}; round-off may choose the branch. Use smaller steps, or perturb the body."
            )
        return found
