"""Growth of a deviation from an equilibrium while damage settles."""

from __future__ import annotations

import numpy as np
from petsc4py import PETSc

from pdpetsc.arrays import Float
from pdpetsc.discrete.communicator import norm
from pdpetsc.petsc.library import put_irregular, with_tolerance
from pdpetsc.solvers.equilibrium import Equilibrium

# Number of power iterations, and the tolerance of their linear solves.
POWERS, RTOL = 20, 1e-3


def growth_of_deviation(sought: Equilibrium, ksp: PETSc.KSP, u: Float, t: float) -> float:
    """Compute the factor by which a deviation grows from sweep to sweep at an equilibrium with settled damage [-].

    A sweep maps a deviation v of the displacement to ``v - K^-1 L v``. K is the tangent with damage held. L is the
    tangent in which all bonds at their largest drive continue to lose force. Power iterations give the largest factor
    of that map. It is above 1 if and only if a symmetric L has a negative eigenvalue.

    Parameters
    ----------
    sought : Equilibrium
        Residual of a problem whose bonds soften. Its tangent is updated to K, with damage held, and forgotten.
    ksp : KSP
        Linear solver of the tangent.
    u : (n_rows, dim) float64
        Unknowns [length].
    t : float
        Load parameter [-].

    Notes
    -----
    Collective. The result is a lower bound. Other factors close to the largest one lower it by a few per cent.
    """
    problem, tangent, scale = sought.problem, sought.tangent, sought.scales.stiffness
    damage, supports = problem.damage, problem.supports
    free = ~supports.fixed
    assert damage is not None
    frozen = damage.frozen
    damage.freeze(True)
    tangent.update(problem.state(u, t))
    with damage.loading():
        loading = problem.linearised(problem.state(u, t))
    damage.freeze(frozen)
    ksp.setOperators(tangent.mat, tangent.preconditioner)
    x, b = tangent.preconditioner.createVecs()
    put_irregular(x)
    v = np.where(free, x.array_r.reshape(u.shape), 0.0)
    norms = []
    with with_tolerance(ksp, RTOL):
        for _ in range(POWERS):
            b.array = supports.reduced(loading(supports.completed(v))).ravel() / scale
            ksp.solve(b, x)
            v = v - x.array_r.reshape(u.shape)
            norms.append(norm(problem.body.cloud.comm, v))
    x.destroy()
    b.destroy()
    sought.forget()
    before, after = norms[POWERS // 2 - 1], norms[-1]
    factor = (after / before) ** (2.0 / POWERS) if before > 0.0 else 0.0
    return factor if np.isfinite(factor) else 0.0
