"""The stable time step of central differences."""

from __future__ import annotations

from collections.abc import Callable, Mapping

import numpy as np
import scipy

from pdpetsc.arrays import Float, irregular
from pdpetsc.discrete.communicator import largest, norm, scalar_product
from pdpetsc.kernels.bonds import change_of_lengths
from pdpetsc.problem.body import Body
from pdpetsc.problem.problem import Problem
from pdpetsc.problem.state import State

# Largest number of Lanczos steps, and relative accuracy of the largest frequency at which they end.
ITERATIONS, EXACT = 60, 5e-3
# Time steps to the second estimate of the largest frequency, and the least and the largest number between estimates.
SECOND, LEAST, MOST_STEPS = 10, 5, 1000
# The number of time steps between estimates is halved if the frequency grows by more than this part of the growth that
# the safety allows, and multiplied if it grows less. The safety allows a growth by at least LEAST_ALLOWED.
GROWS, RESTS, LENGTHENED, LEAST_ALLOWED = 0.25, 0.125, 4, 0.04
# Time steps between checks of the deformation, and the part of the allowed growth at which the frequency is estimated.
CHECKED_SHAPE, DEFORMS = 4, 0.5
# Names in a checkpoint: the largest frequency now and at the start [1 / time], the number of time steps so far, between
# estimates of the frequency, and until the next one.
FREQUENCY, ELASTIC, STEPS, INTERVAL, DUE = "frequency", "frequency_at_start", "time_steps", "interval", "due"
# Name in a checkpoint: the deformation since the last estimate, a sum over records [-].
DEFORMED = "deformed"


class Deformation:
    """Measure how far a body has deformed since an estimate of its largest frequency.

    The largest relative change of the distance of a particle to one of its nearest neighbours bounds the change of the
    spatial gradients, and so that of the frequency at constant stiffness of the material.

    Parameters
    ----------
    body : Body
        The body.
    both : bool
        Whether extensions count besides compressions. They do not in a body that fails: parts that move apart do not
        become stiffer.
    passed : float
        Deformation before, of a run that goes on [-].
    """

    def __init__(self, body: Body, both: bool, passed: float = 0.0) -> None:
        self.passed = passed
        cloud, self._body, self._both = body.cloud, body, both
        # Those of a lattice include its diagonals, which shear along the axes presses.
        near = min(3**cloud.dim, cloud.n_local)
        found = scipy.spatial.cKDTree(cloud.x).query(cloud.x[: cloud.n_owned], near)[1] if cloud.n_owned else []
        self._near = np.asarray(found, dtype=np.int32).reshape(cloud.n_owned, near)
        self._length = np.ones(self._near.shape)

    def at(self, state: State) -> float:
        """Return the deformation at a state (collective)."""
        return self.passed + self.since(state, begin=False)

    def carry(self, state: State) -> None:
        """Measure from a state on, and keep the deformation up to it as a number, for a checkpoint (collective)."""
        self.passed += self.since(state, begin=True)

    def reset(self, state: State) -> None:
        """Measure from a state on (collective)."""
        self.since(state, begin=True)
        self.passed = 0.0

    def since(self, state: State, begin: bool) -> float:
        """Return the largest change of a distance since the last state with ``begin`` [-] (collective)."""
        x, u, dim = self._body.cloud.x, state.u_local, self._body.dim
        change = change_of_lengths(self._near, x, u, self._length, dim, self._both, begin)
        return largest(self._body.cloud.comm, change)


