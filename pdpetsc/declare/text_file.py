"""Particles from text files of Peridigm, PeriLab and scripts.

Every rank reads the whole file and stores its part of the particles.
"""

from __future__ import annotations

import re
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from functools import lru_cache
from pathlib import Path
from typing import Any, Literal

import numpy as np
import scipy

from pdpetsc.arrays import Float, Mask
from pdpetsc.bounds import MOST_BLOCKS
from pdpetsc.declare.cracks import Crack
from pdpetsc.declare.particles import Arrays, Chunk, Particles
from pdpetsc.declare.surface import Facets
from pdpetsc.declared import Positive, shown
from pdpetsc.errors import CaseError
from pdpetsc.machine import stamp_of

# Names of the columns of a text cloud; PeriLab writes block_id.
_COLUMNS = {"x": "x", "y": "y", "z": "z", "block": "block", "block_id": "block", "volume": "volume"}
# A position this near to a particle, as a share of the extent of the cloud, belongs to the particle.
_THERE = 1e-9


@dataclass(frozen=True)
class TextFile(Particles):
    """Particles from a text file with lines ``x y z block volume``, as of Peridigm and PeriLab.

    Parameters
    ----------
    path : str or Path
        Lines of ``dim`` coordinates [length], a block number and a volume; ``#`` starts a comment. Columns are
        separated by blanks or tabs, commas, or semicolons. A first line such as ``header: x y block_id volume``, these
        words alone, or a comment of them names the columns. Named columns may have any order, there may be others, and
        no block. A plane cloud may have three coordinates with a constant last one. Block ``b`` becomes the set
        ``block_b``.
    node_sets : mapping of str to str, Path or sequence of int
        Particle numbers, counted from 1 in the order of the file, or files of them; each becomes a set.
    thickness : float
        Out-of-plane thickness [length], contained in the volumes.
    dim : int, optional
        Number of coordinates of the body. By default trailing coordinates that are equal for all particles are dropped:
        particles in one plane are a plane body, unless ``dim=3`` is declared.

    Examples
    --------
    >>> import pdpetsc as pd
    >>> cloud = pd.TextFile("cloud.txt", node_sets={"clamped": "clamped.txt", "corner": [1]})
    """

    path: str | Path
    node_sets: Mapping[str, str | Path | Sequence[int]] = field(default_factory=dict)
    thickness: Positive = 1.0
    dim: Literal[1, 2, 3] | None = None

    def input_files(self) -> list[Path]:
        """Return the paths of the cloud and of its set files."""
        return [Path(self.path), *(Path(file) for file in self.node_sets.values() if isinstance(file, str | Path))]

    def chunk(self, part: int, parts: int) -> Chunk:
        """Return part ``part`` of ``parts`` of the file."""
        return self._arrays().chunk(part, parts)

    @property
    def irregular(self) -> bool:
        """Return True unless the particles fill the cells of a lattice."""
        return self._arrays().irregular

    def surface(self, part: int = 0, parts: int = 1, cracks: Sequence[Crack] = ()) -> Facets:
        """Return the surface of ``Arrays`` with these particles."""
        return self._arrays().surface(part, parts, cracks)

    def column(self, name: str) -> Float:
        r"""Return a column of the file by its name, one number per particle (n,) in the order of creation.

        Use it for ``horizon=`` and ``pd.Temperature``.

        Raises
        ------
        CaseError
            The file has no such column, or no names.

        Examples
        --------
        >>> import pathlib, tempfile
        >>> import pdpetsc as pd
        >>> path = pathlib.Path(tempfile.mkdtemp()) / "cloud.csv"
        >>> _ = path.write_text("x,y,volume,angle\n0,0,1,0.1\n1,0,1,0.3\n")
        >>> pd.TextFile(path).column("angle")
        array([0.1, 0.3])
        """
        names, table = _read(Path(self.path))
        wanted = _COLUMNS.get(name.lower(), name.lower())
        if names is None or wanted not in names:
            has = f"its columns are {', '.join(names)}" if names else "its columns have no names"
            raise CaseError(f"{self.path} has no column {name!r}: {has}.")
        found = np.asarray(table[:, names.index(wanted)])
        if not np.isfinite(found).all():
            raise CaseError(f"Column {name!r} of {self.path} has values that are not numbers.")
        return found

    @property
    def columns(self) -> list[str] | None:
        """Return the names of the columns; None for a file without names."""
        return _read(Path(self.path))[0]

    def has(self, name: str) -> bool:
        """Return True if the file has a column of this name; without names, columns are ``x y z block volume``."""
        names, table = _read(Path(self.path))
        return _COLUMNS.get(name.lower(), name.lower()) in (names or _unnamed(table))

    def function(self, name: str) -> Column:
        """Return a column of the file as a function of particle positions, for orientations and loads.

        Raises
        ------
        CaseError
            The file has no such column, or no names.
        """
        return Column(self.path, name, self.dim)

    def _arrays(self) -> Arrays:
        path = Path(self.path)
        names, table = _read(path)
        x, block, volume = _columns(path, names, table)
        sets = {}
        if block is not None:
            wrong = np.flatnonzero(~(np.isfinite(block) & (block == np.round(block))))
            if len(wrong):
                raise CaseError(
                    f"{path} has block {block[wrong[0]]:g} in row {wrong[0] + 1}, not a whole number. If the columns "
                    "are not x y z block volume, add a first line 'header: x y z block_id volume'."
                )
            numbers = np.unique(block)
            if len(numbers) > MOST_BLOCKS:
                raise CaseError(f"{path} has {len(numbers)} different blocks, more than {MOST_BLOCKS}.")
            sets = {f"block_{int(b)}": block == b for b in numbers}
        for name, given in self.node_sets.items():
            if name in sets:
                raise CaseError(f"The node set {name!r} has the name of a block of {path}; give it another one.")
            sets[name] = _members(given, name, len(table))
        return Arrays(self._of_dim(x), volume, sets, self.thickness)

    def _of_dim(self, x: Float) -> Float:
        """Return the coordinates of the body (n, dim)."""
        if self.dim is None:
            return without_constant(x)
        if x.shape[1] < self.dim:
            raise CaseError(
                f"{self.path} has {x.shape[1]} coordinates, fewer than dim={self.dim}. Remove dim, or add columns."
            )
        if without_constant(x).shape[1] > self.dim:
            raise CaseError(
                f"{self.path} has particles outside the first {self.dim} coordinates, and dim={self.dim}. Remove dim, "
                "or correct the coordinates."
            )
        return x[:, : self.dim]


