"""Soft springs on particles that have lost bonds, which keep the tangent regular while a solver iterates."""

from __future__ import annotations

import numpy as np

from pdpetsc.arrays import Float, Mask
from pdpetsc.discrete.communicator import total
from pdpetsc.gradient.products import PointBlocks, Product
from pdpetsc.problem.body import Body
from pdpetsc.problem.material_term import MaterialTerm
from pdpetsc.problem.state import State
from pdpetsc.problem.term import Term

# Stiffness of a spring over a typical diagonal of the tangent [-].
SOFT = 1e-8


class LooseSprings(Term):
    """Soft springs on particles that have lost bonds: a piece that has come free stays where it is.

    A spring, far softer than a bond, ties the particle to where it is when a solve starts. Solvers then move the
    springs with it until they have no force, and only that counts as equilibrium. Outputs leave them out.

    Parameters
    ----------
    body : Body
        Particles and bonds.
    material_term : MaterialTerm
        Whose particles may lose bonds.
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
        """Return nothing: the case does not declare them."""
        return []

    def hold(self, u: Float) -> None:
        """Hold the particles that have lost bonds where they are at unknowns ``u`` (n_rows, dim) (collective)."""
        held = self._material_term.local_damage() > 0.0
        self._anchor = u
        if int(total(self._body.cloud.comm, int(np.any(held != self._held)))):
            self.version += 1
        self._held = held
        self.active = int(total(self._body.cloud.comm, np.count_nonzero(held))) > 0

    def move(self, u: Float) -> None:
        """Move the springs so that they have no force at ``u`` (not collective)."""
        self._anchor = u

    def force(self, u: Float) -> Float:
        """Return the forces against the springs at ``u`` (n_rows, dim) [force] (not collective)."""
        return self.resistance(u - self._anchor)

    def resistance(self, du: Float) -> Float:
        """Return the forces against a change of the unknowns (n_rows, dim) [force] (not collective)."""
        f = np.zeros_like(du)
        n = len(self._held)
        f[:n] = np.where(self._held[:, None], self._each * du[:n], 0.0)
        return f

    def add_row_force(self, state: State, r: Float) -> None:
        """Add the forces of the springs."""
        if self.active:
            r += self.force(state.u)

    def linearise(self, state: State) -> list[Product]:
        """Return their stiffness."""
        if not self.active:
            return []
        return [PointBlocks(np.where(self._held, self._each, 0.0)[:, None, None] * np.eye(self._body.dim))]
