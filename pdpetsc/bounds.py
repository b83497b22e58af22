"""Bounds on text that others wrote: its size, how deeply it is nested, and the numbers in it."""

from __future__ import annotations

import re
from pathlib import Path

from pdpetsc.errors import CaseError

# Bytes of a deck, and entries in it: a deck has a few hundred.
LONGEST_DECK, MOST_ENTRIES = 500_000, 10_000
# Bytes of a table of numbers or parameter sets, and parameter sets of one study.
LONGEST_TABLE, MOST_SETS = 50_000_000, 100_000
# Brackets, lists and sections that are in each other.
DEEPEST = 50
# Load steps of a deck.
MOST_STEPS = 10_000
# Blocks of a cloud.
MOST_BLOCKS = 10_000
_WHOLE = re.compile(r"[0-9]{1,18}")
_REAL = re.compile(r"[+-]?(?:[0-9]+\.?[0-9]*|\.[0-9]+)(?:[eE][+-]?[0-9]{1,4})?")
_QUOTED = re.compile(r'"""|\'\'\'|"(?:[^"\\\n]|\\.)*"|\'[^\'\n]*\'|[\[\]{}]')


def text_in(path: Path, what: str, longest: int = LONGEST_TABLE, encoding: str = "utf-8") -> str:
    """Read the text of a file that a user wrote.

    Raises
    ------
    CaseError
        The file cannot be read, is no text, or has more bytes than ``longest``.
    """
    try:
        with path.open("rb") as file:
            raw = file.read(longest + 1)
        if len(raw) > longest:
            raise CaseError(f"The {what} {path} has more than {longest} bytes.")
        return raw.decode(encoding)
    except OSError as error:
        raise CaseError(f"Cannot read the {what} {path}: {error.strerror or error}.") from None
    except ValueError as error:
        if isinstance(error, CaseError):
            raise
        raise CaseError(f"Cannot read the {what} {path}: it is not text.") from None


def whole_number(text: str) -> int | None:
    """Return a whole number of at most 18 digits from 0 to 9, None for any other text."""
    return int(text) if _WHOLE.fullmatch(text) else None


def real_number(text: str) -> float | None:
    """Return a number in digits from 0 to 9, None for any other text; it is infinite beyond the largest float."""
    return float(text) if _REAL.fullmatch(text) else None


def refuse_deep(text: str) -> None:
    """Raise CaseError if brackets of a text outside quotes are nested more than ``DEEPEST`` deep."""
    depth = 0
    for found in _QUOTED.finditer(text):
        depth += {"[": 1, "{": 1, "]": -1, "}": -1}.get(found[0], 0)
        if depth > DEEPEST:
            raise CaseError(f"it is nested more than {DEEPEST} deep.")
