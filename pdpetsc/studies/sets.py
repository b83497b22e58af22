"""Parameter sets: every combination of some values, lists and samples from a file."""

from __future__ import annotations

import contextlib
import csv
import difflib
import importlib
import io
import itertools
import json
import math
import sys
from collections.abc import Iterable, Mapping, Sequence
from pathlib import Path
from typing import Any, TypeAlias

from pdpetsc.bounds import MOST_SETS, refuse_deep, text_in
from pdpetsc.declared import shown
from pdpetsc.errors import CaseError

Set: TypeAlias = dict[str, str]

# What a file of parameter sets may hold, and what a table of samples in it may.
TABLES = ("sets", "grids", "samples")
OF_SAMPLES = ("method", "n", "seed", "ranges")
METHODS = ("latin_hypercube", "sobol")
SCALES = ("linear", "log", "integer")
_LARGEST = sys.float_info.max


def text_of(value: Any) -> str:
    """Return a value as the command line takes it: the shortest text that gives the same number back."""
    if isinstance(value, bool):
        return "true" if value else "false"
    if isinstance(value, float):
        return repr(value).removesuffix(".0")
    return str(value)


def values_in(text: str) -> list[str]:
    """Return the values of ``NAME=A,B,C``; a comma inside brackets or quotes parts nothing."""
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
    """Return every combination of the values of each parameter, the last one changing quickest.

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
    """Return each set of one list together with each of the other.

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

    A CSV has a row a set under a header of names. A JSON is a list of objects, or an object of the tables that a TOML
    has: ``sets``, each one set; ``grids``, each of lists of values, all combinations; ``samples``, each of ``method``
    ("latin_hypercube" or "sobol"), ``n``, ``seed`` and ``ranges``, which have ``low``, ``high`` and ``scale``
    ("linear", "log" or "integer").

    Raises
    ------
    CaseError
        There is no such file, or something in it is not one of these.
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


def _from_csv(text: str) -> list[Set]:
    rows = list(csv.reader(io.StringIO(text, newline="")))
    if not rows:
        return []
    header = [name.strip() for name in rows[0]]
    if len(set(header)) < len(header) or not all(name.isidentifier() for name in header):
        raise CaseError("its first line must be the names of parameters, each once.")
    found = []
    for number, row in enumerate(rows[1:], 2):
        if not any(word.strip() for word in row):
            continue
        if len(row) != len(header) or not all(word.strip() for word in row):
            raise CaseError(f"line {number} must have {len(header)} values, one for each name.")
        found.append({name: word.strip() for name, word in zip(header, row, strict=True)})
    return found


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
    if not isinstance(tables, Mapping):
        raise CaseError("it must be a list of parameter sets, or have sets, grids or samples.")
    _refuse_unknown(tables, TABLES, "a table")
    found: list[Set] = []
    for one in _tables(tables, "sets"):
        found.append({name: _single(name, value) for name, value in one.items()})
    for one in _tables(tables, "grids"):
        found += grid({n: v if isinstance(v, list) else [v] for n, v in one.items()})
        _refuse_many(len(found))
    for one in _tables(tables, "samples"):
        found += _sampled(one)
        _refuse_many(len(found))
    return found


def _tables(tables: Mapping[str, Any], name: str) -> list[Mapping[str, Any]]:
    found = tables.get(name, [])
    found = [found] if isinstance(found, Mapping) else found
    if not isinstance(found, list) or not all(isinstance(one, Mapping) for one in found):
        raise CaseError(f"{name} must be tables of parameters by name.")
    return found


def _single(name: str, value: Any) -> str:
    if isinstance(value, list | Mapping) or value is None:
        raise CaseError(f"parameter {name} of a set takes one value, not {value!r}; values to combine go to grids.")
    return text_of(value)


def _refuse_unknown(found: Iterable[str], known: Sequence[str], kind: str) -> None:
    for name in found:
        if name not in known:
            near = difflib.get_close_matches(name, known, n=1)
            hint = f"did you mean {near[0]}?" if near else f"there are {', '.join(known)}."
            raise CaseError(f"{name!r} is not {kind} of it; {hint}")


def _sampled(table: Mapping[str, Any]) -> list[Set]:
    """Return samples of ranges, the same ones whenever they are asked for."""
    from scipy.stats import qmc

    _refuse_unknown(table, OF_SAMPLES, "a word of samples")
    method, n, seed, ranges = (table.get(name, 0 if name == "seed" else None) for name in OF_SAMPLES)
    if method not in METHODS:
        raise CaseError(f"the method of samples is {' or '.join(METHODS)}, not {method!r}.")
    if isinstance(n, bool) or not isinstance(n, int) or n < 1:
        raise CaseError(f"n of samples is a positive whole number, not {shown(n)}.")
    _refuse_many(n)
    if isinstance(seed, bool) or not isinstance(seed, int) or seed < 0:
        raise CaseError(f"the seed of samples is a whole number >= 0, not {shown(seed)}.")
    if method == "sobol" and n & (n - 1):
        raise CaseError(f"Sobol's points fill their ranges evenly where n is a power of two, not {n}.")
    if not isinstance(ranges, Mapping) or not ranges:
        raise CaseError("samples need ranges: a table of low and high for each parameter.")
    engine = (qmc.LatinHypercube if method == "latin_hypercube" else qmc.Sobol)(len(ranges), seed=seed)
    points = engine.random(n)
    columns = {name: _of_range(name, one, points[:, k].tolist()) for k, (name, one) in enumerate(ranges.items())}
    return [dict(zip(columns, values, strict=True)) for values in zip(*columns.values(), strict=True)]


def _of_range(name: str, table: Any, shares: Sequence[float]) -> list[str]:
    """Return the values at shares in [0, 1) of a range."""
    table = dict(zip(("low", "high"), table, strict=False)) if isinstance(table, list) and len(table) == 2 else table
    if not isinstance(table, Mapping):
        raise CaseError(f"the range of {name} has low and high, not {table!r}.")
    _refuse_unknown(table, ("low", "high", "scale"), f"a word of the range of {name}")
    low, high, scale = table.get("low"), table.get("high"), table.get("scale", "linear")
    numbers = [v for v in (low, high) if isinstance(v, int | float) and not isinstance(v, bool) and abs(v) <= _LARGEST]
    if len(numbers) < 2 or not numbers[0] < numbers[1] or not math.isfinite(numbers[1] - numbers[0]):
        raise CaseError(f"the range of {name} needs numbers low < high, not {shown(low)} and {shown(high)}.")
    if scale not in SCALES:
        raise CaseError(f"the scale of {name} is {', '.join(SCALES)}, not {scale!r}.")
    if scale == "log":
        if numbers[0] <= 0.0:
            raise CaseError(f"the range of {name} has no logarithm from {low!r} on.")
        return [text_of(float(numbers[0] * (numbers[1] / numbers[0]) ** share)) for share in shares]
    if scale == "integer":
        if not all(float(number).is_integer() for number in numbers):
            raise CaseError(f"the range of {name} goes from one whole number to another, not {low!r} to {high!r}.")
        return [str(int(numbers[0]) + int(share * (numbers[1] - numbers[0] + 1))) for share in shares]
    return [text_of(float(numbers[0] + share * (numbers[1] - numbers[0]))) for share in shares]
