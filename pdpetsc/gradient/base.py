"""The sparse gradient operator of correspondence schemes, and functions to build it."""

from __future__ import annotations

import copy
from abc import ABC, abstractmethod
from collections.abc import Callable
from dataclasses import dataclass, replace
from functools import cached_property
from typing import ClassVar

import numpy as np

from pdpetsc.arrays import Float, GlobalIndex, LocalIndex, Mask, entries_of
from pdpetsc.declared import Declared
from pdpetsc.discrete.cloud import Cloud
from pdpetsc.discrete.families import Families
from pdpetsc.errors import FlatFamilies
from pdpetsc.gradient.shared_steps import SAME, shared_steps
from pdpetsc.kernels.gradient import divergence_kernel, gradient_kernel, inverses, shape_kernel, weights_kernel
from pdpetsc.kernels.point_blocks import gradient_blocks_kernel
from pdpetsc.kernels.sparsity import sum_by, transpose
from pdpetsc.kernels.tangent import NO_CONTROL, gradient_times_kernel, same_gradient_kernel

# A family is flat if the smallest eigenvalue of its shape tensor is below this share of the mean eigenvalue.
FLAT = 1e-6
# Below this share a part of a family, such as a sector, has no gradient point of its own. Sectors of a lattice have
# more than 0.2.
THIN = 1e-2
# No index of moduli: each point has its own.
NO_SETS = np.empty(0, dtype=np.int32)
# Largest number of particles that an error message lists.
NAMED_IDS = 5


@dataclass(frozen=True)
class StencilMembers:
    """Members of stencils: the particles of gradient points, bonds, families or patches.

    Attributes
    ----------
    owner : (n_points,) int32
        Own particle ``i`` of each stencil, ascending.
    point_ptr : (n_points + 1,) int64
        Start of the members of each stencil.
    members : (n_entries,) int32
        Local particles.
    """

    owner: LocalIndex
    point_ptr: GlobalIndex
    members: LocalIndex

    def by_particle(self, n_local: int) -> tuple[GlobalIndex, GlobalIndex, LocalIndex]:
        """Return the entries of each local particle and their stencils, as ``transpose`` does. The result is cached."""
        found: tuple[GlobalIndex, GlobalIndex, LocalIndex] | None = self.__dict__.get("_by_particle")
        if found is None:
            found = self.__dict__["_by_particle"] = transpose(self.point_ptr, self.members, n_local)
        return found


@dataclass(frozen=True)
class Stencils(StencilMembers):
    """Gradient points and the weighted neighbours of each, before the shape tensors are inverted.

    The first member of a point is its owner, with weight 0.

    Attributes
    ----------
    weight : (n_entries,) float64
        ``omega V_k`` times the share of the bond that belongs to the point [volume].
    """

    weight: Float

    def shape_tensors(self, x: Float) -> Float:
        """Return ``K_p = sum_k weight_pk xi_pk (x) xi_pk`` (n_points, dim, dim) [volume length^2]."""
        dim = x.shape[1]
        K = np.empty((len(self.owner), dim, dim))
        shape_kernel(dim)(self.owner, self.point_ptr, self.members, self.weight, x, K)
        return K


@dataclass(frozen=True)
class Parts:
    """Parts of families, such as sectors; some parts have no gradient point.

    Attributes
    ----------
    of_point : (n_points,) int64
        Part of each point.
    served_by : (n_owned, n_parts) int64
        Point of each part of a particle: its own, or that of the part that contains its bonds.
    """

    of_point: GlobalIndex
    served_by: GlobalIndex


