"""Sparse matrices that approximate the system of conforming weights, for its preconditioner."""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Mapping, Sequence
from itertools import combinations
from typing import NamedTuple

import numpy as np
import scipy

from pdpetsc.arrays import Float, GlobalIndex, LocalIndex, Mask, row_of_entries, starts_of
from pdpetsc.discrete.background_grid import LEAST_WIDTH, BackgroundGrid
from pdpetsc.discrete.communicator import exchange, largest, owners, smallest, total
from pdpetsc.discrete.families import Families
from pdpetsc.discrete.halo import Halo
from pdpetsc.gradient.conforming_system import ConformingSystem
from pdpetsc.kernels.background import sum_in_elements
from pdpetsc.kernels.conforming import linear_moments_kernel
from pdpetsc.kernels.near import reach_kernel
from pdpetsc.kernels.sparsity import nearest_neighbours

# Near members are at most this many times as far away as the 2 dim-th nearest member. On lattices this includes the
# diagonals.
NEAR = 1.6
# Largest mean number of members of points with few members, by dimension.
FEW = {1: 10.0, 2: 14.0, 3: 12.0}
# Least mean number of members of points for a grid, and largest ratio of horizons.
ENOUGH, UNIFORM = 6.5, 1.5
# Largest number of iterations with a grid and with nearest neighbours. A system that needs more of the latter has
# almost nothing to solve.
MOST_ON_GRID, MOST = 200, 2000
# Largest number of unknowns for which a matrix is factored, by dimension.
DIRECT_ON_GRID, DIRECT = {2: 250_000, 3: 30_000}, {1: 10**7, 2: 250_000, 3: 6_000}


class Triplets(NamedTuple):
    """Entries of a matrix, each a row, a column and a value, which are summed over all ranks.

    Attributes
    ----------
    rows, columns : (n,) int64
        Global numbers.
    values : (n,) float64
        Values.
    """

    rows: GlobalIndex
    columns: GlobalIndex
    values: Float


class NearInverse(ABC):
    """Approximate the inverse of the system, ``r / d + I K^-1 I^T r`` with a sparse matrix ``K`` for each component.

    Attributes
    ----------
    x : (n, dim) float64
        Positions of the own unknowns of the matrices.
    matrices : list of Triplets
        The matrix of all components, or one of each.
    inverse_diagonal : (n_owned, 1) float64
        ``1 / d``.
    most : int
        Largest number of iterations.
    direct : dict
        Largest number of unknowns for which a matrix is factored, by dimension.
    """

    direct: Mapping[int, int]
    x: Float
    matrices: list[Triplets]
    inverse_diagonal: Float
    most: int

    @abstractmethod
    def __init__(self, system: ConformingSystem, families: Families) -> None: ...

    @abstractmethod
    def restrict(self, values: Float) -> Float:
        """Compute ``I^T r`` (n, dim) of the own unknowns from values (n_owned, dim) (collective)."""

    @abstractmethod
    def interpolate(self, values: Float) -> Float:
        """Compute ``I v`` (n_owned, dim) from values (n, dim) of the own unknowns (collective)."""


class OfNearest(NearInverse):
    """The system itself if points have few members, such as sectors; otherwise that of nearest neighbours only.

    No simpler matrix approximates the system of points with few members. Otherwise it is the system of one point per
    particle with near members only. A row then has about 25 entries in 2D and 85 in 3D, for any horizon.

    Parameters
    ----------
    system : ConformingSystem
        The system.
    families : Families
        Bonds of the own particles.

    Notes
    -----
    Construction is collective.
    """

    most, direct = MOST, DIRECT

    def __init__(self, system: ConformingSystem, families: Families) -> None:
        self._cloud = cloud = system.cloud
        dim, n, operator = cloud.dim, cloud.n_owned, system.operator
        self.x, self.inverse_diagonal = cloud.x[:n], np.zeros((n, 1))
        if system.mean_members <= FEW[dim]:
            found = self._of_points(operator.owner, operator.point_ptr, operator.members, operator.volume)
        else:
            reach, every = np.zeros(n), np.ones(len(families.neighbours), dtype=bool)
            reach_kernel(dim, 2 * dim)(families.indptr, families.neighbours, every, cloud.x, reach)
            near = families.lengths(cloud.x) <= NEAR * reach[families.centres]
            counts = np.bincount(families.centres[near], minlength=n)
            ptr = starts_of(counts + 1)
            members = np.insert(families.neighbours[near], ptr[:-1] - np.arange(n), np.arange(n))
            found = self._of_points(np.arange(n), ptr, members, cloud.volume[:n])
        rows, columns = cloud.row[found.row], cloud.row[found.col]
        self.matrices = [Triplets(rows, columns, found.data)]
        if len(cloud.sign):
            sign = np.ones((cloud.n_local, dim))
            sign[n:] = cloud.sign
            turned = sign[found.row] * sign[found.col] * found.data[:, None]
            self.matrices = [Triplets(rows, columns, turned[:, component]) for component in range(dim)]

    def restrict(self, values: Float) -> Float:
        return values

    def interpolate(self, values: Float) -> Float:
        return values

    def _of_points(
        self, owner: LocalIndex | GlobalIndex, ptr: GlobalIndex, members: LocalIndex, W: Float
    ) -> scipy.sparse.coo_matrix:
        """Return ``C (I - Phi M^-1 Phi^T) C^T`` for points with these owners, members and volumes."""
        cloud, dim, points = self._cloud, self._cloud.dim, len(owner)
        M = np.empty((points, dim + 1, dim + 1))
        linear_moments_kernel(dim)(ptr, members, cloud.x, cloud.local_horizon[owner], M)
        low, axes = np.linalg.eigh(M)
        keep = low > 1e-12 * low[:, -1:]
        root = axes * np.where(keep, 1.0 / np.sqrt(np.where(keep, low, 1.0)), 0.0)[:, None, :]
        of = row_of_entries(ptr)
        xi = (cloud.x[members] - cloud.x[owner[of]]) / cloud.local_horizon[owner[of], None]
        phi = np.concatenate([np.ones((len(of), 1)), xi], axis=1)
        D = W[of, None] * np.einsum("ea,eab->eb", phi, root[of])
        width, n = dim + 1, cloud.n_local
        columns = (of[:, None] * width + np.arange(width)).ravel()
        shared = scipy.sparse.csr_matrix((D.ravel(), (np.repeat(members, width), columns)), shape=(n, width * points))
        diagonal = np.bincount(members, W[of] ** 2, n)
        found = scipy.sparse.csr_matrix((diagonal, (np.arange(n), np.arange(n))), shape=(n, n)) - shared @ shared.T
        return scipy.sparse.coo_matrix(found)


