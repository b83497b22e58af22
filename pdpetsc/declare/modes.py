"""Natural frequencies and buckling loads that a run computes at its end."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Literal

from pdpetsc.declared import Count, Declared


@dataclass(frozen=True)
class Modes(Declared):
    """The lowest modes of the body in its last equilibrium, or the loads at which it buckles.

    With mirror planes only the symmetric modes are found. Facets that a ``Contact`` presses are held by its
    stiffness; ``BodyContact`` is refused.

    Frequencies solve ``K phi = (2 pi f)^2 M phi`` with the tangent K of the last equilibrium and the masses ``M = rho
    V`` of the particles, from the ``density`` of their materials. A negative frequency -f stands for the growth
    ``exp(2 pi f t)`` of a mode in an unstable equilibrium.

    Buckling factors solve ``K_0 phi = c (K_0 - K_1) phi`` with the tangents of the undeformed body and of the last
    equilibrium. The body buckles at c times the load, if the tangent is linear in the load: apply a small part of it.

    The results are ``frequency_1``, ``frequency_2``, ... or ``buckling_1``, ...; the shapes are in ``modes.h5``, see
    ``Result.mode``. The eigenvectors are kept on one rank.

    Parameters
    ----------
    count : int
        Number of modes.
    of : {"frequency", "buckling"}
        What is computed.

    Raises
    ------
    CaseError
        A material has no density or may flow, the solver is not ``Newton``, the tangent is not symmetric, or the case
        has damage, heat conduction or a periodic cell.

    References
    ----------
    Lehoucq1998 (the solver).

    Examples
    --------
    >>> import pdpetsc as pd
    >>> steel = pd.LinearElastic(E=200e9, nu=0.3, plane="stress", density=8000.0)
    >>> modes = pd.Modes(6)
    """

    count: Count
    of: Literal["frequency", "buckling"] = "frequency"

    @property
    def names(self) -> list[str]:
        """Return the names of the results."""
        return [f"{self.of}_{number}" for number in range(1, self.count + 1)]
