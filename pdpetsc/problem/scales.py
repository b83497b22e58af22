"""Scales of the unknowns and residuals that PETSc receives, independent of the units of the case."""

from __future__ import annotations

import math
from dataclasses import dataclass

from pdpetsc.arrays import Float, GlobalIndex, Mask
from pdpetsc.discrete.communicator import largest, total
from pdpetsc.kernels.sparsity import nearest_neighbours
from pdpetsc.problem.body import Body
from pdpetsc.problem.material_term import MaterialTerm


@dataclass(frozen=True)
class Scales:
    """Scale unknowns and residuals for PETSc: displacements by ``length``, residuals by ``stiffness * length``.

    PETSc compares some numbers with absolute ones: pivots of its factorisations, tolerances of line searches and Krylov
    methods. With these scales they do not depend on the units of the case. The scales are powers of two, so that
    scaling causes no rounding.

    Parameters
    ----------
    length : float
        Approximate distance of neighbours [length].
    stiffness : float
        Approximate diagonal of the tangent [force / length].
    """

    length: float
    stiffness: float

    @property
    def force(self) -> float:
        """Return the unit of force in PETSc [force]."""
        return self.stiffness * self.length


def scales_of(body: Body, material_term: MaterialTerm) -> Scales:
    """Compute the scales of a body (collective)."""
    return Scales(_power_of_two(mean_spacing(body)), _power_of_two(stiffness_scale(body, material_term)))


def stiffness_scale(body: Body, material_term: MaterialTerm) -> float:
    """Compute a typical diagonal of the tangent, ``kappa V / horizon^2``, of the stiffest material (collective)."""
    cloud = body.cloud
    each = cloud.volume[: cloud.n_owned] / cloud.local_horizon[: cloud.n_owned] ** 2
    return largest(cloud.comm, material_term.kappa) * float(total(cloud.comm, each.sum())) / cloud.n_global


def mean_spacing(body: Body, chosen: Mask | GlobalIndex | slice = slice(None)) -> float:
    """Compute the mean distance of chosen own particles to their nearest neighbours [length] (collective)."""
    nearest = nearest_distances(body)[chosen]
    distance, count = total(body.cloud.comm, [float(nearest.sum()), float(len(nearest))])
    return float(distance / count)


def nearest_distances(body: Body) -> Float:
    """Compute the distance of each own particle to its nearest neighbour (n_owned,) [length].

    The horizon for a particle without neighbours.

    Notes
    -----
    Not collective.
    """
    cloud, family, lattice = body.cloud, body.families, body.families.lattice
    nearest = cloud.local_horizon[: cloud.n_owned].copy()
    if lattice is None:
        nearest_neighbours(family.indptr, family.neighbours, cloud.x, nearest)
        return nearest
    irregular = lattice.irregular
    near = irregular.cloud.local_horizon[: irregular.cloud.n_owned].copy()
    nearest_neighbours(irregular.indptr, irregular.neighbours, irregular.cloud.x, near)
    nearest[lattice.shared] = lattice.of_shared(near[irregular.n :])
    nearest[irregular.local[: irregular.n]] = near[: irregular.n]
    return nearest


def _power_of_two(value: float) -> float:
    return math.ldexp(1.0, round(math.log2(value))) if value > 0.0 and math.isfinite(value) else 1.0
