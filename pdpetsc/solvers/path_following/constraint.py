"""The constraint that replaces the prescribed load along a path."""

from __future__ import annotations

from dataclasses import dataclass

from pdpetsc.arrays import Float
from pdpetsc.discrete.communicator import Comm, scalar_product


@dataclass(frozen=True)
class Constraint:
    """Prescribe the growth of ``of . (u - u0) + share (load - load0)``.

    Attributes
    ----------
    of : (n_rows, dim) float64
        Weights of the unknowns.
    share : float
        Weight of the load factor.
    u0, load0
        Unknowns [length] and load factor [-] at the start of the step.
    """

    of: Float
    share: float
    u0: Float
    load0: float

    def grown(self, comm: Comm, u: Float, load: float) -> float:
        """Compute the growth (collective)."""
        return scalar_product(comm, self.of, u - self.u0) + self.share * (load - self.load0)
