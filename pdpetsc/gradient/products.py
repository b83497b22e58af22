"""Summands of tangents: products ``sum_s h_s (x) A_s (x) g_s`` over stencils.

A product is applied to a displacement, adds its rows to a matrix, and adds its diagonal blocks. Controls are products
too (``control.base.Control``).
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import Any, TypeAlias

import numpy as np

from pdpetsc.arrays import Float, LocalIndex, entries_of
from pdpetsc.discrete.sparsity import Sparsity
from pdpetsc.gradient.base import GradientOperator, Moduli, SameGradient, StencilMembers
from pdpetsc.kernels.assembly import assemble_kernel
from pdpetsc.kernels.rank_one import (
    facet_times_kernel,
    rank_one_blocks_kernel,
    rank_one_rows_kernel,
    rank_one_times_kernel,
)
from pdpetsc.kernels.rows import RowLayout

# Adds the forces of the stencils of selected own particles for a displacement, both with ghosts (n_local, dim).
Loop: TypeAlias = Callable[[Float, Float, LocalIndex], None]


@dataclass(frozen=True)
class Entries:
    """Values of the tangent matrix, to which products add their rows.

    Attributes
    ----------
    sparsity : Sparsity
        Blocks of the matrix.
    diag, off : float64
        Values of the own rows, own columns and others, in scalar CSR layout.
    ghost : float64
        This rank's share of the rows of its ghosts.
    component : int or None
        Component of the displacement if blocks have one value; None for whole blocks.
    """

    sparsity: Sparsity
    diag: Float
    off: Float
    ghost: Float
    component: int | None = None

    @classmethod
    def zeros(cls, sparsity: Sparsity, component: int | None = None) -> Entries:
        """Return zeros for all blocks."""
        size = sparsity.cloud.dim**2 if component is None else 1
        blocks = sparsity.owned.diag_ptr[-1], sparsity.owned.off_ptr[-1], sparsity.ghost.diag_ptr[-1]
        diag, off, ghost = (np.zeros(size * int(n)) for n in blocks)
        return cls(sparsity, diag, off, ghost, component)

    def add(self, kernel: Callable[..., Any], stencils: StencilMembers, *data: Any) -> None:
        """Add the rows of stencils, of own particles and of ghosts (not collective).

        Parameters
        ----------
        kernel : callable
            Adds rows. Its arguments are a ``RowLayout``, the data, and the values in own and in other columns.
        stencils : StencilMembers
            Stencils of the kernel.
        data
            Arguments of the kernel after the layout.
        """
        sparsity = self.sparsity
        by_particle = stencils.by_particle(sparsity.cloud.n_local)
        local_ptr, locals_of, behind, signs = sparsity.locals_of_columns
        if self.component is not None:
            signs = np.ascontiguousarray(signs[:, [self.component]])
        for rows, own in ((sparsity.owned, self.diag), (sparsity.ghost, self.ghost)):
            layout = RowLayout(
                rows.first, rows.diag_ptr, rows.off_ptr, rows.columns, local_ptr, locals_of, behind, signs, *by_particle
            )
            kernel(layout, *data, own, self.off)


class Product:
    """A linear map from displacements to forces; a tangent is a sum of products.

    A term without ghosts (a foundation, a spring) returns ``PointBlocks``. A term that couples families derives from
    this class and defines ``add_product``, ``add_rows`` and ``stiffness``.
    """

    @property
    def blocks(self) -> Float | None:
        """Return the blocks of each own particle with itself (n_owned, dim, dim) [force / length]; None without any."""
        return None

    def add_product(self, du: Float, f: Float, particles: LocalIndex) -> None:
        """Add ``K du`` of the families of selected own particles, both with ghosts (n_local, dim) (not collective)."""

    def add_rows(self, entries: Entries) -> None:
        """Add the rows of the matrix (collective)."""

    def add_point_blocks(self, blocks: Float) -> bool:
        """Add the diagonal blocks of the families of local particles (n_local, dim, dim) [force / length].

        These are the diagonal blocks of the rows that ``add_rows`` adds, except that softening bonds count with their
        secant. The blocks of ``blocks`` are not included. If the diagonal blocks are not available, add nothing and
        return False; they are then computed from the rows (not collective).
        """
        return False

    def stiffness(self) -> Float | None:
        """Return ``sum_p W_p dP/dF`` of the own particles (n_owned, dim, dim, dim, dim) [energy], or None.

        The matrix of nearest neighbours is assembled from it (not collective).
        """
        return None

    def strength(self) -> Float | None:
        """Return the trace of ``stiffness`` (n_owned,) [energy], or None (not collective)."""
        D = self.stiffness()
        return None if D is None else np.asarray(np.einsum("pikik->p", D))

    def constraint(self) -> ConstraintProduct | None:
        """Return the product if its stiffness makes it nearly a constraint, else None (not collective)."""
        return None

    def stiff(self) -> FacetSprings | None:
        """Return the product if its springs are many times stiffer than the body, else None (not collective)."""
        return None

    def together(self, other: Product) -> Loop | None:
        """Return ``add_product`` of both in one loop if that is faster, else None (not collective)."""
        return None

    def shared_gradient(self, operator: GradientOperator) -> SameGradient | None:
        """Return the data of a control for the loop over ``operator``; None if this is no control on that gradient."""
        return None


class PointBlocks(Product):
    """Blocks that couple each particle to itself only, such as foundations and springs.

    Parameters
    ----------
    blocks : (n_owned, dim, dim) float64
        Minus the derivative of the force on each own particle by its displacement [force / length].
    """

    def __init__(self, blocks: Float) -> None:
        self._blocks = blocks

    @property
    def blocks(self) -> Float:
        return self._blocks

    def add_point_blocks(self, blocks: Float) -> bool:
        """Add nothing: there are no families."""
        return True


class ScaledProduct(Product):
    """A number times another product, which has no blocks of its own.

    Parameters
    ----------
    product : Product
        The other product.
    factor : float
        The number [-].
    """

    def __init__(self, product: Product, factor: float) -> None:
        self._product, self._factor = product, factor

    def add_product(self, du: Float, f: Float, particles: LocalIndex) -> None:
        """Add the forces of the product for scaled displacements."""
        self._product.add_product(self._factor * du, f, particles)

    def add_rows(self, entries: Entries) -> None:
        part = Entries.zeros(entries.sparsity, entries.component)
        self._product.add_rows(part)
        for values, added in ((entries.diag, part.diag), (entries.off, part.off), (entries.ghost, part.ghost)):
            values += self._factor * added

    def add_point_blocks(self, blocks: Float) -> bool:
        """Add scaled blocks, if they are available."""
        part = np.zeros_like(blocks)
        known = self._product.add_point_blocks(part)
        blocks += self._factor * part
        return known

    def stiffness(self) -> Float | None:
        D = self._product.stiffness()
        return None if D is None else self._factor * D


class PointProduct(Product):
    """``H^T (W A) G`` over gradient points.

    Parameters
    ----------
    operator : GradientOperator
        Gradients, with the volumes of the points.
    A : Moduli
        Moduli of the points.
    h : (n_entries, dim) float64, optional
        Weights of the forces of points on particles [1 / length]; those of the gradient if absent.
    share : callable, optional
        Returns the remaining share of the stiffness of each own particle with such weights (n_owned,) [-].
    """

    def __init__(
        self, operator: GradientOperator, A: Moduli, h: Float | None = None, share: Callable[[], Float] | None = None
    ) -> None:
        self._operator, self._A, self._h, self._share = operator, A, h, share
        self._loop = operator.loop(A, h)

    def together(self, other: Product) -> Loop | None:
        """Return the loop with a control on the same gradient, if ``other`` is one."""
        if self._h is not None:
            return None
        loop = self._loop.controlled(other.shared_gradient(self._operator))
        return None if loop is None else loop.add

    def add_product(self, du: Float, f: Float, particles: LocalIndex) -> None:
        """Add the forces of the moduli."""
        self._loop.add(du, f, particles)

    def add_rows(self, entries: Entries) -> None:
        """Add the rows of the points."""
        operator, A = self._operator, self._A.listed
        g, h = operator.g, operator.g if self._h is None else self._h
        kernel = assemble_kernel(entries.sparsity.cloud.dim)
        entries.add(kernel, operator, operator.point_ptr, operator.members, h, g, operator.volume, A)

    def add_point_blocks(self, blocks: Float) -> bool:
        """Add ``sum_p W_p h_pk . A_p . g_pk`` of every local particle ``k``."""
        self._loop.add_point_blocks(blocks)
        return True

    def stiffness(self) -> Float:
        """Return the stiffness summed over the points of each particle, times its share."""
        operator, A = self._operator, self._A
        if A.of is None:
            D = operator.sum_over_points(operator.volume[:, None, None, None, None] * A.values)
        else:  # points of one particle have the moduli of its material
            D = A.values[A.of[operator.points_of[:-1]]]
            D *= operator.sum_over_points(operator.volume)[:, None, None, None, None]
        if self._share is not None:
            D *= self._share()[:, None, None, None, None]
        return np.asarray(D)

    def strength(self) -> Float:
        """Return the trace of ``stiffness`` without assembling it."""
        operator, A = self._operator, self._A
        trace = np.einsum("pikik->p", A.values)
        sums = operator.sum_over_points(operator.volume * (trace if A.of is None else trace[A.of]))
        return sums if self._share is None else np.asarray(sums * self._share())


class RankOneProduct(Product):
    """``sum_s b_s h_s (x) g_s``: each stencil has one vector of forces and one scalar of its displacements.

    Parameters
    ----------
    stencils : StencilMembers
        The stencils.
    n_owned : int
        Number of own particles.
    h, g : (n_entries, dim) float64
        Vectors of the members; ``g`` sums to zero in each stencil.
    b : (n_stencils,) float64
        Factor of each stencil. ``b h g`` is a force per length.

    Attributes
    ----------
    data : tuple
        Start and members of each stencil, ``h``, ``g`` and ``b``.
    """

    def __init__(self, stencils: StencilMembers, n_owned: int, h: Float, g: Float, b: Float) -> None:
        self._stencils, self.data = stencils, (stencils.point_ptr, stencils.members, h, g, b)
        self._first = np.searchsorted(stencils.owner, np.arange(n_owned + 1))

    def add_product(self, du: Float, f: Float, particles: LocalIndex) -> None:
        """Add ``b_s h_s (g_s . du)`` of the stencils of the particles."""
        rank_one_times_kernel(du.shape[1])(particles, self._first, *self.data, du, f)

    def add_rows(self, entries: Entries) -> None:
        """Add ``b_s h_s (x) g_s``."""
        entries.add(rank_one_rows_kernel(entries.sparsity.cloud.dim), self._stencils, *self.data)

    def add_point_blocks(self, blocks: Float) -> bool:
        """Add ``b_s h_sk (x) g_sk`` of every member ``k``."""
        rank_one_blocks_kernel(blocks.shape[-1])(*self.data, blocks)
        return True


class FacetProduct(Product):
    """``sum_s sum_a h_sa (x) g_sa``: forces between the particles of facets.

    Parameters
    ----------
    stencils : StencilMembers
        The particles that each pair of facets, or facet and tool, moves with; owners ascend.
    n_owned : int
        Number of own particles.
    h, g : (n_entries, r, dim) float64
        Vectors of the members. ``h g`` is a force per length.
    """

    def __init__(self, stencils: StencilMembers, n_owned: int, h: Float, g: Float) -> None:
        self._stencils, self._n_owned, self._h, self._g = stencils, n_owned, h, g
        self._first = np.searchsorted(stencils.owner, np.arange(n_owned + 1))

    def add_product(self, du: Float, f: Float, particles: LocalIndex) -> None:
        """Add ``sum_a h_sa (g_sa . du)`` of the stencils of the particles; the forces may resist translations."""
        of = self._stencils
        kernel = facet_times_kernel(du.shape[1], self._h.shape[1])
        kernel(particles, self._first, of.point_ptr, of.members, self._h, self._g, du, f)

    def add_rows(self, entries: Entries) -> None:
        """Add ``sum_a h_sa (x) g_sa``."""
        self.one_by_one().add_rows(entries)

    def add_point_blocks(self, blocks: Float) -> bool:
        """Add ``sum_a h_sak (x) g_sak`` of every member ``k``."""
        for a in range(self._h.shape[1]):
            one = self._stencils.point_ptr, self._stencils.members, self._h[:, a], self._g[:, a]
            rank_one_blocks_kernel(blocks.shape[-1])(*map(np.ascontiguousarray, one), np.ones(len(one[0]) - 1), blocks)
        return True

    def one_by_one(self) -> RankOneProduct:
        """Return the same product as a sum of stencils, each for a single ``a`` and with one vector per member."""
        of, r, n = self._stencils, self._h.shape[1], len(self._stencils.owner)
        entry, ptr = entries_of(of.point_ptr, np.repeat(np.arange(n), r))
        which = np.repeat(np.tile(np.arange(r), n), np.diff(ptr))
        stencils = StencilMembers(np.repeat(of.owner, r), ptr, of.members[entry])
        return RankOneProduct(stencils, self._n_owned, self._h[entry, which], self._g[entry, which], np.ones(n * r))


class FacetSprings(FacetProduct):
    """Springs between the particles of facets, many times stiffer than the body."""

    @property
    def n_entries(self) -> int:
        """Return the number of particles in all stencils (not collective)."""
        return len(self._stencils.members)

    def stiff(self) -> FacetSprings:
        return self


class SofteningProduct(RankOneProduct):
    """Softening part of a tangent: force of the intact bond times gradient of its degradation factor.

    It is not part of the diagonal blocks, which use the secant of such bonds.
    """

    def add_point_blocks(self, blocks: Float) -> bool:
        return True


class ConstraintProduct(RankOneProduct):
    """``sum_c D_c b_c (x) b_c``, so stiff that each stencil has nearly a constraint ``b_c . du = 0``.

    Parameters
    ----------
    stencils, n_owned
        As for ``RankOneProduct``.
    b : (n_entries, dim) float64
        ``b_c`` [1 / length].
    D : (n,) float64
        ``D_c`` [energy].
    soft : (n,) float64
        Approximate stiffness of the rest of the tangent against such displacements [energy].
    """

    def __init__(self, stencils: StencilMembers, n_owned: int, b: Float, D: Float, soft: Float) -> None:
        super().__init__(stencils, n_owned, b, b, D)
        self.ptr, self.members = stencils.point_ptr, stencils.members
        self.b, self.D, self.soft = b, D, soft

    def constraint(self) -> ConstraintProduct:
        return self
