"""Fields that are solved for beside the displacement, such as a temperature."""

from __future__ import annotations

from typing import Protocol


class SolvedField(Protocol):
    """A field that equilibrium depends on and that does not depend on the displacement of the step."""

    @property
    def monolithic(self) -> bool:
        """Return True if it is solved for together with the displacement, not before it (not collective)."""
        ...

    def advance(self, before: float, t: float) -> None:
        """Go from the last converged step time ``before`` to ``t``, or set up the system of that step (collective).

        Raises
        ------
        SolveError
            The field has no solution.
        """

    def revert(self) -> None:
        """Go back to the last converged step (collective)."""

    def destroy(self) -> None:
        """Free what it holds outside Python (collective)."""
