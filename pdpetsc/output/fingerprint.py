"""Fingerprints of declarations, which identify a case in every process and on every rank."""

from __future__ import annotations

import ast
import contextlib
import dataclasses
import enum
import functools
import hashlib
import itertools
import linecache
import os
import struct
import sys
import sysconfig
from collections import defaultdict
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path, PurePath
from types import BuiltinFunctionType, CodeType, FunctionType, MethodType, ModuleType
from typing import Any

import numpy as np

from pdpetsc.declare.files import Mesh
from pdpetsc.declare.formats import files_of
from pdpetsc.declare.text_file import Column, TextFile
from pdpetsc.declared import shown
from pdpetsc.discrete.communicator import Comm, agreed
from pdpetsc.errors import CaseError
from pdpetsc.machine import digest_of

# Parts of a case that a continued run may change: load steps, solver, output, expected results and units.
MAY_DIFFER = {
    "steps", "solver", "options", "history", "results", "fields", "picture", "checkpoints", "expect", "units"
}  # fmt: skip
_PACKAGE = f"{Path(__file__).parent.parent}{os.sep}"
_PLACES = ("stdlib", "platstdlib", "purelib", "platlib")
_LIBRARIES = (_PACKAGE, *(f"{sysconfig.get_path(name)}{os.sep}" for name in _PLACES))
# Types of globals that belong to the definition of a function, unlike stored results.
_READ: tuple[type, ...] = (
    bool, int, float, str, bytes, tuple, list, set, frozenset, dict, np.ndarray, np.generic,
    FunctionType, functools.partial, type, ModuleType,
)  # fmt: skip
# Types that must be equal on all ranks also inside functions; other values there may depend on the rank.
_NUMBERS: tuple[type, ...] = (float, np.floating, np.ndarray, np.random.Generator, np.random.RandomState)
# Label of a variable that a function reads, followed by the path of the function.
_OF = "` of `"


def declared_parts(case: Any) -> dict[str, str]:
    """Return the fingerprints of the parts of a case that a continued run must share (not collective).

    Parameters
    ----------
    case : Case
        The case. Different spellings of the same declaration have the same fingerprint.

    Returns
    -------
    dict of str to str
        Fingerprints by names of the parts.
    """
    parts = {f.name: getattr(case, f.name) for f in dataclasses.fields(case) if f.name not in MAY_DIFFER}
    parts["material"] = case.materials
    if not case.of_bonds:
        parts["scheme"], parts["weights"] = case.gradients, case.chosen_weights
    return {name: fingerprint(value) for name, value in parts.items()}


def differing(found: Mapping[str, str], declared: Mapping[str, str]) -> list[str]:
    """Return the names of the parts that differ or are missing on one side, in the order of ``declared``."""
    return [name for name in {**declared, **found} if found.get(name) != declared.get(name)]


def fingerprint(value: Any) -> str:
    """Return the fingerprint of a declared object.

    The fingerprint contains class and fields of dataclasses, type, shape and bytes of arrays, the content of particle
    files, and class and state of other objects. For functions it contains the source without comments, and the
    defaults, closures and globals that they read. Functions without source are represented by names and constants, and
    code of installed libraries by its name.
    """
    return _Walk().of(value).digest.hex()


def refuse_differing(comm: Comm, declared: Mapping[str, Any]) -> None:
    """Raise CaseError on all ranks if a declared value differs between ranks.

    Inside functions and objects other than dataclasses only floating-point numbers, arrays and random generators are
    compared: a function may read the number of its rank.

    Parameters
    ----------
    declared : mapping of str to object
        Declared values by name.

    Raises
    ------
    CaseError
        A value differs; the message names the first one.

    Notes
    -----
    Collective.
    """
    if comm.size == 1:
        return
    with agreed(comm):
        walk = _Walk(across_ranks=True)
        parts = [(name, walk.of(value)) for name, value in declared.items()]
    digests = comm.allgather([part.digest for _, part in parts])
    other = next((rank for rank, digest in enumerate(digests) if digest != digests[0]), None)
    if other is None:
        return
    with agreed(comm):
        seen: set[int] = set()
        listed = [entry for name, part in parts for entry in _entries(part, name, seen)]
    mine = comm.bcast(listed), comm.bcast(listed, root=other)
    nothing = ("", b"", "nothing")
    first, second = next(pair for pair in itertools.zip_longest(*mine, fillvalue=nothing) if pair[0][:2] != pair[1][:2])
    path = (first if first[0] else second)[0]
    with agreed(comm):
        raise CaseError(
            f"`{path}` differs between ranks: {first[2]} on rank 0, {second[2]} on rank {other}; a case must be the "
            f"same on every rank, so seed random numbers."
        )


