"""Exodus II meshes: element blocks, node sets and side sets with their names or numbers."""

from __future__ import annotations

import re
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from pdpetsc.arrays import Float, GlobalIndex
from pdpetsc.declare.cells import CORNERS, Block, MeshData
from pdpetsc.errors import CaseError

# The sides of an element, from 1 on, as indices in ``FACETS``; Exodus II manual, table of side set nodes.
_SIDES = {
    "line": [0, 1], "triangle": [0, 1, 2], "quad": [0, 1, 2, 3], "tetra": [1, 2, 3, 0], "pyramid": [1, 2, 3, 4, 0],
    "wedge": [2, 3, 4, 0, 1], "hexahedron": [2, 3, 4, 5, 0, 1], "vertex": [],
}  # fmt: skip
# Kinds by the letters that an element type begins with; the corners come first whatever its order.
_KINDS = {
    "HEX": "hexahedron", "TET": "tetra", "WED": "wedge", "PYR": "pyramid", "TRI": "triangle", "QUA": "quad",
    "SHE": "quad", "BAR": "line", "BEA": "line", "TRU": "line", "ROD": "line", "EDG": "line", "SPH": "vertex",
    "NOD": "vertex", "POI": "vertex", "CIR": "vertex",
}  # fmt: skip


def read(path: Path) -> MeshData:
    """Read an Exodus file.

    Unnamed blocks become ``group_n``, unnamed node sets ``node_set_n`` and side sets ``side_set_n`` with their numbers.

    Raises
    ------
    CaseError
        The file lacks coordinates or has elements of unknown type, or netCDF4 is not installed.
    """
    try:
        import netCDF4
    except ImportError:
        raise CaseError("reading Exodus needs netCDF4; install pdpetsc[exodus]") from None
    with netCDF4.Dataset(str(path)) as file:
        file.set_auto_mask(False)
        variables = file.variables
        blocks, groups, start = [], {}, 0
        shell = []
        points = _points(variables)
        for number, name in _listed(file, "num_el_blk", "eb", "group"):
            if f"connect{number}" not in variables:
                continue
            connect = variables[f"connect{number}"]
            word = str(getattr(connect, "elem_type", "")).upper()
            block = _block(word, np.asarray(connect[:]))
            if block.kind == "vertex":
                block = Block(block.kind, block.nodes, _volumes(variables, number, len(block.nodes)))
            # Shells, and triangles in space, have their two faces before their edges.
            shell.append(word.startswith("SHE") or (word.startswith("TRI") and points.shape[1] == 3))
            groups[name] = start + np.arange(len(block.nodes))
            start += len(block.nodes)
            blocks.append(block)
        return MeshData(
            points, blocks, groups, _sides(file, blocks, shell),
            _sets(file, "num_node_sets", "ns", "node_set", "node_ns"),
        )  # fmt: skip


def _points(variables: Any) -> Float:
    if "coord" in variables:
        return np.asarray(variables["coord"][:], dtype=float).T
    axes = [axis for axis in "xyz" if f"coord{axis}" in variables]
    if not axes:
        raise CaseError("it has no coordinates")
    return np.stack([np.asarray(variables[f"coord{axis}"][:], dtype=float) for axis in axes], axis=1)


def _block(word: str, nodes: NDArray[Any]) -> Block:
    kind = _KINDS.get(word[:3])
    if kind is None or nodes.ndim != 2 or nodes.dtype.kind not in "iu":
        raise CaseError(f"it has elements of type {word!r}, which particles cannot be made of")
    if kind == "quad" and nodes.shape[1] in (3, 6, 7):
        kind = "triangle"
    if nodes.shape[1] < CORNERS[kind]:
        raise CaseError(f"elements of type {word!r} have {nodes.shape[1]} nodes")
    return Block(kind, nodes.astype(np.int64) - 1)


def _volumes(variables: Any, number: int, count: int) -> Float | None:
    """Return the volumes of spheres: the attribute of that name, else the second one, after the radius; else None."""
    if f"attrib{number}" not in variables:
        return None
    attributes = np.asarray(variables[f"attrib{number}"][:], dtype=float)
    names = variables[f"attrib_name{number}"][:] if f"attrib_name{number}" in variables else []
    words = [_text(name).lower() for name in names]
    place = words.index("volume") if "volume" in words else 1
    if attributes.ndim != 2 or len(attributes) != count or attributes.shape[1] <= place:
        return None
    return attributes[:, place]


def _sets(file: Any, dimension: str, short: str, word: str, variable: str) -> dict[str, GlobalIndex]:
    """Return the sets by name; members count from 0."""
    found = {}
    for number, name in _listed(file, dimension, short, word):
        if f"{variable}{number}" in file.variables:
            found[name] = np.unique(np.asarray(file.variables[f"{variable}{number}"][:]).astype(np.int64) - 1)
    return found


def _sides(file: Any, blocks: list[Block], shell: list[bool]) -> dict[str, GlobalIndex]:
    """Return the side sets by name: cells, counted from 0, and indices of facets (n, 2).

    Raises
    ------
    CaseError
        An element does not have a side.
    """
    starts = np.cumsum([0, *(len(block.nodes) for block in blocks)])
    found = {}
    for number, name in _listed(file, "num_side_sets", "ss", "side_set"):
        if f"elem_ss{number}" not in file.variables:
            continue
        cells = np.asarray(file.variables[f"elem_ss{number}"][:]).astype(np.int64) - 1
        places = np.full(len(cells), -1)
        if f"side_ss{number}" in file.variables:
            sides = np.asarray(file.variables[f"side_ss{number}"][:]).astype(np.int64)
            if sides.shape != cells.shape:
                raise CaseError(f"side set {name!r} has {len(cells)} elements and {len(sides)} sides")
            for block, start, is_shell in zip(blocks, starts, shell, strict=False):
                mine = np.flatnonzero((cells >= start) & (cells < start + len(block.nodes)))
                known = np.array([-1, -1] * is_shell + _SIDES[block.kind], dtype=np.int64)
                wrong = mine[(sides[mine] < 1) | (sides[mine] > len(known))]
                if len(wrong):
                    raise CaseError(f"side set {name!r} has side {sides[wrong[0]]} of a {block.kind}")
                places[mine] = known[sides[mine] - 1]
        found[name] = np.unique(np.stack([cells, places], axis=1), axis=0)
    return found


def _listed(file: Any, dimension: str, short: str, word: str) -> list[tuple[int, str]]:
    """Return (position from 1 on, name) of the blocks or sets; names are unique."""
    count = len(file.dimensions[dimension]) if dimension in file.dimensions else 0
    ids = [*np.ravel(file.variables[f"{short}_prop1"][:])] if f"{short}_prop1" in file.variables else []
    texts = file.variables[f"{short}_names"][:] if f"{short}_names" in file.variables else []
    listed: list[tuple[int, str]] = []
    taken: set[str] = set()
    for k in range(count):
        # Numbers start at 1; some writers leave 0.
        number = int(ids[k]) if k < len(ids) and ids[k] > 0 else k + 1
        name = _text(texts[k]) if k < len(texts) else ""
        if not name or name in taken:
            name = f"{name or word}_{number}"
        if name in taken:
            raise CaseError(f"two of its sets or blocks have the name {name!r}")
        taken.add(name)
        listed.append((k + 1, name))
    return listed


def _text(characters: Any) -> str:
    raw = b"".join(np.ravel(np.asarray(characters, dtype="S1")).tolist())
    return re.sub(r"[^\x20-\x7e]", "", raw.split(b"\0")[0].decode("latin-1")).strip()
