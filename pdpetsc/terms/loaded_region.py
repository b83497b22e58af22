"""A region that moves as a rigid body under a load."""

from __future__ import annotations

from collections.abc import Mapping, Sequence

from pdpetsc.arrays import LocalIndex
from pdpetsc.gradient.products import Product
from pdpetsc.problem.rigid_body import RigidBody
from pdpetsc.problem.state import State
from pdpetsc.problem.term import KeptArray, Term


class LoadedRegion(Term):
    """Hold the motion of a rigid region that follows from its load; the supports move its particles.

    Parameters
    ----------
    rigid : RigidBody
        The region.
    owner : (n,) int32
        Its own particles.
    """

    def __init__(self, rigid: RigidBody, owner: LocalIndex) -> None:
        self.rigid, self._kept = rigid, KeptArray(owner, rigid.kept)

    def linearise(self, state: State) -> Sequence[Product]:
        """Return an empty list: the term has no forces."""
        return []

    def energy(self, state: State) -> float:
        """Return 0: the term has no forces."""
        return 0.0

    def arrays(self) -> Mapping[str, KeptArray]:
        """Return the motion at the last converged step."""
        return {"rigid": self._kept}
