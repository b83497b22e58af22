"""Construction of problem and solver of a case, for ``run`` or for direct use."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping
from dataclasses import fields, replace
from functools import cached_property
from typing import Any

import numpy as np
from numpy.typing import NDArray

from pdpetsc.arrays import Float
from pdpetsc.case import Case, check_declared
from pdpetsc.declare.schedule import tables_of
from pdpetsc.declare.steps import AdaptiveSteps, Steps
from pdpetsc.declare.supports import beyond_sides
from pdpetsc.declared import name_of
from pdpetsc.discrete.cloud import Cloud
from pdpetsc.discrete.communicator import Comm, agreed, communicator
from pdpetsc.discrete.components import refuse_rigid_motion
from pdpetsc.errors import CaseError
from pdpetsc.output.fingerprint import refuse_differing
from pdpetsc.petsc.defaults import coupled_options, default_options
from pdpetsc.petsc.jacobian import Choice, assembler, choose, predicted
from pdpetsc.petsc.library import return_freed_memory
from pdpetsc.petsc.options import Options
from pdpetsc.post.solution import Field, Solution
from pdpetsc.problem.problem import Problem
from pdpetsc.running.build import make_chunk, make_cloud, make_families, make_problem, rehearse, with_whole_patches
from pdpetsc.running.phases import Phases
from pdpetsc.running.result import gathered
from pdpetsc.running.suited import with_suited_scheme
from pdpetsc.solvers.protocol import Converged, OnFailure, Setting, Solver, Start
from pdpetsc.solvers.table import refuse_unmet, solver_of


class Prepared:
    """A case with its built and distributed problem, before the solution; returned by ``prepare``.

    Attributes
    ----------
    case : Case
        The declared case, with the scheme and control chosen for a nearly incompressible body.
    comm : Comm
        The ranks that share the problem.
    problem : Problem
        Terms and supports on the distributed cloud: residual, tangent, energies.
    phases : Phases
        Times of the set-up.

    Notes
    -----
    Every method is collective on ``comm``.
    """

    def __init__(self, case: Case, problem: Problem, chosen: Options, phases: Phases) -> None:
        self.case = case
        self.problem = problem
        self.phases = phases
        self._chosen = chosen

    @property
    def comm(self) -> Comm:
        """Return the ranks that share the problem (not collective)."""
        return self.problem.body.cloud.comm

    @property
    def cloud(self) -> Cloud:
        """Return the particles of this rank with their ghosts (not collective)."""
        return self.problem.body.cloud

    @cached_property
    def choice(self) -> Choice:
        """Return the choice of the representation of the tangent."""
        pivots = self.case.steps.unstable != "warn"
        with self._chosen.active():  # so that options it reads count as used
            return choose(self.problem, self._chosen.chosen, self.case.solver, pivots)

    @cached_property
    def options(self) -> Options:
        """Return the PETSc options of this problem: of the caller, of the case, and defaults for the problem."""
        found = default_options(self.problem, self.case.solver, self.choice)
        return self._chosen.suggest(coupled_options(found) if self.problem.coupled else found)

    def solution(self, unknowns: Float | None = None, t: float = 0.0, step: int = 0) -> Solution:
        """Return a solution for fields and quantities; by default of the undeformed body.

        Parameters
        ----------
        unknowns : (n_rows, dim) float64, optional
            Displacements of the owned particles, then the virtual rows of a periodic cell [length].
        t : float
            Step time [-].
        step : int
            Number of the step.
        """
        if unknowns is None:
            unknowns = np.zeros((self.cloud.n_rows, self.problem.dim))
        return Solution(self.problem, unknowns, t, step)

    def gathered(self, field: Field, solution: Solution) -> NDArray[Any] | None:
        """Return a field of a solution for all particles in creation order on rank 0; None on other ranks."""
        return gathered(solution, field)

    def make_solver(
        self, stop: Callable[[], bool] = lambda: False, allocates: Callable[[int], None] = lambda size: None
    ) -> Solver:
        """Create the solver of the case; call its ``destroy`` before MPI ends.

        Parameters
        ----------
        stop : callable
            Called at intervals, collectively; True ends ``march``.
        allocates : callable
            Called with the bytes of a matrix over all ranks before it is allocated.

        Raises
        ------
        CaseError
            The solver cannot solve this problem, or PETSc refuses an option.
        """
        declared, steps, problem = self.case.solver, self.case.steps, self.problem
        modes = self.case.modes
        refuse_unmet(problem, declared, vibrates=modes is not None and modes.of == "frequency")
        make = solver_of(problem, declared).make
        filled = None
        if declared.needs.tangent != "none":
            if self.choice.matrix_free:
                with self.phases.timed("kernels"):
                    rehearse(self.comm, self.case, problem.dim, lambda of: assembler(of, self.choice))
            with self.phases.timed("pattern"):
                filled = assembler(problem, self.choice)
                allocates(predicted(filled))
        with self.options.active():
            if filled is None:
                return make(Setting(problem, declared, steps, None, stop))
            with self.phases.timed("allocation"):
                return make(Setting(problem, declared, steps, filled, stop))

    def march(
        self, solver: Solver, start: Start | None = None, on_failure: OnFailure = lambda at, dt, result: None
    ) -> Iterator[Converged]:
        """Solve the load steps and yield the converged states; options of this problem are set only inside.

        Raises
        ------
        SolveError
            No further step converges; earlier states remain valid.
        """
        return_freed_memory(False)
        steps = solver.march(Start(self.solution().unknowns) if start is None else start, on_failure)
        while True:
            with self.options.active():
                converged = next(steps, None)
            if converged is None:
                return
            yield converged


def prepare(
    case: Case, comm: Any = None, options: Mapping[str, Any] | None = None, phases: Phases | None = None
) -> Prepared:
    """Build the problem of a case, distributed over the ranks of a communicator, without solving it.

    Parameters
    ----------
    case : Case
        The case.
    comm : communicator of mpi4py or petsc4py, optional
        The ranks; by default all.
    options : mapping, optional
        PETSc options without dash; they override those of the case.
    phases : Phases, optional
        Receives the times of the set-up.

    Raises
    ------
    CaseError
        The case or the name of an option is wrong, or the case differs between ranks.

    Notes
    -----
    Collective on ``comm``.

    Examples
    --------
    >>> import pdpetsc as pd
    >>> prepared = pd.prepare(case)                                  # doctest: +SKIP
    >>> state = prepared.problem.state(u, t=1.0)                     # doctest: +SKIP
    >>> forces = prepared.problem.internal_force(state)              # doctest: +SKIP
    >>> solver = prepared.make_solver()                              # doctest: +SKIP
    >>> for converged in prepared.march(solver):                     # doctest: +SKIP
    ...     print(converged.t, prepared.solution(converged.u, converged.t).energies)
    """
    ranks = communicator(comm)
    phases = Phases() if phases is None else phases
    return_freed_memory(True)
    refuse_differing(ranks, _of_all_ranks(case) | {"options": {**case.options, **(options or {})}})
    chosen = Options({**case.options, **(options or {})})
    with phases.timed("particles"):
        with agreed(ranks):
            case = _with_stops(_with_supports(case))
        chunk = make_chunk(ranks, case)
        case = with_suited_scheme(ranks, case, chunk)
        cloud = make_cloud(ranks, case, chunk)
        with agreed(ranks):
            check_declared(case, cloud.dim)
            # Files of particles are read once.
            weighed = replace(case, weights=case.chosen_weights)
    with phases.timed("kernels"):
        rehearse(ranks, weighed, cloud.dim)
    with phases.timed("families"):
        cloud, families = with_whole_patches(weighed, chunk, cloud, make_families(weighed, cloud))
        del chunk
    with phases.timed("model"):
        problem = make_problem(weighed, cloud, families, chosen)
        if problem.inertia is None:
            refuse_rigid_motion(cloud, families, problem.resisted, problem.joined)
    return Prepared(case, problem, chosen, phases)


def _with_supports(case: Case) -> Case:
    """Return the case with the layers and mirror planes that its supports add to a lattice."""
    particles, planes = beyond_sides(case.particles, case.conditions, case.chosen_horizon)
    return replace(case, particles=particles, symmetry=[*case.symmetry, *planes])


def _with_stops(case: Case) -> Case:
    """Return the case with adaptive steps, its own or those of a motion, that end at the times of its tables."""
    if case.solver.duration is not None and case.steps != Steps():
        raise CaseError(f"{case.solver.title} has time steps of its own. Leave steps out.")
    steps = case.solver.adaptive or case.steps
    if not isinstance(steps, AdaptiveSteps):
        return case
    times = [t for condition in case.conditions for table in tables_of(condition) for t in table.corners]
    return replace(case, steps=steps.ending_at(times))


def _of_all_ranks(case: Case) -> dict[str, Any]:
    """Return the declared values that must be equal on all ranks; fields and results are compared by name."""
    declared = {field.name: getattr(case, field.name) for field in fields(case)}
    results = None if case.results is None else name_of(case.results)
    return declared | {"fields": [name_of(field) for field in case.written], "results": results}
