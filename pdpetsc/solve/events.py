"""The event-driven solver: from one failing bond to the next."""

from __future__ import annotations

import itertools
from collections.abc import Callable, Iterator
from dataclasses import dataclass

import numpy as np

from pdpetsc.arrays import Float
from pdpetsc.damage import BondDamage
from pdpetsc.discrete.communicator import largest, smallest
from pdpetsc.errors import CaseError, Interrupted, SolveError
from pdpetsc.kernels.bonds import first_failure, first_of_tied
from pdpetsc.loading import Loading
from pdpetsc.model import Assembler, BondModel, Model
from pdpetsc.scene.solver import EventDriven
from pdpetsc.solve.base import Solver, StepResult
from pdpetsc.solve.inelastic import InelasticForces
from pdpetsc.solve.pairs import Pairs, make_pairs
from pdpetsc.solve.steps import Converged

# Bonds this close to their limit fail at the same load, one after the other in the order of their keys.
TIED = 1e-10
# A force below this share of the one at failure is gone, a rate below this share of the largest one is none.
GONE = 1e-12
# Where the load has fallen to this share of its largest value the body carries nothing any more.
UNLOADED = 1e-9
# Changed bonds at which the matrix is factored anew: this times the root of the number of unknowns, within limits.
UPDATES = 2.0
FEWEST, MOST = 32, 400
# Up to so many failing bonds all ways in which some unload are tried.
TRIED = 10

# Step times at which conditions are compared with their proportional values, and how closely.
PROBES = (0.0, 0.3, 0.7)
PROPORTIONAL = 1e-12

Key = tuple[int, int, int]


@dataclass(eq=False)
class Failing:
    """A bond that is losing its force, or has lost part of it.

    Attributes
    ----------
    key : tuple of int
        The bond.
    k, limit : float
        Stiffness [force / length] and elongation at which it first fails [length].
    force, elongation : float
        At present.
    number : int
        Its number among the changed bonds.
    """

    key: Key
    k: float
    limit: float
    force: float
    elongation: float
    number: int