class OnGrid(NearInverse):
    """The diagonal of the system, and the curvature of functions on a background grid.

    The system resists waves shorter than two horizons like its diagonal. For longer waves its energy is that of a
    plate, a quadratic form of the second derivatives of the multipliers. Here it is

    ``sum_q sum_m e_qm (u_q+m - 2 u_q + u_q-m)^2 / w_m^4 + sum_e sum_mn e_emn (D_m D_n u)^2 / (w_m w_n)^2``

    over nodes ``q`` and elements ``e`` of cells of width ``w``, with the mean difference ``D_m`` of the faces of an
    element. ``e_qm`` and ``e_emn`` are the energies of ``x_m^2 / 2`` and ``x_m x_n`` near the node and in the element,
    so that the energy of these functions is exact.

    Parameters
    ----------
    system : ConformingSystem
        The system.
    families : Families
        Bonds of the own particles.

    Notes
    -----
    Construction is collective.
    """

    most, direct = MOST_ON_GRID, DIRECT_ON_GRID

    def __init__(self, system: ConformingSystem, families: Families) -> None:
        self._cloud = cloud = system.cloud
        self._n, self._dim = cloud.n_owned, cloud.dim
        nearest = cloud.local_horizon[: self._n].copy()
        nearest_neighbours(families.indptr, families.neighbours, cloud.x, nearest)
        spacing = float(total(cloud.comm, float(nearest.sum()))) / cloud.n_global
        every, free = np.empty(0, dtype=bool), np.ones((cloud.n_rows, cloud.dim), dtype=bool)
        width = max(cloud.horizon, LEAST_WIDTH * spacing)
        self._grid = grid = BackgroundGrid(cloud, families, every, width, free)
        self.x = grid.own_positions
        own = (grid.numbers >= grid.first) & (grid.numbers < grid.first + len(self.x))
        others = np.flatnonzero(~own[: grid.n_local])
        owner, there = owners(cloud.comm, grid.first, grid.numbers[others])
        # Own nodes first, then those of others by their rank.
        self._order = np.concatenate([np.flatnonzero(own), others])
        self._halo = Halo(cloud.comm, len(self.x), owner.astype(np.int32), there.astype(np.int32))
        self.inverse_diagonal = 1.0 / system.diagonal[:, None]
        self.matrices = self._curvature(system.energies, grid.cells.width / cloud.horizon)

    def restrict(self, values: Float) -> Float:
        """Compute the sums over the particles, ``sum_i N_q(x_i) r_i``."""
        virtual = np.zeros((self._cloud.n_virtual, self._dim))
        nodal = self._grid.restrict(np.concatenate([values, virtual]))[self._order]
        self._halo.reverse(nodal)
        return np.asarray(nodal[: len(self.x)])

    def interpolate(self, values: Float) -> Float:
        """Compute the values of the particles, ``sum_q N_q(x_i) v_q``."""
        nodal = np.zeros((len(self._grid.numbers), self._dim))
        nodal[self._order] = self._halo.with_ghosts(values)
        return self._grid.interpolate(nodal)[: self._n]

    def _curvature(self, energies: Float, width: Float) -> list[Triplets]:
        """Return the matrix of second derivatives, for each component if there are mirror planes (collective).

        ``energies`` (n_owned, functions) are those of ``x_m^2 / 2``, then of ``x_m x_n``.
        """
        grid, dim, n = self._grid, self._dim, len(self.x)
        node, held = grid.numbers[grid.corners], grid.held[grid.corners]
        at_nodes = grid.sums(np.ascontiguousarray(energies[:, :dim]))[self._order]
        self._halo.reverse(at_nodes)
        in_elements = np.zeros((len(node), energies.shape[1]))
        sum_in_elements(grid.element, energies, in_elements)
        # Neighbours of each node along each axis, at its owner: node, axis and side, neighbour, what holds the latter.
        lines = []
        for m in range(dim):
            low = np.flatnonzero(grid.cells.corners[:, m] == 0)
            for side, (here, there) in enumerate([(low + (1 << m), low), (low, low + (1 << m))]):
                bits = held[:, there] @ (1 << np.arange(dim))
                same = np.full(node[:, here].size, 2 * m + side)
                lines.append(np.stack([node[:, here].ravel(), same, node[:, there].ravel(), bits.ravel()], axis=1))
        sent = np.concatenate(lines).astype(np.int64)
        (found,), _ = exchange(self._cloud.comm, owners(self._cloud.comm, grid.first, sent[:, 0])[0], [sent])
        known, index = np.unique(np.concatenate([grid.first + np.arange(n), found[:, 2]]), return_inverse=True)
        own, other = np.split(index.reshape(-1), [n])
        holds = np.zeros((len(known), dim), dtype=bool)
        holds[own], holds[other] = grid.held[self._order[:n]], found[:, 3:] >> np.arange(dim) & 1
        middle = scipy.sparse.csr_matrix((np.full(n, 2.0), (np.arange(n), own)), shape=(n, len(known)))
        parts: list[Differences] = []
        for m in range(dim):
            sides: list[scipy.sparse.csr_matrix] = []
            present: list[Mask] = []
            for side in range(2):
                of = found[:, 1] == 2 * m + side
                each = scipy.sparse.csr_matrix(
                    (np.ones(of.sum()), (found[of, 0] - grid.first, other[of])), shape=middle.shape
                )
                count = np.asarray(each.sum(axis=1)).ravel()
                present.append(count > 0)
                sides.append(scipy.sparse.diags(1.0 / np.maximum(count, 1.0)) @ each)
            # The image of the neighbour is on the other side of a mirror plane.
            mirrored = holds[own, m] & (present[0] ^ present[1])
            mean = scipy.sparse.diags(1.0 + mirrored) @ (sides[0] + sides[1])
            weight = np.where((present[0] & present[1]) | mirrored, at_nodes[:n, m] / width[m] ** 4, 0.0)
            # An odd component is zero on its plane, and so is its second derivative across.
            odd = mirrored[:, None] & (np.arange(dim) == m)
            parts.append(Differences(mean - middle, np.where(odd, 0.0, weight[:, None]), known, holds))
        upper = 2.0 * grid.cells.corners - 1.0
        corners = grid.corners.ravel(), 2**dim * np.arange(len(node) + 1)
        for at, (m, k) in enumerate(combinations(range(dim), 2), dim):
            twist = np.tile(upper[:, m] * upper[:, k] / 2.0 ** (dim - 2), len(node))
            matrix = scipy.sparse.csr_matrix((twist, *corners), shape=(len(node), len(grid.numbers)))
            weight = np.repeat(in_elements[:, at, None] / (width[m] * width[k]) ** 2, dim, axis=1)
            parts.append(Differences(matrix, weight, grid.numbers, grid.held))
        return [_sum_of_squares(parts, c) for c in range(dim if len(self._cloud.sign) else 1)]


