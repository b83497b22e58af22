"""What is found before the equilibrium of a load step, such as a temperature."""

from __future__ import annotations

from typing import Protocol


class StaggeredField(Protocol):
    """A field that equilibrium depends on and that does not depend on the displacement of the step."""

    @property
    def monolithic(self) -> bool:
        """Return whether the solver finds it together with the displacement (not collective)."""
        ...

    def advance(self, before: float, t: float) -> None:
        """Go from the last converged step time ``before`` to ``t`` (collective).

        Raises
        ------
        SolveError
            It cannot.
        """

    def revert(self) -> None:
        """Go back to the last converged step (collective)."""

    def destroy(self) -> None:
        """Free what it holds outside Python (collective)."""