class Frequency:
    """Follow the largest frequency of a motion, estimated again when it may have changed.

    Parameters
    ----------
    problem : Problem
        The problem.
    estimate : callable
        Estimates the frequency at a state [1 / time].
    safety : float
        Time step over the stable one [-].
    state : State
        State at the start.
    resume : mapping of str to float
        Numbers of a checkpoint; empty at the start of a run.

    Attributes
    ----------
    largest : float
        Frequency at the last estimate [1 / time], at least that at the start: a body that flows is stiffer if it
        unloads.
    steps : int
        Number of time steps so far.

    Notes
    -----
    Construction and every method are collective.
    """

    def __init__(
        self, problem: Problem, estimate: Callable[[State], float], safety: float, state: State,
        resume: Mapping[str, float],
    ) -> None:  # fmt: skip
        self._problem, self._estimate, self._pattern = problem, estimate, problem.pattern
        self.largest = resume.get(FREQUENCY) or estimate(state)
        self.steps = int(resume.get(STEPS, 0))
        self._least = resume.get(ELASTIC, self.largest)
        self._interval, self._due = int(resume.get(INTERVAL, SECOND)), 2**62
        # The growth of the frequency that the safety allows.
        self._allowed = max(1.0 / safety - 1.0, LEAST_ALLOWED)
        # None for a body whose frequency does not change.
        self._deformation: Deformation | None = None
        if not problem.linear or problem.damage is not None:
            self._due = int(resume.get(DUE, SECOND))
            self._deformation = Deformation(problem.body, problem.damage is None, resume.get(DEFORMED, 0.0))
            self._deformation.since(state, begin=True)

    def follow(self, u: Float, t: float, failed: bool) -> bool:
        """Count a time step to unknowns and a load parameter; return True if the frequency has changed.

        ``failed`` states whether bonds broke.
        """
        problem, deformation, self.steps = self._problem, self._deformation, self.steps + 1
        if failed and problem.material_term.n_points:  # gradients of fewer bonds may be stiffer
            self._due = min(self._due, self.steps + LEAST)
        if problem.pattern != self._pattern:  # others are near
            self._due, self._pattern = self.steps, problem.pattern
        most, checked = DEFORMS * self._allowed, self.steps % CHECKED_SHAPE == 0
        if checked and deformation is not None and deformation.at(problem.state(u, t)) > most:
            self._due = self.steps
        if self.steps < self._due:
            return False
        state, before = problem.state(u, t), self.largest
        self.largest = max(self._estimate(state), self._least)
        growth = self.largest / before - 1.0 if before > 0.0 else self.largest
        if growth > GROWS * self._allowed:
            self._interval = max(LEAST, self._interval // 2)
        elif growth < RESTS * self._allowed:
            self._interval = min(MOST_STEPS, LENGTHENED * self._interval)
        if deformation is not None:
            deformation.reset(state)
        self._due = self.steps + self._interval
        return self.largest != before

    def carry(self, state: State) -> dict[str, float]:
        """Return the numbers for a checkpoint at a state, from which the deformation is measured on."""
        if self._deformation is not None:
            self._deformation.carry(state)
        return {
            FREQUENCY: self.largest,
            ELASTIC: self._least,
            STEPS: float(self.steps),
            INTERVAL: float(self._interval),
            DUE: float(self._due),
            DEFORMED: 0.0 if self._deformation is None else self._deformation.passed,
        }


def largest_frequency(problem: Problem, state: State, mass: Float) -> float:
    """Return an upper estimate of the largest circular frequency of ``M^-1/2 K M^-1/2`` [1 / time] (collective).

    Lanczos' method without orthogonalisation finds the largest eigenvalue first; its residual is added to it. The
    operator acts on the free components; an unsymmetric tangent is taken as if it were symmetric.

    Parameters
    ----------
    problem : Problem
        The problem, whose stiffest tangent near the state is applied.
    mass : (n_owned,) float64
        Masses of the own particles.

    References
    ----------
    Lehoucq1998, section 4.4 (the residual of a Ritz value).
    """
    comm, cloud = problem.body.cloud.comm, problem.body.cloud
    n, dim = cloud.n_owned, cloud.dim
    free = ~problem.supports.fixed[:n]
    root = np.where(free, 1.0 / np.sqrt(mass)[:, None], 0.0)
    tangent = problem.stiffest(state)
    padded = np.zeros((cloud.n_rows, dim))

    def apply(y: Float) -> Float:
        padded[:n] = root * y
        return np.asarray(root * tangent(padded)[:n])

    v = np.where(free, irregular(cloud.gid[:n], dim), 0.0)
    size = norm(comm, v)
    if size == 0.0:
        return 0.0
    v, before, beta = v / size, np.zeros_like(v), 0.0
    diagonal: list[float] = []
    beside: list[float] = []
    upper = 0.0
    for _ in range(ITERATIONS):
        w = apply(v) - beta * before
        alpha = scalar_product(comm, w, v)
        w -= alpha * v
        beta = norm(comm, w)
        diagonal.append(alpha)
        values, vectors = scipy.linalg.eigh_tridiagonal(diagonal, beside)
        residual = beta * abs(float(vectors[-1, -1]))
        upper = float(values[-1]) + residual
        if residual <= EXACT * abs(upper) or beta <= np.finfo(float).eps * abs(upper):
            break
        beside.append(beta)
        before, v = v, w / beta
    return float(np.sqrt(max(upper, 0.0)))
