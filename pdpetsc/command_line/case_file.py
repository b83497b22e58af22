"""Case files: the function ``case``, its parameters and the returned case."""

from __future__ import annotations

import ast
import importlib.util
import inspect
import re
import sys
import traceback
from collections.abc import Callable, Mapping
from pathlib import Path
from typing import TYPE_CHECKING, Any

from pdpetsc.declared import near_or_all, refuse_unknown, shown
from pdpetsc.errors import CaseError, PdpetscError

if TYPE_CHECKING:
    from pdpetsc.case import Case


def load_case(path: Path) -> Callable[..., Case]:
    """Return the function ``case`` of a case file.

    Raises
    ------
    CaseError
        The file is missing, fails, or defines no such function.
    """
    try:
        there = path.is_file()
    except OSError as error:  # the name is too long
        raise CaseError(f"Cannot read the case file {path}: {error.strerror or error}.") from None
    if not there:
        raise CaseError(f"Cannot read the case file {path}: file not found.")
    spec = importlib.util.spec_from_file_location(path.stem, path)
    if spec is None or spec.loader is None:
        raise CaseError(f"The case file {path} must end in .py.")
    module = importlib.util.module_from_spec(spec)
    sys.path.insert(0, str(path.parent.resolve()))
    _guarded(path, lambda: spec.loader.exec_module(module))  # type: ignore[union-attr]
    function = getattr(module, "case", None)
    if not callable(function):
        raise CaseError(f"The case file {path} defines no function case(...).")
    return function  # type: ignore[no-any-return]


def arguments_of(function: Callable[..., Any], given: Mapping[str, str]) -> dict[str, Any]:
    """Return the keywords of a case function with the given values converted to their defaults' types.

    Raises
    ------
    CaseError
        A name is unknown, a value cannot be converted, or a parameter has no default.
    """
    try:
        parameters = inspect.signature(function).parameters
    except (TypeError, ValueError):
        raise CaseError(
            f"The case {shown(function)} is no function of a case file; define it by def case(...)."
        ) from None
    for name, parameter in parameters.items():
        if parameter.default is inspect.Parameter.empty:
            raise CaseError(f"Parameter {name} of the case function needs a default.")
    refuse_unknown(given, parameters, "The case has no parameter")
    values = {name: parameter.default for name, parameter in parameters.items()}
    return values | {name: convert(name, text, values[name]) for name, text in given.items()}


def make_case(path: Path, function: Callable[..., Any], parameters: Mapping[str, Any]) -> Case:
    """Call the function of a case file; raise CaseError unless it returns a case."""
    from pdpetsc.case import Case

    case = _guarded(path, lambda: function(**parameters))
    if not isinstance(case, Case):
        raise CaseError(f"case(...) of {path} must return a pdpetsc.Case, not {type(case).__name__}.")
    return case


def _guarded(path: Path, call: Callable[[], Any]) -> Any:
    """Call a function of the case file and convert its errors to one message with the line."""
    try:
        return call()
    except PdpetscError:
        raise
    except SystemExit as error:
        raise CaseError(
            f"The case file {path} called sys.exit{_line_of(path, error)}. Raise an error, or return the case."
        ) from error
    except SyntaxError as error:
        inside = error.filename is None or Path(error.filename).name == path.name
        where = f"The case file {path}" if inside else f"{error.filename}, which the case file {path} imports,"
        raise CaseError(f"{where} has a syntax error in line {error.lineno}: {error.msg}.") from error
    except Exception as error:
        where = _line_of(path, error) or " somewhere below it"
        words = " ".join(str(error).split()).rstrip(".")
        said = f"{type(error).__name__}: {words}" if words else type(error).__name__
        said = _of_arguments(words) if isinstance(error, TypeError) else said if said.endswith("?") else f"{said}."
        raise CaseError(f"The case file {path} failed{where}: {said}") from error


def _of_arguments(words: str) -> str:
    """Return the message of a TypeError, in plain words if it is about arguments of a class or function of pdpetsc."""
    import pdpetsc

    rooms = [pdpetsc, *(room for room in map(vars(pdpetsc).get, pdpetsc.__all__) if inspect.ismodule(room))]
    name, _, problem = words.partition("() ")
    name = name.removesuffix(".__init__")
    taker = next((getattr(room, name) for room in rooms if name in getattr(room, "__all__", vars(room))), None)
    if callable(taker) and (unknown := re.match(r"got an unexpected keyword argument '(\w+)'", problem)):
        known = list(inspect.signature(taker).parameters)
        return f"{name} has no argument {unknown[1]}; {near_or_all(unknown[1], known)}"
    if callable(taker) and (missing := re.match(r"missing \d+ required .*arguments?: (.*)", problem)):
        return f"{name} needs {missing[1].replace(chr(39), '')}."
    return f"TypeError: {words}."


def _line_of(path: Path, error: BaseException) -> str:
    lines = [f.lineno for f in traceback.extract_tb(error.__traceback__) if Path(f.filename).name == path.name]
    return f" in line {lines[-1]}" if lines else ""


def convert(name: str, text: str, default: Any) -> Any:
    """Convert a word of the command line to the type of a default, or raise CaseError."""
    kind = type(default)
    try:
        if kind is bool:
            return {"true": True, "yes": True, "1": True, "false": False, "no": False, "0": False}[text.lower()]
        if kind in (int, float, str):
            return kind(text)
        value = ast.literal_eval(text)
        return value if default is None else kind(value)
    except (ValueError, KeyError, SyntaxError, TypeError, OverflowError, RecursionError, MemoryError):
        raise CaseError(f"Parameter {name} takes {kind.__name__} like {default!r}, not {shown(text)}.") from None