@dataclass(frozen=True)
class Column:
    """A column of a text cloud as a function of positions; created by ``TextFile.function``.

    Parameters
    ----------
    path : str or Path
        The file.
    name : str
        The column.
    dim : int, optional
        As for ``TextFile``.
    """

    path: str | Path
    name: str
    dim: Literal[1, 2, 3] | None = None

    def __post_init__(self) -> None:
        self._cloud.column(self.name)

    @property
    def __name__(self) -> str:
        """Return the name of the column, for messages."""
        return self.name

    def input_files(self) -> list[Path]:
        """Return the file of the column."""
        return [Path(self.path)]

    @property
    def _cloud(self) -> TextFile:
        return TextFile(self.path, dim=self.dim)

    def __call__(self, x: Float, t: float = 0.0) -> Float:
        """Return the values (n,) of the particles at positions ``x`` (n, dim); ``t`` is not used.

        Raises
        ------
        CaseError
            A position is not that of a particle.
        """
        tree, values, extent = _placed(self, stamp_of(self.path))
        distance, which = tree.query(x)
        off = np.flatnonzero(distance > _THERE * extent)
        if len(off):
            raise CaseError(
                f"Column {self.name!r} of {self.path} has no value at {list(x[off[0]])}: no particle is there."
            )
        return np.asarray(values[which])


@lru_cache(maxsize=8)
def _placed(column: Column, version: tuple[int, ...] | None) -> tuple[Any, Float, float]:
    """Return a search tree, a column and the extent of the cloud; cached while the file is unchanged."""
    x = np.asarray(column._cloud._arrays().x, dtype=float)
    return scipy.spatial.cKDTree(x), column._cloud.column(column.name), max(float(np.ptp(x, axis=0).max()), 1e-300)


def without_constant(x: Float, at_least: int = 1) -> Float:
    """Drop trailing coordinates (n, dim) that are the same for all points."""
    dim = x.shape[1]
    while dim > at_least and np.ptp(x[:, dim - 1]) <= 1e-12 * max(float(np.ptp(x)), 1e-300):
        dim -= 1
    return x[:, :dim]


def _members(given: object, name: str, count: int) -> Mask:
    """Return the flags of a set of particles (count,), given by numbers from 1 on in a file or a list."""
    if isinstance(given, str | Path):
        what = str(given)
        rows = [row for row in _lines(Path(given)) if row.split("#", 1)[0].strip()]
        first = 1 if rows and rows[0].lstrip().lower().startswith("header:") else 0
        # Lines may have several numbers, not the same number in each.
        text = " ".join(row.split("#", 1)[0].replace(",", " ") for row in rows[first:])
        members = np.ravel(_table(Path(given), [text])) if text.strip() else np.zeros(0)
        if not len(members):
            raise CaseError(f"{given} has no lines of numbers.")
    else:
        what = f"Node set {name!r}"
        try:
            members = np.asarray(given, dtype=float).ravel()
        except (TypeError, ValueError, OverflowError):
            raise CaseError(f"{what} takes a file or particle numbers, not {shown(given)}.") from None
    if not (members == np.round(members)).all():
        raise CaseError(f"{what} holds particle numbers that are not whole.")
    if len(members) and (members.min() < 1 or members.max() > count):
        raise CaseError(f"{what} names particles outside 1 to {count}.")
    flags = np.zeros(count, dtype=bool)
    flags[members.astype(np.int64) - 1] = True
    return flags


