"""Correspondence with one dilatation for each patch of particles."""

from __future__ import annotations

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np
import scipy

from pdpetsc.arrays import Float, GlobalIndex, LocalIndex, Mask, row_of_entries
from pdpetsc.control.by_shear import twice_shear
from pdpetsc.discrete.communicator import agreed
from pdpetsc.discrete.families import Families
from pdpetsc.discrete.sparsity import sharing_stencil
from pdpetsc.errors import CaseError
from pdpetsc.gradient.axes import body_axes
from pdpetsc.gradient.base import GradientOperator, Moduli, Patches, Scheme, StencilMembers
from pdpetsc.gradient.mean_dilatation import boxes
from pdpetsc.gradient.products import ConstraintProduct, PointProduct, Product, RankOneProduct
from pdpetsc.kernels.gradient import determinant_kernel
from pdpetsc.kernels.sparsity import sum_by
from pdpetsc.material.base import Material
from pdpetsc.problem.body import Body
from pdpetsc.problem.state import State
from pdpetsc.terms.material_points import MaterialPoints

# Moduli of one material with a larger ratio, without intermediate values, are separated by a jump.
JUMP = 1.5
# Stiffness of a softened patch against its mean dilatation, over twice the shear modulus.
SOFTER = 1.0
# Smallest value of that stiffness, as a share.
LEAST = 1e-12


class Shared(NamedTuple):
    """Store gradient points at a state, with the dilatations of their patches.

    Attributes
    ----------
    F, F_bar : (n_points, dim, dim) float64
        Gradients of the points, and gradients for the material [-].
    missing : (n_points,) float64
        ``<theta> - theta`` [-].
    """

    F: Float
    F_bar: Float
    missing: Float


class Response(NamedTuple):
    """Store the response of a material to shared dilatations.

    Attributes
    ----------
    P_bar, P : (n_points, dim, dim) float64
        Stress at ``F_bar``, and stress of the forces [stress].
    lacking : (n_points,) float64
        ``<r> - r`` [stress].
    """

    P_bar: Float
    P: Float
    lacking: Float


