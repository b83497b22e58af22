"""Branch switching: from an unstable equilibrium to a stable one under the same load."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from functools import partial

import numpy as np

from pdpetsc.arrays import Float, irregular
from pdpetsc.discrete.communicator import largest, scalar_product
from pdpetsc.errors import SolveError
from pdpetsc.solvers.eigenvectors import of_inverse
from pdpetsc.solvers.equilibrium import Equilibrium
from pdpetsc.solvers.protocol import Flexibility, StepResult
from pdpetsc.solvers.snes import SnesSolver

# Relative difference of eigenvalues that are equal.
EQUAL = 1e-6
# Share of random numbers in the vector that determines the sign of an eigenvector.
SHARE = 1e-3
# Smallest increment of the amplitude over the spacing.
LEAST = 1e-3
# Largest number of Newton iterations at a given amplitude, and of switches in a step.
ITERATIONS, SWITCHES = 20, 10


class BranchSwitch:
    """Find a stable equilibrium under the load of an unstable one, along its unstable eigenvector.

    With the amplitude ``a = c . (v - u)`` of the eigenvector, the method solves ``r(v) = m c`` for growing amplitudes,
    with a force m along the eigenvector. The force is negative next to the unstable equilibrium u, since its derivative
    there is the negative eigenvalue. At another equilibrium it changes its sign. The potential energy there is lower by
    the work ``-int m da``. The first amplitude is the smallest spacing, the largest the size of the body. The opposite
    direction is tried second.

    Parameters
    ----------
    solver : SnesSolver
        Solves for equilibrium.
    sought : Equilibrium
        Residual of the solver.
    inverse : callable
        Returns the inverse of the tangent at unknowns (n_rows, dim) [length].

    Notes
    -----
    Every method is collective.
    """

    def __init__(self, solver: SnesSolver, sought: Equilibrium, inverse: Callable[[Float], Flexibility]) -> None:
        self.solver, self.sought, self.inverse = solver, sought, inverse

    def stable(self, u: Float, result: StepResult) -> tuple[Float, StepResult]:
        """Return a stable equilibrium under the load of the unstable equilibrium ``u``, and its outcome.

        The outcome has not converged if none is found. If an equilibrium on the way is unstable too, the search
        continues from it.

        Raises
        ------
        SolveError
            The eigensolver finds no unstable eigenvector.
        """
        begin, first = u, result
        for _ in range(SWITCHES):
            mode = self.mode(u)
            found = None if mode is None else self._along(u, mode, result.negative_pivots or 0)
            if mode is None:  # the pivots are those of the last but one iteration
                result = replace(result, negative_pivots=0)
            elif found is not None:
                u, result = found
                first = replace(result.after(first), easy=False)
            else:
                break
            if not result.negative_pivots:
                comm = self.solver.problem.body.cloud.comm
                away = largest(comm, np.abs(u - begin), initial=0.0)
                return u, replace(first, negative_pivots=0, switched=away)
        return u, first.refused("the equilibrium is unstable, and no stable one was found along its eigenvector")

    def mode(self, u: Float) -> Float | None:
        """Return the eigenvector (n_rows, dim) of the most negative eigenvalue of the tangent, or None.

        Eigenvalues are those of ``K phi = lambda V phi`` with the volumes of the particles. The largest component is 1
        [-]. The mean displacement is positive, or if it vanishes a sum with factors that belong to particles. Of
        several eigenvectors with the same eigenvalue, the one with the largest such sum is returned; without a
        factorisation, the one that the irregular start of the iteration contains. The result is thus the same on any
        number of ranks. It is None if no eigenvalue is negative.
        """
        problem, cloud = self.solver.problem, self.solver.problem.body.cloud
        n = cloud.n_owned
        flexible = self.inverse(u)
        flexible(np.zeros_like(u))
        if flexible.stable():
            return None
        volume = cloud.volume[:n]
        values, shapes = of_inverse(problem, flexible, volume, [("SA", flexible.negative_pivots() or 1)])
        if not len(values):
            raise SolveError(
                f"The eigensolver found no unstable mode of the equilibrium at step time {self.solver.t:.6g}."
            )
        eigenvalues = 1.0 / values
        onto = volume[:, None] * (1.0 + SHARE * irregular(cloud.gid[:n], problem.dim))
        mode = np.zeros_like(u)
        for value, shape in zip(eigenvalues, shapes, strict=True):
            if value <= (1.0 - EQUAL) * eigenvalues.min():
                mode[:n] += scalar_product(cloud.comm, onto, shape) * shape
        return mode / largest(cloud.comm, np.abs(mode), initial=0.0)

    def _along(self, u: Float, mode: Float, pivots: int) -> tuple[Float, StepResult] | None:
        """Return an equilibrium with fewer negative pivots along a mode or against it, and its outcome, or None."""
        for sign in (1.0, -1.0):
            push = _Push(self, u, sign * mode)
            found = push.over(pivots)
            self.sought.forget()
            if found is not None or self.solver.stop():
                return found
        return None


class _Push:
    """Push a body out of an equilibrium ``u`` along a mode."""

    def __init__(self, switch: BranchSwitch, u: Float, mode: Float) -> None:
        self._solver, self._sought, self._inverse = switch.solver, switch.sought, switch.inverse
        self._u, self._mode = u, mode
        problem, n = self._solver.problem, self._solver.problem.body.cloud.n_owned
        weighted = np.zeros_like(u)
        weighted[:n] = problem.body.cloud.volume[:n, None] * mode[:n]
        self._c = weighted / self._dot(weighted, mode)
        self._force = problem.supports.reduced(self._c)

    def over(self, pivots: int) -> tuple[Float, StepResult] | None:
        """Return the first equilibrium with fewer negative pivots and its outcome, or None."""
        solver, sought = self._solver, self._sought
        v, at, ahead, step = self._u, 0.0, self._mode, sought.smallest_spacing
        while (step := min(step, sought.size - at)) >= LEAST * sought.smallest_spacing and not solver.stop():
            pushed = self._held_at(at + step, v + step * ahead)
            if pushed is None:
                step *= 0.5
            elif pushed[1] < 0.0:
                v, at, ahead, step = pushed[0], at + step, (pushed[0] - v) / step, 2.0 * step
            else:
                sought.forget()
                found, result = solver.solve(pushed[0], solver.t)
                stabler = result.negative_pivots is not None and result.negative_pivots < pivots
                if result.converged and stabler and at <= self._amplitude(found) <= at + step:
                    return found, result
                step *= 0.5
        return None

    def _held_at(self, amplitude: float, v: Float) -> tuple[Float, float] | None:
        """Return the equilibrium at an amplitude [length] and the force along the mode; None if Newton's method fails.

        Newton's method starts from ``v`` with the amplitude as constraint.
        """
        solver, sought = self._solver, self._sought
        sought.impose(solver.t)
        sought.begin(self._u)
        sought.resist(np.zeros_like(v))
        force = 0.0
        for iteration in range(ITERATIONS):
            loads = solver.problem.external_force(solver.state(v)) + force * self._force
            sought.impose(solver.t, loads=loads)
            if iteration > 0 and sought.judge(v, solver.rtol):
                return v, force
            residual = sought.residual(v)
            if residual is None or not np.isfinite(self._dot(residual, residual)):
                return None
            flexible = self._inverse(v)
            try:
                back, along = flexible(residual), flexible(self._force)
            except SolveError:
                return None
            more = (amplitude - self._amplitude(v) + self._dot(self._c, back)) / self._dot(self._c, along)
            change = more * along - back
            if not np.isfinite(self._dot(change, change)):
                return None
            v, force = v + sought.admissible_part(partial(_moved, v, change)) * change, force + more
        return None

    def _amplitude(self, v: Float) -> float:
        return self._dot(self._c, v - self._u)

    def _dot(self, one: Float, other: Float) -> float:
        return scalar_product(self._solver.problem.body.cloud.comm, one, other)


def _moved(v: Float, change: Float, part: float) -> Float:
    return v + part * change
