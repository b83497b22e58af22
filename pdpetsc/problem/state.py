"""State of a problem: unknowns, clock, and what is computed from them."""

from __future__ import annotations

from collections.abc import Callable, Hashable
from typing import Any, TypeVar

from pdpetsc.arrays import Float
from pdpetsc.clock import START, Clock
from pdpetsc.problem.body import Body

T = TypeVar("T")


class State:
    """Unknowns and clock, and what terms have computed from them.

    Ghosts are exchanged once, when they are first asked for, and what a term keeps here (deformation gradients,
    degradation factors of bonds) is computed once for forces, tangent, energy and outputs.

    Parameters
    ----------
    body : Body
        Whose unknowns they are.
    u : (n_rows, dim) float64
        Unknowns [length]; not to be changed while the state is in use.
    clock : Clock
        Load parameter and physical time.
    u_local : (n_local, dim) float64, optional
        Displacements with ghosts, where they are known [length].
    """

    def __init__(self, body: Body, u: Float, clock: Clock = START, u_local: Float | None = None) -> None:
        self.body = body
        self.u = u
        self._clock = clock
        # The stress-free deformation, None for a body that does not expand.
        self.expansion = None if body.expansion is None else body.expansion.at(clock.load)
        self._u_local = u_local
        self._kept: dict[Hashable, Any] = {}

    @property
    def clock(self) -> Clock:
        """Return load parameter and physical time."""
        return self._clock

    @property
    def t(self) -> float:
        """Return the load parameter [-]."""
        return self._clock.load

    @property
    def temperature(self) -> Float | None:
        """Return the temperature of the own particles (n_owned,), None in a body without."""
        return None if self.expansion is None else self.expansion.temperature

    @property
    def own(self) -> Float:
        """Return the displacements of the own particles (n_owned, dim) [length]."""
        return self.u[: self.body.cloud.n_owned]

    @property
    def u_local(self) -> Float:
        """Return the displacements with ghosts (n_local, dim) [length] (collective on first use)."""
        if self._u_local is None:
            self._u_local = self.body.with_ghosts(self.u)
        return self._u_local

    def elongated(self, finite: bool) -> tuple[Float, float]:
        """Return the elongations (n_bonds,) and the least current length of a bond on this rank [length].

        Of a body that expands they are those beyond what its bonds have without force (collective).
        """
        u_local, expansion = self.u_local, self.expansion

        def make() -> tuple[Float, float]:
            e, least = self.body.elongated(u_local, finite)
            return e if expansion is None else e - expansion.elongation(finite), least

        return self.kept(("elongation", finite), make)

    def kept(self, key: Hashable, make: Callable[[], T]) -> T:
        """Return what was kept under ``key``, or make and keep it."""
        if key not in self._kept:
            self._kept[key] = make()
        value: T = self._kept[key]
        return value

    def forget(self) -> None:
        """Free what is kept, which would be computed again."""
        self._u_local = None
        self._kept.clear()