@dataclass(frozen=True)
class GradientOperator(StencilMembers):
    """Sparse operator from displacements to deformation gradients, ``F_p = I + sum_k u_k (x) g_pk``.

    The first member of a point is its owner.

    Attributes
    ----------
    g : (n_entries, dim) float64
        Weights [1 / length]; those of a point sum to zero.
    volume : (n_points,) float64
        Quadrature volumes ``W_p = V_i / (points of i)`` [volume].
    note : str
        Adaptations of the scheme to this body, for the log; the same on all ranks.
    parts : Parts or None
        Part of the family of each point, if broken bonds may leave a part without a point. None if the points of a
        particle do not depend on broken bonds.
    unsuited : str
        Why the weights may not converge on this body; empty if nothing is known against them. The same on all ranks.
    """

    g: Float
    volume: Float
    note: str = ""
    parts: Parts | None = None
    unsuited: str = ""

    @property
    def n_points(self) -> int:
        """Return the number of gradient points on this rank."""
        return len(self.owner)

    @cached_property
    def points_of(self) -> GlobalIndex:
        """Return the start of the points of every own particle (n_owned + 1,); each particle has at least one."""
        return np.concatenate([[0], np.flatnonzero(np.diff(self.owner)) + 1, [self.n_points]])

    def at(self, points: GlobalIndex) -> GradientOperator:
        """Return the operator of selected points (n,), ascending (not collective)."""
        entries, first = entries_of(self.point_ptr, points)
        return GradientOperator(
            self.owner[points], first, self.members[entries], self.g[entries], self.volume[points]
        )  # fmt: skip

    def gradient(self, u: Float) -> Float:
        """Return ``H_p = sum_k u_k (x) g_pk`` (n_points, dim, dim) for ``u`` (n_local, dim)."""
        dim = u.shape[1]
        H = np.empty((self.n_points, dim, dim))
        gradient_kernel(dim)(self.point_ptr, self.members, self.g, u, H)
        return H

    def divergence(self, P: Float, f: Float, same: ControlledGradient | None = None) -> None:
        """Add ``sum_p W_p P_p g_pk`` to ``f`` (n_local, dim): the transpose of ``gradient`` on weighted stresses.

        If ``same`` is present, also add the forces of this control on the same gradient, found for this operator.
        """
        add_divergence(self, self.g, P, f, same)

    @property
    def listed(self) -> GradientOperator:
        """Return the operator with all weights listed: itself (not collective)."""
        return self

    def changed(self, **attributes: object) -> GradientOperator:
        """Return the operator with other values of some attributes, such as the volumes of its points."""
        found = copy.copy(self)
        found.__dict__.pop("listed", None)
        found.__dict__.update(attributes)
        return found

    def same_gradient(self, springs: Springs) -> SameGradient | None:
        """Return the data of a control for the loop over this operator if both have the same gradient, else None."""
        n, n_bonds = len(springs.K_inverse), len(springs.stiffness)
        if self.n_points != n or len(self.members) != n_bonds + n:
            return None
        deviation = same_gradient_kernel(springs.x.shape[1])
        data = self.point_ptr, self.members, self.g, springs.stiffness, springs.K_inverse, springs.x
        return BondGradient(springs.stiffness, inverses(springs.K_inverse)) if deviation(*data) <= SAME else None

    def loop(self, A: Moduli, h: Float | None = None) -> PointLoop:
        """Return ``H^T (W A) G`` for moduli A; forces have the weights ``h`` (n_entries, dim), by default g."""
        return ListedLoop(self, A.listed, h)

    def sum_over_points(self, values: Float) -> Float:
        """Return the sum over the points of each particle, (n_owned, ...)."""
        if self.n_points == len(self.points_of) - 1:
            return values
        return np.asarray(np.add.reduceat(values, self.points_of[:-1]))

    def mean_over_points(self, values: Float, n_owned: int) -> Float:
        """Return the mean over the points of each particle, (n_owned, ...)."""
        count = np.bincount(self.owner, minlength=n_owned)
        each = np.maximum(count, 1).reshape(-1, *(1,) * (values.ndim - 1))
        return np.asarray(sum_by(self.owner, values, n_owned) / each)


class ListedOnUse(GradientOperator):
    """An operator that stores less than its weights; ``g``, ``members`` and ``point_ptr`` list them on first use.

    It defines ``at``, and the sums and loops of ``GradientOperator`` without the list.
    """

    @cached_property
    def listed(self) -> GradientOperator:
        """Return the operator with all weights listed (not collective)."""
        return self.at(np.arange(self.n_points))

    @property
    def point_ptr(self) -> GlobalIndex:
        """Return the start of the members of each point."""
        return self.listed.point_ptr

    @property
    def members(self) -> LocalIndex:
        """Return the members of all points."""
        return self.listed.members

    @property
    def g(self) -> Float:
        """Return the weights of all members."""
        return self.listed.g


