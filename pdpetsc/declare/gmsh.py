"""Gmsh meshes of format 4.1, text and binary.

This reader replaces meshio's, which refuses files with entities in no physical group, and drops all but the first of
the unnamed groups of an entity.
"""

from __future__ import annotations

import re
from abc import ABC, abstractmethod
from pathlib import Path
from typing import BinaryIO

import numpy as np
from numpy.typing import NDArray

from pdpetsc.arrays import Float, GlobalIndex, Lookup
from pdpetsc.declare.cells import Block, MeshData
from pdpetsc.errors import CaseError

# Kind and number of nodes of an element type.
_TYPES = {
    1: ("line", 2), 2: ("triangle", 3), 3: ("quad", 4), 4: ("tetra", 4), 5: ("hexahedron", 8), 6: ("wedge", 6),
    7: ("pyramid", 5), 8: ("line", 3), 9: ("triangle", 6), 10: ("quad", 9), 11: ("tetra", 10), 12: ("hexahedron", 27),
    13: ("wedge", 18), 14: ("pyramid", 14), 15: ("vertex", 1), 16: ("quad", 8), 17: ("hexahedron", 20),
    18: ("wedge", 15), 19: ("pyramid", 13),
}  # fmt: skip
_NAME = re.compile(rb'^\s*(\d+)\s+(-?\d+)\s+"(.*)"\s*$')


class _Numbers(ABC):
    """The numbers of a section, read in turn."""

    @abstractmethod
    def read(self, count: int, binary: str, text: type) -> NDArray[np.generic]:
        """Return the next numbers, of kind ``binary`` in binary files and of type ``text`` in text files."""

    def ints(self, count: int) -> GlobalIndex:
        """Return integers of 4 bytes."""
        return self.read(count, "<i4", int).astype(np.int64)

    def sizes(self, count: int) -> GlobalIndex:
        """Return counts and tags of 8 bytes."""
        return self.read(count, "<u8", int).astype(np.int64)

    def reals(self, count: int) -> Float:
        """Return floating-point numbers."""
        return self.read(count, "<f8", float).astype(np.float64)


class _Binary(_Numbers):
    def __init__(self, file: BinaryIO, end: bytes) -> None:
        self._file = file

    def read(self, count: int, binary: str, text: type) -> NDArray[np.generic]:
        _refuse_negative(count)
        kind = np.dtype(binary)
        raw = self._file.read(count * kind.itemsize)
        if len(raw) < count * kind.itemsize:
            raise CaseError("it ends too early")
        return np.frombuffer(raw, kind)


class _Text(_Numbers):
    def __init__(self, file: BinaryIO, end: bytes) -> None:
        self._words, self._at = list[bytes](), 0
        for line in file:
            if line.strip() == end:
                break
            self._words += line.split()
        else:
            raise CaseError(f"its section before {end.decode()} does not end")

    def read(self, count: int, binary: str, text: type) -> NDArray[np.generic]:
        _refuse_negative(count)
        words = self._words[self._at : self._at + count]
        if len(words) < count:
            raise CaseError("a section ends too early")
        self._at += count
        return np.array(words).astype(text) if count else np.zeros(0, text)


def _refuse_negative(count: int) -> None:
    if count < 0:
        raise CaseError(f"it has a count of {count}")


def is_read(path: Path) -> bool:
    """Return True if a file has format 4.1."""
    with path.open("rb") as file:
        head = file.read(200)
    return re.search(rb"\$MeshFormat\s+4\.1\s", head) is not None


def read(path: Path) -> MeshData:
    """Read a file; groups without a name become ``group_n`` for cells, ``facets_n`` for others.

    Raises
    ------
    CaseError
        The file is damaged or partitioned, or has elements of an unknown type.
    """
    names: dict[tuple[int, int], str] = {}
    groups: dict[tuple[int, int], GlobalIndex] = {}
    points, tags = np.zeros((0, 3)), np.zeros(0, dtype=np.int64)
    elements: list[tuple[int, int, Block]] = []
    kind: type[_Binary | _Text] = _Text
    with path.open("rb") as file:
        for line in file:
            section = line.strip()
            if not section.startswith(b"$") or section.startswith(b"$End"):
                continue
            end = b"$End" + section[1:]

            def numbers(end: bytes = end) -> _Numbers:
                return kind(file, end)

            if section == b"$MeshFormat":
                kind = _format(file)
            elif section == b"$PhysicalNames":
                names = _names(file, end)
            elif section == b"$Entities":
                groups = _entities(numbers())
            elif section == b"$PartitionedEntities":
                raise CaseError("it is partitioned; save it as one part")
            elif section == b"$Nodes":
                points, tags = _nodes(numbers())
            elif section == b"$Elements":
                elements = _elements(numbers())
            else:
                _skip(file, end)
    if len(np.unique(tags)) < len(tags):
        raise CaseError("it has a node twice")
    return _mesh(points, tags, elements, groups, names)