@dataclass(frozen=True)
class _Part:
    """A declared value: digest without the values inside it, and these values by label; both empty if it is ignored."""

    value: Any
    own: bytes = b""
    parts: Sequence[tuple[str, _Part]] = ()

    @property
    def counts(self) -> bool:
        return bool(self.own or self.parts)

    @functools.cached_property
    def digest(self) -> bytes:
        # Keys of mappings and numbers of entries are included in ``own``.
        inside = [(b"" if label.startswith("[") else label.encode(), part.digest) for label, part in self.parts]
        return _hash(self.own, *itertools.chain.from_iterable(inside))


def _entries(part: _Part, path: str, seen: set[int]) -> Iterator[tuple[str, bytes, str]]:
    """Yield path, digest and text of a value and of the values inside it, once for each object."""
    if id(part) in seen:
        return
    seen.add(id(part))
    if part.own:
        value = part.value
        yield path, part.own, f"{len(value)} entries" if isinstance(value, list | tuple) else shown(value)
    for label, inner in part.parts:
        yield from _entries(inner, f"{label}{path}" if label.endswith(_OF) else f"{path}{label}", seen)


def _hash(*parts: bytes | str) -> bytes:
    digest = hashlib.blake2b(digest_size=12)
    for part in parts:
        data = part.encode(errors="surrogatepass") if isinstance(part, str) else part
        digest.update(struct.pack("<Q", len(data)) + data)
    return digest.digest()


class _Walk:
    """Convert objects into parts.

    ``_open`` holds the ids of the objects around the current one, which may refer back to them. ``_done`` holds the
    finished parts; they keep their objects alive, so that no other object gets the same id.

    Parameters
    ----------
    across_ranks : bool
        Ignore values that may differ between ranks, and include the order of mappings.
    """

    def __init__(self, across_ranks: bool = False) -> None:
        self._across_ranks = across_ranks
        self._in_function = False
        self._open: list[int] = []
        self._done: dict[tuple[int, bool], _Part] = {}

    def of(self, value: Any) -> _Part:
        """Return the part of an object."""
        content = _content_of(value)
        if content is not None:
            return _Part(value, content if not self._leaves_out or isinstance(value, _NUMBERS) else b"")
        if id(value) in self._open:
            return _Part(value, b"" if self._leaves_out else _hash("again", str(self._open[::-1].index(id(value)))))
        key = id(value), self._in_function
        if key not in self._done:
            self._open.append(id(value))
            try:
                own, parts = self._composite(value)
                parts = [(label, part) for label, part in parts if part.counts]
                self._done[key] = _Part(value, b"" if self._leaves_out else own, parts)
            except RecursionError:
                self._done[key] = _Part(value, _hash("deep", type(value).__qualname__))
            finally:
                self._open.pop()
        return self._done[key]

    @property
    def _leaves_out(self) -> bool:
        return self._across_ranks and self._in_function

    def _read_by_function(self, values: Mapping[str, Any]) -> list[tuple[str, _Part]]:
        """Return the values that a function or class of the user reads, by label."""
        outer, self._in_function = self._in_function, True
        try:
            return [(label, self.of(value)) for label, value in values.items()]
        finally:
            self._in_function = outer

    def _composite(self, value: Any) -> tuple[bytes, list[tuple[str, _Part]]]:
        """Return the digest of an object without the values inside it, and these values by label."""
        if isinstance(value, list | tuple | np.ndarray):
            return _hash("sequence", str(len(value))), [(f"[{n}]", self.of(entry)) for n, entry in enumerate(value)]
        if isinstance(value, set | frozenset):
            return _hash("set", *sorted(self.of(entry).digest for entry in value)), []
        if isinstance(value, Mapping):
            items = [(self.of(key).digest, f"[{key!r}]", self.of(entry)) for key, entry in value.items()]
            items = items if self._across_ranks else sorted(items, key=lambda item: item[0])
            return _hash("mapping", *(key for key, _, _ in items)), [item[1:] for item in items]
        read = _read_by(value)
        if read is not None:
            name = getattr(value, "__qualname__", type(value).__qualname__)
            is_own = isinstance(value, FunctionType) and not of_library(value.__code__.co_filename)
            return _hash("function", name, _source(value.__code__) if is_own else ""), self._read_by_function(read)
        kind = self._read_by_function({f"class{_OF}": type(value)})
        if dataclasses.is_dataclass(value):
            fields = {f.name: getattr(value, f.name, None) for f in dataclasses.fields(value) if f.compare}
            if isinstance(value, TextFile | Column | Mesh):
                fields |= _contents(value)
            parts = [(f".{name}", self.of(field)) for name, field in fields.items()]
        else:
            parts = self._read_by_function(_state(value))
        return _hash("object", type(value).__qualname__), kind + parts


