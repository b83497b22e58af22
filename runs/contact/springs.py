"""Soft springs for bodies that only contact would hold, which a case refuses."""

from dataclasses import dataclass

import numpy as np

import pdpetsc as pd


class Springs(pd.Term):
    """Springs ``k`` (n,) [force / length] in both directions on the particles of a rank."""

    energy_of = "springs"

    def __init__(self, k):
        self.k = k

    @property
    def grounded(self):
        """Return which displacements (n, 2) they hold."""
        return np.repeat(self.k[:, None] > 0.0, 2, axis=1)

    def add_row_force(self, state, r):
        r[: len(self.k)] += self.k[:, None] * state.own

    def linearise(self, state):
        return [pd.PointBlocks(self.k[:, None, None] * np.eye(2))]

    def energy(self, state):
        return 0.5 * float((self.k[:, None] * state.own**2).sum())


@dataclass(frozen=True)
class SoftSprings(pd.ExtraTerm):
    """Springs of a stiffness per volume [force / length^4]."""

    stiffness: float

    def build(self, body):
        return Springs(self.stiffness * body.cloud.volume[: body.cloud.n_owned])