class PatchPoints(MaterialPoints):
    """Compute internal forces with one dilatation for each patch of particles (``gradient.mean_dilatation``).

    The dilatation is that of the elastic part, without the stress-free deformation.

    With vectors ``b = <F^-T g>`` and ``s`` of the same kind on the particles of a patch, the tangent has two parts. The
    first is that of points with fixed mean dilatation. The second is ``W (s (x) b + b (x) s + k b (x) b)`` of every
    patch.

    Parameters
    ----------
    body, operator, materials, material_of, factor
        As for ``MaterialPoints``.
    patches : Patches
        Points that share a dilatation.

    Attributes
    ----------
    rest : (n_points,) float64
        Stiffness against the rest of the dilatation, ``2 share mu`` [stress].
    weight : (n_points,) float64
        Share of each point in the volume of its patch [-].
    patches : StencilMembers
        Particles of every patch with their families. The owner is first, and again among the others.

    Raises
    ------
    CaseError
        The body is a bar or in plane stress; raised on every rank.

    Notes
    -----
    Construction is collective.
    """

    horizons = 3
    constrained = True

    def __init__(
        self, body: Body, operator: GradientOperator, materials: Sequence[Material], material_of: LocalIndex,
        factor: Float | None, patches: Patches,
    ) -> None:  # fmt: skip
        super().__init__(body, operator, materials, material_of, factor)
        cloud, dim = body.cloud, body.dim
        with agreed(cloud.comm):
            if dim == 1 or (dim == 2 and any(material.plane == "stress" for material in materials)):
                raise CaseError(
                    "MeanDilatation is for solids and plane strain; a bar, or a plane without stress across it, "
                    "changes its section as it likes and needs no patches: take the scheme alone."
                )
        self.twice_shear = np.empty(operator.n_points)
        for one in self.materials:
            twice = twice_shear(one.material.moduli(dim))
            self.twice_shear[one.points] = twice if one.factor is None else twice * one.factor
        self.rest = patches.share * self.twice_shear
        axes, _ = body_axes(cloud, body.families, body.families.bonds(cloud.x))
        grid = boxes(cloud.comm, cloud.x[: cloud.n_owned] @ axes.T, patches.edge)
        keys = np.column_stack([grid, material_of])
        if factor is not None:
            keys = np.column_stack([keys, _apart(keys, factor)])
        self._gather(_pieces(body.families, keys))

    def _gather(self, patch_of: GlobalIndex) -> None:
        """Set up the patches of the own particles (n_owned,)."""
        cloud, operator = self.body.cloud, self.operator
        n, own = cloud.n_owned, np.arange(cloud.n_owned)
        # Families with ghosts are processed after the ghosts arrive, and before the last families without ghosts: a
        # patch belongs to the last of its particles.
        late = self.body.families.with_any(np.arange(cloud.n_local) >= n)
        last = np.full(int(patch_of.max(initial=-1)) + 1, -1)
        np.maximum.at(last, patch_of, own + n * late)
        owner = last % n if n else last
        order = np.argsort(owner)
        number = np.empty(len(order), dtype=np.int64)
        number[order] = np.arange(len(order))
        self.patch_of_point = number[patch_of][operator.owner]
        patch_owner = owner[order].astype(np.int32)
        self._n_patches = len(order)
        self.weight = operator.volume / self._sum(operator.volume)[self.patch_of_point]
        point_of = row_of_entries(operator.point_ptr)
        pairs = self.patch_of_point[point_of] * cloud.n_local + operator.members
        kept, self._slot = np.unique(pairs, return_inverse=True)
        patch, member = np.divmod(kept, max(cloud.n_local, 1))
        ptr = np.searchsorted(patch, np.arange(len(order) + 1)).astype(np.int64)
        # The owner comes first, with a zero vector, as the centre of a point does.
        self._front = ptr[:-1]
        members = np.insert(member, self._front, patch_owner).astype(np.int32)
        self.patches = StencilMembers(patch_owner, ptr + np.arange(len(ptr)), members)
        self._point_of_entry = point_of

    @property
    def stencils(self) -> tuple[GlobalIndex, LocalIndex] | None:
        """Return the particles of patches with their families."""
        return self.patches.point_ptr, self.patches.members

    within_families = False

    def dependents(self, marked: Float) -> Mask:
        """Return the own particles that share a patch with a marked local particle (collective)."""
        return sharing_stencil(self.body.cloud, self.patches.point_ptr, self.patches.members, marked)

    def shared(self, state: State) -> Shared:
        """Compute the gradients at an admissible state, with the dilatations of patches."""
        F = self.point_gradient(state)
        return state.kept(("shared", id(self.operator)), lambda: self._share(state, F, self.weight))

    def shared_at(self, state: State, F: Float, volume: Float) -> Shared:
        """Compute gradients F with the dilatations of patches, for points with other volumes (n_points,)."""
        return self._share(state, F, volume / self._sum(volume)[self.patch_of_point])

    def _share(self, state: State, F: Float, weight: Float) -> Shared:
        """Compute gradients of all points with the elastic dilatations of patches, weighted per point (n_points,)."""
        dim = self.body.dim
        theta = np.einsum("pii->p", F) - dim if self._linear else np.log(np.linalg.det(F))
        if state.expansion is not None:
            theta -= self._free_dilatation(state.expansion.strain[self.operator.owner])
        missing = self._sum(weight * theta)[self.patch_of_point] - theta
        if self._linear:
            F_bar = F + missing[:, None, None] / dim * np.eye(dim)
        else:
            F_bar = np.exp(missing / dim)[:, None, None] * F
        return Shared(F, F_bar, missing)

    def response(self, state: State) -> Response:
        """Compute the stresses at an admissible state."""

        def make() -> Response:
            return self.respond(state, self.laws(state).stress(self.shared(state).F_bar), self.rest)

        return state.kept(("response", id(self.operator), self.version), make)

    def respond(self, state: State, P_bar: Float, rest: Float) -> Response:
        """Compute the stresses at a state from those at ``F_bar`` (n_points, dim, dim) and the stiffness ``rest``."""
        F, F_bar, missing = self.shared(state)
        r = self.conjugate(F_bar, P_bar, rest * missing)
        lacking = self._sum(self.weight * r)[self.patch_of_point] - r
        scale, by_F = self.dilatation_by_F(F, missing)
        return Response(P_bar, scale[:, None, None] * P_bar + lacking[:, None, None] * by_F, lacking)

    def conjugate(self, F_bar: Float, P_bar: Float, rest: Float) -> Float:
        """Compute the derivative r of the energy density by ``<theta> - theta`` (n,) at constant F [stress].

        ``rest`` (n,) is the contribution of the stiffness against the rest of the dilatation.
        """
        work = np.einsum("pii->p", P_bar) if self._linear else np.einsum("pij,pij->p", P_bar, F_bar)
        return np.asarray(work / self.body.dim + rest)

    def dilatation_by_F(self, F: Float, missing: Float) -> tuple[Float, Float]:
        """Return ``F_bar / F`` (n,), 1 if linear, and the derivative of ``theta`` by F (n, dim, dim)."""
        if self._linear:
            return np.ones(len(F)), np.broadcast_to(np.eye(self.body.dim), F.shape)
        return np.exp(missing / self.body.dim), np.swapaxes(np.linalg.inv(F), 1, 2)

    def deformation(self, state: State) -> Float:
        """Return ``F_bar`` (n_points, dim, dim) [-], the gradient for materials."""
        return self.shared(state).F_bar

    def point_gradient(self, state: State) -> Float:
        """Return F of the points (n_points, dim, dim) [-]; materials use ``deformation``."""
        return super().deformation(state)

    def stress(self, state: State) -> Float:
        """Return the stress of the forces (n_points, dim, dim) [stress]."""
        return self.response(state).P

    def point_energy(self, state: State) -> Float:
        """Compute ``psi_p + share mu (<theta> - theta_p)^2`` (n_points,) [energy / volume]."""
        return np.asarray(super().point_energy(state) + 0.5 * self.rest * self.shared(state).missing ** 2)

    def energy_at(self, state: State, F: Float, volume: Float) -> Float:
        """Compute the energy density of all points (n_points,) at other gradients F and volumes (n_points,)."""
        shared = self.shared_at(state, F, volume)
        return np.asarray(self.laws(state).energy(shared.F_bar) + 0.5 * self.rest * shared.missing**2)

    def energy_by_strain(self, state: State) -> Float:
        """Compute the derivative of the energy density by the eigenstrain at constant F (n_points, 3, 3)."""
        assert state.expansion is not None
        S, one = super().energy_by_strain(state), np.eye(3)
        slope = one if self._linear else np.linalg.inv(one + state.expansion.strain[self.operator.owner])
        return np.asarray(S - self.response(state).lacking[:, None, None] * slope)

    def _free_dilatation(self, strain: Float) -> Float:
        """Compute the stress-free dilatation (n_points,) [-] of eigenstrains (n_points, 3, 3)."""
        return np.asarray(np.einsum("pii->p", strain) if self._linear else np.log(np.linalg.det(np.eye(3) + strain)))

    def admissible(self, state: State) -> bool:
        """Return True if ``det F > 0`` at all points, unless all materials are linear, and materials are defined."""
        F, _ = self.point_gradient(state), self.laws(state)  # collective: compute it on every rank
        if not self._linear and not determinant_kernel(self.body.dim)(F) > 0.0:
            return False
        return super().admissible(state)

    def linearise(self, state: State) -> list[Product]:
        """Return the tangent of points with fixed mean dilatation, and those of the patches."""
        return self.products(state, self.response(state), self.laws(state).moduli(self.shared(state).F_bar), self.rest)

    def products(
        self, state: State, response: Response, moduli: Float, rest: Float,
        own: tuple[GlobalIndex, Float] | None = None,
    ) -> list[Product]:  # fmt: skip
        """Return the tangent of a response whose stress at ``F_bar`` has moduli (n_points, dim, dim, dim, dim).

        ``own`` are some points with additional moduli at their own gradient.
        """
        dim, linear = self.body.dim, self._linear
        F, _, missing = self.shared(state)
        P_bar, _, lacking = response
        scale, B = self.dilatation_by_F(F, missing)
        seen = np.broadcast_to(np.eye(dim), F.shape) if linear else F
        A = moduli * (scale**2)[:, None, None, None, None]
        right, left = np.einsum("pimkn,pkn->pim", A, seen), np.einsum("pim,pimkn->pkn", seen, A)
        if not linear:
            right += scale[:, None, None] * P_bar
            left += scale[:, None, None] * P_bar
        k = np.einsum("pim,pim->p", left, seen) / dim**2 + rest
        A -= np.einsum("pim,pkn->pimkn", right / dim, B) + np.einsum("pim,pkn->pimkn", B, left / dim)
        A += np.einsum("p,pim,pkn->pimkn", k, B, B)
        if not linear:
            A -= np.einsum("p,pin,pkm->pimkn", lacking, B, B)
        if own is not None:
            A[own[0]] += own[1]
        w, volume = self.weight, self._sum(self.operator.volume)
        b = self.vectors(w[:, None, None] * B)
        s_right = self.vectors(w[:, None, None] * (right / dim - k[:, None, None] * B))
        s_left = self.vectors(w[:, None, None] * (left / dim - k[:, None, None] * B))
        stiff = self._sum(w * k)
        # A softened patch resists its mean dilatation like shear.
        shear = SOFTER * self._sum(w * self.twice_shear)
        soft = np.clip(stiff, LEAST * shear, shear)
        s_left += np.repeat(soft, np.diff(self.patches.point_ptr))[:, None] * b
        patches = self.patches, self.body.cloud.n_owned
        return [
            PointProduct(self.operator, Moduli(A)),
            RankOneProduct(*patches, s_right, b, volume),
            RankOneProduct(*patches, b, s_left, volume),
            ConstraintProduct(*patches, b, volume * (stiff - soft), volume * soft),
        ]

    def cauchy_stress(self, state: State) -> Float:
        """Compute the mean of ``P F^T / det F`` (n_owned, dim, dim) [stress]; of P if linear."""
        P, F = self.response(state).P, self.shared(state).F
        if self._linear:
            return self.mean_stress(P)
        return self.mean_stress(np.einsum("pik,pjk->pij", P, F) / np.linalg.det(F)[:, None, None])

    def vectors(self, weighted: Float) -> Float:
        """Compute ``sum_p w_p B_p g_pk`` on the entries of patches (n_entries, dim) for tensors ``w B`` of points."""
        of = self._point_of_entry
        each = np.einsum("eim,em->ei", weighted[of], self.operator.g)
        sums = sum_by(self._slot, each, len(self.patches.members) - len(self._front))
        return np.asarray(np.insert(sums, self._front, 0.0, axis=0))

    def _sum(self, values: Float) -> Float:
        """Sum over the points of patches (n_patches,)."""
        return np.asarray(np.bincount(self.patch_of_point, values, self._n_patches))


