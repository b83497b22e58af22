"""The units in which PETSc sees a body: numbers near one, whatever the units of the case."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

from pdpetsc.arrays import Float
from pdpetsc.discrete.communicator import total
from pdpetsc.kernels.pattern import nearest_neighbours
from pdpetsc.model import Model


@dataclass(frozen=True)
class Scales:
    """Unknowns in PETSc are displacements over ``length``, residuals forces over ``stiffness`` times ``length``.

    PETSc compares some of its numbers with absolute ones: pivots of its own factorisations, tolerances of line searches
    and Krylov methods. With these scales what it sees does not depend on the units of the case. They are powers of two,
    so that scaling rounds nothing.

    Parameters
    ----------
    length : float
        About the distance of neighbours [length].
    stiffness : float
        About the diagonal of the tangent [force / length].
    """

    length: float
    stiffness: float

    @property
    def force(self) -> float:
        """Return the force that is one in PETSc [force]."""
        return self.stiffness * self.length


def scales_of(model: Model, spacing: Float) -> Scales:
    """Return the scales of a body whose particles have nearest neighbours at ``spacing`` (any shape) (collective)."""
    comm = model.cloud.comm
    length = float(total(comm, float(spacing.sum()))) / model.cloud.n_global
    return Scales(_power_of_two(length), _power_of_two(stiffness_scale(model)))


def stiffness_scale(model: Model) -> float:
    """Return a typical diagonal of the tangent, ``kappa V / horizon^2``, largest of the materials (collective)."""
    cloud = model.cloud
    volume = float(total(cloud.comm, cloud.volume[: cloud.n_owned].sum())) / cloud.n_global
    return model.kappa * volume / cloud.horizon**2


def nearest_distances(model: Model) -> Float:
    """Return the distance of each own particle to its nearest neighbour (n_owned,) [length]; the horizon without one.

    Notes
    -----
    Not collective.
    """
    cloud, family = model.cloud, model.families
    nearest = np.full(cloud.n_owned, cloud.horizon)
    nearest_neighbours(family.indptr, family.neighbours, cloud.x, nearest)
    return nearest


def _power_of_two(value: float) -> float:
    return math.ldexp(1.0, round(math.log2(value))) if value > 0.0 and math.isfinite(value) else 1.0
