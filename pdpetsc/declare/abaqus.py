"""Reader of Abaqus input decks: nodes, elements, sets and surfaces of one part."""

from __future__ import annotations

import itertools
import re
from collections.abc import Iterator
from dataclasses import dataclass, field
from pathlib import Path
from typing import TypeVar

import numpy as np

from pdpetsc.arrays import Float, GlobalIndex
from pdpetsc.declare.cells import FACETS, Block, MeshData
from pdpetsc.errors import CaseError

# Element types of solids, plane elements, lines and beams; their digits are the number of nodes, for beams the order.
_SOLID = re.compile(r"^(?:A|D|DC)?C3D(\d+)")
_PLANE = re.compile(r"^(?:CPS|CPE|CPEG|CAX|DC2D|AC2D|DCAX|M3D|SFM3D|R3D|DS|STRI|S)(\d+)")
_LINE = re.compile(r"^(?:T2D|T3D|R2D|DC1D)(\d)")
_BEAM = re.compile(r"^B[23]([12])")
_SOLIDS = {4: "tetra", 5: "pyramid", 6: "wedge", 8: "hexahedron", 10: "tetra", 13: "pyramid", 15: "wedge",
           20: "hexahedron", 27: "hexahedron"}  # fmt: skip
_PLANES = {3: "triangle", 4: "quad", 6: "triangle", 8: "quad", 9: "quad"}
# Elements without volume; they become no particles.
_NO_CELLS = ("MASS", "ROTARYI", "SPRING", "DASHPOT", "CONN", "DCOUP", "GAP")
# Keywords that generate or move nodes and elements; they are refused.
_REFUSED = {"NGEN", "NFILL", "NCOPY", "NMAP", "ELGEN", "ELCOPY", "SYSTEM"}
# Largest depth of nested includes.
_DEPTH = 8
# Largest number of files of a deck, and of members of a set in its lines.
_FILES, _MEMBERS = 1000, 10**7


T = TypeVar("T")


@dataclass
class _Deck:
    """The contents read so far; elements by kind and number of nodes, in the order of the file."""

    nodes: dict[int, int] = field(default_factory=dict)
    points: list[list[float]] = field(default_factory=list)
    cells: dict[tuple[str, int], list[list[int]]] = field(default_factory=dict)
    place: dict[int, tuple[tuple[str, int], int]] = field(default_factory=dict)
    without_cells: set[int] = field(default_factory=set)
    node_sets: dict[str, list[int]] = field(default_factory=dict)
    element_sets: dict[str, list[int]] = field(default_factory=dict)
    sides: dict[str, list[tuple[int, str]]] = field(default_factory=dict)
    parts: int = 0
    instances: int = 0
    section: str = ""
    instance: str = ""
    in_part: set[tuple[int, str]] = field(default_factory=set)

    def members(self, sets: dict[str, list[T]], name: str) -> list[T]:
        """Return the members of a set of the present section, for more of them; letters may be small or capital.

        A set of the assembly with the name of a set of the part is another one: that of the part is then called
        ``INSTANCE.NAME``.
        """
        name = next((known for known in sets if known.upper() == name.upper()), name)
        if self.section != "ASSEMBLY":
            self.in_part.add((id(sets), name))
        elif (id(sets), name) in self.in_part:
            self.in_part.discard((id(sets), name))
            sets[f"{self.instance}.{name}"] = sets.pop(name)
        return sets.setdefault(name, [])


