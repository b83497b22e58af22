"""Check that an equilibrium is unique."""

from __future__ import annotations

import numpy as np
from petsc4py import PETSc

from pdpetsc.errors import SolveError
from pdpetsc.petsc.mechanism import mechanism
from pdpetsc.petsc.tangent import PetscTangent
from pdpetsc.problem.problem import Problem


def refuse_mechanism(problem: Problem, tangent: PetscTangent, ksp: PETSc.KSP, scale: float, t: float) -> None:
    """Revert the step and raise SolveError on all ranks if an up-to-date tangent has a mechanism.

    Loads that do not move a mechanism leave its displacement undetermined. The solution is then one of infinitely many.

    Parameters
    ----------
    problem : Problem
        The problem.
    tangent : PetscTangent
        Its tangent.
    ksp : KSP
        Linear solver of the tangent.
    scale : float
        Unit of stiffness in the tangent [force / length].
    t : float
        Load parameter, for the message [-].

    Notes
    -----
    Collective.
    """
    moves = mechanism(tangent, ksp, ~problem.supports.fixed, scale)
    if moves is None:
        return
    problem.revert()
    cloud = problem.body.cloud
    far = np.abs(moves[: cloud.n_owned]).max(axis=1, initial=0.0)
    at = int(np.argmax(far)) if len(far) else -1
    here = (float(far[at]), cloud.x[at].tolist()) if at >= 0 else (0.0, [])
    _, place = max(cloud.comm.allgather(here))
    raise SolveError(
        f"At step time {t:.6g} the equilibrium is not unique: no force resists a mechanism of the body, in which the "
        f"particle at ({', '.join(f'{x:.6g}' for x in place)}) moves most; take a larger horizon, add a zero-energy "
        f"control, or hold that particle."
    )
