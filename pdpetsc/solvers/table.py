"""Which solver does what a case declares, and what a solver must find in a problem."""

from __future__ import annotations

from importlib import import_module

from pdpetsc.declare.solvers import DeclaredSolver, DynamicRelaxation, EventDriven, Newton, PathFollowing
from pdpetsc.errors import CaseError
from pdpetsc.problem.problem import Problem
from pdpetsc.problem.proportional import refuse_what_is_not_proportional
from pdpetsc.solvers.monolithic import MonolithicSolver
from pdpetsc.solvers.newton import StaticSolver
from pdpetsc.solvers.path_following.solver import PathSolver
from pdpetsc.solvers.protocol import Solver
from pdpetsc.solvers.relaxation import RelaxationSolver

# A new solver is one class of its own and a line here.
IMPLEMENTATIONS: dict[type[DeclaredSolver], type[Solver]] = {
    Newton: StaticSolver,
    DynamicRelaxation: RelaxationSolver,
    PathFollowing: PathSolver,
}
# The solver that finds the temperature together with the displacement, as one that finds displacements does.
MONOLITHIC: dict[type[Solver], type[Solver]] = {StaticSolver: MonolithicSolver}
# Module and class of solvers that are imported on first use.
SATELLITES: dict[type[DeclaredSolver], tuple[str, str]] = {
    EventDriven: ("pdpetsc.solvers.event_driven.solver", "EventSolver"),
}


def solver_of(problem: Problem, declared: DeclaredSolver) -> type[Solver]:
    """Return what solves a problem as a case declares: with the temperature among the unknowns where it asks for that.

    Raises
    ------
    CaseError
        The table has nothing, or what it has finds no temperature together with the displacement.
    """
    found = implementation(declared)
    if not problem.coupled:
        return found
    if found not in MONOLITHIC:
        raise CaseError(
            f'HeatConduction with coupling="monolithic" takes Newton, and {declared.title} finds displacements alone; '
            f'take coupling="staggered", which finds the same.'
        )
    return MONOLITHIC[found]


def implementation(declared: DeclaredSolver) -> type[Solver]:
    """Return what does what a case declares (not collective); raise CaseError where the table has nothing."""
    for kind in type(declared).__mro__:
        if kind in IMPLEMENTATIONS:
            return IMPLEMENTATIONS[kind]
        if kind in SATELLITES:
            module, name = SATELLITES[kind]
            solver: type[Solver] = getattr(import_module(module), name)
            return solver
    raise CaseError(
        f"No solver is known for {type(declared).__name__}; enter the class that does it in "
        f"pdpetsc.solvers.table.IMPLEMENTATIONS."
    )


def refuse_unmet(problem: Problem, declared: DeclaredSolver) -> None:
    """Raise CaseError on all ranks where a problem lacks what a solver declares to need (collective)."""
    solver_of(problem, declared).refuse(problem)
    needs = declared.needs
    if needs.piecewise_linear and not problem.piecewise_linear:
        raise CaseError(
            f"{declared.title} needs laws that are piecewise linear: LinearElastic, or bonds with small kinematics; "
            f"this body has a law that is not linear between failures, so take Newton."
        )
    timed = problem.material_term.timed or (problem.damage is not None and problem.damage.timed)
    if declared.finds_load and timed:
        raise CaseError(
            f"{declared.title} finds the load, which is no time; a material that depends on its rate, or fails by it, "
            f"needs load steps, so take Newton."
        )
    if needs.symmetric:
        for term in problem.terms:
            if not term.symmetric:
                raise CaseError(
                    f"{declared.title} needs a symmetric tangent, and that of {type(term).__name__} is not, so take "
                    f"Newton."
                )
    if needs.proportional != "no":
        refuse_what_is_not_proportional(problem, declared.title, beyond=needs.proportional == "at any load")
