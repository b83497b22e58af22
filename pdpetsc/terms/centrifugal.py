"""Centrifugal force of a body that spins."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from pdpetsc.arrays import Float
from pdpetsc.declare.conditions import Centrifugal, evaluated
from pdpetsc.discrete.communicator import total
from pdpetsc.errors import CaseError, case_errors
from pdpetsc.gradient.products import PointBlocks, Product
from pdpetsc.problem.body import Body
from pdpetsc.problem.state import State
from pdpetsc.terms.following_load import FollowingLoad


class CentrifugalForce(FollowingLoad):
    """Apply ``f_i = m_i w^2 P (x_i + u_i - c)`` to particles of mass ``m_i``.

    Parameters
    ----------
    body : Body
        Particles and bonds.
    declared : Centrifugal
        Declared force.
    mass : (n_owned,) float64
        Masses of the particles that it acts on, 0 for others [mass].
    name : str
        Name of the condition in messages.

    Raises
    ------
    CaseError
        The point or the axis has another number of components.

    Notes
    -----
    Construction is collective, the methods are not.
    """

    def __init__(self, body: Body, declared: Centrifugal, mass: Float, name: str) -> None:
        dim = body.dim
        if len(declared.about) != dim:
            raise CaseError(f"{name} has an axis through a point of {len(declared.about)} numbers; give {dim}.")
        axis = np.asarray(declared.axis, dtype=float)
        if dim == 3 and (axis.shape != (3,) or not np.linalg.norm(axis) > 0.0):
            raise CaseError(f"{name} has no direction as axis; give three numbers.")
        self._P = np.eye(dim) - (np.outer(axis, axis) / (axis @ axis) if dim == 3 else 0.0)
        self._declared, self._mass = declared, mass
        self._arm = (body.cloud.x[: body.cloud.n_owned] - np.asarray(declared.about, dtype=float)) @ self._P
        with case_errors():
            force = total(body.cloud.comm, self._squared(1.0) * (mass @ self._arm))
        super().__init__(name, force)

    def _squared(self, t: float) -> float:
        """Return ``w^2`` [1 / time^2]."""
        factor = evaluated("schedule of a Centrifugal condition", self._declared.schedule, (), t, t)
        return float(self._declared.speed * factor) ** 2

    def add_row_force(self, state: State, r: Float) -> None:
        n = len(self._mass)
        r[:n] -= (self._squared(state.t) * self._mass)[:, None] * (self._arm + state.u[:n] @ self._P)

    def linearise(self, state: State) -> Sequence[Product]:
        """Return minus ``m_i w^2 P``."""
        return [PointBlocks(-(self._squared(state.t) * self._mass)[:, None, None] * self._P)]