@dataclass(frozen=True)
class Moduli:
    """Moduli ``A_p = dP/dF`` of gradient points, stored once for all points with equal moduli.

    Attributes
    ----------
    values : (n_sets, dim, dim, dim, dim) float64
        Different moduli [stress].
    of : (n_points,) int32 or None
        Index of the moduli of each point; None if each point has its own.
    """

    values: Float
    of: LocalIndex | None = None

    def at(self, points: GlobalIndex) -> Float:
        """Return the moduli of selected points (n, dim, dim, dim, dim) [stress]."""
        return self.values[points if self.of is None else self.of[points]]

    @property
    def matrices(self) -> tuple[Float, LocalIndex]:
        """Return the different moduli (n_sets, dim dim, dim dim) [stress], and ``of``, empty instead of None."""
        size = self.values.shape[1] ** 2
        return self.values.reshape(-1, size, size), NO_SETS if self.of is None else self.of

    @cached_property
    def listed(self) -> Float:
        """Return the moduli of all points (n_points, dim, dim, dim, dim) [stress]."""
        return self.values if self.of is None else self.values[self.of]


@dataclass(frozen=True)
class Springs:
    """Springs ``s_ij |eta_ij - H_i xi_ij|^2 / 2`` of the bonds of whole families.

    Attributes
    ----------
    families : Families
        The bonds.
    stiffness : (n_bonds,) float64
        ``s_ij`` [force / length].
    K_inverse : (n_owned, dim, dim) float64
        Inverse of ``sum_j s_ij xi (x) xi``, which gives ``H_i`` [1 / (force length)].
    x : (n_local, dim) float64
        Positions [length].
    add_forces : callable
        Adds the forces of ``u`` (n_local, dim) in the families of selected own particles to ``f``.
    """

    families: Families
    stiffness: Float
    K_inverse: Float
    x: Float
    add_forces: Callable[[Float, Float, LocalIndex], object]


class SameGradient:
    """Data of a control that computes its forces from the gradient of the material."""


@dataclass(frozen=True)
class BondGradient(SameGradient):
    """The energy ``1/2 sum_ij s_ij |eta_ij - H_i xi_ij|^2`` with ``g_ij = s_ij K_i^-1 xi_ij``.

    Attributes
    ----------
    stiffness : (n_bonds,) float64
        ``s_ij`` [force / length].
    K : (n_owned, dim, dim) float64
        ``sum_j s_ij xi (x) xi`` [force length].
    """

    stiffness: Float
    K: Float


@dataclass(frozen=True)
class ControlledGradient:
    """A control on the gradient of an operator, at a displacement.

    Attributes
    ----------
    control : SameGradient
        Data of the control.
    H : (n_points, dim, dim) float64
        Gradient of the displacement [-].
    u : (n_local, dim) float64
        The displacement [length].
    """

    control: SameGradient
    H: Float
    u: Float


def add_divergence(
    operator: GradientOperator, h: Float, P: Float, f: Float, same: ControlledGradient | None = None
) -> None:
    """Add ``sum_p W_p P_p h_pk`` to ``f`` (n_local, dim), and the forces of a control on the gradient."""
    dim, data = f.shape[1], (operator.point_ptr, operator.members, h, operator.volume, P, f)
    if same is None:
        divergence_kernel(dim)(*data, *NO_CONTROL, P, f)
    else:
        assert isinstance(same.control, BondGradient)
        divergence_kernel(dim, 1)(*data, same.control.stiffness, same.control.K, same.H, same.u)


class PointLoop(ABC):
    """``H^T (W A) G``, applied particle by particle, alone or together with a control on the same gradient."""

    @abstractmethod
    def controlled(self, same: SameGradient | None) -> PointLoop | None:
        """Return the loop that also adds the forces of a control; None if that is not possible."""

    @abstractmethod
    def add(self, u: Float, f: Float, particles: LocalIndex) -> None:
        """Add the forces of the points of selected own particles for displacements (n_local, dim) (not collective)."""

    @abstractmethod
    def add_point_blocks(self, blocks: Float) -> None:
        """Add the diagonal blocks of the local particles (n_local, dim, dim), without those of a control."""


