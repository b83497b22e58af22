"""Base class of loads that depend on the displacement."""

from __future__ import annotations

from pdpetsc.arrays import Float
from pdpetsc.problem.term import Term


class FollowingLoad(Term):
    """A load that depends on the displacement.

    Parameters
    ----------
    name : str
        Name of the condition in messages.
    resultant : (dim,) float64
        Total force on the undeformed body at the end of the load, for the run record [force].
    """

    linear = False
    load = True

    def __init__(self, name: str, resultant: Float) -> None:
        self._resultant = name, 1.0, resultant

    @property
    def parts(self) -> list[str]:
        """Return an empty list: loads have a separate record."""
        return []

    @property
    def resultants(self) -> list[tuple[str, float, Float]]:
        """Return name, load parameter and total force (dim,) [force] on the undeformed body."""
        return [self._resultant]
