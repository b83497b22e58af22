"""What every solver offers: a march from the state that a run starts from, one converged state after another."""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Callable, Iterator, Mapping
from contextlib import contextmanager
from dataclasses import dataclass, field
from typing import Any, TypeAlias

from pdpetsc.arrays import Float
from pdpetsc.declare.steps import AdaptiveSteps, Steps
from pdpetsc.problem.assembly import Filler
from pdpetsc.problem.problem import Problem
from pdpetsc.problem.state import State


@dataclass(frozen=True)
class StepResult:
    """Outcome of one attempt at a load step.

    Attributes
    ----------
    converged : bool
        Whether the solver met its tolerance, or the residual stagnated at the round-off floor.
    reason : str
        Why it ended, in words.
    norms : list of float
        Residual norms over the free degrees of freedom, at the start and after iterations [force].
    reference : float
        Norm of external forces and reactions that the tolerance is relative to, at most the sum of the forces that the
        step involves [force].
    iterations : int
        Newton iterations or time steps.
    linear_iterations : int
        Krylov iterations of all Newton iterations.
    easy : bool
        Whether a longer load step is worth a try.
    negative_pivots : int or None
        Negative eigenvalues of the last tangent that was factored, 0 where equilibrium is stable under its loads; None
        where there is no factor that tells.
    growth : float
        After damage has settled in sweeps, the factor by which a deviation from the equilibrium grows from one sweep to
        the next [-]. Above 1 other branches of equilibria lead away, and round-off may decide which one a run takes.
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


@dataclass(frozen=True)
class Converged:
    """A converged step.

    Attributes
    ----------
    u : (n_rows, dim) float64
        Unknowns [length].
    t : float
        Step time [-].
    result : StepResult
        Its outcome.
    failures : list of StepResult
        Failed attempts before it.
    broken : int
        Bonds that broke in it.
    sweeps : int
        Number of equilibria that were found with the damage held, where Newton with damage failed; else 0.
    resume : mapping of str to float
        Numbers that the solver needs to go on from here as if it had not stopped, under names of its own.
    write_fields : bool
        Whether it is one of those whose fields are written.
    work : float or None
        External work since the step before, over the equilibria between them [energy]; None where there are none.
    """

    u: Float
    t: float
    result: StepResult
    failures: list[StepResult] = field(default_factory=list)
    broken: int = 0
    sweeps: int = 0
    resume: Mapping[str, float] = field(default_factory=dict)
    write_fields: bool = True
    work: float | None = None


@dataclass(frozen=True)
class Start:
    """Where a march starts from.

    Attributes
    ----------
    u : (n_rows, dim) float64
        Converged unknowns [length].
    t : float
        Their step time [-].
    resume : mapping of str to float
        What the solver of the run before named in ``Converged.resume``; empty at the start of a run.
    tangent_at : (n_rows, dim) float64 or None
        Displacements whose tangent the first step begins with [length], where they are not ``u``.
    """

    u: Float
    t: float = 0.0
    resume: Mapping[str, float] = field(default_factory=dict)
    tangent_at: Float | None = None


# Called after a failed attempt with the last converged step time, the step that is tried next, and the outcome.
OnFailure: TypeAlias = Callable[[float, float, StepResult], None]


@dataclass(frozen=True)
class Setting:
    """What a solver is made from.

    Attributes
    ----------
    problem : Problem
        What is solved.
    declared : DeclaredSolver
        What the case declares, of the class that the table of solvers has it under.
    steps : Steps or AdaptiveSteps
        How the load is applied, for those that step it.
    filled : Filler or None
        What fills the matrices; None for a solver that needs no tangent.
    stop : callable
        Asked now and then, collectively; True ends the march (a signal arrived).
    """

    problem: Problem
    declared: Any
    steps: Steps | AdaptiveSteps
    filled: Filler | None
    stop: Callable[[], bool]

    @property
    def assembler(self) -> Filler:
        """Return what fills the matrices, for a solver that declares to need a tangent."""
        assert self.filled is not None
        return self.filled


class Solver(ABC):
    """Marches from one equilibrium to the next.

    Attributes
    ----------
    unit : str
        Name of its iterations in messages.
    advice : str
        What a user may try when it failed.
    resumed : (n_rows, dim) float64 or None
        Displacements whose tangent the first step begins with [length], where they are not those it starts from.
    ended : str
        What ended a march that finds its own end, for the log; empty where the load is what ends it.
    """

    unit: str
    advice: str
    resumed: Float | None = None
    ended: str = ""

    @classmethod
    @abstractmethod
    def make(cls, setting: Setting) -> Solver:
        """Return the solver of a setting (collective)."""

    @classmethod  # noqa: B027 - most need no more than they declare
    def refuse(cls, problem: Problem) -> None:
        """Raise CaseError on all ranks for a problem that this solver cannot solve (collective)."""

    @classmethod  # noqa: B027 - most have none
    def rehearse(cls, problem: Problem) -> None:
        """Compile or load the loops that only this solver runs (collective on the problem's ranks)."""

    @abstractmethod
    def march(self, start: Start, on_failure: OnFailure) -> Iterator[Converged]:
        """Yield one converged state after the other, from ``start`` to the end of the load (collective).

        Raises
        ------
        SolveError
            No further state was found; what was yielded before stands.
        Interrupted
            A signal asked to stop.
        """

    @property
    def tangent_at(self) -> Float | None:
        """Return the displacements whose tangent begins the next step (n_rows, dim) [length]; None: the last."""
        return None

    def response(self, u: Float, t: float, force: Float) -> Float | None:
        """Return what the tangent at an equilibrium answers forces with (n_rows, dim) [length] (collective).

        None where this solver has no tangent at hand. ``force`` (n_rows, dim) [force] is zero where unknowns are
        prescribed. Nothing is solved after it.
        """
        return None

    def resume(self, start: Start) -> None:
        """Take over what a checkpoint keeps, so that the run goes on as if it had not stopped (collective).

        Raises
        ------
        CaseError
            The numbers in the checkpoint cannot be those of a run.
        """
        self.resumed = start.tangent_at

    def line(self, number: int, converged: Converged) -> str | None:
        """Return what is printed of a converged step, None for nothing (not collective)."""
        result = converged.result
        last = result.norms[-1] / result.reference if result.reference > 0.0 else 0.0
        negative = result.negative_pivots or 0
        pivots = f"{negative} negative pivot{'s' if negative > 1 else ''}"
        inner = f", {result.linear_iterations:3d} linear" if result.linear_iterations else ""
        return (
            f"step {number:4d}  t = {converged.t:<8.6g} {result.iterations:2d} {self.unit}{inner} iterations, "
            f"residual {last:.1e}"
            f"{' (round-off floor)' if 'floor' in result.reason else ''}"
            f"{f', unstable equilibrium ({pivots})' if negative else ''}"
            f"{f', {converged.broken} bonds broke' if converged.broken else ''}"
            f"{f', damage held in {converged.sweeps} sweeps' if converged.sweeps else ''}"
            f"{f', not unique (a deviation grows by {result.growth:.2f} a sweep)' if result.growth > 1.0 else ''}"
        )

    @property
    @abstractmethod
    def matrix_bytes(self) -> int:
        """Return the memory of the matrix over all ranks [bytes]."""

    @abstractmethod
    def description(self) -> str:
        """Return the solver and its options in a few words, for the log."""

    @abstractmethod
    def destroy(self) -> None:
        """Free what the solver holds outside Python."""


class StepSolver(Solver):
    """Finds equilibrium of one load step after another.

    Attributes
    ----------
    problem : Problem
        What is solved, whose damage and history the load stepping changes between equilibria.
    load : float
        Load factor of the last equilibrium, of solvers that find it [-].
    t : float
        Step time of the last solve [-].
    """

    problem: Problem
    load: float = 0.0
    t: float = 0.0
    # Whether an equilibrium must be a minimum of the energy; along a path the load is no constant.
    of_minima: bool = True

    @property
    def meets_curvature(self) -> bool:
        """Return True if the linear solver detects directions of negative curvature without counting pivots.

        Not collective.
        """
        return False

    def state(self, u: Float) -> State:
        """Return the state at unknowns and the step time of the last solve (collective)."""
        return self.problem.state(u, self.t)

    def refuse_mechanism(self, u: Float) -> None:
        """Raise SolveError on all ranks if the equilibrium at ``u`` is one of infinitely many (collective).

        Solvers without a tangent do not know.
        """

    def growth(self, u: Float) -> float:
        """Return ``StepResult.growth`` at an equilibrium with settled damage; 0 if nothing tells (collective)."""
        return 0.0

    @contextmanager
    def loosely(self) -> Iterator[None]:
        """Let equilibria be found to ``LOOSE`` of the forces, if the solver has a tolerance (collective)."""
        yield

    @abstractmethod
    def solve(self, u: Float, t: float) -> tuple[Float, StepResult]:
        """Find equilibrium at step time ``t`` from ``u`` (n_rows, dim); collective."""
