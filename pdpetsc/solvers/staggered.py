"""Heat conduction before the equilibrium of every load step."""

from __future__ import annotations

import numpy as np
from scipy.sparse import csr_matrix, diags

from pdpetsc.arrays import Float
from pdpetsc.errors import SolveError
from pdpetsc.petsc.conduction import ScalarMatrix
from pdpetsc.petsc.options import Options
from pdpetsc.terms.heat import Heat


class HeatMarch:
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

    def __init__(self, heat: Heat, options: Options) -> None:
        self.heat = heat
        self.iterations = 0
        self._options = options
        self._stiff: tuple[int, csr_matrix] | None = None
        self._made: tuple[tuple[int, float], ScalarMatrix] | None = None

    def advance(self, before: float, t: float) -> None:
        """Go from the temperature of step time ``before`` to that of ``t``."""
        heat = self.heat
        declared, field = heat.declared, heat.field
        dt = 0.0 if declared.duration is None else (t - before) * declared.duration
        matrix, w = self._matrix(dt), declared.theta
        T_0 = field.before
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
        found, self.iterations, good = matrix.solve(b, start)
        if not good:
            raise SolveError(
                f"Heat conduction found no temperature at step time {t:.6g}: a piece of the body gains heat that "
                f"nothing takes away, or the linear solver failed; prescribe a temperature or convection on every "
                f"piece, or let conduction take time."
            )
        field.take(found)

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
