"""Fingerprints of what a case declares: the same for the same source in every process, another for another case."""

from __future__ import annotations

import dataclasses
import enum
import functools
import hashlib
import itertools
import json
import os
import stat
import struct
import sys
import sysconfig
from collections.abc import Iterable, Iterator, Mapping, Sequence
from contextlib import contextmanager
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

# What a run that goes on may declare otherwise: how the load is stepped and equilibrium found, and what is recorded.
MAY_DIFFER = {
    "steps", "solver", "options", "history", "results", "fields", "picture", "checkpoints", "expect", "units"
}  # fmt: skip
_PACKAGE = f"{Path(__file__).parent.parent}{os.sep}"
_PLACES = ("stdlib", "platstdlib", "purelib", "platlib")
_LIBRARIES = (_PACKAGE, *(f"{sysconfig.get_path(name)}{os.sep}" for name in _PLACES))
_COUNTS: tuple[type, ...] = (
    bool, int, float, str, bytes, tuple, list, set, frozenset, dict, np.ndarray, np.generic,
    FunctionType, functools.partial, type, ModuleType,
)  # fmt: skip
_RANDOM: tuple[type, ...] = (np.random.Generator, np.random.RandomState)
_PLAIN: tuple[type, ...] = (bool, int, float, np.generic, enum.Enum, str, bytes, PurePath, set, frozenset, *_RANDOM)
# Stands between a variable of a function and the path of the function.
_OF = "` of `"


def declared_parts(case: Any) -> dict[str, str]:
    """Return a fingerprint of each part of a case that a continued run has to share (not collective).

    Parameters
    ----------
    case : Case
        What is run. What is spelled in two ways and means the same has the same fingerprint.

    Returns
    -------
    dict of str to str
        Names of the case's parts and their fingerprints.
    """
    parts = {f.name: getattr(case, f.name) for f in dataclasses.fields(case) if f.name not in MAY_DIFFER}
    parts["material"] = case.materials
    if not case.of_bonds:
        parts["scheme"], parts["weights"] = case.gradients, case.chosen_weights
    return {name: fingerprint(value) for name, value in parts.items()}


def differing(found: Mapping[str, str], declared: Mapping[str, str]) -> list[str]:
    """Return the names of the parts whose fingerprints differ or that one side lacks, in the order of ``declared``."""
    return [name for name in {**declared, **found} if found.get(name) != declared.get(name)]


def fingerprint(value: Any) -> str:
    """Return the fingerprint of a declared object.

    Dataclasses count by class and fields, arrays by type, shape and bytes, functions by qualified name, code,
    constants, defaults, closure and the globals that they name, other objects by class and state, files of particles by
    their content. Code of installed libraries counts by its name.
    """
    return _Walk().of(value).hex()


def refuse_differing(comm: Comm, declared: Mapping[str, Any]) -> None:
    """Raise CaseError on all ranks if a declared value differs between ranks.

    All plain values, arrays and the content of files of particles are compared exactly. Of functions and of objects
    other than dataclasses the floating-point numbers, arrays and random generators in them are compared: a function
    may read the number of its rank.

    Parameters
    ----------
    declared : mapping of str to object
        Declared values by name.

    Raises
    ------
    CaseError
        The first value that differs.

    Notes
    -----
    Collective. Each value is walked and each array hashed once on every rank.
    """
    if comm.size == 1:
        return
    with agreed(comm):
        digest = _Entries().digest_of(declared)
    digests = comm.allgather(digest)
    other = next((rank for rank, told in enumerate(digests) if told != digests[0]), None)
    if other is None:
        return
    with agreed(comm):
        entries = _Entries(listed=[])
        entries.digest_of(declared)
    mine = comm.bcast(entries.listed), comm.bcast(entries.listed, root=other)
    nothing = ("", b"", "nothing")
    first, second = next(pair for pair in itertools.zip_longest(*mine, fillvalue=nothing) if pair[0][:2] != pair[1][:2])
    path = (first if first[0] else second)[0]
    with agreed(comm):
        raise CaseError(
            f"`{path}` differs between ranks: {first[2]} on rank 0, {second[2]} on rank {other}; a case must be the "
            f"same on every rank, so seed random numbers."
        )


