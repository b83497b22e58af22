"""Soft springs on particles that have lost bonds, which keep the tangent regular during a solve."""

from __future__ import annotations

import numpy as np

from pdpetsc.arrays import Float, Mask
from pdpetsc.discrete.communicator import anywhere
from pdpetsc.gradient.products import PointBlocks, Product
from pdpetsc.problem.body import Body
from pdpetsc.problem.material_term import MaterialTerm
from pdpetsc.problem.state import State
from pdpetsc.problem.term import Term

# Stiffness of a spring over a typical diagonal of the tangent [-].
SOFT = 1e-8


class LooseSprings(Term):
    """Hold particles that have lost bonds with soft springs, so that a detached piece stays in place.

    A spring, far softer than a bond, connects the particle to its position at the start of a solve. Solvers then move
    the springs until they have no force; only such a state is an equilibrium. Outputs do not contain the springs.

    Parameters
    ----------
    body : Body
        Particles and bonds.
    material_term : MaterialTerm
        Material whose particles may lose bonds.
    stiffness : float
        Typical stiffness of a particle [force / length].
    """

    of_solver = True

    def __init__(self, body: Body, material_term: MaterialTerm, stiffness: float) -> None:
        self._body = body
        self._material_term = material_term
        self._each = SOFT * stiffness
        self._anchor = np.zeros((body.cloud.n_rows, body.dim))
        self._held: Mask = np.zeros(body.cloud.n_owned, dtype=bool)
        self.active = False

    @property
    def parts(self) -> list[str]:
        """Return an empty list: the case does not declare the springs."""
        return []

    def hold(self, u: Float) -> None:
        """Hold the particles that have lost bonds at their positions at unknowns ``u`` (n_rows, dim) (collective)."""
        held = self._material_term.local_damage() > 0.0
        self._anchor = u
        if anywhere(self._body.cloud.comm, held != self._held):
            self.version += 1
        self._held = held
        self.active = anywhere(self._body.cloud.comm, held)

    def move(self, u: Float) -> None:
        """Move the springs so that they have no force at ``u`` (not collective)."""
        self._anchor = u

    def force(self, u: Float) -> Float:
        """Compute the restoring forces of the springs at ``u``, as residual (n_rows, dim) [force] (not collective)."""
        return self.resistance(u - self._anchor)

    def resistance(self, du: Float) -> Float:
        """Compute the forces against a change of the unknowns, as residual (n_rows, dim) [force] (not collective)."""
        f = np.zeros_like(du)
        n = len(self._held)
        f[:n] = np.where(self._held[:, None], self._each * du[:n], 0.0)
        return f

    def add_row_force(self, state: State, r: Float) -> None:
        """Add the forces of the springs."""
        if self.active:
            r += self.force(state.u)

    def linearise(self, state: State) -> list[Product]:
        """Return the stiffness of the springs."""
        if not self.active:
            return []
        return [PointBlocks(np.where(self._held, self._each, 0.0)[:, None, None] * np.eye(self._body.dim))]
