"""Cells of finite element meshes: volumes, centroids, facets and the free surface."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray

from pdpetsc.arrays import Float, GlobalIndex, Mask, twins
from pdpetsc.declare import curved

# Simplices that a cell is divided into, by its corner nodes.
SIMPLICES: dict[str, list[tuple[int, ...]]] = {
    "line": [(0, 1)],
    "triangle": [(0, 1, 2)],
    "quad": [(0, 1, 2), (0, 2, 3)],
    "tetra": [(0, 1, 2, 3)],
    "pyramid": [(0, 1, 2, 4), (0, 2, 3, 4)],
    "wedge": [(0, 1, 2, 5), (0, 1, 5, 4), (0, 4, 5, 3)],
    "hexahedron": [(0, 1, 2, 6), (0, 2, 3, 6), (0, 3, 7, 6), (0, 7, 4, 6), (0, 4, 5, 6), (0, 5, 1, 6)],
}


def _turned(ways: list[tuple[int, ...]], turn: tuple[int, ...], times: int) -> list[list[tuple[int, ...]]]:
    """Return simplices whose corners are turned once, twice and so on by a rotation of the cell onto itself."""
    found = [ways]
    for _ in range(times):
        found.append([tuple(turn[corner] for corner in simplex) for simplex in found[-1]])
    return found[1:]


# Other ways that a cell falls into simplices: no diagonal is better than another.
_OTHER_WAYS: dict[str, list[list[tuple[int, ...]]]] = {
    "quad": _turned(SIMPLICES["quad"], (1, 2, 3, 0), 1),
    "pyramid": _turned(SIMPLICES["pyramid"], (1, 2, 3, 0, 4), 1),
    "wedge": _turned(SIMPLICES["wedge"], (1, 2, 0, 4, 5, 3), 2),
    "hexahedron": _turned(SIMPLICES["hexahedron"], (1, 2, 3, 0, 5, 6, 7, 4), 3),
}
# Facets of a cell by its corner nodes, outward where the volume of its simplices is positive.
FACETS: dict[str, list[tuple[int, ...]]] = {
    "line": [(0,), (1,)],
    "triangle": [(0, 1), (1, 2), (2, 0)],
    "quad": [(0, 1), (1, 2), (2, 3), (3, 0)],
    "tetra": [(0, 2, 1), (0, 1, 3), (1, 2, 3), (0, 3, 2)],
    "pyramid": [(0, 3, 2, 1), (0, 1, 4), (1, 2, 4), (2, 3, 4), (3, 0, 4)],
    "wedge": [(0, 2, 1), (3, 4, 5), (0, 1, 4, 3), (1, 2, 5, 4), (2, 0, 3, 5)],
    "hexahedron": [(0, 3, 2, 1), (4, 5, 6, 7), (0, 1, 5, 4), (1, 2, 6, 5), (2, 3, 7, 6), (3, 0, 4, 7)],
}
# Corners with the ends of the edges there, right-handed in a cell of positive volume; at the tip of a pyramid those of
# the four tetrahedra that its base falls into.
_AT_CORNERS: dict[str, list[tuple[int, list[tuple[int, ...]]]]] = {
    "quad": [(0, [(1, 3)]), (1, [(2, 0)]), (2, [(3, 1)]), (3, [(0, 2)])],
    "pyramid": [(0, [(1, 3, 4)]), (1, [(2, 0, 4)]), (2, [(3, 1, 4)]), (3, [(0, 2, 4)])],
    "wedge": [
        (0, [(1, 2, 3)]), (1, [(2, 0, 4)]), (2, [(0, 1, 5)]), (3, [(5, 4, 0)]), (4, [(3, 5, 1)]), (5, [(4, 3, 2)]),
    ],
    "hexahedron": [
        (0, [(1, 3, 4)]), (1, [(2, 0, 5)]), (2, [(3, 1, 6)]), (3, [(0, 2, 7)]),
        (4, [(7, 5, 0)]), (5, [(4, 6, 1)]), (6, [(5, 7, 2)]), (7, [(6, 4, 3)]),
    ],
}  # fmt: skip
CORNERS = {"vertex": 1, "line": 2, "triangle": 3, "quad": 4, "tetra": 4, "pyramid": 5, "wedge": 6, "hexahedron": 8}
DIMENSION = {"vertex": 0, "line": 1, "triangle": 2, "quad": 2, "tetra": 3, "pyramid": 3, "wedge": 3, "hexahedron": 3}
# Corners of a facet at most.
_WIDTH = 4
# A face with four corners is flat where one is this near to the plane of its diagonals, as a share of their length.
_FLAT = 1e-10


@dataclass(frozen=True)
class Block:
    """Cells of one kind.

    Attributes
    ----------
    kind : str
        A key of ``CORNERS``.
    nodes : (n, m) int64
        Rows of the points, corners first.
    volume : (n,) float64, optional
        Of cells of one node that are spheres with a volume of their own [length^3].
    """

    kind: str
    nodes: GlobalIndex
    volume: Float | None = None

    @property
    def corners(self) -> GlobalIndex:
        """Return the corner nodes (n, n_corners)."""
        return self.nodes[:, : CORNERS[self.kind]]

    @property
    def dim(self) -> int:
        """Return the dimension of the cells."""
        return DIMENSION[self.kind]


@dataclass(frozen=True)
class MeshData:
    """A mesh as its file has it.

    Attributes
    ----------
    points : (n_points, 1 to 3) float64
        Where the nodes are [length].
    blocks : list of Block
        All cells, also those of boundaries; they are numbered through all blocks.
    cell_sets : mapping of str to (n,) int64
        Named sets of cells.
    side_sets : mapping of str to (n, 2) int64
        Named sets of facets: the cell of each, and which of the ``FACETS`` of its kind it is; -1 for the cell itself,
        such as a side of a shell, or where the file does not say.
    node_sets : mapping of str to (n,) int64
        Named sets of nodes.
    """

    points: Float
    blocks: list[Block]
    cell_sets: Mapping[str, GlobalIndex] = field(default_factory=dict)
    side_sets: Mapping[str, GlobalIndex] = field(default_factory=dict)
    node_sets: Mapping[str, GlobalIndex] = field(default_factory=dict)


def volumes_and_moments(points: Float, block: Block) -> tuple[Float, Float]:
    """Return signed volumes (n,) and first moments (n, dim) of the cells.

    Edges with a node in their middle are the parabolas through it, faces the surfaces of the shape functions; edges
    without one are straight, and faces with four corners then bilinear surfaces. All are the same for both neighbours,
    flat or not: ``V = 1/dim oint x . da`` and ``int x_a dV = 1/2 oint x_a^2 da_a`` are integrated exactly.
    """
    dim = points.shape[1]
    volume = np.zeros(len(block.nodes))
    moment = np.zeros((len(block.nodes), dim))
    inner = middles(points, block)
    if inner is not None:
        low = points[block.nodes[:, 0]]
        for corners, middle in zip(FACETS[block.kind], inner, strict=True):
            x, area = curved.quadrature(points, block.nodes[:, list(corners)], middle, degree=2)
            x = x - low[:, None]
            volume += np.einsum("nqa,nqa->n", x, area) / dim
            moment += 0.5 * (x**2 * area).sum(axis=1)
        return volume, moment + volume[:, None] * low
    if any(len(corners) == _WIDTH for corners in FACETS[block.kind]):
        low = points[block.nodes[:, 0]]
        for corners in FACETS[block.kind]:
            x, area = _quadrature(points[block.nodes[:, list(corners)]] - low[:, None])
            volume += np.einsum("nqa,nqa->n", x, area) / 3.0
            moment += 0.5 * (x**2 * area).sum(axis=1)
        return volume, moment + volume[:, None] * low
    for simplex in SIMPLICES[block.kind]:
        corners_of = points[block.nodes[:, list(simplex)]]
        edges = corners_of[:, 1:] - corners_of[:, :1]
        part = np.linalg.det(edges) / float(np.prod(np.arange(1, dim + 1)))
        volume += part
        moment += part[:, None] * corners_of.mean(axis=1)
    return volume, moment


def middles(points: Float, block: Block) -> GlobalIndex | None:
    """Return the nodes within the facets of quadratic cells (n_facets, n, 5), None where all of them are straight.

    Raises
    ------
    CaseError
        They are in no known order.
    """
    if block.dim < 2 or points.shape[1] != block.dim:
        return None
    found = curved.middles(points, block.kind, block.nodes, CORNERS[block.kind], FACETS[block.kind])
    for corners, middle in zip(FACETS[block.kind], found, strict=True):
        wide = np.pad(block.nodes[:, list(corners)], ((0, 0), (0, _WIDTH - len(corners))), constant_values=-1)
        if curved.bent(points, wide, middle).any():
            return found
    return None


def tangled(points: Float, block: Block) -> Mask:
    """Return which cells are turned inside out somewhere (n,): their nodes are in a wrong order, or moved too far.

    The sign of the volume that the edges at a corner span is that of the cell at every corner; a plane cell may have
    one corner that points inward. Corners whose edges lie in a plane, as of collapsed cells, do not count.
    """
    x = points[block.corners]
    if block.kind in ("line", "vertex", "triangle", "tetra"):
        return np.zeros(len(x), dtype=bool)
    spans = []
    for corner, others in _AT_CORNERS[block.kind]:
        for three in others:
            edges = x[:, list(three)] - x[:, [corner]]
            size = np.prod(np.linalg.norm(edges, axis=2), axis=1)
            span = np.linalg.det(edges)
            spans.append(np.where(np.abs(span) > _FLAT * size, np.sign(span), 0.0))
    signs = np.stack(spans, axis=1)
    fewer = np.minimum((signs > 0.0).sum(axis=1), (signs < 0.0).sum(axis=1))
    return np.asarray(fewer > (1 if block.dim == 2 else 0))


def _quadrature(x: Float) -> tuple[Float, Float]:
    """Return points (n, q, 3) and vector areas (n, q, 3) at them, exact on faces with corners (n, 3 or 4, 3).

    Of triangles for quadratic functions, in the middles of the edges; of bilinear surfaces for products of cubic ones.
    Those of the latter are one near each corner, in turn.
    """
    if x.shape[1] == 3:
        area = 0.5 * np.cross(x[:, 1] - x[:, 0], x[:, 2] - x[:, 0])
        return 0.5 * (x + np.roll(x, -1, axis=1)), np.repeat(area[:, None] / 3.0, 3, axis=1)
    signs = np.array([[-1.0, -1.0], [1.0, -1.0], [1.0, 1.0], [-1.0, 1.0]])
    places, areas = [], []
    for at, to in signs / np.sqrt(3.0):
        N = 0.25 * (1.0 + at * signs[:, 0]) * (1.0 + to * signs[:, 1])
        along = np.einsum("k,nki->ni", 0.25 * signs[:, 0] * (1.0 + to * signs[:, 1]), x)
        across = np.einsum("k,nki->ni", 0.25 * signs[:, 1] * (1.0 + at * signs[:, 0]), x)
        places.append(np.einsum("k,nki->ni", N, x))
        areas.append(np.cross(along, across))
    return np.stack(places, axis=1), np.stack(areas, axis=1)


def shares_of_nodes(points: Float, blocks: list[Block]) -> tuple[GlobalIndex, Float]:
    """Return the nodes that are corners of cells, ascending, and the volumes of their dual cells.

    A simplex gives every corner the same share; other cells fall into simplices, in several ways at once.
    """
    volume = np.zeros(len(points))
    used = np.zeros(len(points), dtype=bool)
    for block in blocks:
        used[np.ravel(block.corners)] = True
        whole = volumes_and_moments(points, block)[0]
        share = np.zeros(block.corners.shape)
        for way in [SIMPLICES[block.kind], *_OTHER_WAYS.get(block.kind, [])]:
            for simplex in way:
                corners = points[block.nodes[:, list(simplex)]]
                share[:, list(simplex)] += np.linalg.det(corners[:, 1:] - corners[:, :1])[:, None]
        share *= (np.abs(whole) / share.sum(axis=1))[:, None]
        volume += np.bincount(np.ravel(block.corners), np.ravel(share), len(points))
    nodes = np.flatnonzero(used)
    return nodes, volume[nodes]


def edge_lengths(points: Float, blocks: list[Block]) -> Float:
    """Return the mean length of the edges of cells that meet at each point (n_points,) [length], 0 where none does."""
    ends = []
    for block in blocks:
        pairs = {(a, b) for face in FACETS[block.kind] for a, b in zip(face, (*face[1:], face[0]), strict=True)}
        pairs = {(0, 1)} if block.kind == "line" else {(min(pair), max(pair)) for pair in pairs}
        ends += [np.sort(block.nodes[:, list(pair)], axis=1) for pair in sorted(pairs)]
    edges = np.unique(np.concatenate(ends), axis=0)
    # Collapsed cells have edges from a node to itself.
    edges = edges[edges[:, 0] < edges[:, 1]]
    length = np.linalg.norm(points[edges[:, 1]] - points[edges[:, 0]], axis=1)
    count = np.bincount(edges.ravel(), minlength=len(points))
    sums = np.bincount(edges.ravel(), np.repeat(length, 2), len(points))
    return np.asarray(sums / np.maximum(count, 1))


def flat_parts(
    points: Float, corners: GlobalIndex, x: Float, area: Float, middle: GlobalIndex
) -> tuple[Float, Float, GlobalIndex]:
    """Return facets as they are, and several points in the place of those that are not flat or straight.

    Parameters
    ----------
    corners : (n, 4) int64
        Nodes of facets in turn, followed by -1 where there are fewer than four.
    x, area : (n, dim) float64
        Centroids and vector areas.
    middle : (n, 5) int64
        Nodes within quadratic facets, -1 where there are none.

    Returns
    -------
    x, area, facet
        Centroids and vector areas (n_parts, dim), and the facet (n_parts,) of each: ``sum x (x) a`` is that of the
        bilinear or quadratic surface.
    """
    round_ = curved.bent(points, corners, middle)
    bent = _warped(points, corners) & ~round_
    as_is = ~(bent | round_)
    places, areas, facet = [x[as_is]], [area[as_is]], [np.flatnonzero(as_is)]
    count = (corners >= 0).sum(axis=1)

    def add(rows: GlobalIndex, at: Float, of: Float) -> None:
        places.append(at.reshape(-1, x.shape[1]))
        areas.append((_signs(of, area[rows])[:, None, None] * of).reshape(-1, x.shape[1]))
        facet.append(np.repeat(rows, at.shape[1]))

    for m in (2, 3, 4):
        rows = np.flatnonzero(round_ & (count == m))
        if len(rows):
            add(rows, *curved.quadrature(points, corners[rows, :m], middle[rows], degree=1))
    if bent.any():
        add(np.flatnonzero(bent), *_quadrature(points[corners[bent]]))
    return np.concatenate(places), np.concatenate(areas), np.concatenate(facet)


def _signs(parts: Float, area: Float) -> Float:
    """Return 1 for facets whose parts (n, q, dim) add up along their vector areas (n, dim), else -1 (n,)."""
    return np.where((parts.sum(axis=1) * area).sum(axis=1) < 0.0, -1.0, 1.0)


def _warped(points: Float, corners: GlobalIndex) -> Mask:
    """Return which facets have four corners that do not lie in a plane (n,)."""
    found = np.zeros(len(corners), dtype=bool)
    if points.shape[1] < 3:
        return found
    square = np.flatnonzero((corners >= 0).all(axis=1))
    x = points[corners[square]]
    one, other = x[:, 2] - x[:, 0], x[:, 3] - x[:, 1]
    off = np.abs(np.einsum("ni,ni->n", np.cross(one, other), x[:, 1] - x[:, 0]))
    size = np.maximum(np.linalg.norm(one, axis=1), np.linalg.norm(other, axis=1))
    found[square] = off > _FLAT * size**3
    return found


def parts_of_facets(
    points: Float, corners: GlobalIndex, area: Float
) -> tuple[GlobalIndex, Float, Float, GlobalIndex, Float]:
    """Return the parts of facets that belong to the dual cells of their corners.

    Parameters
    ----------
    corners : (n, 4) int64
        Nodes of facets in turn, followed by -1 where there are fewer than four.
    area : (n, dim) float64
        Their vector areas.

    Returns
    -------
    nodes, x, area, facet, outline
        Corner (n_parts,), centroid (n_parts, dim), vector area (n_parts, dim) and facet (n_parts,) of every part, and
        its corners in turn (n_parts, 4, dim): the corner, the middle of the facet and those of two edges.
    """
    count = (corners >= 0).sum(axis=1)
    nodes, centres, areas, facet, outlines = [], [], [], [], []
    # Share of the corner, and of each other one, in the centroid of the part next to it.
    for m, own, other in ((1, 1.0, 0.0), (2, 3.0 / 4.0, 1.0 / 4.0), (3, 22.0 / 36.0, 7.0 / 36.0)):
        of = np.flatnonzero(count == m)
        x = points[corners[of, :m]]
        for corner in range(m):
            nodes.append(corners[of, corner])
            centres.append((own - other) * x[:, corner] + other * x.sum(axis=1))
            areas.append(area[of] / m)
            facet.append(of)
            outlines.append(_quarter(x, corner))
    of = np.flatnonzero(count == _WIDTH)
    if len(of):
        x = points[corners[of]]
        bent = _warped(points, corners[of])[:, None]
        at, part = _quadrature(x)
        sign = _signs(part, area[of])
        for corner in range(_WIDTH):
            quarter = _quarter(x, corner)
            nodes.append(corners[of, corner])
            centres.append(np.where(bent, at[:, corner], _centroid(quarter)))
            areas.append(sign[:, None] * np.where(bent, part[:, corner], _vector_area(quarter, 0)))
            facet.append(of)
            outlines.append(quarter)
    of_parts = np.concatenate(nodes), np.concatenate(centres), np.concatenate(areas), np.concatenate(facet)
    return *of_parts, np.concatenate(outlines)


def _quarter(x: Float, corner: int) -> Float:
    """Return the part (n, 4, dim) of facets with corners (n, m, dim) that belongs to one of them, its corners in turn.

    It is between the corner, the middles of its edges and that of the facet.
    """
    m = x.shape[1]
    after, before = (0.5 * (x[:, corner] + x[:, (corner + step) % m]) for step in (1, -1))
    return np.stack([x[:, corner], after, x.mean(axis=1), before], axis=1)


@dataclass(frozen=True)
class CellFacets:
    """All facets of cells, those of one cell one after another; cells count through the blocks.

    Attributes
    ----------
    key : (n_facets, 4) int64
        The corner nodes ascending, -1 in front where there are fewer: equal for facets of neighbours.
    cell : (n_facets,) int64
        The cell that each belongs to.
    area : (n_facets, dim) float64
        Outward vector areas; lengths in the plane, 1 on a line.
    centre : (n_facets, dim) float64
        Centroids.
    corners : (n_facets, 4) int64
        The corner nodes in turn, followed by -1 where there are fewer.
    place : (n_facets,) int64
        Which of the ``FACETS`` of its cell each is.
    middle : (n_facets, 5) int64
        Nodes within quadratic facets, in the middles of edges in turn and one within, -1 where there are none.
    """

    key: GlobalIndex
    cell: GlobalIndex
    area: Float
    centre: Float
    corners: GlobalIndex
    place: GlobalIndex
    middle: GlobalIndex

    @property
    def shared(self) -> tuple[GlobalIndex, GlobalIndex]:
        """Return the facets that two cells share, as seen from the one and from the other (n, ) each."""
        return twins(self.key)

    @property
    def free(self) -> Mask:
        """Return which facets belong to one cell only (n_facets,)."""
        found = np.ones(len(self.key), dtype=bool)
        found[np.concatenate(self.shared)] = False
        return found


def facets(points: Float, blocks: list[Block]) -> CellFacets:
    """Return the facets of cells that fill their space.

    Parameters
    ----------
    points : (n, dim) float64
        Where the nodes are [length].
    blocks : list of Block
        Cells of dimension ``dim``.
    """
    keys, cells, areas, centres, turns, places, within = [], [], [], [], [], [], []
    before = 0
    for block in blocks:
        number = before + np.arange(len(block.nodes))
        before += len(number)
        sign = np.where(volumes_and_moments(points, block)[0] < 0.0, -1.0, 1.0)
        inner = middles(points, block)
        for place, corners in enumerate(FACETS[block.kind]):
            nodes = block.nodes[:, list(corners)]
            keys.append(facet_keys(nodes))
            turns.append(np.pad(nodes, ((0, 0), (0, _WIDTH - nodes.shape[1])), constant_values=-1))
            cells.append(number)
            areas.append(sign[:, None] * _vector_area(points[nodes], place))
            centres.append(_centroid(points[nodes]))
            places.append(np.full(len(number), place))
            none = np.full((len(number), curved.MIDDLES), -1)
            within.append(none if inner is None else inner[place])
    return CellFacets(
        np.concatenate(keys),
        np.concatenate(cells),
        np.concatenate(areas),
        np.concatenate(centres),
        np.concatenate(turns),
        np.concatenate(places),
        np.concatenate(within),
    )


def facet_keys(nodes: NDArray[np.int64]) -> GlobalIndex:
    """Return the nodes of facets (n, m) ascending and each once, filled up with -1 to four."""
    key = np.full((len(nodes), _WIDTH), -1, dtype=np.int64)
    key[:, : nodes.shape[1]] = nodes
    key.sort(axis=1)
    # A face of a collapsed cell is one of fewer corners, as its neighbour has it.
    key[:, 1:][key[:, 1:] == key[:, :-1]] = -1
    key.sort(axis=1)
    return key


def having(wanted: GlobalIndex, surface: CellFacets) -> Mask:
    """Return which facets have one of the wanted keys (n, 4)."""
    both = np.concatenate([wanted, surface.key])
    _, inverse = np.unique(both, axis=0, return_inverse=True)
    number = np.ravel(inverse)
    asked = np.zeros(number.max(initial=0) + 1, dtype=bool)
    asked[number[: len(wanted)]] = True
    return np.asarray(asked[number[len(wanted) :]])


def on_sides(cell: GlobalIndex, place: GlobalIndex, surface: CellFacets) -> Mask:
    """Return which facets are at these places of these cells (n,) each; none at a place -1."""
    width = 1 + max(len(corners) for corners in FACETS.values())
    return np.asarray(np.isin(surface.cell * width + surface.place, (cell * width + place)[place >= 0]))


def with_corners_in(nodes: GlobalIndex, surface: CellFacets) -> Mask:
    """Return which facets have all their corners among nodes (n,)."""
    return np.asarray((np.isin(surface.corners, nodes) | (surface.corners < 0)).all(axis=1))


def _centroid(x: Float) -> Float:
    """Return the centroids (n, dim) of facets with corners (n, m, dim); of two triangles where there are four."""
    if x.shape[1] < 4:
        return np.asarray(x.mean(axis=1))
    halves = [x[:, [0, 1, 2]], x[:, [0, 2, 3]]]
    sizes = [np.linalg.norm(np.cross(half[:, 1] - half[:, 0], half[:, 2] - half[:, 0]), axis=1) for half in halves]
    share = (sizes[0] / np.maximum(sizes[0] + sizes[1], np.finfo(float).tiny))[:, None]
    return np.asarray(share * halves[0].mean(axis=1) + (1.0 - share) * halves[1].mean(axis=1))


def _vector_area(x: Float, place: int) -> Float:
    """Return the vector areas (n, dim) of facets with corners (n, m, dim); ``place`` tells the ends of a line apart."""
    dim = x.shape[2]
    if dim == 1:
        return np.full((len(x), 1), -1.0 if place == 0 else 1.0)
    if dim == 2:
        along = x[:, 1] - x[:, 0]
        return np.stack([along[:, 1], -along[:, 0]], axis=1)
    # The cross product of the diagonals is the vector area of a quadrilateral, flat or not.
    one, other = (x[:, 1] - x[:, 0], x[:, 2] - x[:, 0]) if x.shape[1] == 3 else (x[:, 2] - x[:, 0], x[:, 3] - x[:, 1])
    return np.asarray(0.5 * np.cross(one, other))
