"""The event-driven solver: from one failing bond to the next."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from dataclasses import dataclass
from typing import cast

import numpy as np

from pdpetsc.arrays import Float
from pdpetsc.damage.laws import PiecewiseLinear, reached
from pdpetsc.declare.solvers import EventDriven
from pdpetsc.discrete.communicator import smallest
from pdpetsc.errors import CaseError, Interrupted, SolveError
from pdpetsc.kernels.bonds import first_failure, first_of_tied
from pdpetsc.problem.assembly import Assembler
from pdpetsc.problem.damage import Damage
from pdpetsc.problem.problem import Problem
from pdpetsc.solvers.event_driven.direction import Changed, Direction, find_direction
from pdpetsc.solvers.event_driven.inelastic import InelasticForces
from pdpetsc.solvers.event_driven.pairs import Key, Pairs, make_pairs, rehearse_pairs
from pdpetsc.solvers.protocol import Converged, OnFailure, Setting, Solver, Start, StepResult
from pdpetsc.terms.bond_forces import BondForces

# Bonds this close to their limit fail at the same load, one after the other, ordered by their positions.
TIED = 1e-10
# An event comes first if it is closer than another by this relative distance.
NEARER = 1e-12
# A load below this share of its largest value indicates a body without load capacity.
UNLOADED = 1e-9
# Number of changed bonds at which the matrix is refactored: this multiple of the root of the number of unknowns, within
# limits.
UPDATES = 2.0
FEWEST, MOST = 32, 400
# After this number of consecutive events without motion the path is in a cycle.
STANDSTILL = 1000
# Reason for the end of a path at load parameter 1.
WHOLE_LOAD = "the whole load"
# Number of events that are all printed, and the interval of printed events afterwards.
FIRST_EVENTS, EVENTS_A_LINE = 10, 100


class EventSolver(Solver):
    """Follow the equilibrium of a body with piecewise linear laws, event by event.

    Between events the displacement moves along a straight line. A bond at its limit fails: its force ``q`` decreases
    along its law, ``de = c dq``. ``c = 0`` for a bond that snaps; ``c = -(r - 1) / k`` for a bond that softens up to
    ``r`` times its limit. The load increases or decreases as equilibrium requires. If another bond reaches its limit
    meanwhile, either both continue to fail, or the first unloads along its secant. The consistent choice is used:
    forces of failing bonds decrease, unloading bonds shorten.

    Parameters
    ----------
    problem, assembler
        The problem, and the object that fills its matrix.
    options : EventDriven
        Declared solver.
    stop : callable
        Called at every event, collectively; True ends the run (a signal arrived).

    Raises
    ------
    CaseError
        The solver does not support the laws or conditions; the message states the reason.

    References
    ----------
    Jirasek1994, section 4; Mikes2021, section 2.2.
    """

    unit = "event"
    advice = "perturb the positions, so that fewer bonds fail at once"

    def __init__(self, problem: Problem, assembler: Assembler, options: EventDriven, stop: Callable[[], bool]) -> None:
        # Only events change the degradation factor; between them the body is linear.
        problem.freeze(True)
        damage = problem.bond_damage
        self._problem = problem
        self._comm = problem.body.cloud.comm
        self._options = options
        self._stop = stop
        self._pairs: Pairs | None = None
        if damage is not None:
            _refuse_laws(damage)
            assert isinstance(problem.material_term, BondForces)
            self._pairs = make_pairs(problem.material_term)
        self.solver = InelasticForces(problem, assembler, self._pairs)
        unknowns = problem.body.cloud.n_global * problem.dim
        automatic = int(np.clip(UPDATES * np.sqrt(unknowns), FEWEST, MOST))
        self._updates = options.updates or automatic
        self.factored = 0
        self._touched: list[int] = []
        n = 0 if self._pairs is None else len(self._pairs.k)
        self._e, self._phi, self._able = np.zeros(n), np.ones(n), np.ones(n, dtype=bool)
        self._reach = np.empty(0) if self._pairs is None else self._pairs.limit.copy()

    @property
    def matrix_bytes(self) -> int:
        """Return the memory of the matrix over all ranks [bytes]."""
        return self.solver.matrix.bytes

    def description(self) -> str:
        """Return a short description of the solver."""
        ksp = self.solver.ksp
        return f"event-driven, ksp {ksp.getType()}, pc {ksp.getPC().getType()}, {self._updates} changes per factor"

    def destroy(self) -> None:
        self.solver.destroy()

    @classmethod
    def make(cls, setting: Setting) -> EventSolver:
        """Build the solver of a setting (collective)."""
        return cls(setting.problem, cast(Assembler, setting.assembler), setting.declared, setting.stop)

    @classmethod
    def rehearse(cls, problem: Problem) -> None:
        """Compile or load the kernels between events (collective on the ranks of the problem)."""
        if problem.bond_damage is not None and isinstance(problem.material_term, BondForces):
            rehearse_pairs(problem.material_term)

    @classmethod
    def refuse(cls, problem: Problem) -> None:
        """Raise CaseError on all ranks if bonds fail that do not carry forces themselves (not collective)."""
        if problem.damage is not None and not isinstance(problem.material_term, BondForces):
            raise CaseError(
                "The event-driven solver follows the bonds of bond-based materials; those of deformation gradients "
                "fail in load steps, with Newton."
            )

    def line(self, number: int, converged: Converged) -> str | None:
        """Return the printed line of an event: of the first ones, every hundredth, and the last."""
        reason = converged.result.reason
        if number > FIRST_EVENTS and number % EVENTS_A_LINE and reason != WHOLE_LOAD:
            return None
        return f"event {number:5d}  t = {converged.t:<10.6g} {reason}"

    def march(self, start: Start, on_failure: OnFailure) -> Iterator[Converged]:
        """Yield the state at every event, from the unloaded body to the end of the load (collective).

        The path begins at the unloaded body, for any ``start``, and ``on_failure`` is never called.

        Raises
        ------
        SolveError
            No direction of the path was found, or there are too many events. The states yielded before are valid.
        Interrupted
            A signal requested a stop.
        """
        problem = self._problem
        u, t, highest, still = np.zeros((problem.body.cloud.n_rows, problem.dim)), 0.0, 0.0, 0
        self._factor()
        self.solver.refuse_mechanism()
        for event in range(self._options.most):
            if self._stop():
                raise Interrupted(f"Stopped by a signal; results are complete up to step time {t:.6g}.")
            if len(self.solver.local) >= self._updates and not self._changed.failing:
                self._factor()
                # All forces are secant forces under a proportional load: this is the same state without round-off.
                u = t * self.solver.elastic
                self._e = self._elongation(u)
            ahead = self._ahead(t)
            du = self.solver.response(ahead.rate, ahead.p)
            de = self._elongation(du)
            step, fails, breaks = self._next(de, ahead, t)
            u, t = u + step * du, t + step * ahead.rate
            self._e += step * de
            self._move(ahead, step)
            done = fails is None and breaks is None
            reason = WHOLE_LOAD if done else self._begin(fails) if fails is not None else self._break(breaks)
            highest = max(highest, abs(t))
            done = done or (not self._changed.failing and abs(t) <= UNLOADED * highest)
            still = still + 1 if step == 0.0 else 0
            if still > STANDSTILL:
                raise SolveError(f"At step time {t:.6g} {still} events in a row move nothing; {self.advice}.")
            self._store()
            every = self._options.fields_every
            write = done or (every > 0 and (event + 1) % every == 0)
            yield Converged(u, t, StepResult(True, reason), write_fields=write)
            if done:
                return
        raise SolveError(f"More than {self._options.most} events up to step time {t:.6g}; raise most of EventDriven.")

    def _factor(self) -> None:
        self.solver.factor()
        self.factored += 1
        self._changed = Changed()
        self._keys: list[Key] = []

    def _elongation(self, u: Float) -> Float:
        """Compute the elongation of every pair of this rank (n_pairs,) [length] (collective)."""
        if self._pairs is None:
            return np.empty(0)
        return self._pairs.elongation(self._problem.body.with_ghosts(u))

    def _ahead(self, t: float) -> Direction:
        """Find the direction of the path; bonds outside it stop failing."""
        bonds = self._changed
        waiting = []
        if bonds.failing:
            at_limit = np.flatnonzero((bonds.elongation >= bonds.reach * (1.0 - TIED)) & (bonds.phi > 0.0)).tolist()
            waiting = [m for m in at_limit if m not in bonds.failing]
        try:
            ahead = find_direction(bonds, waiting)
        except SolveError as error:
            raise SolveError(f"At step time {t:.6g} {error}.") from None
        switched = set(bonds.failing) ^ set(ahead.failing)
        bonds.failing = ahead.failing
        for m in switched:
            self._mark(m)
        return ahead

    def _next(self, de: Float, ahead: Direction, t: float) -> tuple[float, _Candidate | None, int | None]:
        """Return the step to the next event, the bond that then begins to fail, and the bond that then breaks."""
        end = (1.0 - t) / ahead.rate if ahead.rate > 0.0 else np.inf
        force = self._changed.force
        breaks = min(ahead.failing, key=lambda m: -force[m] / ahead.force[m], default=None)
        step = end if breaks is None else min(end, max(-force[breaks] / ahead.force[breaks], 0.0))
        failing = np.inf
        if self._pairs is not None:
            failing = smallest(self._comm, first_failure(self._e, de, self._reach, self._able))
        if failing < step * (1.0 - NEARER):
            return failing, self._candidate(de, failing), None
        if step == np.inf:
            raise SolveError(f"At step time {t:.6g} the load falls and nothing fails any more; {self.advice}.")
        return float(step), None, None if step == end else breaks

    def _candidate(self, de: Float, step: float) -> _Candidate:
        """Return the first bond, ordered by position, that reaches its limit after a step."""
        pairs = self._pairs
        assert pairs is not None
        found = int(first_of_tied(self._e, de, self._reach, self._able, step, TIED, pairs.order))
        mine = None
        if found >= 0:
            key = (int(pairs.keys[found, 0]), int(pairs.keys[found, 1]), int(pairs.keys[found, 2]))
            numbers = pairs.k, pairs.limit, pairs.final, self._reach, self._phi, pairs.order
            mine = _Candidate(key, *(float(one[found]) for one in numbers))
        first: _Candidate = min(filter(None, self._comm.allgather(mine)), key=lambda one: one.order)
        return first

    def _move(self, ahead: Direction, step: float) -> None:
        """Move the changed bonds along the direction."""
        bonds = self._changed
        force = bonds.force[ahead.failing] + step * ahead.force[ahead.failing]
        bonds.elongation[:] += step * ahead.elongation
        bonds.phi[ahead.failing] = force / (bonds.k * bonds.elongation)[ahead.failing]
        for m in ahead.failing:
            self._mark(m)

    def _begin(self, found: _Candidate) -> str:
        """Start the failure of a bond."""
        bonds = self._changed
        m = self.solver.numbers.get(found.key, -1)
        if m < 0:
            softness = -(found.final - 1.0) / found.k
            row, E = self.solver.add(found.key)
            m = bonds.append(row, E, found.k, found.limit, found.phi, softness)
            self._keys.append(found.key)
        bonds.elongation[m] = found.reach
        bonds.failing.append(m)
        self._mark(m)
        return f"bond {found.key[0]}-{found.key[1]} begins to fail"

    def _break(self, m: int | None) -> str:
        assert m is not None
        self._changed.phi[m] = 0.0
        self._changed.failing.remove(m)
        self._mark(m)
        return f"bond {self._keys[m][0]}-{self._keys[m][1]} is broken"

    def _mark(self, m: int) -> None:
        """Store the state of a changed bond among the pairs of this rank."""
        here = self.solver.local[m]
        if here < 0:
            return
        bonds = self._changed
        self._phi[here] = bonds.phi[m]
        self._touched.append(here)
        self._reach[here] = bonds.reach[m]
        self._able[here] = bonds.phi[m] > 0.0 and m not in bonds.failing

    def _store(self) -> None:
        """Write the degradation factors of the changed bonds to the body."""
        if self._pairs is not None:
            damage = self._problem.bond_damage
            assert damage is not None
            touched = np.array(self._touched, dtype=np.int64)
            damage.bonds.phi[self._pairs.bonds[touched]] = self._phi[touched, None]
            drive = reached(self._phi[touched], self._pairs.final[touched])
            damage.bonds.kappa[self._pairs.bonds[touched]] = drive[:, None]
            damage.version += 1
            self._touched.clear()


@dataclass(frozen=True)
class _Candidate:
    """Store a bond at its limit: ``reach`` is the current limit of its elongation, ``order`` that of ``Pairs``."""

    key: Key
    k: float
    limit: float
    final: float
    reach: float
    phi: float
    order: float


def _refuse_laws(damage: Damage) -> None:
    laws = damage.bonds.laws.laws
    for law in laws:
        if not isinstance(law, PiecewiseLinear):
            raise CaseError(
                f"The event-driven solver needs laws that are piecewise linear: {type(law).__name__} is not; take "
                f"Brittle, LinearSoftening, or Newton."
            )
    if damage.driving_variable.limit is None:
        names = ", ".join(type(law.criterion).__name__ for law in laws)
        raise CaseError(
            f"The event-driven solver needs what drives damage to be linear in the elongation of the bond itself: "
            f"{names} is not; take a critical stretch, or Newton."
        )