def read(path: Path) -> MeshData:
    """Read an Abaqus deck; surfaces of elements become side sets, surfaces of nodes node sets.

    Raises
    ------
    CaseError
        A line cannot be read, or the deck has several parts or generates its mesh by commands.
    """
    deck = _Deck()
    for keyword, options, data in _sections(path):
        if keyword in _REFUSED:
            raise CaseError(f"it makes its mesh with *{keyword}; write nodes and elements out")
        if keyword in ("PART", "INSTANCE", "ASSEMBLY"):
            deck.section = keyword
        elif keyword in ("END PART", "END ASSEMBLY"):
            deck.section = ""
        elif keyword == "END INSTANCE":
            deck.section = "ASSEMBLY"
        deck.parts += keyword == "PART"
        deck.instances += keyword == "INSTANCE"
        if keyword == "INSTANCE":
            deck.instance = options.get("NAME", "").strip('"')
            if data:
                raise CaseError("it moves an instance of a part; write nodes where they are")
        if keyword in ("NODE", "ELEMENT") and "INPUT" in options:
            raise CaseError(f"*{keyword} reads the file {options['INPUT']!r}; include its lines by *INCLUDE")
        # Nodes and elements of an assembly itself are reference points and omitted; its sets have members of an
        # instance.
        own = deck.section == "ASSEMBLY" and "INSTANCE" not in options
        if keyword == "NODE" and not own:
            _nodes(deck, options, data)
        elif keyword == "ELEMENT" and not own:
            _elements(deck, options, data)
        elif keyword in ("NSET", "ELSET") and not own:
            sets = deck.node_sets if keyword == "NSET" else deck.element_sets
            name = _option(options, keyword, keyword)
            if keyword == "NSET" and options.get("ELSET"):
                found = _nodes_of(deck, _named(deck.element_sets, options["ELSET"]))
            else:
                found = _generated(data) if "GENERATE" in options else _members(sets, data)
            deck.members(sets, name.strip('"')).extend(found)
        elif keyword == "SURFACE":
            _surface(deck, options, data)
    if max(deck.parts, deck.instances) > 1:
        raise CaseError("it has several parts or instances; write one part")
    return _mesh(deck)


def _mesh(deck: _Deck) -> MeshData:
    blocks: list[Block] = []
    start: dict[tuple[str, int], int] = {}
    points = np.array(deck.points, dtype=float).reshape(len(deck.points), -1)
    for key, rows in deck.cells.items():
        start[key] = sum(len(block.nodes) for block in blocks)
        nodes_of = np.array(rows, dtype=np.int64)
        blocks.append(Block(key[0], _ends_first(points, nodes_of) if key == ("line", 3) else nodes_of))
    flat = {number: start[key] + row for number, (key, row) in deck.place.items()}

    def cells(members: list[int]) -> GlobalIndex:
        missing = [m for m in members if m not in flat and m not in deck.without_cells]
        if missing:
            raise CaseError(f"a set names element {missing[0]}, which it does not have")
        return np.unique(np.array([flat[m] for m in members if m in flat], dtype=np.int64))

    def sides(members: list[tuple[int, str]]) -> GlobalIndex:
        cells([member for member, _ in members])
        pairs = [
            (flat[member], place)
            for member, word in members
            if member in flat
            for place in _places(word, len(FACETS.get(deck.place[member][0][0], [])))
        ]
        return np.asarray(np.unique(np.array(pairs, dtype=np.int64).reshape(-1, 2), axis=0))

    def nodes(members: list[int]) -> GlobalIndex:
        missing = [m for m in members if m not in deck.nodes]
        if missing:
            raise CaseError(f"a set names node {missing[0]}, which it does not have")
        return np.unique(np.array([deck.nodes[m] for m in members], dtype=np.int64))

    return MeshData(
        points, blocks,
        {name: cells(members) for name, members in deck.element_sets.items()},
        {name: sides(members) for name, members in deck.sides.items()},
        {name: nodes(members) for name, members in deck.node_sets.items()},
    )  # fmt: skip


def _sections(path: Path, depth: int = 0) -> Iterator[tuple[str, dict[str, str], list[list[str]]]]:
    """Yield keyword, options and the words of the data lines, including those of included files."""
    if depth > _DEPTH:
        raise CaseError("its files include each other without end")
    keyword, options, data = "", dict[str, str](), list[list[str]]()
    with path.open(errors="replace") as file:
        lines = iter(file)
        for line in lines:
            text = line.strip()
            if not text or text.startswith("**"):
                continue
            if not text.startswith("*"):
                data.append([word.strip() for word in text.split(",")])
                continue
            if keyword:
                yield keyword, options, data
            (keyword, options), data = _keyword(text, lines), []
            if keyword == "INCLUDE":
                yield from _sections(path.parent / _option(options, "INPUT", keyword), depth + 1)
                keyword = ""
    if keyword:
        yield keyword, options, data


