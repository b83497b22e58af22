"""Preconditioner matrix with nearest neighbours instead of whole families."""

from __future__ import annotations

import numpy as np

from pdpetsc.arrays import Float, Mask
from pdpetsc.control.non_uniform import NonUniform
from pdpetsc.discrete.communicator import anywhere, total
from pdpetsc.discrete.families import Families
from pdpetsc.gradient.base import GradientOperator, Moduli, flat, shape_tensors, stencil_weights, whole_families
from pdpetsc.gradient.products import Entries, PointBlocks, PointProduct, Product
from pdpetsc.kernels.near import near_bonds_kernel, reach_kernel
from pdpetsc.problem.assembly import Assembler
from pdpetsc.problem.problem import Problem, Tangent

# A bond is near up to this multiple of the length of the dim-th shortest bond of either end.
REACH = 1.25
# Factor by which a near family is widened while its shape tensor is thinner than THIN, and the largest number of times.
WIDER, THIN, WIDENINGS = 1.3, 0.1, 12
# Eigenvalues of a shape tensor below this share of the largest count as zero.
LACKING = 1e-3
# Stiffness of the zero-energy control over the modulus of the body, and its smallest value over the mean one.
CONTROL, LEAST = 0.5, 1e-6


class NearAssembler(Assembler):
    """Assemble correspondence with Silling's control over nearest neighbours, with the stiffness of the whole body.

    The matrix is ``G_n^T D G_n + K_control``. ``D_i = sum_p W_p A_p`` sums the points of particle i in the body, for
    any scheme, materials and damage. ``G_n`` is the gradient over near unbroken bonds. The coupling of a particle with
    itself alone is that of the body.

    A row has 13 blocks on a square lattice and 25 on a cubic one, for any horizon. A long wave has the same energy in
    both bodies. Energies of short waves differ by a factor that does not depend on the size of the body.

    Parameters
    ----------
    problem : Problem
        The problem.

    Notes
    -----
    Construction is collective.
    """

    def __init__(self, problem: Problem) -> None:
        cloud = problem.body.cloud
        families = near_families(problem)
        self._families = families
        stencils = whole_families(cloud, families, cloud.volume[families.neighbours])
        K = stencils.shape_tensors(cloud.x)
        self._size = np.einsum("pii->p", K)
        # The gradient is zero in directions that a family does not span.
        self._K_inverse = np.linalg.pinv(K, rcond=LACKING, hermitian=True)
        g = stencil_weights(stencils, cloud.x, self._K_inverse)
        one = np.ones(cloud.n_owned)
        self._operator = GradientOperator(stencils.owner, stencils.point_ptr, stencils.members, g, one)
        super().__init__(problem, (stencils.point_ptr, stencils.members))
        self._tangent: Tangent | None = None

    def take_tangent(self) -> Tangent:
        """Return the tangent of the last fill, and release it (not collective)."""
        assert self._tangent is not None
        tangent, self._tangent = self._tangent, None
        return tangent

    def _fill(self, tangent: Tangent, entries: Entries) -> Tangent:
        """Add the rows of near families; return the tangent of the near body."""
        self._tangent = tangent
        D = tangent.stiffness()
        near: list[Product] = [PointProduct(self._operator, Moduli(D)), self._control(D)]
        for product in near:
            product.add_rows(entries)
        own = [] if tangent.blocks is None else [PointBlocks(tangent.blocks)]
        return Tangent(self.problem.body, [*near, *own])

    def _control(self, D: Float) -> NonUniform:
        """Build the control with a stiffness like that of the body (collective)."""
        cloud, dim = self.problem.body.cloud, self.problem.dim
        modulus = np.einsum("piikk->p", D) / dim**2
        sums = total(cloud.comm, [modulus.sum(), float(len(modulus))])
        modulus = np.maximum(modulus, max(LEAST * float(sums[0] / sums[1]), float(np.finfo(float).tiny)))
        factor = CONTROL * modulus / np.where(self._size > 0.0, self._size, 1.0)
        stiffness = factor[self._families.centres] * cloud.volume[self._families.neighbours]
        return NonUniform(cloud, self._families, stiffness, self._K_inverse / factor[:, None, None])


def near_families(problem: Problem) -> Families:
    """Return the bonds of the own particles to near neighbours, symmetric in both ends (collective).

    A bond is near if it is within the reach of one end, 1.25 times the length of its ``dim``-th shortest bond. The
    reach is increased if the near neighbours lie in a plane or on a line. Broken bonds do not count.
    """
    cloud, families, dim, damage = problem.body.cloud, problem.body.families, problem.dim, problem.bond_damage
    kept = np.ones(len(families.neighbours), dtype=bool) if damage is None else damage.bonds.intact
    reach = np.zeros(cloud.n_local)
    reach_kernel(dim, dim)(families.indptr, families.neighbours, kept, cloud.x, reach[: cloud.n_owned])
    reach *= REACH
    whole = np.diff(families.chosen(kept).indptr)
    for _ in range(WIDENINGS):
        near = _within(problem, kept, reach)
        thin = flat(shape_tensors(near, cloud.volume[near.neighbours], cloud.x), THIN)
        thin &= np.diff(near.indptr) < whole
        if not anywhere(cloud.comm, thin):
            break
        reach[: cloud.n_owned][thin] *= WIDER
    return near


def _within(problem: Problem, kept: Mask, reach: Float) -> Families:
    """Return the kept bonds within the reach of an end; the reach of own particles is the input (collective)."""
    cloud, families = problem.body.cloud, problem.body.families
    cloud.halo.forward(reach)
    near = np.empty(len(kept), dtype=bool)
    near_bonds_kernel(problem.dim)(families.indptr, families.neighbours, kept, cloud.x, reach, near)
    return families.chosen(near)
