"""Energy balance of a step along a path with damage: the body must not release more energy than was supplied."""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np

from pdpetsc.arrays import Float
from pdpetsc.discrete.communicator import total
from pdpetsc.problem.problem import Problem
from pdpetsc.problem.state import State
from pdpetsc.problem.term import Term

# Tolerated decrease of the dissipated energy, as a share of the largest stored energy so far. Gradients of fewer bonds
# may store more energy at the same displacement. If bonds of gradients soften or regain force, the forces have no
# potential even at constant damage, and the stored energy is an estimate.
SHARE, SHARE_WITHOUT_POTENTIAL = 0.1, 1.0
# Names in a checkpoint of the largest stored energy of the run, and of the decrease of the dissipated energy below its
# largest value [energy].
LARGEST, FALLEN = "largest_energy", "fallen_energy"


class EnergyBalance:
    """Compute external work minus stored energy minus dissipation of the damage laws, step by step.

    The work is that of the trapezoidal rule over the equilibria that a step passes (``pass_by``). The rule is exact if
    forces are linear between two of them. If materials or softening bonds make them nonlinear, its error estimate is
    half of the product of the changes of forces and displacements. A load step may pass a peak of the load that neither
    of its ends shows, so load steps are not checked.

    Parameters
    ----------
    problem : Problem
        The problem.
    start : State
        Equilibrium at which the first step begins.
    resume : mapping of str to float
        Numbers of a checkpoint.

    Attributes
    ----------
    judges : bool
        Whether the balance is checked.
    work : float
        External work since the last ``keep`` [energy].

    Notes
    -----
    The balance is not checked if bonds do not fail, or if a term of the case defines no energy. Construction and every
    method are collective unless stated otherwise.
    """

    def __init__(self, problem: Problem, start: State, resume: Mapping[str, float]) -> None:
        self._problem = problem
        silent = any(type(term).energy is Term.energy for term in problem.terms if not (term.load or term.of_solver))
        self.judges = problem.damage is not None and not silent
        estimated = problem.softens and problem.material_term.dissipated_energy() is None
        self._share = SHARE_WITHOUT_POTENTIAL if estimated else SHARE
        self._bends = self.judges and (problem.softens or not problem.piecewise_linear)
        self._at, self._force, self._tools = _bare(start), self._acting(start), problem.tool_forces(start)
        self._kept = self._at, self._force, self._tools
        self._energy = self._found = self._held(start)
        self._largest = max(resume.get(LARGEST, 0.0), self._energy[0])
        self._fallen = self._falls = resume.get(FALLEN, 0.0)
        self.work, self._error = 0.0, 0.0

    @property
    def resume(self) -> dict[str, float]:
        """Return the numbers for a checkpoint (not collective)."""
        return {LARGEST: self._largest, FALLEN: self._fallen}

    def pass_by(self, state: State) -> None:
        """Add the work from the last equilibrium to this one, with its current damage."""
        problem, force, tools = self._problem, self._acting(state), self._problem.tool_forces(state)
        moved = state.u - self._at.u
        mean, change = 0.5 * (force + self._force), 0.5 * (force - self._force)
        by_tools = problem.tool_work(self._at, state, self._tools, tools)
        off_by_tools = problem.tool_work(self._at, state, [-force for force in self._tools], tools)
        sums = total(problem.body.cloud.comm, [(mean * moved).sum() + by_tools, (change * moved).sum() + off_by_tools])
        self.work += float(sums[0])
        self._error += abs(float(sums[1])) if self._bends else 0.0
        self._at, self._force, self._tools = _bare(state), force, tools

    def broken_by(self, state: State) -> str:
        """Return the reason for refusing a step that ends at the last passed state; empty if its energy balances."""
        if not self.judges:
            return ""
        self._found = stored, by_laws = self._held(state)
        gained = (stored - self._energy[0]) + (by_laws - self._energy[1])
        largest = max(self._largest, stored)
        self._falls = max(self._fallen + gained - self.work - self._error, 0.0)
        if self._falls <= self._share * largest:
            return ""
        return (
            f"the energy does not balance, as if breaking bonds had given back {self._falls:.3g} of what they "
            f"dissipated, where the body has stored {largest:.3g} at most"
        )

    def released(self, state: State) -> float:
        """Return the work since ``keep`` less the change of the stored energy to a passed state, over their sizes."""
        self._found = self._held(state)
        gained = self._found[0] - self._energy[0]
        size = abs(self.work) + abs(gained)
        return (self.work - gained) / size if size > 0.0 else 0.0

    def keep(self) -> None:
        """Begin the next step at the end of the last one (not collective)."""
        self.work, self._error = 0.0, 0.0
        self._kept, self._energy = (self._at, self._force, self._tools), self._found
        self._largest = max(self._largest, self._energy[0])
        self._fallen = self._falls

    def go_back(self) -> None:
        """Restart the step (not collective)."""
        self.work, self._error = 0.0, 0.0
        self._at, self._force, self._tools = self._kept

    def _acting(self, state: State) -> Float:
        """Compute the forces of loads and supports (n_rows, dim) [force]."""
        inside = self._problem.internal_force(state, of_solver=False)
        loads = self._problem.external_force(state)
        return loads if inside is None else np.where(self._problem.supports.reacting, inside, loads)

    def _held(self, state: State) -> tuple[float, float]:
        """Return the stored energy of the body, and the energy dissipated by the damage laws [energy]."""
        by_laws = self._problem.material_term.dissipated_energy()
        return sum(self._problem.energies(state).values()), 0.0 if by_laws is None else by_laws


def _bare(state: State) -> State:
    """Return a state without its cached quantities, which need many times the memory of the unknowns."""
    return State(state.body, state.u, state.clock)
