"""Checks of declared values against the annotated types of their fields."""

from __future__ import annotations

import dataclasses
import difflib
import inspect
import math
import numbers
import traceback
import types
from collections.abc import Callable, Collection, Iterable, Mapping, Sequence
from functools import cache
from pathlib import Path
from typing import Annotated, Any, Literal, TypeAlias, TypeVar, Union, get_args, get_origin, get_type_hints

import numpy as np

from pdpetsc.arrays import Float
from pdpetsc.errors import CaseError, PdpetscError

# Largest number of characters of a value in a message.
SHOWN = 60

T = TypeVar("T")


@dataclasses.dataclass(frozen=True)
class Bound:
    """A condition on a number besides its type: words for one and for several numbers, and a test."""

    words: tuple[str, str]
    holds: Callable[[float], bool]


# Annotations for fields with numbers.
Finite: TypeAlias = Annotated[float, Bound(("a finite number", "finite numbers"), math.isfinite)]
Positive: TypeAlias = Annotated[
    float, Bound(("a positive number", "positive numbers"), lambda x: math.isfinite(x) and x > 0.0)
]
NonNegative: TypeAlias = Annotated[
    float, Bound(("a finite number >= 0", "finite numbers >= 0"), lambda x: math.isfinite(x) and x >= 0.0)
]
NonNegativeOrInfinite: TypeAlias = Annotated[float, Bound(("a number >= 0", "numbers >= 0"), lambda x: x >= 0.0)]
Fraction: TypeAlias = Annotated[
    float, Bound(("a number between 0 and 1", "numbers between 0 and 1"), lambda x: 0.0 < x < 1.0)
]
Count: TypeAlias = Annotated[int, Bound(("a positive whole number", "positive whole numbers"), lambda n: n >= 1)]

Natural: TypeAlias = Annotated[int, Bound(("a whole number >= 0", "whole numbers >= 0"), lambda n: n >= 0)]


class Declared:
    """Base class of declarations: a dataclass that checks its fields against their annotations.

    A subclass with its own ``__post_init__`` calls this one first and may then rely on the types.

    Raises
    ------
    CaseError
        A field has another type, such as a string for a number, a class for an object or one item for a sequence, or
        is NaN.
    """

    def __post_init__(self) -> None:
        kind: Any = type(self)
        for name, hint in _hints(kind).items():
            value = getattr(self, name)
            if not fits(value, hint):
                raise CaseError(
                    f"{kind.__name__.lstrip('_')} takes {words_of(hint)} as {name}, not {shown(value)}"
                    f"{_advice(value, hint)}."
                )


def input_files(value: Any) -> list[Path]:
    """Return the input files of a declared object and of the objects inside it.

    A class that reads files has its own method ``input_files``.
    """
    own = getattr(value, "input_files", None)
    if own is not None:
        return list(own())
    if dataclasses.is_dataclass(value):
        value = vars(value)
    if isinstance(value, Mapping):
        value = list(value.values())
    parts = value if isinstance(value, list | tuple) else []
    return [file for part in parts for file in input_files(part)]


def shown(value: object) -> str:
    """Return the text of a value for messages."""
    if isinstance(value, type):
        return f"the class {value.__name__}"
    if isinstance(value, types.FunctionType):
        return f"the function {value.__name__}"
    try:
        text = " ".join(repr(value).split())
    except Exception:
        text = f"an object of {type(value).__name__}"
    return text if len(text) <= SHOWN else text[: SHOWN - 3] + "..."


def meant(word: str, known: Iterable[str], sentence: str) -> str:
    """Return a sentence with the known word most similar to a given one, or an empty string."""
    near = difflib.get_close_matches(word, list(known), n=1)
    return sentence.format(near[0]) if near else ""


def near_or_all(word: str, known: Collection[str]) -> str:
    """Return the end of a message on an unknown word: the most similar known word, or all of them."""
    return meant(word, known, "did you mean {}?") or f"it has {', '.join(known) or 'none'}."


class ByName(dict[str, T]):
    """A dictionary whose error for an unknown name suggests a known one; ``what`` is what it holds, for the message."""

    def __init__(self, what: str, items: Mapping[str, T]) -> None:
        super().__init__(items)
        self.what = what

    def __missing__(self, name: str) -> T:
        raise KeyError(f"The {self.what} has no {name!r}; {near_or_all(name, self)}")


