"""Interface of fields that are solved for besides the displacement, such as a temperature."""

from __future__ import annotations

from typing import Protocol


class SolvedField(Protocol):
    """Describe a field that equilibrium depends on and that does not depend on the displacement of the step."""

    @property
    def monolithic(self) -> bool:
        """Return True if the field is solved together with the displacement, not before it (not collective)."""
        ...

    def advance(self, before: float, t: float) -> None:
        """Solve the field from the converged load parameter ``before`` to ``t``, or set up its system (collective).

        Raises
        ------
        SolveError
            The field has no solution.
        """

    def revert(self) -> None:
        """Restore the last converged step (collective)."""

    def destroy(self) -> None:
        """Free memory outside Python (collective)."""
