"""Springs that hold particles which have lost bonds, for solvers."""

from __future__ import annotations

import numpy as np

from pdpetsc.arrays import Float, Mask
from pdpetsc.discrete.communicator import total
from pdpetsc.problem.body import Body
from pdpetsc.problem.matter import Matter
from pdpetsc.problem.state import State
from pdpetsc.problem.term import LinearisedTerm, PointTangent, Term

# Stiffness that holds a particle which has lost bonds, over a typical one.
SOFT = 1e-8


class LooseSprings(Term):
    """A piece that has come free stays where it was: soft springs hold particles that have lost bonds.

    The force is that of a spring far softer than a bond to the place where a solve starts; it vanishes where nothing
    moves any more, and equilibrium counts only there. Outputs do not see it.

    Parameters
    ----------
    body : Body
        Particles and bonds.
    matter : Matter
        Whose particles may lose bonds.
    stiffness : float
        Typical stiffness of a particle [force / length].
    """

    of_solver = True

    def __init__(self, body: Body, matter: Matter, stiffness: float) -> None:
        self._body = body
        self._matter = matter
        self._each = SOFT * stiffness
        self._anchor = np.zeros((body.cloud.n_rows, body.dim))
        self._held: Mask = np.zeros(body.cloud.n_owned, dtype=bool)
        self.active = False

    @property
    def parts(self) -> list[str]:
        """Return nothing: they are none of the case."""
        return []

    def hold(self, u: Float) -> None:
        """Hold the particles that have lost bonds where they are at unknowns ``u`` (n_rows, dim) (collective)."""
        held = self._matter.local_damage() > 0.0
        self._anchor = u
        if int(total(self._body.cloud.comm, int(np.any(held != self._held)))):
            self.version += 1
        self._held = held
        self.active = int(total(self._body.cloud.comm, np.count_nonzero(held))) > 0

    def move(self, u: Float) -> None:
        """Let the springs have no force at ``u`` (not collective)."""
        self._anchor = u

    def force(self, u: Float) -> Float:
        """Return the forces against the springs at ``u`` (n_rows, dim) [force] (not collective)."""
        f = np.zeros_like(u)
        n = len(self._held)
        f[:n] = np.where(self._held[:, None], self._each * (u[:n] - self._anchor[:n]), 0.0)
        return f

    def add_row_force(self, state: State, r: Float) -> None:
        """Add the forces of the springs."""
        if self.active:
            r += self.force(state.u)

    def linearised(self, state: State) -> LinearisedTerm | None:
        """Return their stiffness."""
        if not self.active:
            return None
        return PointTangent(np.where(self._held, self._each, 0.0)[:, None, None] * np.eye(self._body.dim))
