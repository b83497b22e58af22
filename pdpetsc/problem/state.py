"""State of a problem: unknowns, clock, and quantities computed from them."""

from __future__ import annotations

from collections.abc import Callable, Hashable
from typing import Any, TypeVar

from pdpetsc.arrays import Float
from pdpetsc.clock import START, Clock
from pdpetsc.problem.body import Body

T = TypeVar("T")


class State:
    """Store unknowns and clock, and the quantities that terms compute from them.

    Ghosts are exchanged once, on first use. Quantities that terms cache here (deformation gradients, degradation
    factors of bonds) are computed once for forces, tangent, energy and outputs.

    Parameters
    ----------
    body : Body
        The body.
    u : (n_rows, dim) float64
        Unknowns [length]; must not change while the state is in use.
    clock : Clock
        Load parameter and physical time.
    u_local : (n_local, dim) float64, optional
        Displacements with ghosts, if known [length].
    """

    def __init__(self, body: Body, u: Float, clock: Clock = START, u_local: Float | None = None) -> None:
        self.body = body
        self.u = u
        self.clock = clock
        # Stress-free deformation; None for a body without expansion.
        self.expansion = None if body.expansion is None else body.expansion.at(clock.load)
        self._u_local = u_local
        self._elongated: dict[bool, tuple[Float, float]] = {}
        self._kept: dict[Hashable, Any] = {}

    @property
    def t(self) -> float:
        """Return the load parameter [-]."""
        return self.clock.load

    @property
    def temperature(self) -> Float | None:
        """Return the temperature of the own particles (n_owned,); None for a body without temperature."""
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
        """Return the elongations (n_bonds,) and the smallest current length of a bond on this rank [length].

        For a body that expands, the force-free elongations are subtracted (collective).
        """
        if finite not in self._elongated:
            e, least = self.body.elongated(self.u_local, finite)
            self._elongated[finite] = e if self.expansion is None else e - self.expansion.elongation(finite), least
        return self._elongated[finite]

    def kept(self, key: Hashable, make: Callable[[], T]) -> T:
        """Return the value cached under ``key``; compute it with ``make`` on first use."""
        if key not in self._kept:
            self._kept[key] = make()
        value: T = self._kept[key]
        return value

    def after_damage(self, clock: Clock) -> State:
        """Return the state with the same displacements and elongations, after damage or histories have changed."""
        state = State(self.body, self.u, clock, self._u_local)
        state._elongated = self._elongated
        return state

    def forget(self) -> None:
        """Free the cached quantities; they are computed again on demand."""
        self._u_local, self._elongated = None, {}
        self._kept.clear()
