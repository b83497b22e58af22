"""Coarse space of a two-level preconditioner: a background grid with cells one horizon wide."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
import scipy

from pdpetsc.arrays import Float, GlobalIndex, LocalIndex, Mask
from pdpetsc.discrete.communicator import Comm, exchange, offset, total
from pdpetsc.discrete.components import rigid_at
from pdpetsc.discrete.families import Families, with_pairs
from pdpetsc.kernels.background import (
    add_at,
    add_elements,
    interpolate_kernel,
    join_corners,
    join_within_cells,
    restrict_kernel,
    scalar_values,
    sum_in_elements,
    tied_kernel,
)
from pdpetsc.kernels.point_blocks import definite
from pdpetsc.kernels.sparsity import scalar_rows
from pdpetsc.problem.assembly import Filler
from pdpetsc.problem.problem import Problem
from pdpetsc.problem.scales import nearest_distances
from pdpetsc.problem.state import State

# Smallest width of a cell over the distance of neighbours, for a horizon with few particles.
LEAST_WIDTH = 2.0
# A body thinner than this share of a cell lies in the middle of one cell of this relative width.
THINNEST = 0.5
# Smallest modulus, as a share of that of a particle with such a diagonal block. Without it, a particle whose family is
# too flat for a gradient would have no stiffness, although gradients of others hold it.
WEAK = 0.1
# Additional stiffness of every element, as a share of its modulus, against rotations and modes that no bond resists.
# The springs of loose particles are stiffer.
FLOOR = 1e-9
# Largest number of nodes, so that node numbers are exact integers. Cells are wider if parts of the body are far apart.
MOST = 2.0**48
# Elements per block of the assembly.
CHUNK = 4096


@dataclass(frozen=True)
class Cells:
    """Store the boxes of equal size that cover a body.

    The boxes fit a periodic cell exactly, and start at mirror planes.

    Attributes
    ----------
    low, width : (dim,) float64
        Origin of the first cell, and side lengths of each cell [length].
    count : (dim,) int64
        Number of cells in every direction.
    periodic : (dim,) bool
        Whether the last cell in a direction is adjacent to the first.
    """

    low: Float
    width: Float
    count: GlobalIndex
    periodic: Mask

    @classmethod
    def of(cls, problem: Problem) -> Cells:
        """Build cells about one horizon wide over the particles of all ranks (collective)."""
        cloud = problem.body.cloud
        x, dim = cloud.x[: cloud.n_owned], cloud.dim
        spacing = float(total(cloud.comm, float(nearest_distances(problem.body).sum()))) / cloud.n_global
        wanted = max(cloud.horizon, LEAST_WIDTH * spacing)
        ends = np.array(cloud.comm.allgather((x.min(axis=0, initial=np.inf), x.max(axis=0, initial=-np.inf))))
        low, high = ends[:, 0].min(axis=0), ends[:, 1].max(axis=0)
        bound = np.zeros((2, dim), dtype=bool)
        periodic = np.zeros(dim, dtype=bool)
        for axis, at in cloud.places.planes.items():
            side = int(low[axis] + high[axis] < 2.0 * at)
            bound[side, axis] = True
            (high if side else low)[axis] = at
        if cloud.images is not None:
            cell = cloud.images.cell
            for axis in cell.periodic:
                periodic[axis] = True
                low[axis], high[axis] = cell.origin[axis], cell.origin[axis] + cell.lengths[axis]
        size = high - low
        count = np.maximum(np.rint(size / wanted), 1.0)
        while np.prod(count + 1.0) > MOST:
            count = np.maximum(np.floor(0.5 * count), 1.0)
        count = count.astype(np.int64)
        width = np.where(periodic, size / count, np.maximum(size / count, THINNEST * wanted))
        spare = count * width - size
        low = low - np.where(bound[0], 0.0, np.where(bound[1], spare, 0.5 * spare))
        return cls(low, width, count, periodic)

    def locate(self, x: Float) -> tuple[GlobalIndex, Float]:
        """Return the cell of points (n, dim) and their positions in it, (n, dim) in [0, 1]."""
        place = (x - self.low) / self.width
        cell = np.clip(np.floor(place), 0, self.count - 1).astype(np.int64)
        return cell, np.clip(place - cell, 0.0, 1.0)

    @property
    def corners(self) -> GlobalIndex:
        """Return for each corner of a cell whether it is the upper one in every direction (2^dim, dim), 0 or 1."""
        dim = len(self.count)
        return np.asarray((np.arange(2**dim)[:, None] >> np.arange(dim)) & 1)

    def nodes(self, cell: GlobalIndex) -> GlobalIndex:
        """Return the numbers of the nodes at the corners of cells (n, 2^dim)."""
        node = cell[:, None, :] + self.corners
        node = np.where(self.periodic, node % self.count, node)
        return np.asarray(np.ravel_multi_index(tuple(np.moveaxis(node, -1, 0)), tuple(self.count + 1)))

    @property
    def n_nodes(self) -> int:
        """Return the number of node numbers."""
        return int(np.prod(self.count + 1))

    def positions(self, nodes: GlobalIndex) -> Float:
        """Return the positions of nodes (n, dim) [length]."""
        return np.asarray(self.low + self.width * np.stack(np.unravel_index(nodes, tuple(self.count + 1)), axis=-1))

    def stiffness(self) -> Float:
        """Compute ``mean of dN_p/dx_m dN_q/dx_n`` over a cell, (n_corners^2, dim^2) [1 / length^2]."""
        dim, upper = len(self.count), self.corners
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
                found[:, :, m, n] = value / (self.width[m] * self.width[n])
        return found.reshape(4**dim, dim**2)


class BackgroundGrid(Filler):
    """Provide linear finite elements on cells one horizon wide, as coarse space for the tangent of a body.

    ``u_i = sum_q N_q(x_i) U_q`` in reference positions. An element consists of the particles in one cell that bonds
    connect. Elements in neighbouring cells share the node between them if bonds connect them there; both sides of a
    crack have separate nodes.

    The stiffness is ``sum_e int B^T D_e B``. The moduli ``D_e`` are the sum over the particles of the element,
    distributed evenly over its cell. In every uniform deformation the energy is that of the body, for any scheme,
    materials and damage. Prescribed degrees of freedom do not move with the nodes; a node resists their motion as the
    particle itself would.

    In a periodic cell nodes repeat. The virtual unknowns are additional nodes, which strain the elements across the
    sides of the cell. Nodes on a mirror plane do not leave it.

    Parameters
    ----------
    problem : Problem
        The problem.

    Attributes
    ----------
    first, n_own, n_global : int
        Number of the first own node, number of own nodes, and number of all nodes; virtual unknowns last.
    numbers : (n_nodes,) int64
        Global numbers of the nodes that move particles of this rank; virtual unknowns are last.

    Notes
    -----
    Construction, ``fill`` and ``rigid_modes`` are collective; the others are not.
    """

    def __init__(self, problem: Problem) -> None:
        self.problem = problem
        cloud = problem.body.cloud
        self._cloud, self._dim = cloud, cloud.dim
        self.cells = cells = Cells.of(problem)
        damage = problem.bond_damage
        kept = np.empty(0, dtype=bool) if damage is None else damage.bonds.intact
        bonds, kept = with_pairs(problem.body.families.connecting_families, kept, problem.joined)
        cell, self._at = cells.locate(cloud.x[: cloud.n_owned])
        element, of_element = self._elements(bonds, kept, cell)
        own_elements = np.unique(element[: cloud.n_owned])
        number, own_nodes = self._numbers(bonds, kept, element, of_element, own_elements)
        # Remove nodes that move no own particle.
        used, corners = np.unique(number[own_elements], return_inverse=True)
        self._corners = corners.reshape(len(own_elements), -1).astype(np.int32)
        self._element = np.searchsorted(own_elements, element[: cloud.n_owned]).astype(np.int32)
        own_cells = of_element[own_elements]
        self._wraps = cells.periodic & (own_cells == cells.count - 1)
        self._lengths = cells.count * cells.width
        self._own_positions = cells.positions(own_nodes)
        self.n_own = len(own_nodes) + cloud.n_virtual
        self.first = offset(cloud.comm, self.n_own)
        self.n_global = int(total(cloud.comm, self.n_own))
        virtual = self.n_global - cloud.n_virtual_global + np.arange(cloud.n_virtual_global)
        self.numbers: GlobalIndex = np.concatenate([used, virtual])
        self._n_virtual = cloud.n_virtual_global
        grid_node = np.empty(len(used), dtype=np.int64)
        grid_node[self._corners] = cells.nodes(own_cells)
        self._held = np.concatenate([self._on_planes(grid_node), np.zeros((self._n_virtual, self._dim), dtype=bool)])
        self._free = ~problem.supports.fixed
        self._strains = self._strain_of_virtual()
        self._set_pattern()

    def rehearse(self, state: State) -> None:
        """Fill the matrix once, and interpolate from particles to nodes and back (collective)."""
        tangent = self.problem.linearised(state)
        blocks = tangent.point_blocks()
        definite(blocks, 0.0)
        self.fill(tangent.stiffness(), blocks, np.einsum("pii->pi", blocks), 1.0)
        self.interpolate(self.restrict(state.u))

    def interpolate(self, nodal: Float) -> Float:
        """Interpolate nodal displacements (n_nodes, dim) to the unknowns (n_rows, dim); prescribed ones are zero."""
        cloud, n = self._cloud, self._cloud.n_owned
        u = np.empty((cloud.n_rows, self._dim))
        nodal = np.where(self._held, 0.0, nodal)
        strain = np.zeros((self._dim, self._dim))
        if self._n_virtual:
            virtual = nodal[-self._n_virtual :]
            strain = np.tensordot(virtual.ravel(), self._strains, axes=1)
            if cloud.n_virtual:
                u[n:] = virtual
        data = self._element, self._at, self._corners, self._wraps, self._lengths
        interpolate_kernel(self._dim)(*data, nodal, strain, u[:n])
        return np.asarray(u * self._free)

    def restrict(self, f: Float) -> Float:
        """Compute the share of this rank of nodal forces (n_nodes, dim) from forces on unknowns (n_rows, dim)."""
        cloud, n = self._cloud, self._cloud.n_owned
        f = f * self._free
        nodal, moment = np.zeros((len(self.numbers), self._dim)), np.zeros((self._dim, self._dim))
        data = self._element, self._at, self._corners, self._wraps, self._lengths
        restrict_kernel(self._dim)(*data, f[:n], nodal, moment)
        if self._n_virtual:
            virtual = np.einsum("vab,ab->v", self._strains, moment).reshape(-1, self._dim)
            nodal[-self._n_virtual :] = virtual + (f[n:] if cloud.n_virtual else 0.0)
        nodal[self._held] = 0.0
        return nodal

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
        n_elements = len(self._corners)
        sums = np.zeros((n_elements, dim**4))
        sum_in_elements(self._element, np.ascontiguousarray(D).reshape(len(D), -1), sums)
        sums = sums.reshape(n_elements, *(dim,) * 4)
        weak = self._weak(D, diagonal)
        floor = FLOOR * np.abs(np.einsum("eikik->e", sums)) / dim**2
        for i in range(dim):
            for k in range(dim):
                sums[:, i, k, i, k] += floor + 0.5 * weak
                sums[:, i, k, k, i] += 0.5 * weak
        sums = sums.transpose(0, 2, 4, 1, 3).reshape(n_elements, dim**2, dim**2) / scale
        integrals = self.cells.stiffness()
        tied, ties = self._ties(blocks, diagonal, scale)
        of = self._element[tied]
        values = np.zeros((self._n_blocks, dim, dim))
        for begin in range(0, n_elements, CHUNK):
            part = slice(begin, begin + CHUNK)
            K = (integrals @ sums[part]).reshape(-1, n_corners, n_corners, dim, dim)
            some = slice(*np.searchsorted(of, [begin, begin + CHUNK]))
            tied_kernel(dim)(tied[some], self._element, self._at, ties[some], begin, K)
            add_elements(self._slots[part], K, values)
            wrapped = np.flatnonzero(self._across[part])
            if len(wrapped):
                across = np.searchsorted(self._across_elements, begin + wrapped)
                add_elements(self._across_slots[across], self._with_virtual(begin + wrapped, K[wrapped]), values)
        return self._complete(values)

    def rigid_modes(self) -> Float:
        """Return the rigid motions of the body at the own nodes (n_own, dim, modes), zero for virtual unknowns."""
        modes = rigid_at(self._cloud, self._own_positions)
        return np.concatenate([modes, np.zeros((self._cloud.n_virtual, *modes.shape[1:]))])

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

    def _elements(self, families: Families, kept: Mask, cell: GlobalIndex) -> tuple[LocalIndex, GlobalIndex]:
        """Return the element of every local particle, -1 for mirror images, and the cell of each (collective)."""
        cloud = self._cloud
        of = np.zeros(cloud.n_local, dtype=np.int64)
        of[: cloud.n_owned] = np.ravel_multi_index(tuple(cell.T), tuple(self.cells.count))
        cloud.halo.forward(of)
        mirrored = cloud.places.behind(cloud.place) > 0
        of[mirrored] = -1
        parent = np.arange(cloud.n_local, dtype=np.int32)
        join_within_cells(families.indptr, families.neighbours, kept, of, parent)
        label = cloud.gid.copy()
        while True:
            least = np.full(cloud.n_local, np.iinfo(np.int64).max)
            np.minimum.at(least, parent, label)
            new = least[parent]
            cloud.halo.forward(new)
            changed = np.any(new != label)
            label = new
            if int(total(cloud.comm, int(changed))) == 0:
                break
        here = np.flatnonzero(~mirrored)
        self._labels, first, number = np.unique(label[here], return_index=True, return_inverse=True)
        element = np.full(cloud.n_local, -1, dtype=np.int32)
        element[here] = number.reshape(-1)
        cells = np.stack(np.unravel_index(of[here[first]], tuple(self.cells.count)), axis=-1)
        return element, cells.astype(np.int64)

    def _numbers(
        self, families: Families, kept: Mask, element: LocalIndex, cell: GlobalIndex, own: GlobalIndex
    ) -> tuple[GlobalIndex, GlobalIndex]:
        """Return the global node number at every corner of the elements, and the nodes that this rank holds.

        Each number of the grid is assigned to a rank, which compares the corners there. Corners that a rank has joined
        are one node, and so are corners of the same element on several ranks. The lowest rank with a particle at the
        node holds it (collective).
        """
        cloud = self._cloud
        nodes = self.cells.nodes(cell)
        n_corners = nodes.shape[1]
        parent = np.arange(nodes.size, dtype=np.int64)
        order = np.argsort(element[: cloud.n_owned], kind="stable")
        join_corners(families.indptr, families.neighbours, kept, order, element, nodes, parent)
        here = np.zeros(len(nodes), dtype=bool)
        here[own] = True
        question = np.stack(
            [nodes.ravel(), np.repeat(self._labels, n_corners), parent, np.repeat(here, n_corners)], axis=1
        ).astype(np.int64)
        comm = cloud.comm
        keeper = question[:, 0] * comm.size // self.cells.n_nodes
        held = np.empty(0, dtype=np.int64)

        def number_nodes(asked: GlobalIndex, _: GlobalIndex) -> GlobalIndex:
            nonlocal held
            order = np.argsort(asked, kind="stable")
            held = asked[order]
            numbers = np.empty(len(asked), dtype=np.int64)
            numbers[order] = offset(comm, len(asked)) + np.arange(len(asked))
            return numbers

        def one_of_each(asked: GlobalIndex, source: GlobalIndex) -> GlobalIndex:
            count, copy = _joined(asked, source)
            holder = np.full(count, comm.size, dtype=np.int64)
            there = asked[:, 3] > 0
            np.minimum.at(holder, copy[there], source[there])
            node = np.empty(count, dtype=np.int64)
            node[copy] = asked[:, 0]
            return _ask(comm, holder, node, number_nodes)[copy]

        number = _ask(comm, keeper, question, one_of_each)
        return number.reshape(nodes.shape), held

    def _on_planes(self, nodes: GlobalIndex) -> Mask:
        """Return which components of nodes of the grid (n, dim) a mirror plane holds."""
        held = np.zeros((len(nodes), self._dim), dtype=bool)
        x = self.cells.positions(nodes)
        for axis, at in self._cloud.places.planes.items():
            held[:, axis] = np.abs(x[:, axis] - at) < 1e-6 * self.cells.width[axis]
        return held

    def _strain_of_virtual(self) -> Float:
        """Return the mean strain per virtual unknown (n_virtual * dim, dim, dim) [1 / length]."""
        images, dim = self._cloud.images, self._dim
        strains = np.zeros((self._n_virtual * dim, dim, dim))
        if images is not None:
            for v, ((a, b), size) in enumerate(zip(images.cell.components, images.sizes, strict=True)):
                strains[v, a, b] = strains[v, b, a] = 1.0 / size
        return strains

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
        return np.asarray(np.bincount(self._element, lacking, len(self._corners)), dtype=float)

    def _ties(self, blocks: Float | None, diagonal: Float, scale: float) -> tuple[GlobalIndex, Float]:
        """Return the particles with stiffness besides that of elements, ordered by element, and the block of each."""
        n, dim = self._cloud.n_owned, self._dim
        fixed = ~self._free[:n]
        found = fixed.any(axis=1)
        if blocks is not None:
            found |= blocks.any(axis=(1, 2))
        tied = np.flatnonzero(found)
        tied = tied[np.argsort(self._element[tied], kind="stable")]
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
        comm, n_nodes, n_corners = self._cloud.comm, len(self.numbers), self._corners.shape[1]
        self._across = self._wraps.any(axis=1)
        self._across_elements = np.flatnonzero(self._across)
        virtual = np.tile(n_nodes - self._n_virtual + np.arange(self._n_virtual), (len(self._across_elements), 1))
        members = np.concatenate([self._corners[self._across_elements], virtual], axis=1).astype(np.int64)
        corners = self._corners.astype(np.int64)
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
        firsts = np.array(comm.allgather(self.first), dtype=np.int64)
        self._to = np.searchsorted(firsts, row, side="right") - 1
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
        self._block_ptr: GlobalIndex = np.concatenate([[0], np.cumsum(counts)]).astype(np.int64)

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
        if self._held.any():
            free = ~self._held
            values *= free[self._block_rows][:, :, None] & free[self._block_columns][:, None, :]


def _ask(
    comm: Comm, holder: GlobalIndex, question: GlobalIndex, answers: Callable[[GlobalIndex, GlobalIndex], GlobalIndex]
) -> GlobalIndex:
    """Return the answers of the ranks ``holder`` (n,) to the rows of ``question`` (collective).

    ``answers`` is called on every rank with the questions that it received and the source rank of each.
    """
    (asked,), counts = exchange(comm, holder, [question])
    source = np.repeat(np.arange(comm.size), counts)
    (answer,), _ = exchange(comm, source, [answers(asked, source)])
    found = np.empty_like(answer)
    found[np.argsort(holder, kind="stable")] = answer
    return found


def _joined(corners: GlobalIndex, source: GlobalIndex) -> tuple[int, GlobalIndex]:
    """Return the number of nodes of corners ``(node, element, joined on its rank)`` (n, 3 or more), and their nodes."""
    _, on_rank = np.unique(source * (int(corners[:, 2].max(initial=0)) + 1) + corners[:, 2], return_inverse=True)
    order = np.lexsort((corners[:, 1], corners[:, 0]))
    new = np.any(np.diff(corners[order][:, :2], axis=0, prepend=-1) != 0, axis=1)
    of_element = np.empty(len(corners), dtype=np.int64)
    of_element[order] = np.cumsum(new) - 1
    n = len(corners)
    count_1 = int(on_rank.max(initial=-1)) + 1
    size = count_1 + int(of_element.max(initial=-1)) + 1
    graph = scipy.sparse.coo_matrix(
        (np.ones(n, dtype=np.int8), (on_rank.reshape(-1), count_1 + of_element)), shape=(size, size)
    )
    count, label = scipy.sparse.csgraph.connected_components(graph, directed=False)
    return int(count), label[on_rank.reshape(-1)].astype(np.int64)
