"""Forces and start of a motion, common to the time integrators."""

from __future__ import annotations

from collections.abc import Callable, Mapping

import numpy as np

from pdpetsc.arrays import Float
from pdpetsc.errors import CaseError, Interrupted, SolveError
from pdpetsc.problem.inertia import Inertia
from pdpetsc.problem.problem import Problem, Tangent
from pdpetsc.problem.state import State
from pdpetsc.solvers.protocol import StepResult

# Largest number of printed lines of a motion.
LINES = 50
# Step of differences in time over a time step.
SMALL = 1e-3
# Names in a checkpoint: the time at the end [time], and the error of the energy balance [-].
END, ERROR = "end", "energy_error"


def printed(t: float, step: float) -> bool:
    """Return True if a record at step time ``t``, a step after the last one, has a line: ``LINES`` of a whole run do.

    Not collective.
    """
    return int(t * LINES * (1.0 + 1e-9)) > int((t - step) * LINES * (1.0 + 1e-9))


def resume_motion(problem: Problem, resume: Mapping[str, float], end: float) -> None:
    """Restore the numbers of a checkpoint; raise CaseError unless it is of a motion to the time ``end``.

    Not collective.
    """
    if END not in resume:
        raise CaseError(
            "The checkpoint is of an equilibrium, and the case moves. Start from it with preload=True of the solver."
        )
    if resume[END] != end:
        raise CaseError(f"The checkpoint is of a motion to the time {resume[END]:g}, not {end:g}. Use the same end.")
    inertia_of(problem).error = resume.get(ERROR, 0.0)


def forces(problem: Problem, state: State) -> tuple[Float, Float]:
    """Compute internal forces without inertia, and external forces (n_rows, dim) [force] (collective).

    Raises
    ------
    SolveError
        The forces are not defined: det F <= 0.
    """
    internal = problem.internal_force(state, of_solver=False)
    if internal is None:
        raise SolveError(
            f"At step time {state.t:.6g} the motion has det F <= 0, or a strain without stress; take shorter steps, "
            f"or look for zero-energy modes."
        )
    return internal, problem.external_force(state)


def elastic_tangent(problem: Problem) -> Tangent:
    """Return the tangent ``K_0`` of material and control in the undeformed body (collective).

    Solvers call it when they are made, before histories are read from a checkpoint.
    """
    rest = problem.state(np.zeros(problem.supports.fixed.shape), 0.0)
    _ = rest.u_local
    elastic = [term for term in problem.terms if term.energy_of in ("strain", "control")]
    return Tangent(problem.body, [one for term in elastic for one in term.linearise(rest)])


def inertia_of(problem: Problem) -> Inertia:
    """Return the inertia of a problem of motion (not collective)."""
    assert problem.inertia is not None
    return problem.inertia


def preload(
    problem: Problem, u: Float, equilibrate: Callable[[Float], tuple[Float, StepResult]], stop: Callable[[], bool]
) -> Float:
    """Return the unknowns (n_rows, dim) of the equilibrium at step time 0, and commit it (collective).

    Raises
    ------
    SolveError
        There is no equilibrium.
    Interrupted
        A signal requested a stop.
    """
    inertia = inertia_of(problem)
    inertia.active = False
    try:
        found, result = equilibrate(u)
    finally:
        inertia.active = True
    if stop():
        raise Interrupted("Stopped by a signal before the motion began.")
    if not result.converged:
        raise SolveError(
            f"The motion has no equilibrium to start from: {result.reason}; hold the body, or lower the loads at step "
            f"time 0."
        )
    problem.commit(problem.state(found, 0.0))
    return found


def begin_motion(problem: Problem, u: Float, dt: float) -> Float:
    """Set velocity and acceleration at step time 0; return the unknowns (n_rows, dim) there (collective).

    ``dt`` is the length of the first step in step time.
    """
    inertia, fixed = inertia_of(problem), problem.supports.fixed
    n = len(inertia.mass)
    start = np.where(fixed, problem.supports.prescribed(0.0), u)
    held = fixed[:n] & ~inertia.carried[:, None]
    set_in_motion(problem, start, np.where(held, held_velocity(problem, 0.0, dt), inertia.v), 0.0)
    return start


def held_velocity(problem: Problem, t: float, dt: float) -> Float:
    """Return the velocities of the held components at step time ``t`` (n_owned, dim) [length / time] (collective).

    They are differences over a small share of a step of length ``dt``, and 0 for free components.
    """
    n = problem.body.cloud.n_owned
    before, after = max(t - SMALL * dt, 0.0), min(t + SMALL * dt, 1.0)
    if after <= before:
        return np.zeros((n, problem.dim))
    moved = problem.supports.prescribed(after) - problem.supports.prescribed(before)
    return np.asarray(moved[:n] / ((after - before) * problem.duration))


def set_in_motion(problem: Problem, u: Float, v: Float, t: float) -> tuple[Float, Float]:
    """Set displacement, velocity and acceleration at load parameter ``t``; return internal and external forces.

    ``u`` are the unknowns (n_rows, dim), ``v`` the velocities of the own particles; the forces are (n_rows, dim)
    (collective).
    """
    inertia, n = inertia_of(problem), len(v)
    inertia.place(u[:n], v, np.zeros_like(v), t)
    internal, external = forces(problem, problem.state(u, t))
    unbalanced = (external - internal)[:n] - inertia.damped(v)
    free = ~problem.supports.fixed[:n]
    inertia.place(u[:n], v, np.where(free, unbalanced / inertia.mass[:, None], 0.0), t)
    return internal, external