def _hash(kind: str, *parts: bytes) -> bytes:
    digest = hashlib.blake2b(kind.encode(), digest_size=12)
    for part in parts:
        digest.update(struct.pack("<Q", len(part)))
        digest.update(part)
    return digest.digest()


class _Walk:
    """Walks an object.

    ``_open`` are the objects on the way to the present one, which may refer back to them; ``_done`` are those that have
    been walked, held so that no other one gets their number.
    """

    def __init__(self) -> None:
        self._open: list[int] = []
        self._done: dict[int, tuple[Any, bytes]] = {}

    def of(self, value: Any, label: str = "") -> bytes:
        """Return the fingerprint of any object; ``label`` says where in the object around it it is."""
        if value is None or value is Ellipsis or isinstance(value, bool | np.bool_):
            return _hash("constant", str(value).encode())
        if isinstance(value, enum.Enum):
            return _hash("enum", type(value).__qualname__.encode(), value.name.encode())
        if isinstance(value, int | float | np.integer | np.floating):
            # 1 and 1.0 are the same load.
            number: Any = value
            exact = isinstance(value, float | np.floating) or -(2**53) < number < 2**53
            return _hash("number", repr((float(number) if exact else int(number)) + 0).encode())
        if isinstance(value, str | bytes | PurePath):
            return _hash("text", value if isinstance(value, bytes) else str(value).encode(errors="surrogatepass"))
        if id(value) in self._open:
            return _hash("again", str(len(self._open) - self._open.index(id(value))).encode())
        if id(value) not in self._done:
            self._open.append(id(value))
            try:
                self._done[id(value)] = value, self._composite(value)
            except RecursionError:
                self._done[id(value)] = value, _hash("deep", type(value).__qualname__.encode())
            finally:
                self._open.pop()
        return self._done[id(value)][1]

    def _all(self, values: Iterable[Any]) -> list[bytes]:
        return [self.of(value, f"[{n}]") for n, value in enumerate(values)]

    def _mapping(self, values: Mapping[Any, Any], label: str = "[{!r}]") -> bytes:
        items = (_hash("item", self.of(key), self.of(item, label.format(key))) for key, item in values.items())
        return _hash("mapping", *sorted(items))

    def _composite(self, value: Any) -> bytes:
        if isinstance(value, np.ndarray) and value.dtype != object:
            whole = np.ascontiguousarray(value)
            return _hash("array", whole.dtype.str.encode(), str(whole.shape).encode(), whole.tobytes())
        if isinstance(value, list | tuple | np.ndarray):
            return _hash("sequence", *self._all(value))
        if isinstance(value, set | frozenset):
            return _hash("set", *sorted(self._all(value)))
        if isinstance(value, Mapping):
            return self._mapping(value)
        if isinstance(value, ModuleType):
            return _hash("module", value.__name__.encode())
        if isinstance(value, CodeType):
            return self._code(value)
        if isinstance(value, type):
            return self._class(value)
        if isinstance(value, FunctionType):
            return self._function(value)
        if isinstance(value, MethodType):
            return _hash("method", self.of(value.__func__), self.of(value.__self__))
        if isinstance(value, functools.partial):
            return self._partial(value)
        if isinstance(value, BuiltinFunctionType | np.ufunc):
            return _hash("builtin", str(getattr(value, "__qualname__", value.__name__)).encode())
        inner = getattr(value, "py_func", None) or getattr(value, "__wrapped__", None)
        if isinstance(inner, FunctionType):
            return _hash("wrapped", type(value).__qualname__.encode(), self.of(inner))
        return _hash("object", self._class(type(value)), self._state(value))

    def _state(self, value: Any) -> bytes:
        """Return the fingerprint of what an instance holds."""
        if isinstance(value, TextFile | Column | Mesh):
            found = {f.name: getattr(value, f.name) for f in dataclasses.fields(value)}
            sets = found.get("node_sets", {})
            named = {name: _content(one) if isinstance(one, str | Path) else one for name, one in sets.items()}
            files = files_of(Path(value.path), value.format) if isinstance(value, Mesh) else [value.path]
            return self._mapping({**found, "path": _contents(files), "node_sets": named}, ".{}")
        if dataclasses.is_dataclass(value):
            fields = [f.name for f in dataclasses.fields(value) if f.compare]
            return self._mapping({name: getattr(value, name, None) for name in fields}, ".{}")
        if hasattr(value, "__dict__"):
            return self._mapping(vars(value), ".{}")
        try:
            return self.of(value.__reduce_ex__(4)[1:3])
        except Exception:  # what cannot be taken apart (a lock, a generator) counts by its class
            return b""

    def _class(self, kind: type) -> bytes:
        """Return the fingerprint of a class: its name, and methods and constants where the user wrote it."""
        name = kind.__qualname__.encode()
        if id(kind) in self._open[:-1]:
            return _hash("class", name)
        module = sys.modules.get(kind.__module__)
        written = module is None or not of_library(getattr(module, "__file__", None) or _PACKAGE)
        members = {}
        for key, member in vars(kind).items():
            plain = getattr(member, "__func__", None) or getattr(member, "fget", None) or member
            # What dataclasses make has no file; it follows from the fields.
            if isinstance(plain, FunctionType):
                if plain.__code__.co_filename != "<string>" and not of_library(plain.__code__.co_filename):
                    members[key] = plain
            elif written and not key.startswith("_") and _counts(plain) and not isinstance(plain, type):
                members[key] = plain
        self._open.append(id(kind))
        try:
            bases = [self._class(base) for base in kind.__bases__]
            return _hash("class", name, *bases, self._mapping(members, ".{}"))
        finally:
            self._open.pop()

    def _function(self, function: FunctionType) -> bytes:
        """Return the fingerprint of a function."""
        cells = []
        for name, cell in zip(function.__code__.co_freevars, function.__closure__ or (), strict=True):
            try:
                cells.append(self.of(cell.cell_contents, f"{name}{_OF}"))
            except ValueError:  # not yet filled
                cells.append(b"")
        own = [function.__qualname__.encode(), self.of(function.__defaults__), self.of(function.__kwdefaults__), *cells]
        if of_library(function.__code__.co_filename):
            return _hash("function", *own)
        named = _names(function.__code__)
        known = {name: function.__globals__[name] for name in sorted(named) if name in function.__globals__}
        used = {name: value for name, value in known.items() if _counts(value)}
        return _hash("function", *own, self._code(function.__code__), self._mapping(used, f"{{}}{_OF}"))

    def _partial(self, value: functools.partial[Any]) -> bytes:
        return _hash("partial", self.of(value.func), self.of(value.args), self.of(value.keywords))

    def _code(self, code: CodeType) -> bytes:
        # Neither file nor lines: a case may move, and so may a function in it.
        constants = self._all(code.co_consts)
        names = [",".join(part).encode() for part in (code.co_names, code.co_varnames, code.co_freevars)]
        counts = json.dumps([code.co_argcount, code.co_kwonlyargcount, code.co_posonlyargcount, code.co_flags])
        return _hash("code", code.co_code, *constants, *names, counts.encode())