def _keyword(text: str, lines: Iterator[str]) -> tuple[str, dict[str, str]]:
    """Return keyword and options of a line, continued in ``lines`` if needed."""
    while text.endswith(","):
        text += next(lines, "").strip() or " "
    first, *rest = text[1:].split(",")
    pairs = [word.partition("=") for word in rest if word.strip()]
    return " ".join(first.upper().split()), {" ".join(name.upper().split()): value.strip() for name, _, value in pairs}


def files(path: Path) -> list[Path]:
    """Return a deck and all files that it includes, directly or not, each once."""
    found = [path]
    # The list grows during the loop.
    for one in found:
        found += [file for file in dict.fromkeys(_included(one)) if file not in found]
        if len(found) > _FILES:
            break
    return found


def _included(path: Path) -> list[Path]:
    """Return the files that a file includes; none if there is no such file."""
    found = list[Path]()
    if not path.is_file():
        return found
    with path.open(errors="replace") as file:
        lines = iter(file)
        for line in lines:
            text = line.strip()
            if text.startswith("*") and not text.startswith("**"):
                keyword, options = _keyword(text, lines)
                if keyword == "INCLUDE" and options.get("INPUT"):
                    found.append(path.parent / _option(options, "INPUT", keyword))
    return found


def _option(options: dict[str, str], name: str, keyword: str) -> str:
    if not options.get(name):
        raise CaseError(f"*{keyword} has no {name}")
    return options[name].strip('"')


def _whole(word: str, what: str) -> int:
    try:
        return int(word)
    except ValueError:
        raise CaseError(f"{word!r} is no number of {what}") from None


def _nodes(deck: _Deck, options: dict[str, str], data: list[list[str]]) -> None:
    if options.get("SYSTEM", "R").upper() != "R":
        raise CaseError("it has nodes in a system that is not rectangular")
    members = []
    for words in data:
        words = words[:-1] if words[-1] == "" else words
        number = _whole(words[0], "a node")
        try:
            # Omitted coordinates are zero.
            x = [float(word) if word else 0.0 for word in words[1:4]]
        except ValueError:
            raise CaseError(f"the coordinates of node {number} are not numbers") from None
        x += [0.0] * (3 - len(x))
        if number in deck.nodes:
            raise CaseError(f"it has node {number} twice")
        deck.nodes[number] = len(deck.points)
        deck.points.append(x)
        members.append(number)
    if options.get("NSET"):
        deck.members(deck.node_sets, options["NSET"].strip('"')).extend(members)


def _ends_first(points: Float, nodes: GlobalIndex) -> GlobalIndex:
    """Return the nodes of three-node lines with the middle node last; decks have it second or last."""
    x = points[nodes]
    # The node opposite to the longest distance is the middle node.
    apart = np.stack([np.linalg.norm(x[:, (m + 1) % 3] - x[:, (m + 2) % 3], axis=1) for m in range(3)], axis=1)
    middle = np.argmax(apart, axis=1)
    order = np.array([[1, 2, 0], [0, 2, 1], [0, 1, 2]])[middle]
    return np.take_along_axis(nodes, order, axis=1)


def _kind(word: str) -> tuple[str, int] | None:
    """Return kind and number of nodes of an element type; None for types without volume."""
    if word.startswith(_NO_CELLS):
        return None
    if word.startswith("STRI65"):
        return "triangle", 6
    for pattern, kinds in ((_SOLID, _SOLIDS), (_PLANE, _PLANES), (_LINE, {2: "line", 3: "line"})):
        found = pattern.match(word)
        if found and int(found[1]) in kinds:
            return kinds[int(found[1])], int(found[1])
    found = _BEAM.match(word)
    if found:
        return "line", int(found[1]) + 1
    raise CaseError(f"it has elements of type {word}, which particles cannot be made of")