@dataclass(frozen=True)
class ListedLoop(PointLoop):
    """The loop of an operator whose weights are listed, in one pass over its points.

    Attributes
    ----------
    operator : GradientOperator
        The gradient.
    A : (n_points, dim, dim, dim, dim) float64
        Moduli [stress].
    h : (n_entries, dim) float64 or None
        Weights of the forces of points on particles [1 / length]; those of the gradient if None.
    control : BondGradient or None
        The control in the loop.
    """

    operator: GradientOperator
    A: Float
    h: Float | None
    control: BondGradient | None = None

    def controlled(self, same: SameGradient | None) -> PointLoop | None:
        """Return the loop with a control with listed bonds; None if forces have other weights than the gradient."""
        if self.h is not None or not isinstance(same, BondGradient):
            return None
        return replace(self, control=same)

    def add(self, u: Float, f: Float, particles: LocalIndex) -> None:
        """Add the forces of the points of selected own particles."""
        operator, h = self.operator, self.operator.g if self.h is None else self.h
        control = NO_CONTROL if self.control is None else (self.control.stiffness, self.control.K)
        gradient_times_kernel(u.shape[1], int(self.control is not None))(
            particles, operator.points_of, operator.point_ptr, operator.members, operator.g, h, operator.volume,
            self.A, *control, u, f,
        )  # fmt: skip

    def add_point_blocks(self, blocks: Float) -> None:
        """Add ``sum_p W_p h_pk . A_p . g_pk`` of every local particle ``k``."""
        operator, dim, h = self.operator, blocks.shape[-1], self.operator.g if self.h is None else self.h
        gradient_blocks_kernel(dim, int(self.h is None))(
            operator.point_ptr, operator.members, h, operator.g, operator.volume, self.A,
            blocks.reshape(-1, dim * dim),
        )  # fmt: skip


@dataclass(frozen=True)
class Patches:
    """Patches of gradient points that share one dilatation.

    Attributes
    ----------
    edge : float
        Edge of the boxes; the particles in a box form a patch [length].
    share : float
        Stiffness against deviations of a dilatation from the mean of its patch, over twice the shear modulus [-].
    """

    edge: float
    share: float


@dataclass(frozen=True)
class Scheme(Declared, ABC):
    """A correspondence scheme: the gradient points and their weights.

    Attributes
    ----------
    of_family : bool
        True if the weights depend on the bonds of the family only, so that particles with equal bonds share them.
    points_of_bonds : bool
        True if a particle has one point per bond, in the order of its bonds.
    horizon_ratio : float
        Horizon over spacing on a lattice if a case declares no horizon [-].
    """

    of_family: ClassVar[bool] = False
    points_of_bonds: ClassVar[bool] = False
    horizon_ratio: ClassVar[float] = 1.5

    def of_unit_spacing(self) -> Scheme:
        """Return the scheme without lengths of the body, to compile its loops on particles at unit spacing."""
        return self

    @property
    def patches(self) -> Patches | None:
        """Return the patches of gradient points that share one dilatation; None if each point has its own."""
        return None

    def memory(self, dim: int, family: float) -> float:
        """Return the smallest memory per bond while the operator is built, for families of ``family`` bonds [bytes]."""
        return 40.0

    @abstractmethod
    def build(self, cloud: Cloud, families: Families, omega: Float) -> GradientOperator:
        """Build the gradient operator for influence ``omega`` (n_bonds,) [-].

        Raises
        ------
        CaseError
            A family is too small or too flat, on every rank.

        Notes
        -----
        Collective.
        """


def flat(K: Float, share: float = FLAT) -> Mask:
    """Return a mask of shape tensors whose smallest eigenvalue is below ``share`` of the mean eigenvalue."""
    low = np.linalg.eigvalsh(K)[:, 0]
    mean = np.einsum("pii->p", K) / K.shape[1]
    return np.asarray(low <= share * mean)


def whole_families(cloud: Cloud, families: Families, weight: Float) -> Stencils:
    """Return one point per owned particle, over its whole family, with bond weights (n_bonds,)."""
    n = cloud.n_owned
    centres = np.arange(n, dtype=np.int32)
    return with_centres(centres, families.indptr, families.neighbours, weight)


def shape_tensors(families: Families, weight: Float, x: Float) -> Float:
    """Return ``K_i = sum_j weight_ij xi (x) xi`` (n_owned, dim, dim) for bond weights (n_bonds,)."""
    everyone, dim = families.everyone, x.shape[1]
    K = np.empty((len(everyone), dim, dim))
    shape_kernel(dim)(everyone, families.indptr, families.neighbours, weight, x, K)
    return K


