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
                f"{len(unstable)} of {len(steps)} equilibria are unstable, the first at step time {unstable[0]:.6g}; "
                f'perturb the body, or let Steps(unstable="shorten") end the run before.'
            )
        if branching:
            found.append(
                f"At {len(branching)} of {len(steps)} steps damage jumped to where other branches lead away, the "
                f"first at step time {branching[0]:.6g}: round-off may decide what follows, and with it the "
                f"units and the order of particles; take smaller steps, or perturb the body."
            )
        return found
