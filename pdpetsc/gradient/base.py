"""The sparse gradient operator that every correspondence scheme builds, and what schemes share to build it."""

from __future__ import annotations

from abc import ABC, abstractmethod
from dataclasses import dataclass, replace
from functools import cached_property
from typing import ClassVar

import numpy as np

from pdpetsc.arrays import Float, GlobalIndex, LocalIndex, Mask, entries_of
from pdpetsc.declared import Declared
from pdpetsc.discrete.cloud import Cloud
from pdpetsc.discrete.families import Families
from pdpetsc.errors import FlatFamilies
from pdpetsc.kernels.gradient import divergence_kernel, gradient_kernel, inverses, shape_kernel, weights_kernel
from pdpetsc.kernels.point_blocks import gradient_blocks_kernel
from pdpetsc.kernels.sparsity import transpose
from pdpetsc.kernels.tangent import NO_CONTROL, gradient_times_kernel

# A family is flat when the smallest eigenvalue of its shape tensor is below this share of the mean one.
FLAT = 1e-6
# Below this share a part of a family, such as a sector, gets no gradient point of its own; sectors of a lattice have
# more than 0.2.
THIN = 1e-2
# Particles that an error message lists at most.
NAMED_IDS = 5


@dataclass(frozen=True)
class StencilMembers:
    """Particles that belong together: those of a gradient point, of a bond, of a family, of a patch.

    Attributes
    ----------
    owner : (n_points,) int32
        Own particle ``i`` that each stencil belongs to, ascending.
    point_ptr : (n_points + 1,) int64
        Where the members of each stencil start.
    members : (n_entries,) int32
        Local particles.
    """

    owner: LocalIndex
    point_ptr: GlobalIndex
    members: LocalIndex

    def by_particle(self, n_local: int) -> tuple[GlobalIndex, GlobalIndex, LocalIndex]:
        """Return the entries of each local particle and their stencils, as ``transpose`` does, computed once."""
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
    """Parts that families are divided into, such as sectors, of which not all have a gradient point.

    Attributes
    ----------
    of_point : (n_points,) int64
        The part that each point is of.
    served_by : (n_owned, n_parts) int64
        The point of each part of a particle: its own, or that of the part that took its bonds over.
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
        What the scheme had to adapt to this body, for the log; the same on all ranks.
    parts : Parts or None
        Which parts of its particle a point is of, where bonds that break may leave a part without a point; None where
        particles have the same points whichever bonds are left.
    """

    g: Float
    volume: Float
    note: str = ""
    parts: Parts | None = None

    @property
    def n_points(self) -> int:
        """Return the number of gradient points on this rank."""
        return len(self.owner)

    @cached_property
    def points_of(self) -> GlobalIndex:
        """Return where the points of every own particle start (n_owned + 1,): each has at least one."""
        return np.concatenate([[0], np.flatnonzero(np.diff(self.owner)) + 1, [self.n_points]])

    def at(self, points: GlobalIndex) -> GradientOperator:
        """Return the operator of some points (n,) alone, ascending (not collective)."""
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

        The forces of a control that uses the same gradient are added where it is given; it is of a kind that
        ``adds_together`` takes.
        """
        add_divergence(self, self.g, P, f, same)

    def adds_together(self, same: SameGradient | None) -> bool:
        """Return whether ``divergence`` can add the forces of a control with those of stresses."""
        return isinstance(same, BondGradient)

    def loop(self, A: Moduli, h: Float | None = None) -> PointLoop:
        """Return ``H^T (W A) G`` for moduli A, with weights ``h`` (n_entries, dim) of forces if they are not g."""
        return ListedLoop(self, A.listed, h)

    def sum_over_points(self, values: Float) -> Float:
        """Return the sum over the points of each particle, (n_owned, ...)."""
        if self.n_points == len(self.points_of) - 1:
            return values
        return np.asarray(np.add.reduceat(values, self.points_of[:-1]))

    def mean_over_points(self, values: Float, n_owned: int) -> Float:
        """Return the mean over the points of each particle, (n_owned, ...)."""
        count = np.bincount(self.owner, minlength=n_owned)
        flat = values.reshape(len(values), -1)
        sums = np.array([np.bincount(self.owner, column, n_owned) for column in flat.T]).T
        return np.asarray((sums / np.maximum(count, 1)[:, None]).reshape(n_owned, *values.shape[1:]))


@dataclass(frozen=True)
class Moduli:
    """Moduli ``A_p = dP/dF`` of gradient points, kept once for points that have the same.

    Attributes
    ----------
    values : (n_sets, dim, dim, dim, dim) float64
        Different moduli [stress].
    of : (n_points,) int32 or None
        Which of them each point has; each its own where None.
    """

    values: Float
    of: LocalIndex | None = None

    def at(self, points: GlobalIndex) -> Float:
        """Return the moduli of some points (n, dim, dim, dim, dim) [stress]."""
        return self.values[points if self.of is None else self.of[points]]

    @cached_property
    def listed(self) -> Float:
        """Return the moduli of all points (n_points, dim, dim, dim, dim) [stress]."""
        return self.values if self.of is None else self.values[self.of]


class SameGradient:
    """What a control needs to add its forces while the gradient that it shares with the material is at hand."""


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
        What its forces take.
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
    dim, listed = f.shape[1], None if same is None else same.control
    data = operator.point_ptr, operator.members, h, operator.volume, P, f
    if same is None or not isinstance(listed, BondGradient):
        divergence_kernel(dim)(*data, *NO_CONTROL, P, f)
    else:
        divergence_kernel(dim, 1)(*data, listed.stiffness, listed.K, same.H, same.u)


class PointLoop(ABC):
    """``H^T (W A) G``, applied particle by particle, alone or together with a control on the same gradient."""

    @abstractmethod
    def controlled(self, same: SameGradient | None) -> PointLoop | None:
        """Return the loop that adds the forces of a control too, or None if it cannot."""

    @abstractmethod
    def add(self, u: Float, f: Float, particles: LocalIndex) -> None:
        """Add the forces of the points of some own particles for displacements (n_local, dim) (not collective)."""

    @abstractmethod
    def add_point_blocks(self, blocks: Float) -> None:
        """Add what couples each local particle to itself (n_local, dim, dim), without that of a control."""


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
        Weights with which points put forces on particles [1 / length]; those of the gradient if None.
    control : BondGradient or None
        The control in the loop.
    """

    operator: GradientOperator
    A: Float
    h: Float | None
    control: BondGradient | None = None

    def controlled(self, same: SameGradient | None) -> PointLoop | None:
        """Return the loop with a control whose bonds are listed, if forces have the weights of the gradient."""
        if self.h is not None or not isinstance(same, BondGradient):
            return None
        return replace(self, control=same)

    def add(self, u: Float, f: Float, particles: LocalIndex) -> None:
        """Add the forces of the points of some own particles."""
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
    """Which gradient points share one dilatation.

    Attributes
    ----------
    edge : float
        Edge of the boxes whose particles are a patch [length].
    share : float
        Stiffness of dilatations that the mean of a patch does not see over twice the shear modulus [-].
    """

    edge: float
    share: float


