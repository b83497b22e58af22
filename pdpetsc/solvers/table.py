"""Mapping from declared solvers to classes, and checks of the requirements of a solver."""

from __future__ import annotations

from importlib import import_module

from pdpetsc.declare.solvers import (
    DeclaredSolver,
    DynamicRelaxation,
    EventDriven,
    Explicit,
    Implicit,
    Newton,
    PathFollowing,
    SnapThrough,
)
from pdpetsc.errors import CaseError
from pdpetsc.problem.problem import Problem
from pdpetsc.problem.proportional import refuse_what_is_not_proportional
from pdpetsc.problem.rigid_body import RigidBody
from pdpetsc.solvers.dynamics.explicit import ExplicitSolver
from pdpetsc.solvers.dynamics.implicit import ImplicitSolver
from pdpetsc.solvers.dynamics.snap import SnapSolver
from pdpetsc.solvers.monolithic import MonolithicSolver
from pdpetsc.solvers.newton import StaticSolver
from pdpetsc.solvers.path_following.solver import PathSolver
from pdpetsc.solvers.protocol import Solver
from pdpetsc.solvers.relaxation import RelaxationSolver

# A new solver is a class and an entry here.
IMPLEMENTATIONS: dict[type[DeclaredSolver], type[Solver]] = {
    Newton: StaticSolver,
    DynamicRelaxation: RelaxationSolver,
    PathFollowing: PathSolver,
    Implicit: ImplicitSolver,
    Explicit: ExplicitSolver,
    SnapThrough: SnapSolver,
}
# Module and class of solvers imported on first use.
SATELLITES: dict[type[DeclaredSolver], tuple[str, str]] = {
    EventDriven: ("pdpetsc.solvers.event_driven.solver", "EventSolver"),
}


def solver_of(problem: Problem, declared: DeclaredSolver) -> type[Solver]:
    """Return the solver class for a problem and a declared solver, with monolithic coupling if declared.

    Raises
    ------
    CaseError
        The table has no entry, or the solver does not support monolithic coupling.
    """
    found = implementation(declared)
    if not problem.coupled:
        return found
    if found is not StaticSolver:
        raise CaseError(
            f'HeatConduction with coupling="monolithic" takes Newton, and {declared.title} finds displacements alone; '
            f'take coupling="staggered", which finds the same.'
        )
    return MonolithicSolver


def implementation(declared: DeclaredSolver) -> type[Solver]:
    """Return the class of a declared solver (not collective); raise CaseError if the table has no entry."""
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


def refuse_unmet(problem: Problem, declared: DeclaredSolver, vibrates: bool = False) -> None:
    """Raise CaseError on all ranks if a problem does not meet the requirements of a solver (collective).

    ``vibrates`` states whether frequencies of the equilibrium are sought, for which rigid bodies may have a mass.
    """
    solver_of(problem, declared).refuse(problem)
    for _, rigid in problem.rigid_bodies:
        _refuse_load(rigid, solver_of(problem, declared), declared, vibrates)
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


def _refuse_load(rigid: RigidBody, solver: type[Solver], declared: DeclaredSolver, vibrates: bool) -> None:
    """Raise CaseError if a solver does not find the motion of a loaded rigid body."""
    if solver is StaticSolver or (solver is PathSolver and rigid.rows is not None):
        if (rigid.declared.mass is not None or rigid.declared.inertia is not None) and not vibrates:
            raise CaseError(
                f"{rigid.title} has a mass and does not move in time. Use Implicit or Explicit, frequencies by Modes, "
                f"or no mass."
            )
        return
    if solver not in (ImplicitSolver, ExplicitSolver):
        raise CaseError(
            f"{rigid.title} has a load, and {declared.title} does not find its motion. Use Newton, with staggered "
            f"coupling of a temperature, or prescribe the motion."
        )
    if rigid.inertia is None:
        raise CaseError(f"{rigid.title} has a load and no mass. Give it mass, and with a moment inertia.")
    if isinstance(declared, Implicit | Explicit) and declared.preload:
        raise CaseError(f"{rigid.title} has a load, and preload holds it. Leave preload out.")
