"""Base class of loads whose forces depend only on the load parameter."""

from __future__ import annotations

from abc import abstractmethod
from collections.abc import Callable

import numpy as np

from pdpetsc.arrays import Float, Mask
from pdpetsc.discrete.communicator import total
from pdpetsc.errors import case_errors
from pdpetsc.gradient.products import Product
from pdpetsc.problem.body import Body
from pdpetsc.problem.state import State
from pdpetsc.problem.term import Term

# The run record lists the resultant of a load at the first of these load parameters at which it is not zero.
SHOWN = (1.0, 0.75, 0.5, 0.25)


class PrescribedLoads(Term):
    """Provide external forces that depend only on the load parameter, with a record of each resultant.

    Parameters
    ----------
    body : Body
        Particles and bonds.

    Notes
    -----
    Construction and every method are collective.
    """

    load = True

    def __init__(self, body: Body) -> None:
        self.body = body
        self._resultants: list[tuple[str, float, Float]] = []
        self._noted: list[Callable[[float], Float]] = []
        self._last: tuple[float, Float] | None = None

    @property
    def parts(self) -> list[str]:
        """Return an empty list: loads have a separate record."""
        return []

    @property
    def resultants(self) -> list[tuple[str, float, Float]]:
        """Return name, load parameter and total force (dim,) [force] of every load, when it acts."""
        return self._resultants

    def add_row_force(self, state: State, r: Float) -> None:
        """Subtract the forces at the load parameter of the state."""
        r -= self.forces(state.t)

    def linearise(self, state: State) -> list[Product]:
        """Return an empty list: the loads do not depend on the displacement."""
        return []

    def forces(self, t: float) -> Float:
        """Return the external forces at load parameter ``t`` (n_rows, dim) [force]; the array must not be changed."""
        if self._last is None or self._last[0] != t:
            self._last = t, self._evaluated(t)
        return self._last[1]

    @abstractmethod
    def _evaluated(self, t: float) -> Float:
        """Compute the external forces at load parameter ``t`` (n_rows, dim) [force] in a new array."""

    def _changed(self) -> None:
        """Discard cached forces after a load was added (not collective)."""
        self._last = None

    def _note(self, name: str, forces: Callable[[float], Float]) -> None:
        """Record the resultant of a new load, for a function that computes its forces (n_rows, dim)."""
        self._changed()
        comm, n = self.body.cloud.comm, self.body.cloud.n_owned
        with case_errors():
            sums = [total(comm, forces(t)[:n].sum(axis=0)) for t in SHOWN]
        acting = next((number for number, force in enumerate(sums) if force.any()), 0)
        self._resultants.append((name, SHOWN[acting], sums[acting]))
        self._noted.append(forces)

    def shares_on(self, held: Mask) -> list[tuple[str, float]]:
        """Return name and share of the forces on components (n_owned, dim) of each load [-], 0 for a zero load."""
        comm, n = self.body.cloud.comm, self.body.cloud.n_owned
        found = []
        for (name, t, _), forces in zip(self._resultants, self._noted, strict=True):
            size = np.abs(forces(t)[:n])
            on_held, whole = total(comm, [size[held].sum(), size.sum()])
            found.append((name, float(on_held / whole) if whole > 0.0 else 0.0))
        return found
