"""Fingerprints of what a case declares: the same for the same source in every process, another for another case."""

from __future__ import annotations

import dataclasses
import enum
import functools
import hashlib
import json
import os
import struct
import sys
import sysconfig
from collections.abc import Iterable, Mapping, Sequence
from pathlib import Path, PurePath
from types import BuiltinFunctionType, CodeType, FunctionType, MethodType, ModuleType
from typing import Any

import numpy as np

from pdpetsc.declare.files import Mesh
from pdpetsc.declare.formats import files_of
from pdpetsc.declare.text_file import Column, TextFile

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

    def of(self, value: Any) -> bytes:
        """Return the fingerprint of any object."""
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
        return [self.of(value) for value in values]

    def _mapping(self, values: Mapping[Any, Any]) -> bytes:
        return _hash("mapping", *sorted(_hash("item", self.of(key), self.of(item)) for key, item in values.items()))

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
            return _hash("partial", self.of(value.func), self.of(value.args), self.of(value.keywords))
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
            return self._mapping({**found, "path": _contents(files), "node_sets": named})
        if dataclasses.is_dataclass(value):
            fields = [f.name for f in dataclasses.fields(value) if f.compare]
            return self._mapping({name: getattr(value, name, None) for name in fields})
        if hasattr(value, "__dict__"):
            return self._mapping(vars(value))
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
            return _hash("class", name, *bases, self._mapping(members))
        finally:
            self._open.pop()

    def _function(self, function: FunctionType) -> bytes:
        """Return the fingerprint of a function."""
        cells = []
        for cell in function.__closure__ or ():
            try:
                cells.append(self.of(cell.cell_contents))
            except ValueError:  # not yet filled
                cells.append(b"")
        own = [function.__qualname__.encode(), self.of(function.__defaults__), self.of(function.__kwdefaults__), *cells]
        if of_library(function.__code__.co_filename):
            return _hash("function", *own)
        named = _names(function.__code__)
        known = {name: function.__globals__[name] for name in sorted(named) if name in function.__globals__}
        used = {name: value for name, value in known.items() if _counts(value)}
        return _hash("function", *own, self._code(function.__code__), self._mapping(used))

    def _code(self, code: CodeType) -> bytes:
        # Neither file nor lines: a case may move, and so may a function in it.
        constants = self._all(code.co_consts)
        names = [",".join(part).encode() for part in (code.co_names, code.co_varnames, code.co_freevars)]
        counts = json.dumps([code.co_argcount, code.co_kwonlyargcount, code.co_posonlyargcount, code.co_flags])
        return _hash("code", code.co_code, *constants, *names, counts.encode())


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
        with Path(path).open("rb") as file:
            while block := file.read(2**20):
                digest.update(block)
    except OSError:
        return str(path)
    return digest.hexdigest()