def _content_of(value: Any) -> bytes | None:
    """Return the digest of a value that contains no other values; None for others."""
    if value is None or value is Ellipsis or isinstance(value, bool | np.bool_):
        return _hash("constant", str(value))
    if isinstance(value, enum.Enum):
        return _hash("enum", type(value).__qualname__, value.name)
    if isinstance(value, int | float | np.integer | np.floating):
        # 1 and 1.0 have the same fingerprint.
        number: Any = value
        exact = isinstance(value, float | np.floating) or -(2**53) < number < 2**53
        return _hash("number", repr((float(number) if exact else int(number)) + 0))
    if isinstance(value, str | bytes | PurePath):
        return _hash("text", value if isinstance(value, bytes) else str(value))
    if isinstance(value, np.ndarray) and value.dtype != object:
        return _hash("array", value.dtype.str, str(value.shape), np.ascontiguousarray(value).tobytes())
    if isinstance(value, np.random.Generator | np.random.RandomState):
        return _hash("random", fingerprint(value.__reduce_ex__(4)[1:3]))
    if isinstance(value, ModuleType):
        return _hash("module", value.__name__)
    if isinstance(value, BuiltinFunctionType | np.ufunc):
        return _hash("builtin", str(getattr(value, "__qualname__", value.__name__)))
    return None


def _read_by(value: Any) -> dict[str, Any] | None:
    """Return the values that a function or class reads besides arguments, by label; None for other objects."""
    if isinstance(value, type):
        return _members(value)
    if isinstance(value, FunctionType):
        return _variables(value)
    if isinstance(value, MethodType):
        return {".function": value.__func__, ".self": value.__self__}
    if isinstance(value, functools.partial):
        return {".func": value.func, ".args": value.args, ".keywords": value.keywords}
    inner = getattr(value, "py_func", None) or getattr(value, "__wrapped__", None)
    return {".wrapped": inner} if isinstance(inner, FunctionType) else None


def _state(value: Any) -> dict[str, Any]:
    """Return the attributes of an instance of an ordinary class, by label."""
    if hasattr(value, "__dict__"):
        return {f".{name}": held for name, held in vars(value).items()}
    try:
        return {".state": value.__reduce_ex__(4)[1:3]}
    except Exception:  # an object without readable state (a lock, a generator) is represented by its class
        return {}