class EventSolver(Solver):
    """Follows the equilibrium of a body whose laws are piecewise linear, event by event.

    Between events the displacement moves along a straight line. A bond at its limit fails: its force ``q`` decreases
    along its law, ``de = c dq`` with ``c = 0`` for a bond that snaps and ``c = -(r - 1) / k`` for one that softens to
    ``r`` times its limit; the load moves up or down as equilibrium demands. If another bond reaches its limit
    meanwhile, both fail on, or the first unloads along its secant, whichever is consistent: forces of failing bonds
    decrease, unloading bonds shorten.

    Parameters
    ----------
    model, loading, assembler
        The body and its conditions.
    options : EventDriven
        What the case declares.
    scale : float
        Diagonal of prescribed rows [force / length].
    stop : callable
        Asked at every event, collectively; True ends the run (a signal arrived).

    Raises
    ------
    CaseError
        Laws or conditions are not those of this solver; the message says why.

    References
    ----------
    Jirasek, Bazant (1994), section 4; Mikes, Jirasek, Zeman, Rokos, Peerlings, section 2.2.
    """

    unit = "event"
    advice = "perturb the positions, so that fewer bonds fail at once"

    def __init__(
        self, model: Model, loading: Loading, assembler: Assembler, options: EventDriven, scale: float,
        stop: Callable[[], bool],
    ) -> None:  # fmt: skip
        _refuse(model, loading)
        self._model = model
        self._options = options
        self._stop = stop
        self._pairs: Pairs | None = None
        if isinstance(model, BondModel) and model.failure is not None:
            self._pairs = make_pairs(model)
        self.solver = InelasticForces(model, loading, assembler, self._pairs, scale)
        unknowns = model.cloud.n_global * model.dim
        automatic = int(np.clip(UPDATES * np.sqrt(unknowns), FEWEST, MOST))
        self._updates = options.updates or automatic
        self.factored = 0
        self._law = None if self._pairs is None else _law_of(model)
        self._ratio = 1.0 if self._law is None else self._law.final_ratio
        n = 0 if self._pairs is None else len(self._pairs.k)
        self._e, self._integrity, self._base, self._able = np.zeros(n), np.ones(n), np.ones(n), np.ones(n, dtype=bool)
        self._reach = np.empty(0) if self._pairs is None else self._pairs.limit.copy()
        self._failing: list[Failing] = []
        self._changed: dict[Key, Failing] = {}

    @property
    def matrix_bytes(self) -> int:
        """Return the memory of the matrix over all ranks [bytes]."""
        return self.solver.matrix.bytes

    def description(self) -> str:
        """Return the solver in a few words."""
        ksp = self.solver.ksp
        return f"event-driven, ksp {ksp.getType()}, pc {ksp.getPC().getType()}, {self._updates} changes per factor"

    def solve(self, u: Float, t: float) -> tuple[Float, StepResult]:
        """Refuse: events have no step time of their own to solve at."""
        raise NotImplementedError("the event-driven solver goes from event to event")

    def accept(self, u: Float) -> None:
        """Keep what has failed."""
        self._model.commit(u)

    def revert(self) -> None:
        """Do nothing: no event is tried twice."""

    def destroy(self) -> None:
        """Free the PETSc objects."""
        self.solver.destroy()

    def march(self) -> Iterator[Converged]:
        """Yield the state at every event, from the unloaded body to the end of the load (collective).

        Raises
        ------
        SolveError
            No way goes on, or there are too many events; what was yielded before stands.
        Interrupted
            A signal asked to stop.
        """
        model = self._model
        u, t, highest = np.zeros((model.cloud.n_rows, model.dim)), 0.0, 0.0
        self._factor()
        for event in range(self._options.most):
            if self._stop():
                raise Interrupted(f"Stopped by a signal; results are complete up to step time {t:.6g}.")
            if len(self.solver.members) >= self._updates and not self._failing:
                self._factor()
                # All forces are secant forces under a proportional load: this is the same state without the round-off.
                u = t * self.solver.elastic
                self._e = self._elongation(u)
            rate, du, dq = self._direction(t)
            de = self._elongation(du)
            step, fails, breaks = self._next(de, dq, rate, t)
            u, t = u + step * du, t + step * rate
            self._e += step * de
            for bond, change in zip(self._failing, dq, strict=True):
                bond.force += step * float(change)
                bond.elongation += step * float(change) * self._softness(bond)
                self._set_integrity(bond)
            done = fails is None and breaks is None
            reason = "the whole load" if done else self._break(breaks) if breaks is not None else self._begin(fails)
            highest = max(highest, abs(t))
            done = done or (not self._failing and abs(t) <= UNLOADED * highest)
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
        self._base = self._integrity.copy()
        self._changed = {}

    def _elongation(self, u: Float) -> Float:
        """Return the elongation of every pair here (n_pairs,) [length] (collective)."""
        if self._pairs is None:
            return np.empty(0)
        assert isinstance(self._model, BondModel)
        return self._model.elongation(self._model.with_ghosts(u))[0][self._pairs.bond]

    def _softness(self, bond: Failing) -> float:
        """Return the change of elongation per change of force of a failing bond [length / force]."""
        return -(self._ratio - 1.0) / bond.k

    def _direction(self, t: float) -> tuple[float, Float, Float]:
        """Return the rates of the step time, of the displacement and of the forces of failing bonds along the path."""
        if not self._failing:
            return self._along([])[:3]
        *others, newest = self._failing
        for dropped in _subsets(others):
            kept = [bond for bond in others if bond not in dropped]
            rate, du, dq, shorten = self._along([*kept, newest])
            if np.all(dq < 0.0) and shorten:
                self._failing = [*kept, newest]
                for bond in dropped:
                    self._set_integrity(bond)
                return rate, du, dq
        raise SolveError(
            f"At step time {t:.6g} no direction lets the forces of {len(self._failing)} failing bonds decrease, the "
            f"last one between particles {newest.key[0]} and {newest.key[1]}; {self.advice}."
        )

    def _along(self, active: list[Failing]) -> tuple[float, Float, Float, bool]:
        """Return the rates of step time, displacement and forces, and whether the failing bonds left out shorten.

        The load grows at rate 1 where nothing fails. Otherwise the last of the failing bonds loses its force at failure
        at rate 1, and the load and the other forces follow.
        """
        solver = self.solver
        numbers, inverse = [], []
        for bond in self._changed.values():
            change = bond.force / bond.elongation - solver.members[bond.number].base
            if change != 0.0 and bond not in active:
                numbers.append(bond.number)
                inverse.append(1.0 / change)
        factors = []
        for bond in active:
            c = self._softness(bond)
            factors.append(1.0 - solver.members[bond.number].base * c)
            numbers.append(bond.number)
            inverse.append(c / factors[-1])
        M = solver.S[np.ix_(numbers, numbers)] + np.diag(inverse)
        g = solver.E[numbers]
        if active:
            last = -active[-1].k * active[-1].limit * factors[-1]
            found = _dense_solve(np.column_stack([M[:, :-1], -g]), -last * M[:, -1])
            p, rate = np.append(found[:-1], last), float(found[-1])
        else:
            p, rate = _dense_solve(M, g), 1.0
        dq = p[len(p) - len(active) :] / np.array(factors)
        left_out = [bond.number for bond in self._failing if bond not in active]
        lengthening = rate * solver.E[left_out] - solver.S[np.ix_(left_out, numbers)] @ p
        shorten = bool(np.all(lengthening <= GONE * np.abs(rate * solver.E).max(initial=0.0)))
        return rate, solver.response(rate, numbers, p), dq, shorten

    def _next(self, de: Float, dq: Float, rate: float, t: float) -> tuple[float, _Candidate | None, Failing | None]:
        """Return the step to the next event, the bond that then begins to fail and the one that then is broken."""
        comm = self._model.cloud.comm
        end = (1.0 - t) / rate if rate > 0.0 else np.inf
        ends = [bond.force / -float(change) for bond, change in zip(self._failing, dq, strict=True)]
        breaking = int(np.argmin(ends)) if ends else -1
        step = min([end, *ends])
        failing = np.inf
        if self._pairs is not None:
            failing = smallest(comm, first_failure(self._e, de, self._reach, self._able))
        if min(step, failing) == np.inf:
            raise SolveError(f"At step time {t:.6g} the load falls and nothing fails any more; {self.advice}.")
        if failing < step * (1.0 - GONE):
            return failing, self._candidate(de, failing), None
        return (step, None, self._failing[breaking]) if ends and ends[breaking] == step else (step, None, None)

    def _candidate(self, de: Float, step: float) -> _Candidate:
        """Return the first, by its key, of the bonds that reach their limit after a step."""
        pairs = self._pairs
        assert pairs is not None
        found = int(first_of_tied(self._e, de, self._reach, self._able, step, TIED))
        mine = None
        if found >= 0:
            key = (int(pairs.keys[found, 0]), int(pairs.keys[found, 1]), int(pairs.keys[found, 2]))
            state = float(self._integrity[found]), float(self._base[found])
            mine = _Candidate(key, float(pairs.k[found]), float(pairs.limit[found]), float(self._reach[found]), *state)
        found_by = [c for c in self._model.cloud.comm.allgather(mine) if c is not None]
        first: _Candidate = min(found_by, key=lambda c: c.key)
        return first

    def _begin(self, found: _Candidate | None) -> str:
        """Let a bond fail."""
        assert found is not None
        bond = self._changed.get(found.key)
        if bond is None:
            number = self.solver.place(found.key, found.base * found.k)
            bond = Failing(found.key, found.k, found.limit, 0.0, 0.0, number)
            self._changed[found.key] = bond
        bond.force, bond.elongation = found.integrity * found.k * found.reach, found.reach
        self._failing.append(bond)
        self._set_integrity(bond)
        return f"bond {bond.key[0]}-{bond.key[1]} begins to fail"

    def _break(self, bond: Failing) -> str:
        bond.force = 0.0
        self._failing.remove(bond)
        self._set_integrity(bond)
        return f"bond {bond.key[0]}-{bond.key[1]} is broken"

    def _set_integrity(self, bond: Failing) -> None:
        here = self.solver.members[bond.number].pair
        if here < 0:
            return
        assert self._law is not None
        self._integrity[here] = bond.force / (bond.k * bond.elongation)
        self._reach[here] = bond.limit * self._law.reached(self._integrity[here : here + 1])[0]
        self._able[here] = bond.force > 0.0 and not any(bond is other for other in self._failing)

    def _store(self) -> None:
        """Give the body the present integrity of its bonds."""
        if self._pairs is not None:
            assert isinstance(self._model, BondModel) and self._model.failure is not None
            self._model.failure.integrity[:] = self._integrity[self._pairs.of_bond]
            self._model.version += 1