class _Entries(_Walk):
    """Walks an object and notes the values in it that have to be the same on all ranks.

    Parameters
    ----------
    listed : list, optional
        Takes path, digest and text of each of these values.
    """

    def __init__(self, listed: list[tuple[str, bytes, str]] | None = None) -> None:
        super().__init__()
        self.listed = listed
        self._digest = hashlib.blake2b(digest_size=16)
        self._path = ""
        # An object that a function reads counts in full if it is declared elsewhere too.
        self._done_of_functions: dict[int, tuple[Any, bytes]] = {}
        self._in_function = False

    def digest_of(self, declared: Mapping[str, Any]) -> bytes:
        """Return the digest of the values that are declared under some names."""
        for name, value in declared.items():
            self.of(value, name)
        return self._digest.digest()

    def of(self, value: Any, label: str = "") -> bytes:
        """Note an object and what is in it."""
        outer = self._path
        self._path = f"{label}{outer}" if label.endswith(_OF) else f"{outer}{label}"
        try:
            is_array = isinstance(value, np.ndarray) and value.dtype != object
            if value is None or is_array or isinstance(value, _PLAIN):
                if is_array or not self._in_function or isinstance(value, (float, np.floating, *_RANDOM)):
                    self._note(value, bytes.fromhex(fingerprint(value)))
                return b""
            if not self._in_function:
                self._note(value, _kind(value))
            return super().of(value)
        finally:
            self._path = outer

    def _note(self, value: Any, digest: bytes) -> None:
        self._digest.update(_hash(self._path, digest))
        if self.listed is not None:
            text = f"{len(value)} entries" if isinstance(value, list | tuple) else shown(value)
            self.listed.append((self._path, digest, text))

    @contextmanager
    def _of_function(self) -> Iterator[None]:
        """Note in the body only what a function of the case must not have of its own on a rank."""
        outer, within = self._done, self._in_function
        self._done, self._in_function = self._done_of_functions, True
        try:
            yield
        finally:
            self._done, self._in_function = outer, within

    def _mapping(self, values: Mapping[Any, Any], label: str = "[{!r}]") -> bytes:
        for key, item in values.items():
            self.of(item, label.format(key))
        return b""

    def _function(self, function: FunctionType) -> bytes:
        with self._of_function():
            return super()._function(function)

    def _partial(self, value: functools.partial[Any]) -> bytes:
        with self._of_function():
            return super()._partial(value)

    def _class(self, kind: type) -> bytes:
        with self._of_function():
            return super()._class(kind)

    def _state(self, value: Any) -> bytes:
        if dataclasses.is_dataclass(value):
            return super()._state(value)
        with self._of_function():
            return super()._state(value)


