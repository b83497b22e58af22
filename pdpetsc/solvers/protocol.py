"""Common interface of solvers: a march from an initial state through converged states."""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Callable, Iterator, Mapping
from contextlib import contextmanager
from dataclasses import dataclass, field, replace
from typing import Any, TypeAlias

import numpy as np
from petsc4py import PETSc

from pdpetsc.arrays import Float
from pdpetsc.declare.steps import AdaptiveSteps, Steps
from pdpetsc.errors import SolveError
from pdpetsc.problem.assembly import Filler
from pdpetsc.problem.problem import Problem
from pdpetsc.problem.state import State

# Tolerance of the response to forces that are not loads.
RESPONSE = 1e-4
# Tolerance of intermediate equilibria.
LOOSE = 1e-3
# Reason for accepting a residual above the tolerance.
AT_FLOOR = "residual at the round-off floor"


@dataclass(frozen=True)
class StepResult:
    """Store the outcome of one attempt at a load step.

    Attributes
    ----------
    converged : bool
        Whether the solver met its tolerance, or the residual stagnated at the round-off floor.
    reason : str
        Reason for the end, in words.
    norms : list of float
        Residual norms over the free degrees of freedom, at the start and after iterations [force].
    reference : float
        Reference force of the tolerance: norm of external forces and reactions, at most the sum of the forces in the
        step [force].
    iterations : int
        Newton iterations or time steps.
    linear_iterations : int
        Krylov iterations of all Newton iterations.
    easy : bool
        Whether a longer load step may be tried next.
    negative_pivots : int or None
        Negative eigenvalues of the last factored tangent, 0 if the equilibrium is stable under its loads. None if no
        factor determines them.
    growth : float
        After damage has settled in sweeps, the factor by which a deviation from the equilibrium grows from one sweep to
        the next [-]. Above 1, other branches of equilibria exist, and round-off may decide which branch a run follows.
    crossed : bool
        Whether Newton's method, with damage that follows the displacement, passed unstable states or found a saddle
        point, or sweeps left one. Round-off may then decide which equilibrium was found.
    moved : float
        Time of a motion that led to the equilibrium [time].
    switched : float
        Largest displacement from an unstable equilibrium under the same load to this one [length]; 0 if the step did
        not switch to another branch.
    broken : int
        Number of bonds that broke.
    sweeps : int
        Number of equilibria with damage held, if Newton with damage failed; else 0.
    """

    converged: bool
    reason: str
    norms: list[float] = field(default_factory=list)
    reference: float = 0.0
    iterations: int = 0
    linear_iterations: int = 0
    easy: bool = True
    negative_pivots: int | None = None
    growth: float = 0.0
    crossed: bool = False
    moved: float = 0.0
    switched: float = 0.0
    broken: int = 0
    sweeps: int = 0

    def refused(self, reason: str) -> StepResult:
        """Return this outcome as one that has not converged."""
        return replace(self, converged=False, reason=reason)

    def after(self, before: StepResult) -> StepResult:
        """Return this outcome with what those before it took, easy only if all were, crossed if one was."""
        return replace(
            self,
            iterations=self.iterations + before.iterations,
            linear_iterations=self.linear_iterations + before.linear_iterations,
            easy=self.easy and before.easy,
            crossed=self.crossed or before.crossed,
            broken=self.broken + before.broken,
            sweeps=self.sweeps + before.sweeps,
        )


# Outcome of no solve, before the first one.
NONE = StepResult(True, "")


@dataclass(frozen=True)
class Converged:
    """Store a converged step.

    Attributes
    ----------
    u : (n_rows, dim) float64
        Unknowns [length].
    t : float
        Load parameter [-].
    result : StepResult
        Outcome of the step.
    failures : list of StepResult
        Failed attempts before it.
    resume : mapping of str to float
        Numbers that the solver needs for a restart, by names of its own.
    write_fields : bool
        Whether the fields of this step are written.
    work : float or None
        External work since the last step, over the equilibria between both [energy]; None if there are none.
    """

    u: Float
    t: float
    result: StepResult
    failures: list[StepResult] = field(default_factory=list)
    resume: Mapping[str, float] = field(default_factory=dict)
    write_fields: bool = True
    work: float | None = None


@dataclass(frozen=True)
class Start:
    """Store the initial state of a march.

    Attributes
    ----------
    u : (n_rows, dim) float64
        Converged unknowns [length].
    t : float
        Load parameter of these unknowns [-].
    resume : mapping of str to float
        Numbers of ``Converged.resume`` of the previous run; empty at the start of a run.
    tangent_at : (n_rows, dim) float64 or None
        Displacements at which the first step evaluates its initial tangent [length], if they differ from ``u``.
    """

    u: Float
    t: float = 0.0
    resume: Mapping[str, float] = field(default_factory=dict)
    tangent_at: Float | None = None


