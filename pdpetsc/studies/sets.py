"""Parameter sets: combinations of values, and lists and samples from a file."""

from __future__ import annotations

import contextlib
import csv
import dataclasses
import importlib
import io
import itertools
import json
import math
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Literal, TypeAlias, TypeVar

from pdpetsc.bounds import MOST_SETS, refuse_deep, text_in
from pdpetsc.declared import Count, Declared, Finite, Natural, fits, refuse_unknown, shown
from pdpetsc.errors import CaseError

Set: TypeAlias = dict[str, str]

T = TypeVar("T", bound=Declared)


@dataclass(frozen=True)
class Range(Declared):
    """A range of numbers.

    Parameters
    ----------
    low, high : float
        The ends.
    start : float, optional
        Start of a search; by default the middle.
    scale : {"linear", "log", "integer"}
        Spacing along the range: linear, logarithmic, or integers.

    Raises
    ------
    CaseError
        The ends are not finite numbers low < high, the start is not between them, or the scale does not fit them.
    """

    low: Finite
    high: Finite
    start: Finite | None = None
    scale: Literal["linear", "log", "integer"] = "linear"

    def __post_init__(self) -> None:
        super().__post_init__()
        if not (self.low < self.high and math.isfinite(self.high - self.low)):
            raise CaseError(f"A range needs numbers low < high, not {self.low} and {self.high}.")
        if self.scale == "log" and self.low <= 0.0:
            raise CaseError(f"A range has no logarithm from {self.low:g} on.")
        if self.scale == "integer" and not (float(self.low).is_integer() and float(self.high).is_integer()):
            raise CaseError(f"A range of whole numbers does not go from {self.low:g} to {self.high:g}.")
        if self.start is not None and not self.low < self.start < self.high:
            raise CaseError(f"The start {self.start:g} is not between {self.low:g} and {self.high:g}.")

    def at(self, share: float) -> float:
        """Return the number at a share in [0, 1] of the range; in [0, 1) for integers."""
        if self.scale == "integer":
            return int(self.low) + int(share * (self.high - self.low + 1))
        if self.scale == "log":
            return float(self.low * (self.high / self.low) ** share)
        return float(self.low + share * (self.high - self.low))

    def slope(self, share: float) -> float:
        """Return the derivative of the number by the share."""
        return self.at(share) * math.log(self.high / self.low) if self.scale == "log" else self.high - self.low

    @property
    def first(self) -> float:
        """Return the share at the start of a search."""
        if self.start is None:
            return 0.5
        if self.scale == "log":
            return math.log(self.start / self.low) / math.log(self.high / self.low)
        return (self.start - self.low) / (self.high - self.low)


@dataclass(frozen=True)
class Samples(Declared):
    """Points that fill ranges evenly, from a Latin hypercube or a Sobol sequence.

    Parameters
    ----------
    method : {"latin_hypercube", "sobol"}
        Sampling method.
    n : int
        Number of points, a power of two for Sobol.
    ranges : mapping of str to table
        A ``Range``, or its two ends, for each parameter.
    seed : int
        Seed of the sampler; equal seeds give equal points.
    """

    method: Literal["latin_hypercube", "sobol"]
    n: Count
    ranges: Mapping[str, Any]
    seed: Natural = 0

    def sets(self) -> list[Set]:
        """Return the parameter sets."""
        from scipy.stats import qmc

        _refuse_many(self.n)
        if self.method == "sobol" and self.n & (self.n - 1):
            raise CaseError(f"Sobol's points fill their ranges evenly where n is a power of two, not {self.n}.")
        ranges = {name: _range(name, one) for name, one in self.ranges.items()}
        if not ranges:
            raise CaseError("samples need ranges: a table of low and high for each parameter.")
        engine = qmc.LatinHypercube if self.method == "latin_hypercube" else qmc.Sobol
        points = engine(len(ranges), seed=self.seed).random(self.n).tolist()
        return [
            {name: text_of(one.at(share)) for (name, one), share in zip(ranges.items(), point, strict=True)}
            for point in points
        ]


def _range(name: str, table: Any) -> Range:
    table = {"low": table[0], "high": table[1]} if fits(table, tuple[Any, Any]) else table
    return _made(Range, table, f"range of {name}")


def _made(kind: type[T], table: Any, what: str) -> T:
    """Return an object from a table of its fields."""
    fields = {one.name: one for one in dataclasses.fields(kind)}  # type: ignore[arg-type]
    if not fits(table, Mapping[str, Any]):
        raise CaseError(f"{what} must be a table of {', '.join(fields)}, not {shown(table)}.")
    refuse_unknown(table, fields, f"{what} has no")
    missing = [name for name, one in fields.items() if one.default is dataclasses.MISSING and name not in table]
    if missing:
        raise CaseError(f"{what} need {', '.join(missing)}.")
    try:
        return kind(**table)
    except CaseError as error:
        raise CaseError(f"{what}: {error}") from None


def text_of(value: Any) -> str:
    """Return the text of a value for the command line: the shortest text that converts to the same number."""
    if isinstance(value, bool):
        return "true" if value else "false"
    if isinstance(value, float):
        return repr(value).removesuffix(".0")
    return str(value)