def _kind(value: Any) -> bytes:
    """Return the digest of what an object is, without what is in it; the order of a mapping counts."""
    if isinstance(value, Mapping):
        return _hash("mapping", bytes.fromhex(fingerprint(list(value))))
    if isinstance(value, list | tuple | np.ndarray):
        return _hash("sequence", str(len(value)).encode())
    named = value if hasattr(value, "__qualname__") else type(value)
    return _hash("object", str(named.__qualname__).encode())


def _names(code: CodeType) -> set[str]:
    """Return the names that a code and the codes inside it use."""
    inside = [_names(constant) for constant in code.co_consts if isinstance(constant, CodeType)]
    return set(code.co_names).union(*inside)


def _counts(value: Any) -> bool:
    """Return whether a global that a function names is part of what it does, not of what it has done."""
    return value is None or isinstance(value, _COUNTS) or dataclasses.is_dataclass(value)


def of_library(file: str) -> bool:
    """Return whether code in a file is of Python, pdpetsc or an installed package, not of the user."""
    return file.startswith(_LIBRARIES) or "site-packages" in file or "dist-packages" in file


def _contents(paths: Sequence[str | Path]) -> str:
    """Return the fingerprint of the content of files together."""
    return " ".join(_content(path) for path in paths)


def _content(path: str | Path) -> str:
    """Return the fingerprint of a file's content, of its name where it cannot be read."""
    digest = hashlib.sha256()
    try:
        if not stat.S_ISREG(Path(path).stat().st_mode):  # a pipe would wait for a writer
            return str(path)
        with Path(path).open("rb") as file:
            while block := file.read(2**20):
                digest.update(block)
    except OSError:
        return str(path)
    return digest.hexdigest()
