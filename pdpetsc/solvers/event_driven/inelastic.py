"""Method of inelastic forces: solves with a factored matrix for a body with a few changed bonds."""

from __future__ import annotations

import numpy as np
from petsc4py import PETSc

from pdpetsc.arrays import Float
from pdpetsc.discrete.communicator import total
from pdpetsc.errors import SolveError
from pdpetsc.petsc.matrix import TangentMatrix
from pdpetsc.problem.assembly import Assembler
from pdpetsc.problem.problem import Problem
from pdpetsc.problem.scales import scales_of
from pdpetsc.solvers.equilibrium import read_options
from pdpetsc.solvers.event_driven.pairs import Key, Pairs
from pdpetsc.solvers.unique import refuse_mechanism

# A linear solve has failed if its residual exceeds this share of its right-hand side.
SOLVED = 1e-6


class InelasticForces:
    """Solve ``K u = rate f`` for K that differs from the factored ``K0`` by the stiffness of a few bonds.

    Bond ``b`` with direction vector ``b`` (elongation ``e = b . u``) has the inelastic force ``p``, the difference of
    its tension from ``k0 e``: ``K0 u + sum_b p_b b_b = rate f``. With ``w_b = K0^-1 b_b`` and ``S_cb = b_c . w_b``, all
    elongations follow from ``p``. They need one solve per changed bond.

    Parameters
    ----------
    problem, assembler
        Linear problem with conditions proportional to the load parameter, and the object that fills its matrix.
    pairs : Pairs or None
        Bonds, if they can fail.

    Attributes
    ----------
    numbers : dict of Key to int
        Numbers of the changed bonds.
    local : list of int
        Number of each changed bond among the pairs of this rank, -1 if it is not on this rank.
    elastic : (n_rows, dim) float64
        Displacement under the full load with the factored stiffness [length].

    References
    ----------
    Jirasek1994, section 4.2.

    Notes
    -----
    Construction and every method are collective. Call ``destroy`` before MPI ends.
    """

    def __init__(self, problem: Problem, assembler: Assembler, pairs: Pairs | None) -> None:
        self._problem = problem
        self._body = problem.body
        self._pairs = pairs
        fixed = problem.supports.fixed
        # Prescribed and tied unknowns for zero independent ones.
        self._held = problem.supports.completed(np.zeros(fixed.shape), problem.supports.prescribed(1.0))
        self._external = problem.external_force(problem.state(np.zeros(fixed.shape), 1.0))
        self._scales = scales_of(problem.body, problem.material_term)
        self.matrix = TangentMatrix(assembler, fixed, self._scales.stiffness)
        self._x = self.matrix.mat.createVecRight()
        self._b = self._x.duplicate()
        self._r = self._x.duplicate()
        self.ksp = PETSc.KSP().create(comm=self._body.cloud.comm)
        self.ksp.setOperators(self.matrix.mat)
        self._w = np.empty((0, *fixed.shape))
        self.elastic: Float = np.zeros(fixed.shape)
        self.numbers: dict[Key, int] = {}
        self.local: list[int] = []
        read_options(self.destroy, self.ksp)

    def factor(self) -> None:
        """Factor the current stiffness, and clear the list of changed bonds."""
        zero = np.zeros(self._problem.supports.fixed.shape)
        self.matrix.update(self._problem.state(zero))
        self.numbers, self.local = {}, []
        load = self._external - self._problem.linearised(self._problem.state(zero))(self._held)
        self.elastic = self._solve(load) + self._held
        if self._pairs is not None:
            self._elongated = self._pairs.elongation(self._body.with_ghosts(self.elastic))

    def refuse_mechanism(self) -> None:
        """Raise SolveError on all ranks if the factored stiffness has a mechanism."""
        refuse_mechanism(self._problem, self.matrix, self.ksp, self._scales.stiffness, 0.0)

    def add(self, key: Key) -> tuple[Float, float]:
        """Append a bond, with one solve; return its row of ``S`` (r + 1,) and its elongation under the full load."""
        body, pairs = self._body, self._pairs
        assert pairs is not None
        pair = pairs.local(key)
        f = np.zeros_like(body.cloud.x)
        if pair >= 0 and pairs.reported[pair]:
            f[pairs.ends[pair, 1]] += pairs.n[pair]
            f[pairs.ends[pair, 0]] -= pairs.n[pair]
        w = self._solve(body.gather(f))
        r = len(self.local)
        self.numbers[key] = r
        self.local.append(pair)
        if len(self._w) <= r:
            self._w = np.concatenate([self._w, np.empty((max(r, 16), *w.shape))])
        self._w[r] = w
        here = np.array(self.local)
        mine = np.flatnonzero((here >= 0) & pairs.reported[here])
        ends, n = pairs.ends[here[mine]], pairs.n[here[mine]]
        values = np.zeros(r + 2)
        w_local = body.with_ghosts(w)
        values[mine] = np.einsum("pm,pm->p", n, w_local[ends[:, 1]] - w_local[ends[:, 0]])
        if len(mine) and mine[-1] == r:
            values[r + 1] = self._elongated[pair]
        values = total(body.cloud.comm, values)
        return values[: r + 1], float(values[r + 1])

    def response(self, rate: float, p: Float) -> Float:
        """Compute ``u = rate u_elastic - sum_b p_b w_b`` (n_rows, dim) for inelastic forces p of the changed bonds."""
        u = rate * self.elastic
        return u - (p @ self._w[: len(p)].reshape(len(p), -1)).reshape(u.shape) if len(p) else u

    def destroy(self) -> None:
        """Free the PETSc objects, in order."""
        self.ksp.destroy()
        self._r.destroy()
        self._b.destroy()
        self._x.destroy()
        self.matrix.destroy()

    def _solve(self, load: Float) -> Float:
        supports = self._problem.supports
        self._b.array = supports.reduced(load).ravel() / self._scales.force
        self.ksp.solve(self._b, self._x)
        u = supports.completed(self._scales.length * self._x.array.reshape(supports.fixed.shape))
        if self.ksp.getConvergedReason() < 0 or not self._solved():
            raise SolveError(
                "The linear solver failed: a piece of the body may have come free, or the iterations did not converge; "
                "for those take a direct solver, -pc_type cholesky."
            )
        return u

    def _solved(self) -> bool:
        """Return True if the last solution is valid: a factor of a singular matrix also returns numbers."""
        size = self._b.norm()
        self.matrix.mat.mult(self._x, self._r)
        self._r.aypx(-1.0, self._b)
        left = self._r.norm()
        return bool(np.isfinite(left) and left <= SOLVED * size)
