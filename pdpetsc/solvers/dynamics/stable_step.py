"""The stable time step of central differences."""

from __future__ import annotations

import numpy as np
import scipy

from pdpetsc.arrays import Float, irregular
from pdpetsc.discrete.communicator import largest, norm, scalar_product
from pdpetsc.kernels.bonds import change_of_lengths
from pdpetsc.problem.body import Body
from pdpetsc.problem.problem import Problem
from pdpetsc.problem.state import State

# Largest number of Lanczos steps, and relative accuracy of the largest frequency at which they end.
ITERATIONS, EXACT = 60, 5e-3


class Deformation:
    """Measure how far a body has deformed since an estimate of its largest frequency.

    The largest relative change of the distance of a particle to one of its nearest neighbours bounds the change of the
    spatial gradients, and so that of the frequency at constant stiffness of the material.

    Parameters
    ----------
    body : Body
        The body.
    both : bool
        Whether extensions count besides compressions. They do not in a body that fails: parts that move apart do not
        become stiffer.
    passed : float
        Deformation before, of a run that goes on [-].
    """

    def __init__(self, body: Body, both: bool, passed: float = 0.0) -> None:
        self.passed = passed
        cloud, self._body, self._both = body.cloud, body, both
        # Those of a lattice include its diagonals, which shear along the axes presses.
        near = min(3**cloud.dim, cloud.n_local)
        found = scipy.spatial.cKDTree(cloud.x).query(cloud.x[: cloud.n_owned], near)[1] if cloud.n_owned else []
        self._near = np.asarray(found, dtype=np.int32).reshape(cloud.n_owned, near)
        self._length = np.ones(self._near.shape)

    def at(self, state: State) -> float:
        """Return the deformation at a state (collective)."""
        return self.passed + self.since(state, begin=False)

    def carry(self, state: State) -> None:
        """Measure from a state on, and keep the deformation up to it as a number, for a checkpoint (collective)."""
        self.passed += self.since(state, begin=True)

    def reset(self, state: State) -> None:
        """Measure from a state on (collective)."""
        self.since(state, begin=True)
        self.passed = 0.0

    def since(self, state: State, begin: bool) -> float:
        """Return the largest change of a distance since the last state with ``begin`` [-] (collective)."""
        x, u, dim = self._body.cloud.x, state.u_local, self._body.dim
        change = change_of_lengths(self._near, x, u, self._length, dim, self._both, begin)
        return largest(self._body.cloud.comm, change)


def largest_frequency(problem: Problem, state: State, mass: Float) -> float:
    """Return an upper estimate of the largest circular frequency of ``M^-1/2 K M^-1/2`` [1 / time] (collective).

    Lanczos' method without orthogonalisation finds the largest eigenvalue first; its residual is added to it. The
    operator acts on the free components; an unsymmetric tangent is taken as if it were symmetric.

    Parameters
    ----------
    problem : Problem
        The problem, whose stiffest tangent near the state is applied.
    mass : (n_owned,) float64
        Masses of the own particles.

    References
    ----------
    Lehoucq1998, section 4.4 (the residual of a Ritz value).
    """
    comm, cloud = problem.body.cloud.comm, problem.body.cloud
    n, dim = cloud.n_owned, cloud.dim
    free = ~problem.supports.fixed[:n]
    root = np.where(free, 1.0 / np.sqrt(mass)[:, None], 0.0)
    tangent = problem.stiffest(state)
    padded = np.zeros((cloud.n_rows, dim))

    def apply(y: Float) -> Float:
        padded[:n] = root * y
        return np.asarray(root * tangent(padded)[:n])

    v = np.where(free, irregular(cloud.gid[:n], dim), 0.0)
    size = norm(comm, v)
    if size == 0.0:
        return 0.0
    v, before, beta = v / size, np.zeros_like(v), 0.0
    diagonal: list[float] = []
    beside: list[float] = []
    upper = 0.0
    for _ in range(ITERATIONS):
        w = apply(v) - beta * before
        alpha = scalar_product(comm, w, v)
        w -= alpha * v
        beta = norm(comm, w)
        diagonal.append(alpha)
        values, vectors = scipy.linalg.eigh_tridiagonal(diagonal, beside)
        residual = beta * abs(float(vectors[-1, -1]))
        upper = float(values[-1]) + residual
        if residual <= EXACT * abs(upper) or beta <= np.finfo(float).eps * abs(upper):
            break
        beside.append(beta)
        before, v = v, w / beta
    return float(np.sqrt(max(upper, 0.0)))