def _members(kind: type) -> dict[str, Any]:
    """Return the bases of a class and its user-defined methods and constants, by label."""
    module = sys.modules.get(kind.__module__)
    written = module is None or not of_library(getattr(module, "__file__", None) or _PACKAGE)
    members: dict[str, Any] = {f".base{n}": base for n, base in enumerate(kind.__bases__) if base is not object}
    for name, member in vars(kind).items():
        plain = getattr(member, "__func__", None) or getattr(member, "fget", None) or member
        # Methods generated by dataclasses have no file; they follow from the fields.
        if isinstance(plain, FunctionType):
            if plain.__code__.co_filename != "<string>" and not of_library(plain.__code__.co_filename):
                members[f".{name}"] = plain
        elif written and not name.startswith("_") and _is_read(plain) and not isinstance(plain, type):
            members[f".{name}"] = plain
    return members


def _variables(function: FunctionType) -> dict[str, Any]:
    """Return closure, defaults and globals of a function, by label."""
    code = function.__code__
    read: dict[str, Any] = {".defaults": (function.__defaults__, function.__kwdefaults__)}
    for name, cell in zip(code.co_freevars, function.__closure__ or (), strict=True):
        with contextlib.suppress(ValueError):  # not yet filled
            read[f"{name}{_OF}"] = cell.cell_contents
    if not of_library(code.co_filename):
        known = function.__globals__
        named = [name for name in sorted(_names(code)) if name in known and _is_read(known[name])]
        read |= {f"{name}{_OF}": known[name] for name in named}
        # Constants are needed if there is no source.
        read |= {f".constant{n}": value for n, value in enumerate(code.co_consts) if not isinstance(value, CodeType)}
    return read


def _source(code: CodeType) -> str:
    """Return the definition of a function without comments; the names in it if there is no source."""
    text = "".join(linecache.getlines(code.co_filename))
    begun = _definitions(text).get(code.co_firstlineno, {})
    # If several functions are on one line, choose the one that ends with the code.
    ends = {(line, column) for _, line, _, column in getattr(code, "co_positions", tuple)()}
    definitions = [found for end, found in begun.items() if end in ends] or begun.values()
    return "\n".join(definitions or [*code.co_names, *code.co_varnames])


@functools.lru_cache(maxsize=64)
def _definitions(text: str) -> Mapping[int, Mapping[tuple[int | None, int | None], str]]:
    """Return the functions of a source, by first line and end position."""
    found: dict[int, dict[tuple[int | None, int | None], str]] = defaultdict(dict)
    with contextlib.suppress(SyntaxError, ValueError):
        for node in ast.walk(ast.parse(text)):
            if isinstance(node, ast.FunctionDef | ast.AsyncFunctionDef | ast.Lambda):
                decorators = [decorator.lineno for decorator in getattr(node, "decorator_list", [])]
                end = node.end_lineno, node.end_col_offset
                found[min([node.lineno, *decorators])][end] = ast.unparse(node)
    return found


def _names(code: CodeType) -> set[str]:
    """Return the names that a code and the codes inside it use."""
    inside = [_names(constant) for constant in code.co_consts if isinstance(constant, CodeType)]
    return set(code.co_names).union(*inside)


def _is_read(value: Any) -> bool:
    """Return True if a global belongs to the definition of a function that names it."""
    return value is None or isinstance(value, _READ) or dataclasses.is_dataclass(value)


def of_library(file: str) -> bool:
    """Return True if a file belongs to Python, pdpetsc or an installed package."""
    return file.startswith(_LIBRARIES) or "site-packages" in file or "dist-packages" in file


def _contents(declared: TextFile | Column | Mesh) -> dict[str, Any]:
    """Return digests of the files that an object names, to replace their paths."""
    path = declared.path
    files = files_of(Path(path), declared.format) if isinstance(declared, Mesh) else [path]
    sets = getattr(declared, "node_sets", {})
    named = {name: _content(rows) if isinstance(rows, str | Path) else rows for name, rows in sets.items()}
    return {"path": " ".join(map(_content, files)), "node_sets": named}


def _content(path: str | Path) -> str:
    """Return the digest of the content of a file, or its path if it cannot be read."""
    return digest_of(path) or str(path)