def regular_shape_tensors(cloud: Cloud, families: Families, weight: Float, name: str) -> Float:
    """Return the shape tensors of the families of the own particles (n_owned, dim, dim) for weights (n_bonds,).

    Raises
    ------
    CaseError
        A family is too small or too flat for a gradient, on every rank. The message contains ``name``, which requires
        it.

    Notes
    -----
    Collective.
    """
    steps = shared_steps(families, weight)
    K = shape_tensors(families, weight, cloud.x) if steps is None else steps.shape_tensors()
    refuse_flat(cloud, np.flatnonzero(flat(K)), name)
    return K


def correspondence_weights(families: Families, x: Float, weight: Float, K_inverse: Float) -> Float:
    """Return ``g_ij = weight_ij K_i^-1 xi_ij`` (n_bonds, dim) [1 / length]: the gradient weights of whole families."""
    return np.asarray(weight[:, None] * np.einsum("bmn,bn->bm", K_inverse[families.centres], families.bonds(x)))


def with_centres(owner: LocalIndex, point_ptr: GlobalIndex, members: LocalIndex, weight: Float) -> Stencils:
    """Insert the owner of each point before its members, with weight 0."""
    at = point_ptr[:-1]
    return Stencils(
        owner, point_ptr + np.arange(len(point_ptr)), np.insert(members, at, owner), np.insert(weight, at, 0.0)
    )


def stencil_weights(stencils: Stencils, x: Float, K_inverse: Float) -> Float:
    """Return ``g_pk = weight_pk K_p^-1 xi_pk`` (n_entries, dim) [1 / length]."""
    g = np.empty((len(stencils.members), x.shape[1]))
    kernel = weights_kernel(x.shape[1])
    kernel(stencils.owner, stencils.point_ptr, stencils.members, stencils.weight, x, K_inverse, g)
    return g


def operator(cloud: Cloud, stencils: Stencils, note: str = "") -> GradientOperator:
    """Return the operator with ``g_pk = weight_pk K_p^-1 xi_pk`` and ``W_p = V_i / (points of i)``."""
    g = stencil_weights(stencils, cloud.x, inverses(stencils.shape_tensors(cloud.x)))
    volume = shared_volume(cloud, stencils.owner)
    return GradientOperator(stencils.owner, stencils.point_ptr, stencils.members, g, volume, note)


def from_bond_weights(cloud: Cloud, families: Families, g: Float, note: str = "") -> GradientOperator:
    """Return the operator with one point per particle and weights of its bonds (n_bonds, dim)."""
    stencils = whole_families(cloud, families, np.zeros(len(g)))
    at = families.indptr[:-1]
    own = np.zeros((cloud.n_owned, cloud.dim))
    np.subtract.at(own, families.centres, g)
    volume = cloud.volume[: cloud.n_owned].copy()
    return GradientOperator(
        stencils.owner, stencils.point_ptr, stencils.members, np.insert(g, at, own, axis=0), volume, note
    )


def shared_volume(cloud: Cloud, owner: LocalIndex) -> Float:
    """Return ``W_p = V_i / (points of i)`` (n_points,) [volume]."""
    count = np.bincount(owner, minlength=cloud.n_owned)
    return np.asarray(cloud.volume[owner] / count[owner])


def refuse_flat(cloud: Cloud, own: GlobalIndex, what: str) -> None:
    """Raise FlatFamilies on all ranks unless ``own`` is empty on each; ``what`` requires the gradient (collective)."""
    bad = np.zeros(cloud.n_owned)
    bad[own] = 1.0
    count = cloud.counted(bad)
    if count == 0:
        return
    gid = cloud.gid[own]
    ids = sorted(int(i) for part in cloud.comm.allgather(np.sort(gid)[:NAMED_IDS]) for i in part)[:NAMED_IDS]
    listed = ", ".join(str(i) for i in ids) + (", ..." if count > len(ids) else "")
    raise FlatFamilies(
        f"{count} particles have a family too small or too flat for {what} at horizon {cloud.horizon:g} (ids "
        f"{listed}); widen the horizon, add particles there, or move cracks that pass through particles.",
        gid,
    )
