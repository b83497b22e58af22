"""Heat conduction before the equilibrium of every load step."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from scipy.sparse import csr_matrix, diags

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


def no_temperature(t: float) -> SolveError:
    """Return the error of a step time that has no temperature."""
    return SolveError(
        f"Heat conduction found no temperature at step time {t:.6g}: a piece of the body gains heat that nothing takes "
        f"away, or the linear solver failed; prescribe a temperature or convection on every piece, or let conduction "
        f"take time."
    )


class StaggeredHeat:
    """The temperature of each load step, ``C (T - T_0) / dt + K (w T + (1 - w) T_0) = w Q + (1 - w) Q_0``.

    ``w`` is 1 for the backward Euler rule and 1/2 for Crank and Nicolson's; without a duration it is ``K T = Q``. ``K``
    is that of the bonds that the step begins with.

    Parameters
    ----------
    heat : Heat
        What flows, what is stored, what enters.
    options : Options
        PETSc's of the run.

    Notes
    -----
    Construction and every method are collective. Call ``destroy`` before MPI ends.
    """

    monolithic = False

    def __init__(self, heat: Heat, options: Options) -> None:
        self.heat = heat
        self.iterations = 0
        self._options = options
        self._stiff: tuple[int, csr_matrix] | None = None
        self._made: tuple[tuple[int, float], ScalarMatrix] | None = None

    def advance(self, before: float, t: float) -> None:
        """Go from the temperature of step time ``before`` to that of ``t``."""
        self.solve(self.system(before, t))

    def system(self, before: float, t: float) -> HeatSystem:
        """Return what the temperature of step time ``t`` solves, after that of ``before``."""
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

    def solve(self, system: HeatSystem) -> None:
        """Find the temperature of a step and take it."""
        found, self.iterations, good = system.matrix.solve(system.b, system.start)
        if not good:
            raise no_temperature(system.t)
        self.heat.field.take(found)

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
                near = csr_matrix(heat.declared.theta * near + diags(stored))
            held = heat.prescribed.held
            self._made = key, ScalarMatrix(heat.body.cloud, near, held, self._options)
        return self._made[1]

    def temperature(self) -> Float:
        """Return that of the present step (n_owned,) (not collective)."""
        return self.heat.field.now


class MonolithicHeat(StaggeredHeat):
    """The temperature of each load step as an unknown of Newton's method beside the displacement.

    Attributes
    ----------
    sought : HeatSystem or None
        What the temperature of the present step solves.
    """

    monolithic = True

    def __init__(self, heat: Heat, options: Options) -> None:
        super().__init__(heat, options)
        self.sought: HeatSystem | None = None

    def advance(self, before: float, t: float) -> None:
        """Say what the temperature of step time ``t`` solves; it begins with that of ``before``."""
        self.sought = self.system(before, t)
        self.heat.field.take(self.sought.start)