def _format(file: BinaryIO) -> type[_Binary | _Text]:
    words = file.readline().split()
    if len(words) < 3 or words[2] != b"8":
        raise CaseError("its numbers have not 8 bytes")
    if words[1] == b"0":
        return _Text
    one = file.read(4)
    if one != b"\x01\x00\x00\x00":
        raise CaseError("it was written on a machine with another order of bytes; save it as text")
    return _Binary


def _skip(file: BinaryIO, end: bytes) -> None:
    for line in file:
        if line.strip().endswith(end):
            return
    raise CaseError(f"its section before {end.decode()} does not end")


def _names(file: BinaryIO, end: bytes) -> dict[tuple[int, int], str]:
    found = dict[tuple[int, int], str]()
    file.readline()
    for line in file:
        if line.strip() == end:
            return found
        match = _NAME.match(line)
        if match is None:
            raise CaseError(f"it has the physical name {line.decode(errors='replace').strip()[:40]!r}")
        found[int(match[1]), abs(int(match[2]))] = match[3].decode(errors="replace")
    raise CaseError("its physical names do not end")


def _entities(numbers: _Numbers) -> dict[tuple[int, int], GlobalIndex]:
    """Return the numbers of the physical groups of every entity, by dimension and tag."""
    found = dict[tuple[int, int], GlobalIndex]()
    for dim, count in enumerate(numbers.sizes(4).tolist()):
        for _ in range(count):
            tag = int(numbers.ints(1)[0])
            numbers.reals(3 if dim == 0 else 6)
            found[dim, tag] = np.abs(numbers.ints(int(numbers.sizes(1)[0])))
            if dim > 0:
                numbers.ints(int(numbers.sizes(1)[0]))
    return found


def _nodes(numbers: _Numbers) -> tuple[Float, GlobalIndex]:
    points, tags = [np.zeros((0, 3))], [np.zeros(0, dtype=np.int64)]
    blocks, total, _, _ = numbers.sizes(4).tolist()
    for _ in range(blocks):
        dim, _, parametric = numbers.ints(3).tolist()
        count = int(numbers.sizes(1)[0])
        tags.append(numbers.sizes(count))
        # Nodes may have their parameters on a curve or surface besides their coordinates.
        width = 3 + (dim if parametric else 0)
        points.append(numbers.reals(count * width).reshape(count, width)[:, :3])
    if sum(len(part) for part in tags) != total:
        raise CaseError(f"it has {sum(len(part) for part in tags)} nodes where it says {total}")
    return np.concatenate(points), np.concatenate(tags)


def _elements(numbers: _Numbers) -> list[tuple[int, int, Block]]:
    """Return dimension and tag of the entity of every block of elements, with their node tags."""
    found = []
    blocks, total, _, _ = numbers.sizes(4).tolist()
    for _ in range(blocks):
        dim, tag, number = numbers.ints(3).tolist()
        count = int(numbers.sizes(1)[0])
        if number not in _TYPES:
            raise CaseError(f"it has elements of type {number}, which particles cannot be made of")
        kind, width = _TYPES[number]
        rows = numbers.sizes(count * (1 + width)).reshape(count, 1 + width)
        found.append((dim, tag, Block(kind, rows[:, 1:])))
    if sum(len(block.nodes) for _, _, block in found) != total:
        raise CaseError(f"it has {sum(len(block.nodes) for _, _, block in found)} elements where it says {total}")
    return found


def _mesh(
    points: Float,
    tags: GlobalIndex,
    elements: list[tuple[int, int, Block]],
    groups: dict[tuple[int, int], GlobalIndex],
    names: dict[tuple[int, int], str],
) -> MeshData:
    known = Lookup(tags)
    if not len(tags) and elements:
        raise CaseError("it has no nodes")
    top = max((block.dim for _, _, block in elements if len(block.nodes)), default=0)
    blocks, found, start = [], dict[str, list[GlobalIndex]](), 0
    for dim, tag, block in elements:
        blocks.append(Block(block.kind, _rows(known, block.nodes)))
        for group in groups.get((dim, tag), np.zeros(0, dtype=np.int64)).tolist():
            name = names.get((dim, group), f"group_{group}" if dim == top else f"facets_{group}")
            found.setdefault(name, []).append(start + np.arange(len(block.nodes)))
        start += len(block.nodes)
    return MeshData(points, blocks, {name: np.unique(np.concatenate(parts)) for name, parts in found.items()})


def _rows(known: Lookup, wanted: GlobalIndex) -> GlobalIndex:
    """Return the rows of the points with these tags."""
    rows = known.of(wanted)
    missing = wanted[rows < 0]
    if len(missing):
        raise CaseError(f"its elements name node {missing[0]}, which it does not have")
    return rows
