"""Particles from files: text clouds and finite element meshes.

Every rank reads the file and keeps its own part; only while reading does it hold more.
"""

from __future__ import annotations

import contextlib
import io
from collections.abc import Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from pdpetsc.arrays import Float
from pdpetsc.errors import CaseError
from pdpetsc.scene.particles import Arrays, Chunk, Particles

# Simplices that a cell falls into, by its corner nodes; the first node is shared, so curved nodes are left out.
_SIMPLICES: dict[str, list[tuple[int, ...]]] = {
    "line": [(0, 1)],
    "triangle": [(0, 1, 2)],
    "quad": [(0, 1, 2), (0, 2, 3)],
    "tetra": [(0, 1, 2, 3)],
    "pyramid": [(0, 1, 2, 4), (0, 2, 3, 4)],
    "wedge": [(0, 1, 2, 5), (0, 1, 5, 4), (0, 4, 5, 3)],
    "hexahedron": [(0, 1, 2, 6), (0, 2, 3, 6), (0, 3, 7, 6), (0, 7, 4, 6), (0, 4, 5, 6), (0, 5, 1, 6)],
}
_HIGHER_ORDER = {
    "line3": "line", "triangle6": "triangle", "triangle7": "triangle", "quad8": "quad", "quad9": "quad",
    "tetra10": "tetra", "hexahedron20": "hexahedron", "hexahedron27": "hexahedron", "wedge15": "wedge",
    "pyramid13": "pyramid",
}  # fmt: skip


@dataclass(frozen=True)
class TextFile(Particles):
    """Particles from a text file with lines ``x y z block volume``, as Peridigm and PeriLab use it.

    Parameters
    ----------
    path : str or Path
        Lines of ``dim`` coordinates [length], a block number and a volume; ``#`` starts a comment. A plane cloud may
        have three coordinates, of which the last is constant. Block ``b`` becomes the set ``block_b``.
    node_sets : mapping of str to str or Path
        Files with particle numbers, counted from 1 in the order of the file; each becomes a set.
    thickness : float
        Out-of-plane thickness [length] already contained in the volumes.
    """

    path: str | Path
    node_sets: Mapping[str, str | Path] = field(default_factory=dict)
    thickness: float = 1.0

    def chunk(self, part: int, parts: int) -> Chunk:
        """Return part ``part`` of ``parts`` of the file."""
        return self._arrays().chunk(part, parts)

    def _arrays(self) -> Arrays:
        table = _table(Path(self.path), float)
        if table.ndim != 2 or not 3 <= table.shape[1] <= 5:
            raise CaseError(f"{self.path} needs lines of 1 to 3 coordinates, a block number and a volume.")
        sets = {f"block_{block:g}": table[:, -2] == block for block in np.unique(table[:, -2])}
        for name, path in self.node_sets.items():
            members = np.ravel(_table(Path(path), int)).astype(np.int64) - 1
            if len(members) and (members.min() < 0 or members.max() >= len(table)):
                raise CaseError(f"{path} names particles outside 1 to {len(table)}.")
            flags = np.zeros(len(table), dtype=bool)
            flags[members] = True
            sets[name] = flags
        return Arrays(_without_constant(table[:, :-2]), table[:, -1], sets, self.thickness)


