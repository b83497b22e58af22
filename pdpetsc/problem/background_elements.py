"""Coarse space of a two-level preconditioner: linear elements on a background grid."""

from __future__ import annotations

import numpy as np

from pdpetsc.arrays import Float, GlobalIndex, starts_of
from pdpetsc.discrete.background_grid import LEAST_WIDTH, BackgroundGrid, Cells
from pdpetsc.discrete.communicator import exchange, owners, total
from pdpetsc.discrete.families import with_pairs
from pdpetsc.kernels.background import (
    add_at,
    add_elements,
    scalar_values,
    sum_in_elements,
    tied_kernel,
)
from pdpetsc.kernels.point_blocks import definite
from pdpetsc.kernels.sparsity import scalar_rows
from pdpetsc.problem.assembly import Filler
from pdpetsc.problem.problem import Problem
from pdpetsc.problem.scales import mean_spacing
from pdpetsc.problem.state import State

# Smallest modulus, as a share of that of a particle with such a diagonal block. Without it, a particle whose family is
# too flat for a gradient would have no stiffness, although gradients of others hold it.
WEAK = 0.1
# Additional stiffness of every element, as a share of its modulus, against rotations and modes that no bond resists.
# The springs of loose particles are stiffer.
FLOOR = 1e-9
# Elements per block of the assembly.
CHUNK = 4096


