"""Check that loads and prescribed unknowns are proportional to the load factor, as two of the solvers require."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from pdpetsc.arrays import Float, irregular
from pdpetsc.discrete.communicator import largest
from pdpetsc.errors import CaseError
from pdpetsc.problem.problem import Problem, Tangent
from pdpetsc.problem.scales import mean_spacing
from pdpetsc.problem.state import State
from pdpetsc.problem.term import Term

# Load parameters at which conditions are compared with their proportional values; beyond the range of load steps, which
# a load factor may leave; and the relative tolerance.
PROBES = (0.0, 0.3, 0.7)
BEYOND = (-0.4, 1.6)
PROPORTIONAL = 1e-12
# Overlap of a tool at the start, over the spacing, that is round-off.
TOUCH = 1e-9


def refuse_what_is_not_proportional(problem: Problem, who: str, beyond: bool = False) -> None:
    """Raise on all ranks unless loads and prescribed unknowns are proportional to the load parameter (collective).

    Loads must not depend on the displacement, unless the solver also uses load parameters outside [0, 1] and the load
    is ``Term.proportional``. The forces of all other terms except the material must vanish with the displacement and
    not depend on the load parameter. The residual is then ``f_int(u) - t f_ext``, in the other case with ``f_ext(u)``.

    Parameters
    ----------
    who : str
        Name of the solver, for the message.
    beyond : bool
        Whether to test also load parameters outside [0, 1].
    """
    if problem.body.expansion is not None:
        raise CaseError(
            f"{who} needs a body without stress where it is undeformed; with temperatures and eigenstrains take load "
            f"steps with Newton."
        )
    times, whole = (*PROBES, *(BEYOND if beyond else ())), problem.given(1.0)
    for t in times:
        # Compare displacements and forces each with their own magnitude.
        if any(_differ(problem, p, t * w, w) for p, w in zip(problem.given(t), whole, strict=True)):
            raise CaseError(
                f"{who} needs conditions proportional to the step time, such as numbers with the schedule Ramp: "
                f"the load goes up and down as equilibrium demands, which has no meaning for others."
            )
    for _, rigid in problem.rigid_bodies:
        load = rigid.load(1.0)
        off = max(float(np.abs(rigid.load(t) - t * load).max(initial=0.0)) for t in times)
        if off > PROPORTIONAL * max(float(np.abs(load).max(initial=0.0)), 1e-300):
            raise CaseError(
                f"{who} needs loads proportional to the step time, and that of {rigid.title[0].lower()}"
                f"{rigid.title[1:]} is not; take the schedule Ramp."
            )
    for term in problem.terms:
        if term is not problem.material_term:
            driven = beyond and term.tool_way is not None
            if driven:
                _refuse_tool(problem, term, who, times)
            if beyond and term.load and term.proportional:
                _refuse_following(problem, term, who, times)
            else:
                _refuse_term(problem, term, who, (0.0,) if driven else (1.0, *times))


def _refuse_tool(problem: Problem, term: Term, who: str, times: Sequence[float]) -> None:
    whole = term.tool_displacements(1.0)
    if any(_differ(problem, term.tool_displacements(t), t * whole, whole) for t in times):
        raise CaseError(
            f"{who} needs tools that move in proportion to the step time and do not turn; take the schedule Ramp, or "
            f"load steps with Newton."
        )


def _refuse_following(problem: Problem, term: Term, who: str, times: Sequence[float]) -> None:
    """Raise unless a load that depends on the displacement is proportional to the load parameter (collective)."""
    u, gid = np.zeros(problem.supports.fixed.shape), problem.body.cloud.gid[: problem.body.cloud.n_owned]
    u[: len(gid)] = 0.1 * mean_spacing(problem.body) * irregular(gid, problem.dim)

    def force(t: float) -> Float:
        return problem.force_of([term], State(problem.body, u, problem.clock(t)))

    whole = force(1.0)
    if any(_differ(problem, force(t), t * whole, whole) for t in times):
        raise CaseError(
            f"{who} needs loads proportional to the step time, and {type(term).__name__} is not; take the schedule "
            f"Ramp, or load steps with Newton."
        )


def _refuse_term(problem: Problem, term: Term, who: str, times: Sequence[float]) -> None:
    zero, name = np.zeros(problem.supports.fixed.shape), type(term).__name__
    states = [State(problem.body, zero, problem.clock(t)) for t in times]
    found = [term.linearise(state) for state in states]
    if term.load:
        if any(found):
            raise CaseError(
                f"{who} needs loads that do not depend on the displacement, and {name} has a tangent; let it be an "
                f"internal force (load = False), or take load steps with Newton."
            )
        return
    gid = problem.body.cloud.gid[: problem.body.cloud.n_owned]
    v = np.zeros_like(zero)
    v[: len(gid)] = irregular(gid, problem.dim)
    products = [Tangent(problem.body, parts)(v).copy() for parts in found]
    forces = [problem.force_of([term], state) for state in states]
    offset = max(largest(problem.body.cloud.comm, np.abs(force), initial=0.0) for force in forces)
    size = largest(problem.body.cloud.comm, np.abs(products[0]), initial=0.0)
    if offset > TOUCH * mean_spacing(problem.body) * size or any(
        _differ(problem, product, products[0], products[0]) for product in products[1:]
    ):
        raise CaseError(
            f"{who} needs forces that depend on the displacement alone and vanish with it, besides loads that are "
            f"proportional to the step time; those of {name} do not, so take load steps with Newton."
        )


def _differ(problem: Problem, a: Float, b: Float, of: Float) -> bool:
    """Return True if two arrays differ, relative to the largest entry of a third (collective)."""
    comm = problem.body.cloud.comm
    off, size = (largest(comm, np.abs(values), initial=0.0) for values in (a - b, of))
    return bool(off > PROPORTIONAL * max(size, 1e-300))