def values_in(text: str) -> list[str]:
    """Return the values of ``NAME=A,B,C``; commas inside brackets or quotes do not separate."""
    found, depth, quote = [""], 0, ""
    for letter in text:
        if quote:
            quote = "" if letter == quote else quote
        elif letter in "'\"":
            quote = letter
        elif letter in "([{":
            depth += 1
        elif letter in ")]}":
            depth -= 1
        if letter == "," and depth == 0 and not quote:
            found.append("")
        else:
            found[-1] += letter
    return found


def grid(choices: Mapping[str, Sequence[Any]]) -> list[Set]:
    """Return every combination of the values of each parameter, with the last one varying fastest.

    Raises
    ------
    CaseError
        A parameter has no value, or there are more than ``MOST_SETS`` combinations.
    """
    for name, values in choices.items():
        if not len(values):
            raise CaseError(f"Parameter {name} has no value.")
    _refuse_many(math.prod(len(values) for values in choices.values()))
    combinations = itertools.product(*choices.values())
    return [dict(zip(choices, map(text_of, values), strict=True)) for values in combinations]


def combined(first: Iterable[Set], second: Iterable[Set]) -> list[Set]:
    """Return each set of one list combined with each set of the other.

    Raises
    ------
    CaseError
        A parameter is in both, or there are more than ``MOST_SETS`` sets.
    """
    found = []
    first, second = list(first), list(second)
    _refuse_many(len(first) * len(second))
    for one in first:
        for other in second:
            if both := one.keys() & other.keys():
                raise CaseError(f"Parameter {min(both)} is given twice, with the command and in the file of sets.")
            found.append({**other, **one})
    return found


def read_sets(path: Path) -> list[Set]:
    """Return the parameter sets of a file, in its order.

    A CSV has one set per row under a header of names. A JSON is a list of objects, or an object with the tables of a
    TOML. ``sets`` has one set each. ``grids`` have lists of values, with all combinations. ``samples`` have ``method``
    ("latin_hypercube" or "sobol"), ``n``, ``seed`` and ``ranges`` with ``low``, ``high`` and ``scale`` ("linear", "log"
    or "integer").

    Raises
    ------
    CaseError
        The file does not exist, or has invalid contents.
    """
    kinds = {".csv": _from_csv, ".json": _from_json, ".toml": _from_toml}
    if path.suffix not in kinds:
        raise CaseError(f"The file of parameter sets {path} must end in .csv, .json or .toml.")
    text = text_in(path, "parameter sets")
    try:
        found = kinds[path.suffix](text)
        _refuse_many(len(found))
    except CaseError as error:
        raise CaseError(f"{path}: {error}") from None
    except (ValueError, ArithmeticError, RecursionError, csv.Error) as error:
        raise CaseError(f"{path} is no {path.suffix[1:].upper()} file: {error}.") from None
    if not found:
        raise CaseError(f"{path} holds no parameter set.")
    return found


def rows_of(text: str) -> list[list[str]]:
    """Return the rows of a CSV without empty ones, with words stripped of spaces."""
    rows = ([word.strip() for word in row] for row in csv.reader(io.StringIO(text, newline="")))
    return [row for row in rows if any(row)]


def _from_csv(text: str) -> list[Set]:
    header, *rows = rows_of(text) or [[]]
    if len(set(header)) < len(header) or not all(name.isidentifier() for name in header):
        raise CaseError("its first line must be the names of parameters, each once.")
    for number, row in enumerate(rows, 2):
        if len(row) != len(header) or not all(row):
            raise CaseError(f"row {number} must have {len(header)} values, one for each name.")
    return [dict(zip(header, row, strict=True)) for row in rows]


def _refuse_many(count: int) -> None:
    if count > MOST_SETS:
        raise CaseError(f"{count} parameter sets are more than {MOST_SETS}.")


def _from_json(text: str) -> list[Set]:
    refuse_deep(text)
    found = json.loads(text)
    return _from_tables({"sets": found} if isinstance(found, list) else found)


def _from_toml(text: str) -> list[Set]:
    refuse_deep(text)
    for name in ("tomllib", "tomli"):  # the second one for Python 3.10
        with contextlib.suppress(ImportError):
            return _from_tables(importlib.import_module(name).loads(text))
    raise CaseError("Python 3.10 reads TOML with tomli: pip install tomli; or write JSON or CSV.")


def _from_tables(tables: Any) -> list[Set]:
    if not fits(tables, Mapping[str, Any]):
        raise CaseError("it must be a list of parameter sets, or have sets, grids or samples.")
    refuse_unknown(tables, _OF_TABLE, "it has no table")
    found: list[Set] = []
    for kind, sets_of in _OF_TABLE.items():
        several = tables.get(kind, [])
        several = several if fits(several, Sequence[Any]) else [several]
        if not fits(several, Sequence[Mapping[str, Any]]):
            raise CaseError(f"{kind} must be tables of parameters by name.")
        for one in several:
            found += sets_of(one)
            _refuse_many(len(found))
    return found


def _set(table: Mapping[str, Any]) -> list[Set]:
    for name, value in table.items():
        if not fits(value, bool | float | str):
            raise CaseError(f"parameter {name} of a set takes one value, not {value!r}; values to combine go to grids.")
    return [{name: text_of(value) for name, value in table.items()}]


def _grid(table: Mapping[str, Any]) -> list[Set]:
    return grid({name: values if fits(values, Sequence[Any]) else [values] for name, values in table.items()})


def _samples(table: Mapping[str, Any]) -> list[Set]:
    return _made(Samples, table, "samples").sets()


_OF_TABLE = {"sets": _set, "grids": _grid, "samples": _samples}