@dataclass(frozen=True)
class _Candidate:
    """A bond at its limit: ``reach`` is the present limit of its elongation, ``base`` its integrity when factored."""

    key: Key
    k: float
    limit: float
    reach: float
    integrity: float
    base: float


def _subsets(bonds: list[Failing]) -> Iterator[list[Failing]]:
    """Yield sets of failing bonds to leave out, the smallest first."""
    most = len(bonds) if len(bonds) <= TRIED else 1
    for n in range(most + 1):
        for chosen in itertools.combinations(bonds, n):
            yield list(chosen)


def _dense_solve(M: Float, g: Float) -> Float:
    """Return the solution of a small system, the least one where it is singular."""
    try:
        return np.asarray(np.linalg.solve(M, g))
    except np.linalg.LinAlgError:
        return np.asarray(np.linalg.lstsq(M, g, rcond=None)[0])


def _law_of(model: Model) -> BondDamage | None:
    return model.failure.law if isinstance(model, BondModel) and model.failure is not None else None


def _refuse(model: Model, loading: Loading) -> None:
    """Raise on all ranks if the laws are not piecewise linear or the conditions not proportional (collective)."""
    if not model.linear:
        raise CaseError(
            "The event-driven solver needs laws that are piecewise linear: LinearElastic, or bonds with small "
            "kinematics; this body has a law that is not linear between failures, so take Newton."
        )
    whole = [loading.prescribed(1.0), loading.forces(1.0)]
    for t in PROBES:
        part = [loading.prescribed(t), loading.forces(t)]
        off = max(np.abs(p - t * w).max(initial=0.0) for p, w in zip(part, whole, strict=True))
        size = max(np.abs(w).max(initial=0.0) for w in whole)
        if largest(model.cloud.comm, off) > PROPORTIONAL * max(largest(model.cloud.comm, size), 1e-300):
            raise CaseError(
                "The event-driven solver needs conditions proportional to the step time, such as numbers with the "
                "schedule Ramp: the load goes up and down as equilibrium demands, which has no meaning for others."
            )
