"""The last step, for the initial guess with history or contact and for the direction of a path."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Protocol

import numpy as np

from pdpetsc.arrays import Float
from pdpetsc.discrete.communicator import largest, total
from pdpetsc.problem.body import Body
from pdpetsc.problem.state import State
from pdpetsc.problem.supports import Supports
from pdpetsc.problem.term import KeptArray, Term

# Conditions continue as before if they differ by at most this share of their change in the next step.
STRAIGHT = 0.1


class Loaded(Protocol):
    """Define the interface of the problem that ``LastStep`` uses."""

    body: Body
    supports: Supports
    terms: list[Term]

    def state(self, u: Float, t: float) -> State:
        """Return a state (collective)."""
        ...

    def external_force(self, state: State) -> Float:
        """Return the loads (n_rows, dim) [force] (collective)."""
        ...

    def admissible(self, state: State) -> bool:
        """Return True if the forces are defined at a state (collective)."""
        ...


class LastStep:
    """Store the change of the displacement in the last step: of materials with history, contact and paths by length.

    At a committed state the tangent of a yielded material is elastic. The linear response to new conditions then leads
    far from continued yielding. Where a tool moves on, the facets that it has yet to touch do not resist in the
    tangent. The last step, extrapolated, leads close to the next equilibrium as long as conditions and tools keep their
    direction.

    Parameters
    ----------
    problem : Problem
        The problem.

    Attributes
    ----------
    change : (n_owned, dim) float64
        The change [length]; 0 before the first step.

    Notes
    -----
    Methods are collective unless stated otherwise.
    """

    def __init__(self, problem: Loaded) -> None:
        self._problem = problem
        n, dim = problem.body.cloud.n_owned, problem.body.dim
        self.change = np.zeros((n, dim))
        # Load parameters of its end and its beginning, the same for all particles.
        self._times = np.zeros((n, 2))
        self._from: Float | None = None

    def begin(self, u: Float) -> None:
        """Store the unknowns (n_rows, dim) at the beginning of a step [length] (not collective)."""
        self._from = u[: len(self.change)].copy()

    def commit(self, state: State) -> None:
        """Store the change in a converged step (not collective)."""
        if self._from is None:
            return
        self._times[:] = np.stack([np.full(len(self._times), state.t), self._times[:, 0]], axis=1)
        self.change[:] = state.own - self._from

    def arrays(self) -> Mapping[str, KeptArray]:
        """Return the arrays that a restart needs (not collective)."""
        own = np.arange(len(self.change), dtype=np.int32)
        return {"last_step_change": KeptArray(own, self.change), "last_step_times": KeptArray(own, self._times)}

    def moved_on(self, u: Float, t: float) -> Float | None:
        """Extrapolate the unknowns (n_rows, dim) to load parameter ``t`` [length].

        None if there is no earlier step, the conditions change direction, or the result is not admissible.
        """
        comm = self._problem.body.cloud.comm
        last, first = (largest(comm, column, initial=0.0) for column in self._times.T)
        if not first < last < t:
            return None
        ratio = (t - last) / (last - first)
        tools = [term.tool_displacements for term in self._problem.terms]
        for at in (self._problem.supports.prescribed, lambda time: self._loads(u, time), *tools):
            now = at(last)
            coming, before = at(t) - now, ratio * (now - at(first))
            off, size = total(comm, [float(((coming - before) ** 2).sum()), float((coming**2).sum())])
            if off > STRAIGHT**2 * size:
                return None
        found = u.copy()
        found[: len(self.change)] += ratio * self.change
        return found if self._problem.admissible(self._problem.state(found, t)) else None

    def _loads(self, u: Float, t: float) -> Float:
        return self._problem.external_force(self._problem.state(u, t))