def _read(path: Path) -> tuple[list[str] | None, Float]:
    """Return the names of the columns of a cloud (None if unnamed), and the table."""
    lines = _lines(path)
    names, start = _header(path, lines)
    return names, _table(path, lines[start:])


def _lines(path: Path) -> list[str]:
    if stamp_of(path) is None and not path.is_dir():
        # Every rank reads it, more than once; a pipe without a writer would block.
        raise CaseError(f"Cannot read {path}: it is a pipe or a device; write its content to a file.")
    try:
        return path.read_text(encoding="utf-8-sig").splitlines()
    except OSError as error:
        raise CaseError(f"Cannot read {path}: {error.strerror or 'file not found'}.") from None
    except ValueError:
        raise CaseError(f"{path} is not a table of numbers: it is not text.") from None


def _words(line: str) -> list[str]:
    """Return the words of a line in lower case, separated by commas, semicolons or blanks."""
    mark = _separator(line)
    return [word.strip().lower() for word in (line.split(mark) if mark else line.split())]


def _separator(line: str) -> str | None:
    """Return the separator of the columns: a comma, a semicolon, or None for blanks."""
    return next((mark for mark in ";," if mark in line), None)


def _header(path: Path, lines: list[str]) -> tuple[list[str] | None, int]:
    """Return the names of the columns (None if unnamed), and the first line of the table."""
    start = 0
    while start < len(lines) and (not lines[start].strip() or lines[start].lstrip().startswith("#")):
        words = _words(lines[start].lstrip("# \t"))
        if len(words) >= 3 and set(words) <= set(_COLUMNS):
            return _known(path, words), start + 1
        start += 1
    if start == len(lines):
        return None, start
    if lines[start].lstrip().lower().startswith("header:"):
        return _known(path, _words(lines[start].split(":", 1)[1])), start + 1
    words = _words(lines[start])
    # A line of names has only words, two of which every cloud has.
    if {"x", "volume"} <= set(words) and all(re.fullmatch(r"[a-z_][\w .()/%-]*", word) for word in words):
        return _known(path, words), start + 1
    return None, start


def _known(path: Path, words: list[str]) -> list[str]:
    names = [_COLUMNS.get(word, word) for word in words]
    dim = sum(axis in names for axis in "xyz")
    twice = [name for name in names if names.count(name) > 1]
    if twice or dim == 0 or not {*"xyz"[:dim], "volume"} <= set(names):
        raise CaseError(f"The header of {path} is {' '.join(words)}. It must name x (y, z) and volume, each name once.")
    return names


def _unnamed(table: Float) -> list[str]:
    """Return the columns of a table without names."""
    return [*"xyz"[: table.shape[1] - 2], "block", "volume"]


def _columns(path: Path, names: list[str] | None, table: Float) -> tuple[Float, Float | None, Float]:
    """Return coordinates (n, dim), blocks (n,) or None, and volumes (n,)."""
    width = table.shape[1]
    if names is None:
        if not 3 <= width <= 5:
            raise CaseError(
                f"{path} has {width} columns, not 1 to 3 coordinates, a block and a volume. Name them in a first line "
                "'header: x y z block_id volume'."
            )
        names = _unnamed(table)
    if len(names) != width:
        raise CaseError(f"{path} has {width} columns, and its header names {len(names)}. Name every column once.")
    x = table[:, [names.index(axis) for axis in "xyz" if axis in names]]
    block = table[:, names.index("block")] if "block" in names else None
    return x, block, table[:, names.index("volume")]


def _table(path: Path, lines: list[str]) -> Float:
    rows = [line for line in lines if line.split("#", 1)[0].strip()]
    if not rows:
        raise CaseError(f"{path} has no lines of numbers.")
    # The whole table has one separator; otherwise a decimal comma would split a number.
    mark = _separator(rows[0].split("#", 1)[0])
    try:
        return np.asarray(np.loadtxt(rows, ndmin=2, delimiter=mark))
    except (ValueError, OverflowError) as error:
        raise CaseError(f"{path} is not a table of numbers: {' '.join(str(error).split()).rstrip('.')}.") from None