class BackgroundElements(BackgroundGrid, Filler):
    """Provide linear finite elements on a background grid, as coarse space for the tangent of a body.

    Its cells are one horizon wide, and at least ``LEAST_WIDTH`` spacings. With a horizon of two spacings, narrower
    cells would save a fifth of the iterations, but have over three times the nodes.

    The stiffness is ``sum_e int B^T D_e B``. The moduli ``D_e`` are the sum over the particles of the element,
    distributed evenly over its cell. In every uniform deformation the energy is that of the body, for any scheme,
    materials and damage. Prescribed degrees of freedom do not move with the nodes; a node resists their motion as the
    particle itself would.

    Parameters
    ----------
    problem : Problem
        The problem.

    Notes
    -----
    Construction, ``fill`` and ``rigid_modes`` are collective; the others are not.
    """

    def __init__(self, problem: Problem) -> None:
        self.problem = problem
        cloud, damage = problem.body.cloud, problem.bond_damage
        kept = np.empty(0, dtype=bool) if damage is None else damage.bonds.intact
        bonds, kept = with_pairs(problem.body.families.connecting, kept, problem.joined)
        width = max(cloud.horizon, LEAST_WIDTH * mean_spacing(problem.body))
        super().__init__(cloud, bonds, kept, width, ~problem.supports.fixed)
        self._set_pattern()

    def rehearse(self, state: State) -> None:
        """Fill the matrix once, and interpolate from particles to nodes and back (collective)."""
        tangent = self.problem.linearised(state)
        blocks = tangent.point_blocks()
        definite(blocks, 0.0)
        self.fill(tangent.stiffness(), blocks, np.einsum("pii->pi", blocks), 1.0)
        self.interpolate(self.restrict(state.u))

    def fill(self, D: Float, blocks: Float | None, diagonal: Float, scale: float) -> Float:
        """Compute the values of the own rows of the matrix of the nodes, divided by ``scale``, in scalar CSR layout.

        Parameters
        ----------
        D : (n_owned, dim, dim, dim, dim) float64
            Moduli of the own particles [energy].
        blocks : (n_owned, dim, dim) float64 or None
            Coupling of each particle with itself alone [force / length].
        diagonal : (n_rows, dim) float64
            Diagonal of the tangent of the body [force / length].
        scale : float
            Unit of stiffness in the matrix [force / length].
        """
        dim, n_corners = self._dim, 2**self._dim
        n_elements = len(self.corners)
        sums = np.zeros((n_elements, dim**4))
        sum_in_elements(self.element, np.ascontiguousarray(D).reshape(len(D), -1), sums)
        sums = sums.reshape(n_elements, *(dim,) * 4)
        weak = self._weak(D, diagonal)
        floor = FLOOR * np.abs(np.einsum("eikik->e", sums)) / dim**2
        for i in range(dim):
            for k in range(dim):
                sums[:, i, k, i, k] += floor + 0.5 * weak
                sums[:, i, k, k, i] += 0.5 * weak
        sums = sums.transpose(0, 2, 4, 1, 3).reshape(n_elements, dim**2, dim**2) / scale
        integrals = _integrals(self.cells)
        tied, ties = self._ties(blocks, diagonal, scale)
        of = self.element[tied]
        values = np.zeros((self._n_blocks, dim, dim))
        for begin in range(0, n_elements, CHUNK):
            part = slice(begin, begin + CHUNK)
            K = (integrals @ sums[part]).reshape(-1, n_corners, n_corners, dim, dim)
            some = slice(*np.searchsorted(of, [begin, begin + CHUNK]))
            tied_kernel(dim)(tied[some], self.element, self.at, ties[some], begin, K)
            add_elements(self._slots[part], K, values)
            wrapped = np.flatnonzero(self._across[part])
            if len(wrapped):
                across = np.searchsorted(self._across_elements, begin + wrapped)
                add_elements(self._across_slots[across], self._with_virtual(begin + wrapped, K[wrapped]), values)
        return self._complete(values)

    @property
    def rows(self) -> tuple[GlobalIndex, GlobalIndex]:
        """Return the own rows of the matrix as scalar CSR, ``(row_ptr, columns)``."""
        row_ptr = np.empty(self.n_own * self._dim + 1, dtype=np.int64)
        columns = np.empty(len(self._columns) * self._dim**2, dtype=np.int64)
        scalar_rows(self._block_ptr, self._columns, self._dim, row_ptr, columns)
        return row_ptr, columns

    @property
    def n_entries(self) -> int:
        """Return the number of entries of the own rows of the matrix."""
        return len(self._columns) * self._dim**2

    def _weak(self, D: Float, diagonal: Float) -> Float:
        """Return the modulus that elements lack compared with their diagonal blocks (n_elements,) [energy].

        It is the modulus of an isotropic solid that resists strain but not rotation (collective).
        """
        dim = self._dim
        modulus = np.abs(np.einsum("pikik->p", D)) / dim**2
        size = diagonal[: len(D)].mean(axis=1)
        sums = total(self._cloud.comm, [float(modulus.sum()), float(size.sum())])
        usual = size * float(sums[0] / sums[1]) if sums[1] > 0.0 else size
        lacking = np.maximum(WEAK * usual - modulus, 0.0)
        return np.asarray(np.bincount(self.element, lacking, len(self.corners)), dtype=float)

    def _ties(self, blocks: Float | None, diagonal: Float, scale: float) -> tuple[GlobalIndex, Float]:
        """Return the particles with stiffness besides that of elements, ordered by element, and the block of each."""
        n, dim = self._cloud.n_owned, self._dim
        fixed = ~self._free[:n]
        found = fixed.any(axis=1)
        if blocks is not None:
            found |= blocks.any(axis=(1, 2))
        tied = np.flatnonzero(found)
        tied = tied[np.argsort(self.element[tied], kind="stable")]
        ties = np.zeros((len(tied), dim, dim)) if blocks is None else blocks[tied]
        free = ~fixed[tied]
        ties = ties * free[:, :, None] * free[:, None, :]
        held = np.where(fixed[tied], diagonal[tied], 0.0)
        for i in range(dim):
            ties[:, i, i] += held[:, i]
        return tied, ties / scale

    def _with_virtual(self, elements: GlobalIndex, K: Float) -> Float:
        """Return the contributions of elements across the sides of a periodic cell, including virtual unknowns."""
        dim, n_corners, n_v = self._dim, 2**self._dim, self._n_virtual
        away = self.cells.corners * self._wraps[elements][:, None, :] * self._lengths
        T = np.einsum("vab,eqb->eqav", self._strains, away)
        right = np.einsum("epqab,eqbv->epav", K, T)
        left = np.einsum("epav,epqab->eqvb", T, K)
        both = np.einsum("epav,epau->evu", T, right)
        whole = np.zeros((len(elements), n_corners + n_v, n_corners + n_v, dim, dim))
        whole[:, :n_corners, n_corners:] = right.reshape(-1, n_corners, dim, n_v, dim).transpose(0, 1, 3, 2, 4)
        whole[:, n_corners:, :n_corners] = left.reshape(-1, n_corners, n_v, dim, dim).transpose(0, 2, 1, 3, 4)
        whole[:, n_corners:, n_corners:] = both.reshape(-1, n_v, dim, n_v, dim).transpose(0, 1, 3, 2, 4)
        return whole

    def _set_pattern(self) -> None:
        """Determine the nonzero blocks of the matrix of the nodes, on this rank and in its rows (collective)."""
        comm, n_nodes, n_corners = self._cloud.comm, len(self.numbers), self.corners.shape[1]
        self._across = self._wraps.any(axis=1)
        self._across_elements = np.flatnonzero(self._across)
        virtual = np.tile(n_nodes - self._n_virtual + np.arange(self._n_virtual), (len(self._across_elements), 1))
        members = np.concatenate([self.corners[self._across_elements], virtual], axis=1).astype(np.int64)
        corners = self.corners.astype(np.int64)
        keys = (corners[:, :, None] * n_nodes + corners[:, None, :]).ravel()
        across = (members[:, :, None] * n_nodes + members[:, None, :]).ravel()
        found, slots = np.unique(np.concatenate([keys, across]), return_inverse=True)
        slots = slots.reshape(-1)
        self._n_blocks = len(found)
        self._slots = slots[: len(keys)].reshape(-1, n_corners, n_corners)
        width = n_corners + self._n_virtual
        self._across_slots = slots[len(keys) :].reshape(-1, width, width)
        self._block_rows, self._block_columns = found // n_nodes, found % n_nodes
        row, column = self.numbers[self._block_rows], self.numbers[self._block_columns]
        self._to, _ = owners(comm, self.first, row)
        (row, column), _ = exchange(comm, self._to, [row, column])
        keys = (row - self.first) * self.n_global + column
        # Rows of nodes without element: virtual unknowns of a cell whose sides no element crosses.
        alone = np.arange(self.n_own, dtype=np.int64)
        found, position = np.unique(
            np.concatenate([keys, alone * self.n_global + alone + self.first]), return_inverse=True
        )
        self._position, self._own_diagonal = np.split(position.reshape(-1), [len(keys)])
        self._columns: GlobalIndex = found % self.n_global
        counts = np.bincount(found // self.n_global, minlength=self.n_own)
        self._block_ptr: GlobalIndex = starts_of(counts)

    def _complete(self, values: Float) -> Float:
        """Sum the values of the own rows over all ranks (collective)."""
        dim = self._dim
        self._hold(values)
        (values,), _ = exchange(self._cloud.comm, self._to, [values])
        blocks = np.zeros((len(self._columns), dim, dim))
        add_at(self._position, values, blocks)
        # Set 1 on the diagonal of components without stiffness.
        i = np.arange(dim)
        diagonal = blocks[self._own_diagonal][:, i, i]
        blocks[self._own_diagonal[:, None], i, i] = np.where(diagonal == 0.0, 1.0, diagonal)
        scalars = np.empty(blocks.size)
        scalar_values(self._block_ptr, blocks, scalars)
        return scalars

    def _hold(self, values: Float) -> None:
        """Uncouple the components of nodes that mirror planes hold (not collective)."""
        if self.held.any():
            free = ~self.held
            values *= free[self._block_rows][:, :, None] & free[self._block_columns][:, None, :]


def _integrals(cells: Cells) -> Float:
    """Compute ``mean of dN_p/dx_m dN_q/dx_n`` over a cell, (n_corners^2, dim^2) [1 / length^2]."""
    dim, upper = len(cells.count), cells.corners
    # Integrals of products of the linear functions of one coordinate, and of their derivatives.
    mass = np.where(upper[:, None, :] == upper[None, :, :], 1.0 / 3.0, 1.0 / 6.0)
    slope = 2.0 * upper - 1.0
    found = np.empty((2**dim, 2**dim, dim, dim))
    for m in range(dim):
        for n in range(dim):
            value = np.ones((2**dim, 2**dim))
            for d in range(dim):
                of_p = slope[:, None, d] if d == m else None
                of_q = slope[None, :, d] if d == n else None
                if of_p is not None and of_q is not None:
                    value = value * of_p * of_q
                elif of_p is not None:
                    value = value * of_p * 0.5
                elif of_q is not None:
                    value = value * of_q * 0.5
                else:
                    value = value * mass[:, :, d]
            found[:, :, m, n] = value / (cells.width[m] * cells.width[n])
    return found.reshape(4**dim, dim**2)