def _elements(deck: _Deck, options: dict[str, str], data: list[list[str]]) -> None:
    kind = _kind(_option(options, "TYPE", "ELEMENT").upper())
    members = []
    if kind is None:
        members = [_whole(words[0], "an element") for words in data]
        deck.without_cells.update(members)
    else:
        # An element may continue in the next line.
        numbers = [_whole(word, "a node or element") for words in data for word in words if word]
        width = kind[1] + 1
        if len(numbers) % width:
            raise CaseError(f"elements of type {options['TYPE']} do not have {kind[1]} nodes each")
        rows = deck.cells.setdefault(kind, [])
        for at in range(0, len(numbers), width):
            number, nodes = numbers[at], numbers[at + 1 : at + width]
            if number in deck.place:
                raise CaseError(f"it has element {number} twice")
            missing = [node for node in nodes if node not in deck.nodes]
            if missing:
                raise CaseError(f"element {number} names node {missing[0]}, which it does not have")
            deck.place[number] = (kind, len(rows))
            rows.append([deck.nodes[node] for node in nodes])
            members.append(number)
    if options.get("ELSET"):
        deck.members(deck.element_sets, options["ELSET"].strip('"')).extend(members)


def _nodes_of(deck: _Deck, elements: list[int]) -> list[int]:
    """Return the numbers of the nodes of elements, each once."""
    numbers, places = list(deck.nodes), [deck.place[one] for one in elements if one in deck.place]
    return [numbers[node] for node in dict.fromkeys(node for kind, row in places for node in deck.cells[kind][row])]


def _generated(data: list[list[str]]) -> list[int]:
    """Return the members of a set given by ranges."""
    members: list[int] = []
    for words in data:
        given = [_whole(word, "a range") for word in words if word]
        first, last, step = ([*given, 1])[:3] if len(given) > 1 else (1, 0, 1)
        if step < 1 or last < first or last - first > _MEMBERS:
            raise CaseError(f"a set generates from {first} to {last} by {step}")
        members += range(first, last + 1, step)
        _refuse_many(members)
    return members


def _members(sets: dict[str, list[int]], data: list[list[str]]) -> list[int]:
    """Return the members of a set, given by numbers or by names of earlier sets."""
    members: list[int] = []
    for word in itertools.chain.from_iterable(data):
        if word:
            members += _named(sets, word) if not _is_whole(word) else [_whole(word, "a member")]
            # Sets of sets may double with every line.
            _refuse_many(members)
    return members


def _refuse_many(members: list[int]) -> None:
    if len(members) > _MEMBERS:
        raise CaseError(f"a set has more than {_MEMBERS} members")


def _is_whole(word: str) -> bool:
    return re.fullmatch(r"[+-]?\d+", word) is not None


def _named(sets: dict[str, list[int]], word: str) -> list[int]:
    """Return the members of a set; case and instance of the name do not matter."""
    full = word.strip('"').upper()
    for wanted in (full, full.rpartition(".")[2]):
        for name, members in sets.items():
            if name.upper() == wanted:
                return members
    raise CaseError(f"there is no set {word!r}")


def _places(word: str, count: int) -> list[int]:
    """Return the indices of the facets of an element, with ``count`` facets, for the word of a surface.

    ``S1``, ``E1`` and ``END1`` are the first facet in ``FACETS``; a side of a shell is no facet, -1. An empty word
    means all facets; facets shared by two elements are not on the surface.
    """
    if not word:
        return list(range(count))
    found = re.fullmatch(r"(?:S|E|END)(\d+)", word)
    if found and 1 <= int(found[1]) <= count:
        return [int(found[1]) - 1]
    if word in ("SPOS", "SNEG"):
        return [-1]
    raise CaseError(f"a surface has the face {word!r} of an element with {count} facets")


def _surface(deck: _Deck, options: dict[str, str], data: list[list[str]]) -> None:
    name, kind = _option(options, "NAME", "SURFACE"), options.get("TYPE", "ELEMENT").upper()
    # Only surfaces of named elements or nodes select particles; surfaces of other kinds, combinations of surfaces, and
    # the whole free surface (empty name) do not.
    if kind not in ("ELEMENT", "NODE") or {"COMBINE", "CROP"} & set(options) or not all(words[0] for words in data):
        return
    for words in data:
        sets = deck.element_sets if kind == "ELEMENT" else deck.node_sets
        word = words[0].rpartition(".")[2]
        members = [_whole(word, "a member")] if _is_whole(word) else _named(sets, words[0])
        if kind == "NODE":
            deck.members(deck.node_sets, name).extend(members)
        else:
            side = words[1].upper() if len(words) > 1 else ""
            deck.members(deck.sides, name).extend((member, side) for member in members)
