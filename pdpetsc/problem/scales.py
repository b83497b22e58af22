"""The units in which PETSc sees a body: numbers near one, whatever the units of the case."""

from __future__ import annotations

import math
from dataclasses import dataclass

from pdpetsc.arrays import Float
from pdpetsc.discrete.communicator import total
from pdpetsc.kernels.sparsity import nearest_neighbours
from pdpetsc.problem.body import Body
from pdpetsc.problem.material_term import MaterialTerm


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


def scales_of(body: Body, material_term: MaterialTerm) -> Scales:
    """Return the scales of a body (collective)."""
    cloud = body.cloud
    length = float(total(cloud.comm, float(nearest_distances(body).sum()))) / cloud.n_global
    return Scales(_power_of_two(length), _power_of_two(stiffness_scale(body, material_term)))


def stiffness_scale(body: Body, material_term: MaterialTerm) -> float:
    """Return a typical diagonal of the tangent, ``kappa V / horizon^2``, largest of the materials (collective)."""
    cloud = body.cloud
    each = cloud.volume[: cloud.n_owned] / cloud.local_horizon[: cloud.n_owned] ** 2
    return material_term.kappa * float(total(cloud.comm, each.sum())) / cloud.n_global


def nearest_distances(body: Body) -> Float:
    """Return the distance of each own particle to its nearest neighbour (n_owned,) [length]; the horizon without one.

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