# Called after a failed attempt with the last converged load parameter, the size of the next step, and the outcome.
OnFailure: TypeAlias = Callable[[float, float, StepResult], None]


@dataclass(frozen=True)
class Setting:
    """Store the arguments for building a solver.

    Attributes
    ----------
    problem : Problem
        The problem.
    declared : DeclaredSolver
        Declared solver, of the class in the table of solvers.
    steps : Steps or AdaptiveSteps
        Load steps, for solvers that step the load.
    filled : Filler or None
        Object that fills the matrices; None for a solver that needs no tangent.
    stop : callable
        Called repeatedly and collectively; True ends the march (a signal arrived).
    """

    problem: Problem
    declared: Any
    steps: Steps | AdaptiveSteps
    filled: Filler | None
    stop: Callable[[], bool]

    @property
    def assembler(self) -> Filler:
        """Return the object that fills the matrices, for a solver that needs a tangent."""
        assert self.filled is not None
        return self.filled


class Flexibility(ABC):
    """The inverse of a tangent; every method is collective."""

    @abstractmethod
    def __call__(self, force: Float) -> Float:
        """Return the displacements (n_rows, dim) [length] of forces (n_rows, dim); raise SolveError if that fails."""

    @abstractmethod
    def negative_pivots(self) -> int | None:
        """Return the number of unstable modes after a solve; None unless the tangent was factored."""

    @abstractmethod
    def stable(self) -> bool | None:
        """Return True if there is no unstable mode; None if that is unknown."""


class Solver(ABC):
    """March from one equilibrium to the next.

    Attributes
    ----------
    unit : str
        Name of its iterations in messages.
    advice : str
        Advice to the user after a failure.
    resumed : (n_rows, dim) float64 or None
        Displacements at which the first step evaluates its initial tangent [length], if they differ from the initial
        ones.
    ended : str
        Reason for the end of a march that determines its own end, for the log; empty if the load determines it.
    """

    unit: str
    advice: str
    resumed: Float | None = None
    ended: str = ""

    @classmethod
    @abstractmethod
    def make(cls, setting: Setting) -> Solver:
        """Build the solver of a setting (collective)."""

    @classmethod  # noqa: B027 - most need no more than they declare
    def refuse(cls, problem: Problem) -> None:
        """Raise CaseError on all ranks for a problem that this solver cannot solve (collective)."""

    @classmethod  # noqa: B027 - most have none
    def rehearse(cls, problem: Problem) -> None:
        """Compile or load the kernels that only this solver runs (collective on the ranks of the problem)."""

    @abstractmethod
    def march(self, start: Start, on_failure: OnFailure) -> Iterator[Converged]:
        """Yield the converged states from ``start`` to the end of the load (collective).

        Raises
        ------
        SolveError
            No further state was found; the states yielded before are valid.
        Interrupted
            A signal requested a stop.
        """

    @property
    def tangent_at(self) -> Float | None:
        """Return the displacements at which the next step evaluates its initial tangent (n_rows, dim) [length].

        None for the last displacements.
        """
        return None

    def flexibility(self, u: Float, t: float, rtol: float) -> Flexibility | None:
        """Return the inverse of the tangent at an equilibrium, to a relative tolerance; no load step may follow.

        None if this solver has no tangent (collective).
        """
        return None

    def response(self, u: Float, t: float, force: Float) -> Float | None:
        """Solve the tangent at an equilibrium for forces; return displacements (n_rows, dim) [length] (collective).

        None if this solver has no tangent, or the linear solve fails. ``force`` (n_rows, dim) [force] is zero for
        prescribed unknowns. It must be the last solve.
        """
        try:
            flexible = self.flexibility(u, t, RESPONSE)
            return None if flexible is None else flexible(force)
        except (PETSc.Error, SolveError):  # the run has ended, and is valid without it
            return None

    def resume(self, start: Start) -> None:
        """Restore the numbers of a checkpoint, so that the run continues as if it had not stopped (collective).

        Raises
        ------
        CaseError
            The numbers in the checkpoint are invalid.
        """
        self.resumed = start.tangent_at

    def line(self, number: int, converged: Converged) -> str | None:
        """Return the printed line of a converged step, None for no line (not collective)."""
        result = converged.result
        last = result.norms[-1] / result.reference if result.reference > 0.0 else 0.0
        negative = result.negative_pivots or 0
        pivots = f"{negative} negative pivot{'s' if negative > 1 else ''}"
        growth = f"a deviation grows by the factor {result.growth:.2f} in a sweep"
        # The predictor is a linear solve too, which may be enough.
        by = "" if result.iterations else " of the predictor"
        inner = f" ({result.linear_iterations} linear{by})" if result.linear_iterations else ""
        return (
            f"step {number:4d}  t = {converged.t:<8.6g} {result.iterations:2d} {self.unit} iterations{inner}, "
            f"residual {last:.1e}"
            f"{' (round-off floor)' if result.reason == AT_FLOOR else ''}"
            f"{f', unstable equilibrium ({pivots}), as after buckling or a peak load' if negative else ''}"
            f"{f', moved for {result.moved:.3g} to rest' if result.moved else ''}"
            f"{f', switched to the stable branch, {result.switched:.3g} away' if result.switched else ''}"
            f"{f', {result.broken} bonds broke' if result.broken else ''}"
            f"{f', damage settled in {result.sweeps} sweeps' if result.sweeps else ''}"
            f"{', grew through unstable states' if result.crossed else ''}"
            f"{f', other equilibria are near ({growth})' if result.growth > 1.0 else ''}"
        )

    @property
    def matrix_bytes(self) -> int:
        """Return the memory of the matrix over all ranks [bytes], 0 for no matrix."""
        return 0

    @abstractmethod
    def description(self) -> str:
        """Return a short description of the solver and its options, for the log."""

    def destroy(self) -> None:  # noqa: B027 - some have none
        """Free memory outside Python."""


