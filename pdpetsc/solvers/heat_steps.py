"""Heat conduction in every load step: before the equilibrium, or as unknowns beside the displacement."""

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
    """What the temperature of a load step solves, ``A T = b``.

    Attributes
    ----------
    matrix : ScalarMatrix
        A.
    b : (n_owned,) float64
        [power]
    start : (n_owned,) float64
        The temperature before, with what conditions prescribe.
    t : float
        Step time [-].
    """

    matrix: ScalarMatrix
    b: Float
    start: Float
    t: float


class HeatSteps:
    """The temperature of each load step, ``C (T - T_0) / dt + K (w T + (1 - w) T_0) = w Q + (1 - w) Q_0``.

    ``w`` is 1 for the backward Euler rule and 1/2 for Crank and Nicolson's; without a duration it is ``K T = Q``. ``K``
    is that of the bonds that the step begins with. Staggered, the temperature is solved for before the equilibrium;
    monolithic, it is an unknown of Newton's method beside the displacement (``MonolithicSolver``).

    Parameters
    ----------
    heat : Heat
        What flows, what is stored, what enters.
    options : Options
        PETSc's of the run.

    Attributes
    ----------
    system : HeatSystem or None
        The system of the present load step.

    Notes
    -----
    Construction and every method are collective. Call ``destroy`` before MPI ends.
    """

    def __init__(self, heat: Heat, options: Options) -> None:
        self.heat = heat
        self.system: HeatSystem | None = None
        self._options = options
        self._stiff: tuple[int, scipy.sparse.csr_matrix] | None = None
        self._made: tuple[tuple[int, float], ScalarMatrix] | None = None

    @property
    def monolithic(self) -> bool:
        """Return True if the temperature is solved for together with the displacement (not collective)."""
        return self.heat.declared.coupling == "monolithic"

    def advance(self, before: float, t: float) -> None:
        """Set up the system of the step from ``before`` to ``t``; staggered, go to its solution."""
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
            # A T_0 = (C / dt + w K) T_0, of which the rest of what is known follows.
            stored = heat.capacity / dt * T_0
            b = w * b + stored
            if w < 1.0:
                b += (1.0 - w) * (heat.sources(before) - (matrix.product(T_0) - stored) / w)
        start = T_0.copy()
        prescribed = heat.prescribed
        start[prescribed.held] = prescribed.at(t)[prescribed.held]
        return HeatSystem(matrix, b, start, t)

    def solve(self) -> None:
        """Go to the temperature of the present step."""
        self.heat.field.take(self.solution())

    def solution(self) -> Float:
        """Return the temperature that the system of the present step has for itself (n_owned,).

        Raises
        ------
        SolveError
            The system has no solution, or the linear solver failed.
        """
        assert self.system is not None
        temperature, good = self.system.matrix.solve(self.system.b, self.system.start)
        if not good:
            raise SolveError(
                f"Heat conduction found no temperature at step time {self.system.t:.6g}: a piece of the body gains "
                f"heat that nothing takes away, or the linear solver failed; prescribe a temperature or convection on "
                f"every piece, or let conduction take time."
            )
        return temperature

    def revert(self) -> None:
        """Go back to the temperature of the last converged step."""
        self.heat.revert()

    def destroy(self) -> None:
        """Free the PETSc objects."""
        if self._made is not None:
            self._made[1].destroy()
            self._made = None

    def _matrix(self, dt: float) -> ScalarMatrix:
        """Return ``C / dt + w K``, made once for all steps as long and with the same bonds."""
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