def refuse_unknown(words: Iterable[str], known: Collection[str], begin: str) -> None:
    """Raise CaseError for an unknown word, with a message that starts with ``begin``."""
    for word in words:
        if word not in known:
            there = f"it has {', '.join(known) or 'none'}"
            raise CaseError(f"{begin} {word!r}; {meant(word, known, 'did you mean {}? ')}{there}.")


def called(what: str, function: Callable[..., T], *arguments: Any) -> T:
    """Call a function of the user and return its result; convert its exceptions to one message with their place.

    Parameters
    ----------
    what : str
        Purpose of the function, for the message.
    function : callable
        Called with ``arguments``.

    Raises
    ------
    CaseError
        The function raised an exception.
    """
    try:
        return function(*arguments)
    except PdpetscError:
        raise
    except Exception as error:
        frames = traceback.extract_tb(error.__traceback__)[1:]
        code = getattr(function, "__code__", None)
        inside = [frame for frame in frames if code is not None and frame.filename == code.co_filename]
        where = "".join(f" at {Path(frame.filename).name}:{frame.lineno}" for frame in (inside or frames)[-1:])
        why = " ".join(str(error).split()).rstrip(".")
        said = f": {why}" if why else ""
        raise CaseError(f"The {what} {name_of(function)} failed{where}: {type(error).__name__}{said}.") from error


def refuse_signature(what: str, function: Callable[..., Any], *arguments: str) -> None:
    """Raise CaseError if a function of the user cannot be called with these arguments.

    Functions without a signature, such as some in C, are not checked.
    """
    try:
        signature = inspect.signature(function)
    except (TypeError, ValueError):
        return
    try:
        signature.bind(*arguments)
    except TypeError as error:
        raise CaseError(
            f"The {what} {name_of(function)}{signature} cannot be called with ({', '.join(arguments)}): {error}."
        ) from None


def numbers_from(what: str, function: Callable[..., Any], *arguments: Any) -> Float:
    """Call a function of the user as in ``called``, and return its result as an array of numbers.

    Raises
    ------
    CaseError
        The function raised an exception, or did not return real numbers.
    """
    values = called(what, function, *arguments)
    found = real_numbers(values)
    if found is None:
        raise CaseError(f"The {what} {name_of(function)} must return real numbers, not {shown(values)}.")
    return found


def real_numbers(values: Any) -> Float | None:
    """Return values as an array of numbers; None if they are not real numbers."""
    try:
        return None if np.iscomplexobj(values) else np.asarray(values, dtype=float)
    except (TypeError, ValueError, OverflowError):
        return None


def name_of(function: object) -> str:
    """Return the name of a function."""
    return str(getattr(function, "__name__", type(function).__name__))


@cache
def _hints(kind: Any) -> dict[str, Any]:
    """Return the annotated type of each field; empty if an annotation cannot be resolved."""
    try:
        hints = get_type_hints(kind, include_extras=True)
    except (NameError, AttributeError, TypeError, SyntaxError):
        return {}
    return {field.name: hints[field.name] for field in dataclasses.fields(kind) if field.init}


def fits(value: object, hint: Any) -> bool:
    """Return True if a value is of an annotated type; any value fits an annotation that is not supported."""
    origin, arguments = get_origin(hint), get_args(hint)
    if hint is Any:
        return True
    if origin is Annotated:
        return fits(value, arguments[0]) and all(bound.holds(value) for bound in arguments[1:])
    if hint is None or hint is type(None):
        return value is None
    if hint is float:
        return _is_number(value)
    if hint is int:
        return isinstance(value, numbers.Integral) and not isinstance(value, bool)
    if hint is bool:
        return isinstance(value, bool | np.bool_)
    if origin is Literal:
        return fits(value, type(arguments[0])) and value in arguments
    if origin in (Union, types.UnionType):
        return any(fits(value, argument) for argument in arguments)
    if origin is tuple:
        if not isinstance(value, tuple | list):
            return False
        if arguments[-1] is ...:
            return all(fits(item, arguments[0]) for item in value)
        return len(value) == len(arguments) and all(map(fits, value, arguments))
    if isinstance(origin, type) and issubclass(origin, Mapping):
        return isinstance(value, Mapping) and all(
            fits(key, arguments[0]) and fits(item, arguments[1]) for key, item in value.items()
        )
    if origin is not None and origin is not Callable and _is_sequence_hint(origin):
        return _is_sequence(value) and all(fits(item, arguments[0]) for item in value)  # type: ignore[attr-defined]
    if origin is np.ndarray:
        return isinstance(value, np.ndarray)
    if origin is Callable:
        # A class in place of a function is most likely an object without its parentheses.
        return callable(value) and not isinstance(value, type)
    return not isinstance(hint, type) or isinstance(value, hint)


