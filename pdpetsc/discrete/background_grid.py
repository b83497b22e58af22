"""Background grid: cells about one horizon wide over a body, and nodes that move its particles."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import scipy

from pdpetsc.arrays import Float, GlobalIndex, LocalIndex, Mask
from pdpetsc.discrete.cloud import Cloud
from pdpetsc.discrete.communicator import ask, bounds, offset, total
from pdpetsc.discrete.components import least_labels, rigid_at
from pdpetsc.discrete.families import Families
from pdpetsc.kernels.background import interpolate_kernel, join_corners, join_within_cells, restrict_kernel

# Least width of a cell over the distance of neighbours, for a horizon with few particles.
LEAST_WIDTH = 3.0
# A body thinner than this share of a cell lies in the middle of one cell of this relative width.
THINNEST = 0.5
# Largest number of nodes, so that node numbers are exact integers. Cells are wider if parts of the body are far apart.
MOST = 2.0**48


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
    def of(cls, cloud: Cloud, wanted: float) -> Cells:
        """Build cells about ``wanted`` wide [length] over the particles of all ranks (collective)."""
        x, dim = cloud.x[: cloud.n_owned], cloud.dim
        low, high = bounds(cloud.comm, x)
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


class BackgroundGrid:
    """Provide displacements that are linear in each coordinate of a cell, ``u_i = sum_q N_q(x_i) U_q``.

    An element consists of the particles in one cell that bonds connect. Elements in neighbouring cells share the node
    between them if bonds connect them there; both sides of a crack have separate nodes.

    In a periodic cell nodes repeat. The virtual unknowns are additional nodes, which strain the elements across the
    sides of the cell. Nodes on a mirror plane do not leave it.

    Parameters
    ----------
    cloud : Cloud
        The particles.
    bonds : Families
        The bonds that connect particles.
    kept : (n_bonds,) bool
        Bonds that are not broken; empty if all are kept.
    width : float
        Width of the cells [length].
    free : (n_rows, dim) bool
        Components that follow the nodes.

    Attributes
    ----------
    first, n_own, n_global : int
        Number of the first own node, number of own nodes, and number of all nodes; virtual unknowns last.
    n_local : int
        Number of nodes that move particles of this rank, without virtual unknowns.
    own_positions : (n, dim) float64
        Positions of the own nodes, without virtual unknowns [length].
    numbers : (n_nodes,) int64
        Global numbers of the nodes that move particles of this rank; virtual unknowns are last.
    element : (n_owned,) int32
        Element of each own particle.
    at : (n_owned, dim) float64
        Position of each own particle in its cell, in [0, 1].
    corners : (n_elements, 2^dim) int32
        Nodes of each element.
    held : (n_nodes, dim) bool
        Components that a mirror plane holds.

    Notes
    -----
    Construction and ``rigid_modes`` are collective; the others are not.
    """

    def __init__(self, cloud: Cloud, bonds: Families, kept: Mask, width: float, free: Mask) -> None:
        self._cloud, self._dim, self._free = cloud, cloud.dim, free
        self.cells = cells = Cells.of(cloud, width)
        cell, self.at = cells.locate(cloud.x[: cloud.n_owned])
        element, of_element = self._elements(bonds, kept, cell)
        own_elements = np.unique(element[: cloud.n_owned])
        number, own_nodes = self._numbers(bonds, kept, element, of_element, own_elements)
        # Remove nodes that move no own particle.
        used, corners = np.unique(number[own_elements], return_inverse=True)
        self.corners: LocalIndex = corners.reshape(len(own_elements), -1).astype(np.int32)
        self.element: LocalIndex = np.searchsorted(own_elements, element[: cloud.n_owned]).astype(np.int32)
        own_cells = of_element[own_elements]
        self._wraps = cells.periodic & (own_cells == cells.count - 1)
        self._lengths = cells.count * cells.width
        self.own_positions = cells.positions(own_nodes)
        self.n_own = len(own_nodes) + cloud.n_virtual
        self.first = offset(cloud.comm, self.n_own)
        self.n_global = int(total(cloud.comm, self.n_own))
        virtual = self.n_global - cloud.n_virtual_global + np.arange(cloud.n_virtual_global)
        self.numbers: GlobalIndex = np.concatenate([used, virtual])
        self.n_local = len(used)
        self._n_virtual = cloud.n_virtual_global
        grid_node = np.empty(len(used), dtype=np.int64)
        grid_node[self.corners] = cells.nodes(own_cells)
        self.held = np.concatenate([self._on_planes(grid_node), np.zeros((self._n_virtual, self._dim), dtype=bool)])
        self._strains = self._strain_of_virtual()

    def interpolate(self, nodal: Float) -> Float:
        """Interpolate nodal displacements (n_nodes, dim) to the unknowns (n_rows, dim); prescribed ones are zero."""
        cloud, n = self._cloud, self._cloud.n_owned
        u = np.empty((cloud.n_rows, self._dim))
        nodal = np.where(self.held, 0.0, nodal)
        strain = np.zeros((self._dim, self._dim))
        if self._n_virtual:
            virtual = nodal[-self._n_virtual :]
            strain = np.tensordot(virtual.ravel(), self._strains, axes=1)
            if cloud.n_virtual:
                u[n:] = virtual
        data = self.element, self.at, self.corners, self._wraps, self._lengths
        interpolate_kernel(self._dim)(*data, nodal, strain, u[:n])
        return np.asarray(u * self._free)

    def restrict(self, f: Float) -> Float:
        """Compute the share of this rank of nodal forces (n_nodes, dim) from forces on unknowns (n_rows, dim)."""
        cloud, n = self._cloud, self._cloud.n_owned
        f = f * self._free
        nodal, moment = self._sums(f[:n])
        if self._n_virtual:
            virtual = np.einsum("vab,ab->v", self._strains, moment).reshape(-1, self._dim)
            nodal[-self._n_virtual :] = virtual + (f[n:] if cloud.n_virtual else 0.0)
        nodal[self.held] = 0.0
        return nodal

    def sums(self, values: Float) -> Float:
        """Compute the share of this rank of ``sum_i N_q(x_i) v_i`` (n_nodes, dim) from values (n_owned, dim)."""
        return self._sums(values)[0]

    def _sums(self, values: Float) -> tuple[Float, Float]:
        """Compute ``sums`` and the moment of the values about the periods of their nodes (dim, dim)."""
        nodal, moment = np.zeros((len(self.numbers), self._dim)), np.zeros((self._dim, self._dim))
        data = self.element, self.at, self.corners, self._wraps, self._lengths
        restrict_kernel(self._dim)(*data, values, nodal, moment)
        return nodal, moment

    def rigid_modes(self) -> Float:
        """Return the rigid motions of the body at the own nodes (n_own, dim, modes), zero for virtual unknowns."""
        modes = rigid_at(self._cloud, self.own_positions)
        return np.concatenate([modes, np.zeros((self._cloud.n_virtual, *modes.shape[1:]))])

    def _elements(self, families: Families, kept: Mask, cell: GlobalIndex) -> tuple[LocalIndex, GlobalIndex]:
        """Return the element of every local particle, -1 for mirror images, and the cell of each (collective)."""
        cloud = self._cloud
        of = cloud.halo.with_ghosts(np.ravel_multi_index(tuple(cell.T), tuple(self.cells.count)))
        mirrored = cloud.places.behind(cloud.place) > 0
        of[mirrored] = -1
        parent = np.arange(cloud.n_local, dtype=np.int32)
        join_within_cells(families.indptr, families.neighbours, kept, of, parent)
        label = least_labels(cloud, parent)
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
            return ask(comm, holder, node, number_nodes)[copy]

        number = ask(comm, keeper, question, one_of_each)
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