class StepSolver(Solver):
    """Find equilibrium of one load step after another.

    Attributes
    ----------
    problem : Problem
        The problem; load stepping changes its damage and history between equilibria.
    load : float
        Load factor of the last equilibrium, for solvers that compute it [-].
    t : float
        Load parameter of the last solve [-].
    stop : callable
        Called between and within solves, collectively; True ends the march (a signal arrived).
    """

    problem: Problem
    stop: Callable[[], bool]
    load: float = 0.0
    t: float = 0.0
    # Whether an equilibrium must be a minimum of the energy. Along a path the load is not constant.
    of_minima: bool = True
    # Whether steps depend on negative pivots, which are then worth a factorisation of their own.
    asks_for_stability: bool = False

    @property
    def at(self) -> Any:
        """Return the load factor, and further unknowns that ``return_to`` restores after a rejected solve."""
        return self.load

    def return_to(self, at: Any) -> None:
        """Restore the values of ``at`` (not collective)."""
        self.load = at

    @property
    def meets_curvature(self) -> bool:
        """Return True if the linear solver detects directions of negative curvature without counting pivots.

        Not collective.
        """
        return False

    def state(self, u: Float) -> State:
        """Return the state at unknowns and the load parameter of the last solve (collective)."""
        return self.problem.state(u, self.t)

    def refuse_mechanism(self, u: Float) -> None:
        """Raise SolveError on all ranks if the equilibrium at ``u`` is not unique because of a mechanism (collective).

        Solvers without a tangent do not check.
        """

    def deviation(self, u: Float) -> tuple[float, Float]:
        """Return ``StepResult.growth`` at an equilibrium with settled damage, and its deviation (collective).

        The largest component of the deviation (n_rows, dim) is the smallest spacing [length]; both are 0 if unknown.
        """
        return 0.0, np.zeros_like(u)

    def switched(self, u: Float, result: StepResult) -> tuple[Float, StepResult]:
        """Return a stable equilibrium under the load of the unstable equilibrium ``u``, and its outcome (collective).

        The outcome has not converged if none is found. Solvers without a tangent find none.
        """
        return u, result.refused("this solver finds no stable equilibrium")

    def moved_to_rest(self, u: Float, t: float) -> tuple[Float, StepResult] | None:
        """Find the equilibrium at load parameter ``t`` to which the body moves from ``u`` if the step has none.

        Return unknowns and outcome; None for solvers without inertia. Histories on the way are committed (collective).

        Raises
        ------
        SolveError
            The body does not come to rest.
        Interrupted
            A signal requested a stop.
        """
        return None

    @contextmanager
    def loosely(self, rtol: float | None = None) -> Iterator[None]:
        """Relax the tolerance in the ``with`` block to ``rtol``, by default as the solver chooses (collective)."""
        yield

    @abstractmethod
    def solve(self, u: Float, t: float) -> tuple[Float, StepResult]:
        """Find equilibrium at load parameter ``t`` from ``u`` (n_rows, dim); collective."""
