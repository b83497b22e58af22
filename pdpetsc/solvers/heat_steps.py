"""Heat conduction in load steps: solved before the equilibrium, or together with the displacement."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
import scipy

from pdpetsc.arrays import Float
from pdpetsc.errors import SolveError
from pdpetsc.petsc.conduction import ScalarMatrix
from pdpetsc.petsc.options import Options
from pdpetsc.terms.heat import Heat


class HeatSystem(NamedTuple):
    """Store the system ``A T = b`` of the temperature of a load step.

    Attributes
    ----------
    matrix : ScalarMatrix
        A.
    b : (n_owned,) float64
        Right-hand side [power].
    start : (n_owned,) float64
        Last temperature, with the prescribed values inserted.
    t : float
        Load parameter [-].
    """

    matrix: ScalarMatrix
    b: Float
    start: Float
    t: float


class HeatSteps:
    """Solve ``C (T - T_0) / dt + K (w T + (1 - w) T_0) = w Q + (1 - w) Q_0`` for the temperature of each load step.

    ``w`` is 1 for the backward Euler rule and 1/2 for the Crank-Nicolson rule. Without a duration the equation is ``K T
    = Q``. ``K`` is that of the bonds at the start of the step. With staggered coupling the temperature is solved before
    the equilibrium. With monolithic coupling it is an unknown of Newton's method besides the displacement
    (``MonolithicSolver``).

    Parameters
    ----------
    heat : Heat
        Conduction, capacity and sources.
    options : Options
        PETSc options of the run.

    Attributes
    ----------
    system : HeatSystem
        System of the current load step, set by ``advance``.

    Notes
    -----
    Construction and every method are collective. Call ``destroy`` before MPI ends.
    """

    system: HeatSystem

    def __init__(self, heat: Heat, options: Options) -> None:
        self.heat = heat
        self._options = options
        self._stiff: tuple[int, scipy.sparse.csr_matrix] | None = None
        self._made: tuple[tuple[int, float], ScalarMatrix] | None = None

    @property
    def monolithic(self) -> bool:
        """Return True if the temperature is solved together with the displacement (not collective)."""
        return self.heat.declared.coupling == "monolithic"

    def advance(self, before: float, t: float) -> None:
        """Set up the system of the step from ``before`` to ``t``; solve it if staggered."""
        self.system = self._system(before, t)
        if self.monolithic:
            self.heat.field.take(self.system.start)
        else:
            self.solve()

    def _system(self, before: float, t: float) -> HeatSystem:
        heat = self.heat
        declared = heat.declared
        dt = 0.0 if declared.duration is None else (t - before) * declared.duration
        matrix, w = self._matrix(dt), declared.theta
        T_0 = heat.field.before
        b = heat.sources(t)
        if dt:
            # A T_0 = (C / dt + w K) T_0, which determines the remaining known terms.
            stored = heat.capacity / dt * T_0
            b = w * b + stored
            if w < 1.0:
                b += (1.0 - w) * (heat.sources(before) - (matrix.product(T_0) - stored) / w)
        start = T_0.copy()
        prescribed = heat.prescribed
        start[prescribed.held] = prescribed.at(t)[prescribed.held]
        return HeatSystem(matrix, b, start, t)

    def solve(self) -> None:
        """Set the temperature to the solution of the current step."""
        self.heat.field.take(self.solution())

    def solution(self) -> Float:
        """Return the temperature that solves the system of the current step (n_owned,).

        Raises
        ------
        SolveError
            The system has no solution, or the linear solver failed.
        """
        temperature, good = self.system.matrix.solve(self.system.b, self.system.start)
        if not good:
            raise SolveError(
                f"Heat conduction found no temperature at step time {self.system.t:.6g}: a piece of the body gains "
                f"heat that nothing takes away, or the linear solver failed; prescribe a temperature or convection on "
                f"every piece, or let conduction take time."
            )
        return temperature

    def revert(self) -> None:
        """Restore the temperature of the last converged step."""
        self.heat.revert()

    def destroy(self) -> None:
        """Free the PETSc objects."""
        if self._made is not None:
            self._made[1].destroy()
            self._made = None

    def _matrix(self, dt: float) -> ScalarMatrix:
        """Return ``C / dt + w K``, cached for steps of the same length with the same bonds."""
        heat = self.heat
        broken = heat.broken
        if self._stiff is None or self._stiff[0] != broken:
            self._stiff = broken, heat.matrix()
        key = broken, dt
        if self._made is None or self._made[0] != key:
            self.destroy()
            near = self._stiff[1]
            if dt:
                stored = np.zeros(heat.body.cloud.n_local)
                stored[: heat.body.cloud.n_owned] = heat.capacity / dt
                near = scipy.sparse.csr_matrix(heat.declared.theta * near + scipy.sparse.diags(stored))
            held = heat.prescribed.held
            self._made = key, ScalarMatrix(heat.body.cloud, near, held, self._options)
        return self._made[1]