@dataclass(frozen=True)
class Scheme(Declared, ABC):
    """A correspondence scheme: where deformation gradients are evaluated, and with which weights.

    Attributes
    ----------
    of_family : bool
        Whether the weights follow from the bonds of the family alone, so that particles with the same bonds share them.
    points_of_bonds : bool
        Whether the points of a particle are those of its bonds, in the order in which its bonds are listed.
    horizon_ratio : float
        Horizon over spacing on a lattice if a case declares no horizon [-].
    """

    of_family: ClassVar[bool] = False
    points_of_bonds: ClassVar[bool] = False
    horizon_ratio: ClassVar[float] = 1.5

    def of_unit_spacing(self) -> Scheme:
        """Return it without lengths of its body, to compile its loops on particles one unit apart."""
        return self

    @property
    def patches(self) -> Patches | None:
        """Return which gradient points share one dilatation; None where each has its own."""
        return None

    def memory(self, dim: int, family: float) -> float:
        """Return the least memory per bond while the operator is built, in families of ``family`` bonds [bytes]."""
        return 40.0

    @abstractmethod
    def build(self, cloud: Cloud, families: Families, omega: Float) -> GradientOperator:
        """Return the operator for influence ``omega`` (n_bonds,) [-].

        Raises
        ------
        CaseError
            A family is too small or too flat, on every rank.

        Notes
        -----
        Collective.
        """


def flat(K: Float, share: float = FLAT) -> Mask:
    """Return which shape tensors have their smallest eigenvalue below ``share`` of the mean one."""
    low = np.linalg.eigvalsh(K)[:, 0]
    mean = np.einsum("pii->p", K) / K.shape[1]
    return np.asarray(low <= share * mean)


def whole_families(cloud: Cloud, families: Families, weight: Float) -> Stencils:
    """Return one point per owned particle, over its whole family with the given bond weights (n_bonds,)."""
    n = cloud.n_owned
    centres = np.arange(n, dtype=np.int32)
    return with_centres(centres, families.indptr, families.neighbours, weight)


def regular_shape_tensors(cloud: Cloud, families: Families, weight: Float, name: str) -> Float:
    """Return the shape tensors of the families of the own particles (n_owned, dim, dim) for weights (n_bonds,).

    Raises
    ------
    CaseError
        A family is too small or flat to give a gradient, on every rank; ``name`` says in the message what needs it.

    Notes
    -----
    Collective.
    """
    K = whole_families(cloud, families, weight).shape_tensors(cloud.x)
    refuse_flat(cloud, np.flatnonzero(flat(K)), name)
    return K


def correspondence_weights(families: Families, x: Float, weight: Float, K_inverse: Float) -> Float:
    """Return ``g_ij = weight_ij K_i^-1 xi_ij`` (n_bonds, dim) [1 / length]: the gradient weights of whole families."""
    return np.asarray(weight[:, None] * np.einsum("bmn,bn->bm", K_inverse[families.centres], families.bonds(x)))


def with_centres(owner: LocalIndex, point_ptr: GlobalIndex, members: LocalIndex, weight: Float) -> Stencils:
    """Put the owner of each point in front of its members, with weight 0."""
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
    """Return the operator with one point per particle and the given weights of its bonds (n_bonds, dim)."""
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
    """Raise FlatFamilies on all ranks if ``own`` has own particles on any; ``what`` needs the gradient (collective)."""
    bad = np.zeros(cloud.n_owned)
    bad[own] = 1.0
    count = cloud.counted(bad)
    if count == 0:
        return
    gid = cloud.gid[own]
    ids = sorted(int(i) for part in cloud.comm.allgather(np.sort(gid)[:NAMED_IDS]) for i in part)[:NAMED_IDS]
    listed = ", ".join(str(i) for i in ids) + (", ..." if count > len(ids) else "")
    raise FlatFamilies(
        f"{count} particles have a family too small or too flat for {what} (ids {listed}); widen the horizon or add "
        f"particles there.",
        gid,
    )