def material_points(
    scheme: Scheme, body: Body, operator: GradientOperator, materials: Sequence[Material], material_of: LocalIndex,
    factor: Float | None = None,
) -> MaterialPoints:  # fmt: skip
    """Build the term of materials at the points of a scheme, with shared dilatations if declared (collective)."""
    if scheme.patches is None:
        return MaterialPoints(body, operator, materials, material_of, factor)
    return PatchPoints(body, operator, materials, material_of, factor, scheme.patches)


def _apart(keys: GlobalIndex, factor: Float) -> GlobalIndex:
    """Return numbers (n,) that differ between particles with equal keys (n, k) whose moduli are separated by a jump.

    Parameters
    ----------
    factor : (n,) float64
        Factor on the moduli of each particle [-].
    """
    size = np.log(factor)
    order = np.lexsort([size, *keys.T])
    new = np.zeros(len(order), dtype=np.int64)
    gap = np.diff(size[order]) > np.log(JUMP)
    new[1:] = gap | np.any(np.diff(keys[order], axis=0), axis=1)
    found = np.empty(len(order), dtype=np.int64)
    found[order] = np.cumsum(new)
    return found


def _pieces(families: Families, box: GlobalIndex) -> GlobalIndex:
    """Return the patch of each own particle (n_owned,): particles of one box that bonds inside the box connect.

    Parameters
    ----------
    families : Families
        Bonds, without those cut by cracks.
    box : (n_owned, any) int64
        Numbers of the box of each own particle, and of its material; a rank has all particles of its boxes.
    """
    n = len(box)
    number = np.asarray(np.unique(box, axis=0, return_inverse=True)[1]).ravel()
    a, b = families.centres, families.neighbours
    own = np.flatnonzero(b < n)
    inside = own[number[a[own]] == number[b[own]]]
    graph = scipy.sparse.csr_array((np.ones(len(inside), dtype=np.int8), (a[inside], b[inside])), shape=(n, n))
    return np.asarray(scipy.sparse.csgraph.connected_components(graph, directed=False)[1], dtype=np.int64)
