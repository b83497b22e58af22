"""Growth of a deviation from an equilibrium while damage settles."""

from __future__ import annotations

import numpy as np
from petsc4py import PETSc

from pdpetsc.arrays import Float, irregular
from pdpetsc.discrete.communicator import largest, norm
from pdpetsc.petsc.library import with_tolerance
from pdpetsc.solvers.equilibrium import Equilibrium

# Number of power iterations, and the tolerance of their linear solves.
POWERS, RTOL = 20, 1e-3


def growing_deviation(sought: Equilibrium, ksp: PETSc.KSP, u: Float, t: float) -> tuple[float, Float]:
    """Compute the deviation that grows most from sweep to sweep at an equilibrium with settled damage.

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

    Returns
    -------
    growth : float
        Factor by which it grows in a sweep [-].
    v : (n_rows, dim) float64
        The deviation; its largest component is the smallest spacing [length].

    Notes
    -----
    Collective. The factor is a lower bound. Other factors close to the largest one lower it by a few per cent.
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
    v, n, gid = np.zeros_like(u), problem.body.cloud.n_owned, problem.body.cloud.gid
    # Squares, since numbers of the particles of a lattice themselves give a wave.
    v[:n] = np.where(free[:n], irregular(gid[:n] ** 2, problem.dim), 0.0)
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
    top = largest(problem.body.cloud.comm, np.abs(v), initial=0.0)
    if not (np.isfinite(factor) and top > 0.0):
        return 0.0, np.zeros_like(v)
    return factor, supports.completed(v * (sought.smallest_spacing / top))
