"""Particles from finite element meshes.

Every rank reads the whole file and keeps its own part of the particles.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from functools import cached_property, lru_cache
from pathlib import Path

import numpy as np

from pdpetsc.arrays import Float, GlobalIndex, Mask
from pdpetsc.declare.cells import (
    Block,
    CellFacets,
    MeshData,
    edge_lengths,
    facet_keys,
    facets,
    flat_parts,
    having,
    middles,
    on_sides,
    parts_of_facets,
    shares_of_nodes,
    tangled,
    volumes_and_moments,
    with_corners_in,
)
from pdpetsc.declare.choice import choose
from pdpetsc.declare.cracks import Crack
from pdpetsc.declare.formats import FORMATS, files_of, read_mesh
from pdpetsc.declare.particles import Arrays, Chunk, Particles, ends_of_part
from pdpetsc.declare.surface import Facets
from pdpetsc.declare.text_file import without_constant
from pdpetsc.declare.tiling import Cells
from pdpetsc.declared import Positive
from pdpetsc.errors import CaseError
from pdpetsc.machine import stamp_of

# Smallest volume of a cell over that of its bounding box [-].
NO_VOLUME = 1e-10


@dataclass(frozen=True)
class Mesh(Particles):
    """One particle per cell of a mesh, at the cell's centroid and with its volume.

    Edges with a node in their middle are parabolas, and faces with such nodes are quadratic surfaces. Volumes,
    centroids and the surface are those of the curved cells. Other edges are straight.

    Cells of the highest dimension become particles. Spheres of Exodus become particles with their volumes in the file.
    Named entities of the file become sets:

    - cell sets, element blocks and physical groups, unnamed ones as ``group_n``;
    - side sets, surfaces, and groups of boundary lines and faces: the cells that own these facets, unnamed ones as
      ``side_set_n`` or ``facets_n``; ``name facets`` if cells have the name;
    - node sets: the cells with any of these nodes, unnamed ones as ``node_set_n``; ``name nodes`` if cells or facets
      have the name.

    A set of an Abaqus part with the name of a set of the assembly is ``INSTANCE.NAME``.

    For loads on the surface the names of side sets, of boundary lines and faces and of node sets are those of facets.

    Parameters
    ----------
    path : str or Path
        A mesh of Gmsh (``.msh``), Abaqus (``.inp``), Exodus (``.e``, ``.exo``, ``.ex2``, ``.g``, ``.gen``), VTK
        (``.vtk``, ``.vtu``), Nastran (``.bdf``, ``.nas``, ``.fem``), XDMF (``.xdmf``) or MED (``.med``).
    thickness : float
        Out-of-plane thickness of a plane mesh [length], or cross-section of a line mesh [length^2].
    format : str, optional
        ``"gmsh"``, ``"abaqus"``, ``"exodus"``, ``"vtk"``, ``"vtu"``, ``"nastran"``, ``"xdmf"`` or ``"med"``; by default
        from the ending of the file.

    Examples
    --------
    >>> import pdpetsc as pd
    >>> plate = pd.Mesh("plate.msh", thickness=2.0)
    """

    path: str | Path
    thickness: Positive = 1.0
    format: str | None = None

    def __post_init__(self) -> None:
        super().__post_init__()
        if self.format is not None:
            choose("The format of a Mesh", self.format, FORMATS)

    def input_files(self) -> list[Path]:
        """Return the file of the mesh and the files that it names."""
        return files_of(Path(self.path), self.format)

    def chunk(self, part: int, parts: int) -> Chunk:
        """Return part ``part`` of ``parts`` of the cells."""
        mesh = self._read()
        if _of_spheres(mesh):
            return self._spheres(mesh).chunk(part, parts)
        body = self._body(mesh)
        volume, x = body.volumes_and_centroids(Path(self.path))
        return Arrays(x, volume * self._depth(body), body.sets, self.thickness).chunk(part, parts)

    @property
    def irregular(self) -> bool:
        """Return True unless the cells, or the dual cells of nodes, form a lattice."""
        whole = self.chunk(0, 1)
        return Arrays(whole.x, whole.volume, thickness=self.thickness).irregular

    def surface(self, part: int = 0, parts: int = 1, cracks: Sequence[Crack] = ()) -> Facets:
        """Return the facets of the cells of a part that belong to one cell only, or that a crack separates.

        Their tags are groups of boundary lines and faces, side sets, and node sets: the facets with all corners in the
        set. They have the names of the sets of particles. A name that cells have too means the facets here.
        """
        count, found = self._facets(cracks) if cracks else _whole_surface(self, stamp_of(self.path))
        return found.of_particles(*ends_of_part(part, parts, count))

    def triangles(self, part: int, parts: int) -> Float | None:
        """Return the free facets of all cells as triangles in the first part; quadrilaterals are halved."""
        mesh = self._read()
        if _of_spheres(mesh):
            return None
        body = self._body(mesh)
        if body.dim < 3:
            return None
        if part > 0:
            return np.empty((0, 3, 3))
        points, found = body.points, body.facets
        corners, area = found.corners[found.free], found.area[found.free]
        with_four = corners[:, 3] >= 0
        halves = points[np.concatenate([corners[:, :3], corners[with_four][:, [0, 2, 3]]])]
        area = np.concatenate([area, area[with_four]])
        inward = (np.cross(halves[:, 1] - halves[:, 0], halves[:, 2] - halves[:, 0]) * area).sum(axis=1) < 0.0
        halves[inward] = halves[inward][:, ::-1]
        return np.asarray(halves)

    def cells(self) -> Cells:
        """Return the cells of the mesh; a curved edge in the plane becomes two lines."""
        mesh = self._read()
        if _of_spheres(mesh):
            return super().cells()
        body = self._body(mesh)
        parts = []
        for block in body.blocks:
            inner = middles(body.points, block) if block.dim == 2 else None
            bent = np.stack([block.corners, *([] if inner is None else [inner[:, :, 0].T])], axis=2)
            parts.append(bent.reshape(len(block.nodes), -1))
        found = Cells.of(body.points, parts, np.arange(body.count))
        nodes, corners = np.unique(found.corners, return_inverse=True)
        return replace(found, points=body.points[nodes], corners=corners)

    def _facets(self, cracks: Sequence[Crack]) -> tuple[int, Facets]:
        """Return the number of particles, and the facets of all of them."""
        body = self._body(self._read())
        points, found = body.points, body.facets
        free = found.free
        if cracks:
            _, x = body.volumes_and_centroids(Path(self.path))
            one, other = found.shared
            cut = np.zeros(len(one), dtype=bool)
            for crack in cracks:
                cut |= crack.cuts(x[found.cell[one]], x[found.cell[other]])
            free[one[cut]] = free[other[cut]] = True
        at = np.flatnonzero(free)
        x, area, facet = flat_parts(points, found.corners[at], found.centre[at], found.area[at], found.middle[at])
        tags = {name: flags[at[facet]] for name, flags in body.tags.items()}
        corners = None
        if body.dim == 3 and len(facet) == len(at):  # all are flat
            turn = found.corners[at]
            corners = points[np.where(turn < 0, turn[:, [2]], turn)]
        return body.count, Facets(x, area * self._depth(body), found.cell[at[facet]], tags, corners)

    def _spheres(self, mesh: MeshData) -> Arrays:
        """Return the particles of a mesh of spheres with volumes."""
        volumes = [block.volume for block in mesh.blocks if block.volume is not None]
        volume = np.concatenate(volumes)
        wrong = np.flatnonzero(~(np.isfinite(volume) & (volume > 0.0)))
        if len(wrong):
            raise CaseError(
                f"{self.path} has a sphere with the volume {volume[wrong[0]]:g}, the number {wrong[0] + 1}."
            )
        nodes = np.concatenate([block.nodes[:, 0] for block in mesh.blocks if block.volume is not None])
        sets = {name: _flags(len(nodes), cells) for name, cells in mesh.cell_sets.items()}
        for name, members in mesh.node_sets.items():
            label = f"{name} nodes" if name in sets else name
            sets[label] = np.isin(nodes, members)
        return Arrays(mesh.points[nodes], volume, sets, self.thickness)

    def _read(self) -> MeshData:
        return read_mesh(Path(self.path), self.format)

    def _body(self, mesh: MeshData) -> _BodyMesh:
        """Return the mesh with the cells that become particles."""
        if _of_spheres(mesh):
            raise CaseError(
                f"{self.path} has spheres, which have no faces and corners. Use pd.Mesh with weights=pd.Standard(), "
                "and give tractions a normal and an area."
            )
        dim = max((block.dim for block in mesh.blocks if len(block.nodes)), default=0)
        if dim == 0:
            raise CaseError(
                f"{self.path} has no cells for particles. Save the lines, surfaces or volumes of the body with the "
                "mesh."
            )
        points = without_constant(mesh.points, dim)
        if points.shape[1] != dim:
            raise CaseError(
                f"{self.path} has cells of {dim} dimensions that are not in a plane of constant z, or on a line along "
                "x. Turn the mesh."
            )
        return _BodyMesh(mesh, points)

    def _depth(self, body: _BodyMesh) -> float:
        return self.thickness if body.dim < 3 else 1.0


@dataclass(frozen=True)
class MeshNodes(Mesh):
    """One particle per corner node of a mesh, with the volume of its dual cell; some particles are on the boundary.

    Edges are straight, and nodes between corners are left out. Simplices divide their volume equally among their
    corners, and facets their area. Prescribed displacements then act on the boundary, not half a cell inside. The sets
    are

    - cell sets, element blocks and physical groups: the corners of their cells, those on a common border in both;
    - groups of boundary lines and faces: their corners, as ``name facets`` if cells have the name;
    - side sets, surfaces: the corners of their facets, as for these groups;
    - node sets; ``name nodes`` if cells or facets have the name.

    Parameters
    ----------
    path, thickness, format
        As for ``Mesh``.

    Examples
    --------
    >>> import pdpetsc as pd
    >>> plate = pd.MeshNodes("plate.msh", thickness=2.0)
    """

    def _body(self, mesh: MeshData) -> _BodyMesh:
        """Return the same as ``Mesh``, with the corner nodes of the cells only."""
        blocks = [Block(block.kind, block.corners) for block in mesh.blocks]
        return _BodyMesh(replace(mesh, blocks=blocks), super()._body(mesh).points)

    def chunk(self, part: int, parts: int) -> Chunk:
        """Return part ``part`` of ``parts`` of the corner nodes."""
        body = self._body(self._read())
        body.volumes_and_centroids(Path(self.path))  # refuses cells without volume
        nodes, volume = shares_of_nodes(body.points, body.blocks)
        sets = body.node_sets(nodes)
        found = Arrays(body.points[nodes], volume * self._depth(body), sets, self.thickness).chunk(part, parts)
        rows = slice(*ends_of_part(part, parts, len(nodes)))
        return replace(found, spacing=edge_lengths(body.points, body.blocks)[nodes][rows])

    on_surface = True

    def cells(self) -> Cells:
        """Return the cells of the mesh, with particles at their corners."""
        return replace(super().cells(), particle=None)

    def _facets(self, cracks: Sequence[Crack]) -> tuple[int, Facets]:
        """Return the number of nodes, and the parts of the free facets of the cells that belong to them.

        Raises
        ------
        CaseError
            There are cracks: the faces between the dual cells are unknown.
        """
        if cracks:
            raise CaseError(
                "cracks= needs pd.Mesh: pd.MeshNodes has no faces of cracks, which loads without a normal and "
                "conforming weights need."
            )
        body = self._body(self._read())
        found = body.facets
        free = np.flatnonzero(found.free)
        node, x, area, facet, outline = parts_of_facets(body.points, found.corners[free], found.area[free])
        nodes, _ = shares_of_nodes(body.points, body.blocks)
        tags = {name: flags[free[facet]] for name, flags in body.tags.items()}
        corners = outline if body.dim == 3 else None
        return len(nodes), Facets(x, area * self._depth(body), np.searchsorted(nodes, node), tags, corners)


def _of_spheres(mesh: MeshData) -> bool:
    """Return True if all cells of a mesh are spheres with volumes."""
    blocks = [block for block in mesh.blocks if len(block.nodes)]
    return bool(blocks) and all(block.volume is not None for block in blocks)


@lru_cache(maxsize=4)
def _whole_surface(mesh: Mesh, version: tuple[int, ...] | None) -> tuple[int, Facets]:
    """Return the number of particles, and the facets of all of them without cracks.

    The result is cached while the file has the same ``version``, because every traction needs it.
    """
    return mesh._facets(())


@dataclass(frozen=True)
class _Named:
    """Named entities of a mesh, by their names for regions.

    Attributes
    ----------
    cells : dict of str to (n,) int64
        Particles.
    behind : dict of str to (n,) int64
        Particles of named facets.
    facets : dict of str to (n_facets,) bool
        Flags of named facets.
    nodes : dict of str to (n,) int64
        Named nodes, as rows of the points.
    """

    cells: dict[str, GlobalIndex]
    behind: dict[str, GlobalIndex]
    facets: dict[str, Mask]
    nodes: dict[str, GlobalIndex]


@dataclass(frozen=True)
class _BodyMesh:
    """A mesh whose cells of the highest dimension become particles.

    Attributes
    ----------
    mesh : MeshData
        All cells.
    points : (n_points, dim) float64
        Its points in the dimension of the body [length].
    """

    mesh: MeshData
    points: Float

    @property
    def dim(self) -> int:
        """Return the number of coordinates."""
        return int(self.points.shape[1])

    @cached_property
    def blocks(self) -> list[Block]:
        """Return the cells that become particles."""
        return [block for block in self.mesh.blocks if block.dim == self.dim]

    @property
    def count(self) -> int:
        """Return the number of these cells."""
        return sum(len(block.nodes) for block in self.blocks)

    @cached_property
    def facets(self) -> CellFacets:
        """Return all facets of these cells."""
        return facets(self.points, self.blocks)

    def volumes_and_centroids(self, path: Path) -> tuple[Float, Float]:
        """Return the volumes (n,) and centroids (n, dim) of the cells of a file.

        Raises
        ------
        CaseError
            A cell has no volume, is inverted, or is there twice.
        """
        volumes, centroids = [], []
        for kind in {block.kind for block in self.blocks}:
            corners = np.sort(np.concatenate([block.corners for block in self.blocks if block.kind == kind]), axis=1)
            twice = len(corners) - len(np.unique(corners, axis=0))
            if twice:
                raise CaseError(
                    f"{path} has {twice} cells twice, as files of Gmsh 2.2 have cells in two groups. Save them once, "
                    f"or in format 4.1."
                )
        for block in self.blocks:
            with np.errstate(all="ignore"):
                volume, moment = volumes_and_moments(self.points, block)
                box = np.prod(np.ptp(self.points[block.corners], axis=1), axis=1)
                x = moment / volume[:, None]
                none = np.flatnonzero(~((np.abs(volume) > NO_VOLUME * box) & np.isfinite(x).all(axis=1)))
                wrong = np.flatnonzero(tangled(self.points, block))
            if len(wrong) and not len(none):
                raise CaseError(
                    f"{len(wrong)} cells of kind {block.kind} in {path} are inverted at a corner, the first at "
                    f"{self.points[block.corners[wrong[0]]].mean(axis=0)}. Reorder their nodes, or repair the mesh."
                )
            if len(none):
                raise CaseError(
                    f"{len(none)} cells of kind {block.kind} in {path} have no volume, the first at "
                    f"{self.points[block.corners[none[0]]].mean(axis=0)}. Remove them, or repair the mesh."
                )
            volumes.append(np.abs(volume))
            centroids.append(x)
        return np.concatenate(volumes), np.concatenate(centroids)

    @property
    def sets(self) -> dict[str, Mask]:
        """Return the sets of particles: by cells, by facets and by nodes."""
        members = dict(self.named.cells | self.named.behind)
        for name, nodes in self.named.nodes.items():
            inside = _flags(len(self.points), nodes)
            members[name] = np.flatnonzero(np.concatenate([inside[block.nodes].any(axis=1) for block in self.blocks]))
        return {name: _flags(self.count, particles) for name, particles in members.items() if len(particles)}

    @property
    def tags(self) -> dict[str, Mask]:
        """Return flags of the facets for each name of facets or nodes."""
        named = self.named
        tags = {name: with_corners_in(nodes, self.facets) for name, nodes in named.nodes.items()}
        return tags | {name.removesuffix(" facets"): flags for name, flags in named.facets.items()} | named.facets

    def node_sets(self, nodes: GlobalIndex) -> dict[str, Mask]:
        """Return flags of corner nodes for each set of cells, facets or nodes."""
        members = dict(self.named.nodes)
        for name, cells in self.named.cells.items():
            members[name] = np.concatenate(
                [np.ravel(block.corners[mine]) for block, mine in _by_block(self.blocks, cells)]
            )
        for name, flags in self.named.facets.items():
            corners = np.ravel(self.facets.corners[flags])
            members[name] = corners[corners >= 0]
        found = {name: _flags(len(self.points), of)[nodes] for name, of in members.items()}
        return {name: flags for name, flags in found.items() if flags.any()}

    @cached_property
    def named(self) -> _Named:
        """Return the named entities."""
        mesh, number = self.mesh, self._particles()
        cells, behind, flags = dict[str, GlobalIndex](), dict[str, GlobalIndex](), dict[str, Mask]()
        nodes: dict[str, list[GlobalIndex]] = {name: [members] for name, members in mesh.node_sets.items()}
        for name, members in mesh.cell_sets.items():
            own = number[members][number[members] >= 0]
            if len(own):
                cells[name] = own

        def add(name: str, particles: GlobalIndex, on: Mask) -> None:
            label = f"{name} facets" if name in cells else name
            behind[label] = np.concatenate([behind.get(label, particles[:0]), particles])
            flags[label] = flags.get(label, False) | on

        for name, members in mesh.cell_sets.items():
            for block, mine in _by_block(mesh.blocks, members):
                if len(mine) and block.dim == self.dim - 1:
                    on = having(facet_keys(block.corners[mine]), self.facets)
                    add(name, self.facets.cell[on], on)
                elif len(mine) and block.dim < self.dim - 1:
                    nodes.setdefault(name, []).append(np.ravel(block.nodes[mine]))
        for name, sides in mesh.side_sets.items():
            particle, place = number[sides[:, 0]], sides[:, 1]
            mine = particle >= 0
            add(name, particle[mine], on_sides(particle[mine], place[mine], self.facets))
        if not cells:
            belongs = np.repeat(np.arange(len(self.blocks)), [len(block.nodes) for block in self.blocks])
            for b in range(len(self.blocks)):
                if f"group_{b + 1}" not in behind:
                    cells[f"group_{b + 1}"] = np.flatnonzero(belongs == b)
        taken = {name for name, particles in (cells | behind).items() if len(particles)}
        labels = {name: f"{name} nodes" if name in taken else name for name in nodes}
        return _Named(cells, behind, flags, {labels[name]: np.concatenate(parts) for name, parts in nodes.items()})

    def _particles(self) -> GlobalIndex:
        """Return the particle of every cell of the file, -1 for cells of lower dimension."""
        blocks = self.mesh.blocks
        own = np.repeat([block.dim == self.dim for block in blocks], [len(block.nodes) for block in blocks])
        return np.where(own, np.cumsum(own) - 1, -1)


def _by_block(blocks: Sequence[Block], cells: GlobalIndex) -> Iterator[tuple[Block, GlobalIndex]]:
    """Yield each block with those of the cells that are in it, numbered from its first one on."""
    start = 0
    for block in blocks:
        end = start + len(block.nodes)
        yield block, cells[(cells >= start) & (cells < end)] - start
        start = end


def _flags(count: int, members: GlobalIndex) -> Mask:
    flags = np.zeros(count, dtype=bool)
    flags[members] = True
    return flags