def _is_number(value: object) -> bool:
    if not isinstance(value, numbers.Real) or isinstance(value, bool):
        return False
    try:
        return not math.isnan(float(value))
    except OverflowError:
        return False


def _is_sequence_hint(origin: object) -> bool:
    return isinstance(origin, type) and issubclass(origin, Sequence)


def _is_sequence(value: object) -> bool:
    if isinstance(value, np.ndarray):
        return value.ndim > 0
    return isinstance(value, Sequence) and not isinstance(value, str | bytes | bytearray)


_WORDS: dict[Any, tuple[str, str]] = {
    float: ("a number", "numbers"),
    int: ("a whole number", "whole numbers"),
    bool: ("True or False", "True or False"),
    str: ("a string", "strings"),
    Path: ("a path", "paths"),
    type(None): ("None", "None"),
    Any: ("anything", "anything"),
}


def words_of(hint: Any, several: bool = False) -> str:
    """Return an annotated type in words, for one value or for several."""
    origin, arguments = get_origin(hint), get_args(hint)
    if hint in _WORDS:
        return _WORDS[hint][several]
    if origin is Annotated:
        return str(arguments[1].words[several])
    if origin is Literal:
        return " or ".join(repr(argument) for argument in arguments)
    if origin in (Union, types.UnionType):
        listed = list(dict.fromkeys(words_of(argument, several) for argument in arguments))
        return " or ".join([", ".join(listed[:-1]), listed[-1]] if len(listed) > 1 else listed)
    if origin is tuple and arguments[-1] is not ...:
        return f"{'pairs' if several else 'a pair'} ({', '.join(words_of(argument) for argument in arguments)})"
    if isinstance(origin, type) and issubclass(origin, Mapping):
        return f"a mapping of {words_of(arguments[0], True)} to {words_of(arguments[1], True)}"
    if origin is tuple or (origin is not Callable and _is_sequence_hint(origin)):
        return f"{'sequences' if several else 'a sequence'} of {words_of(arguments[0], True)}"
    if origin is Callable:
        return "functions" if several else "a function"
    if origin is np.ndarray:
        return "arrays" if several else "an array"
    name = getattr(hint, "__name__", str(hint))
    if several:
        return f"{name} objects"
    return f"{'an' if name[0] in 'AEIOU' else 'a'} {name}"


def _advice(value: object, hint: Any) -> str:
    """Return advice on a wrong value, or an empty string."""
    if isinstance(value, type):
        return f"; write {value.__name__}(...) for an object of it"
    for choice in get_args(hint) if get_origin(hint) in (Union, types.UnionType) else (hint,):
        if callable(value) and (instead := getattr(choice, "instead_of_function", "")):
            return f"; {instead}"
        if isinstance(value, Mapping) and get_origin(choice) is Mapping:
            key, entry = get_args(choice)
            name, wrong = next((name, one) for name, one in value.items() if not (fits(name, key) and fits(one, entry)))
            return f"; {shown(name)} is {shown(wrong)}{_advice(wrong, entry)}" if fits(name, key) else ""
        if not _is_sequence_hint(get_origin(choice)) or get_origin(choice) is tuple:
            continue
        item = get_args(choice)[0]
        if fits(value, item):
            return "; put it into a list"
        if _is_sequence(value):
            number, wrong = next((n, entry) for n, entry in enumerate(value, 1) if not fits(entry, item))  # type: ignore[var-annotated, arg-type]
            return f"; entry {number} is {shown(wrong)}"
    return ""
