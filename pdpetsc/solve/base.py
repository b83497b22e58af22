"""What a solver of one load step gives to the load stepping."""

from __future__ import annotations

from abc import ABC, abstractmethod
from dataclasses import dataclass, field

from pdpetsc.arrays import Float
from pdpetsc.problem.problem import Problem
from pdpetsc.problem.state import State


@dataclass(frozen=True)
class StepResult:
    """What one attempt at a load step did.

    Attributes
    ----------
    converged : bool
        Whether the solver met its tolerance, or the residual stagnated at the round-off floor.
    reason : str
        In words.
    norms : list of float
        Residual norms over the free degrees of freedom, at the start and after iterations [force].
    reference : float
        Norm of external forces and reactions that the tolerance is relative to [force].
    iterations : int
        Newton iterations or time steps.
    linear_iterations : int
        Krylov iterations of all Newton iterations.
    easy : bool
        Whether a longer load step is worth a try.
    negative_pivots : int or None
        Negative eigenvalues of the last tangent that was factored, 0 where equilibrium is stable under its loads; None
        where there is no factor that tells.
    """

    converged: bool
    reason: str
    norms: list[float] = field(default_factory=list)
    reference: float = 0.0
    iterations: int = 0
    linear_iterations: int = 0
    easy: bool = True
    negative_pivots: int | None = None


class Solver(ABC):
    """Finds equilibrium.

    Attributes
    ----------
    unit : str
        What its iterations are called.
    advice : str
        What a user may try when it failed.
    resumed : (n_rows, dim) float64 or None
        Where the tangent is of that the first step begins with [length], where it is not that of its start.
    """

    unit: str
    advice: str
    resumed: Float | None = None

    @property
    def tangent_at(self) -> Float | None:
        """Return where the tangent is of that the next step begins with (n_rows, dim) [length]; None for its start."""
        return None

    def resume(self, tangent_at: Float | None, t: float) -> None:
        """Begin the next step, from step time ``t``, as the run did that this one goes on from (collective).

        That is with the tangent of ``tangent_at`` (n_rows, dim) [length].
        """
        self.resumed = tangent_at

    @property
    @abstractmethod
    def matrix_bytes(self) -> int:
        """Return the memory of the matrix over all ranks [bytes]."""

    @abstractmethod
    def description(self) -> str:
        """Return the solver in force in a few words."""

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

    def state(self, u: Float) -> State:
        """Return the state at unknowns and the step time of the last solve (collective)."""
        return self.problem.state(u, self.t)

    @abstractmethod
    def solve(self, u: Float, t: float) -> tuple[Float, StepResult]:
        """Find equilibrium at step time ``t`` from ``u`` (n_rows, dim); collective."""