class Differences(NamedTuple):
    """Store differences ``T u`` of the values of nodes, and their weights.

    Attributes
    ----------
    T : (n, n_columns) sparse
        Coefficients.
    weight : (n, dim) float64
        Weight of each for each component.
    numbers : (n_columns,) int64
        Global number of the node of each column.
    held : (n_columns, dim) bool
        Components that a mirror plane holds there.
    """

    T: scipy.sparse.csr_matrix
    weight: Float
    numbers: GlobalIndex
    held: Mask


def _sum_of_squares(parts: Sequence[Differences], component: int) -> Triplets:
    """Return the matrix of ``sum w (T u)^2`` for a component."""
    found = []
    for T, weight, numbers, held in parts:
        free = T @ scipy.sparse.diags(1.0 - held[:, component])
        product = scipy.sparse.coo_matrix(free.T @ scipy.sparse.diags(weight[:, component]) @ free)
        found.append((numbers[product.row], numbers[product.col], product.data))
    return Triplets(*(np.concatenate(part) for part in zip(*found, strict=True)))


def near_inverses(system: ConformingSystem) -> Sequence[type[NearInverse]]:
    """Return the approximations that suit a system, the fastest first (collective)."""
    cloud = system.cloud
    here = cloud.local_horizon[: cloud.n_owned]
    widest = largest(cloud.comm, here, initial=0.0)
    narrowest = smallest(cloud.comm, here)
    alike = widest <= UNIFORM * narrowest
    return [OnGrid, OfNearest] if cloud.dim > 1 and alike and system.mean_members > ENOUGH else [OfNearest]