@dataclass(frozen=True)
class Mesh(Particles):
    """One particle per cell of a mesh, at the cell's centroid and with its volume.

    Parameters
    ----------
    path : str or Path
        Any format meshio reads (Gmsh, Abaqus, Exodus, VTK, ...). The cells of the highest dimension count. Physical
        groups and cell sets become named sets, unnamed groups ``group_n``, and the node sets of a mesh the sets of the
        cells with all corners in them.
    thickness : float
        Out-of-plane thickness of a plane mesh [length], or cross-section of a line mesh [length^2].
    """

    path: str | Path
    thickness: float = 1.0

    def chunk(self, part: int, parts: int) -> Chunk:
        """Return part ``part`` of ``parts`` of the cells."""
        return self._arrays().chunk(part, parts)

    def _arrays(self) -> Arrays:
        mesh = _read_mesh(Path(self.path))
        kinds = [_HIGHER_ORDER.get(block.type, block.type) for block in mesh.cells]
        dims = [len(_SIMPLICES[kind][0]) - 1 if kind in _SIMPLICES else 0 for kind in kinds]
        dim = max(dims, default=0)
        if dim == 0:
            raise CaseError(f"{self.path} has no cells that particles can be made of.")
        points = _without_constant(mesh.points, dim)
        if points.shape[1] != dim:
            raise CaseError(f"{self.path} has cells of {dim} dimensions that do not lie along the coordinate axes.")
        chosen = [b for b, cell_dim in enumerate(dims) if cell_dim == dim]
        cells = [_centroids(points, mesh.cells[b].data, kinds[b]) for b in chosen]
        counts = [len(volume) for _, volume in cells]
        sets = _cell_sets(mesh, chosen, counts)
        for name, nodes in mesh.point_sets.items():
            inside = np.zeros(len(points), dtype=bool)
            inside[np.asarray(nodes, dtype=np.int64)] = True
            sets.setdefault(name, np.concatenate([inside[mesh.cells[b].data].all(axis=1) for b in chosen]))
        volume = np.concatenate([volume for _, volume in cells]) * (self.thickness if dim < 3 else 1.0)
        return Arrays(np.concatenate([x for x, _ in cells]), volume, sets, self.thickness)


def _table(path: Path, kind: type) -> NDArray[Any]:
    try:
        return np.loadtxt(path, dtype=kind, ndmin=2)
    except OSError as error:
        raise CaseError(f"Cannot read {path}: {error.strerror or 'file not found'}.") from None
    except ValueError as error:
        raise CaseError(f"{path} is not a table of numbers: {error}.") from None


def _read_mesh(path: Path) -> Any:
    import meshio

    if not path.is_file():
        raise CaseError(f"Cannot read the mesh {path}: file not found.")
    try:
        # meshio ends the process on a file it cannot read, and prints warnings to standard output.
        with contextlib.redirect_stdout(io.StringIO()):
            return meshio.read(path)
    except (Exception, SystemExit) as error:
        raise CaseError(f"Cannot read the mesh {path}: {str(error) or type(error).__name__}.") from None


def _without_constant(x: Float, at_least: int = 1) -> Float:
    """Drop trailing coordinates that are the same for all points."""
    dim = x.shape[1]
    while dim > at_least and np.ptp(x[:, dim - 1]) <= 1e-12 * max(float(np.ptp(x)), 1e-300):
        dim -= 1
    return x[:, :dim]


def _centroids(points: Float, nodes: NDArray[Any], kind: str) -> tuple[Float, Float]:
    dim = points.shape[1]
    volume = np.zeros(len(nodes))
    moment = np.zeros((len(nodes), dim))
    for simplex in _SIMPLICES[kind]:
        corners = points[nodes[:, list(simplex)]]
        edges = corners[:, 1:] - corners[:, :1]
        part = np.linalg.det(edges) / float(np.prod(np.arange(1, dim + 1)))
        volume += part
        moment += part[:, None] * corners.mean(axis=1)
    with np.errstate(invalid="ignore", divide="ignore"):
        return moment / volume[:, None], np.abs(volume)


def _cell_sets(mesh: Any, chosen: list[int], counts: list[int]) -> dict[str, NDArray[Any]]:
    sets: dict[str, NDArray[Any]] = {}
    for name, blocks in mesh.cell_sets.items():
        if name.startswith("gmsh:"):
            continue
        flags = [np.zeros(count, dtype=bool) for count in counts]
        for flag, b in zip(flags, chosen, strict=True):
            if blocks[b] is not None:
                flag[np.asarray(blocks[b], dtype=np.int64)] = True
        joined = np.concatenate(flags)
        if joined.any():
            sets[name] = joined
    groups = mesh.cell_data.get("gmsh:physical")
    if groups is not None:
        tags = np.concatenate([np.asarray(groups[b]) for b in chosen])
        dim = mesh.cells[chosen[0]].dim
        names = {int(tag): name for name, (tag, group_dim) in mesh.field_data.items() if group_dim == dim}
        for tag in np.unique(tags):
            sets[names.get(int(tag), f"group_{tag}")] = tags == tag
    elif not mesh.cell_sets:
        block = np.repeat(np.arange(len(counts)), counts)
        for b in range(len(counts)):
            sets[f"group_{b + 1}"] = block == b
    return sets
