"""Nearest neighbours in place of wide families: a small matrix that preconditions the tangent of a body."""

from __future__ import annotations

import numpy as np

from pdpetsc.arrays import Float, GlobalIndex, LocalIndex, Mask
from pdpetsc.discrete.communicator import total
from pdpetsc.discrete.families import Families
from pdpetsc.discrete.pattern import build_pattern
from pdpetsc.gradient.base import GradientOperator, flat, stencil_weights, whole_families
from pdpetsc.kernels.assembly import assemble_kernel
from pdpetsc.kernels.near import near_bonds_kernel, reach_kernel
from pdpetsc.kernels.pattern import transpose
from pdpetsc.kernels.tangent import gradient_times_kernel
from pdpetsc.model.assembler import Assembler
from pdpetsc.model.base import Model
from pdpetsc.model.linearised import NOTHING, Linearised
from pdpetsc.stabilisation.non_uniform import NonUniform

# Bonds are near up to this multiple of the length of the dim-th shortest one of either end.
REACH = 1.25
# A near family is widened in these steps while its shape tensor is thinner than this.
WIDER, THIN, WIDENINGS = 1.3, 0.1, 12
# Eigenvalues of a shape tensor below this share of the largest count as zero.
LACKING = 1e-3
# Stiffness of the zero-energy control over the modulus of the body, and the least of it over the mean one.
CONTROL, LEAST = 0.5, 1e-6


class NearAssembler(Assembler):
    """Plain correspondence with Silling's control over nearest neighbours, with the stiffness of the whole body.

    ``G_n^T D G_n + K_control``: ``D_i = sum_p W_p A_p`` of the points of particle i in the body, whatever its scheme,
    materials and damage, and ``G_n`` the gradient over near bonds that are not broken. On a square lattice a row has 13
    blocks and on a cubic one 25, for any horizon; a long wave has the same energy in both bodies, and the energies of
    short ones differ by a factor that does not depend on the size of the body.

    Parameters
    ----------
    model : Model
        The body.

    Attributes
    ----------
    tangent : Linearised
        The tangent of the body where the matrix was last filled.

    Notes
    -----
    Construction is collective.
    """

    def __init__(self, model: Model) -> None:
        self.model = model
        families = near_families(model)
        self._families = families
        stencils = whole_families(model.cloud, families, model.cloud.volume[families.neighbours])
        K = stencils.shape_tensors(model.cloud.x)
        self._size = np.einsum("pii->p", K)
        # In directions that a family lacks its gradient is zero.
        self._K_inverse = np.linalg.pinv(K, rcond=LACKING, hermitian=True)
        g = stencil_weights(stencils, model.cloud.x, self._K_inverse)
        one = np.ones(model.cloud.n_owned)
        self._operator = GradientOperator(stencils.owner, stencils.point_ptr, stencils.members, g, one)
        self.pattern = build_pattern(model.cloud, self._operator.point_ptr, self._operator.members)
        self._transposed = transpose(self._operator.point_ptr, self._operator.members, model.cloud.n_local)
        self._ghost = np.empty(model.dim**2 * int(self.pattern.ghost.diag_ptr[-1]))
        self._near: NearTangent | None = None

    def assemble_particles(self, u: Float, diag: Float, off: Float) -> None:
        """Write the rows of the own particles."""
        dim, pattern, near = self.model.dim, self.pattern, self._operator
        self.tangent = self.model.linearised(u)
        D = self.tangent.stiffness()
        for rows, values in ((pattern.owned, diag), (pattern.ghost, self._ghost)):
            assemble_kernel(dim)(
                rows.first, rows.diag_ptr, rows.off_ptr, rows.columns, *pattern.locals_of_columns, *self._transposed,
                near.point_ptr, near.members, near.g, near.g, near.volume, D, values, off,
            )  # fmt: skip
        pattern.complete(self._ghost, diag, off, dim)
        control = self._control(D)
        control.matrix(pattern).add(dim, diag, off)
        if pattern.border is not None:
            self._near = NearTangent(self.model, near, D, control)

    def linearised(self, u: Float) -> Linearised:
        """Return the tangent of the near body as last assembled."""
        assert self._near is not None
        return self._near

    def _control(self, D: Float) -> NonUniform:
        """Return the control with a stiffness like that of the body (collective)."""
        model, dim = self.model, self.model.dim
        modulus = np.einsum("piikk->p", D) / dim**2
        sums = total(model.cloud.comm, [modulus.sum(), float(len(modulus))])
        modulus = np.maximum(modulus, max(LEAST * float(sums[0] / sums[1]), float(np.finfo(float).tiny)))
        factor = CONTROL * modulus / np.where(self._size > 0.0, self._size, 1.0)
        stiffness = factor[self._families.centres] * model.cloud.volume[self._families.neighbours]
        return NonUniform(model.cloud, self._families, stiffness, self._K_inverse / factor[:, None, None])


class NearTangent(Linearised):
    """The tangent that a near matrix assembles, for the columns of virtual unknowns."""

    def __init__(self, model: Model, near: GradientOperator, D: Float, control: NonUniform) -> None:
        self.model = model
        self._near, self._D, self._control = near, D, control

    def forces(self, du: Float, f: Float, particles: LocalIndex) -> None:
        """Add those of the near families."""
        near = self._near
        stencils = near.points_of, near.point_ptr, near.members, near.g, near.g, near.volume
        gradient_times_kernel(self.model.dim)(particles, *stencils, self._D, *NOTHING, du, f)
        self._control.force(du, f, particles)

    def stiffness(self) -> Float:
        """Return the stiffness of the body."""
        return self._D


def near_families(model: Model) -> Families:
    """Return the bonds of the own particles to near neighbours, the same from both ends (collective).

    Near is what is within the reach of one of the ends: 1.25 times the length of its ``dim``-th shortest bond, and more
    where what is near lies in a plane or on a line. Broken bonds do not count.
    """
    cloud, families, dim = model.cloud, model.families, model.dim
    kept = np.ones(len(families.neighbours), dtype=bool) if model.failure is None else model.failure.intact
    reach = np.zeros(cloud.n_local)
    reach_kernel(dim)(families.indptr, families.neighbours, kept, cloud.x, reach[: cloud.n_owned])
    reach *= REACH
    for _ in range(WIDENINGS):
        near = _within(model, kept, reach)
        thin = flat(whole_families(cloud, near, cloud.volume[near.neighbours]).shape_tensors(cloud.x), THIN)
        thin &= np.diff(near.indptr) < _counts(families, kept)
        if int(total(cloud.comm, np.count_nonzero(thin))) == 0:
            break
        reach[: cloud.n_owned][thin] *= WIDER
    return near


def _within(model: Model, kept: Mask, reach: Float) -> Families:
    """Return the kept bonds within the reach of an end; that of the own particles counts (collective)."""
    cloud, families = model.cloud, model.families
    cloud.halo.forward(reach)
    near = np.empty(len(kept), dtype=bool)
    near_bonds_kernel(model.dim)(families.indptr, families.neighbours, kept, cloud.x, reach, near)
    indptr: GlobalIndex = np.concatenate([[0], np.cumsum(_counts(families, near))]).astype(np.int64)
    return Families(indptr, families.neighbours[near])


def _counts(families: Families, chosen: Mask) -> GlobalIndex:
    """Return how many bonds of every family are chosen (n_owned,)."""
    before = np.concatenate([[0], np.cumsum(chosen, dtype=np.int64)])
    return np.asarray(np.diff(before[families.indptr]))
