"""Expressions of decks, such as ``0.001*y*t``: parsed by a grammar of their own, never evaluated as code.

either = both {("|" | "||" | "or") both}
both = compared {("&" | "&&" | "and") compared}
compared = sum [("<" | "<=" | ">" | ">=" | "==" | "!=") sum]
sum = product {("+" | "-") product}
product = signed {("*" | "/") signed}
signed = ("+" | "-") signed | power
power = atom [("^" | "**") signed]
atom = number | name | name "(" either {"," either} ")" | "(" either ")"

In Peridigm a sign binds more tightly than a power, so that -x^2 is the square of -x:

product = power {("*" | "/") power}
power = signed ["^" power]
signed = ("+" | "-") signed | atom

There a value may also be a statement, with or without a backslash before each brace, as YAML and XML have it:

statement = "if" "(" either ")" block "else" (block | statement) | ["value" "="] either [";"]
block = "{" statement "}"
"""

from __future__ import annotations

import math
import re
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from typing import Any, ClassVar

import numpy as np

from pdpetsc.declared import shown
from pdpetsc.errors import CaseError

_TOKEN = re.compile(
    r"\s*(?:(?P<number>(?:\d+\.?\d*|\.\d+)(?:[eE][+-]?\d+)?)|(?P<name>[A-Za-z_]\w*)"
    r"|(?P<mark>\*\*|<=|>=|==|!=|&&|\|\||[-+*/^()<>,&|{};=]))",
    re.ASCII,
)
# Functions of decks, as numpy has them, with the number of their arguments.
FUNCTIONS: dict[str, tuple[str, int]] = {
    "sin": ("np.sin", 1), "cos": ("np.cos", 1), "tan": ("np.tan", 1), "asin": ("np.arcsin", 1),
    "acos": ("np.arccos", 1), "atan": ("np.arctan", 1), "sinh": ("np.sinh", 1), "cosh": ("np.cosh", 1),
    "tanh": ("np.tanh", 1), "exp": ("np.exp", 1), "log": ("np.log", 1), "log10": ("np.log10", 1),
    "sqrt": ("np.sqrt", 1), "abs": ("np.abs", 1), "fabs": ("np.abs", 1), "pow": ("**", 2),
    "min": ("np.minimum", 2), "max": ("np.maximum", 2), "ifelse": ("np.where", 3),
}  # fmt: skip
# Those that Peridigm's expressions do not have.
_NOT_PERIDIGM = ("abs", "min", "max", "ifelse")
_BINDING = {"|": 1, "&": 2, "<": 3, "<=": 3, ">": 3, ">=": 3, "==": 3, "!=": 3, "+": 4, "-": 4, "*": 5, "/": 5, "**": 7}
_COMPARE = ("<", "<=", ">", ">=", "==", "!=")
# Levels of brackets, and words: a chain of sums is as deep as it has terms.
_DEEPEST, _LONGEST = 60, 400


@dataclass(frozen=True)
class Node:
    """A number, a name, an operation or a call, with what it acts on."""

    kind: str
    word: str
    parts: tuple[Node, ...] = ()

    @property
    def names(self) -> set[str]:
        """Return the variables in it."""
        own = {self.word} if self.kind == "name" else set()
        return own.union(*(part.names for part in self.parts))

    @property
    def logical(self) -> bool:
        """Return whether it is true or false."""
        return self.kind == "operation" and self.word in (*_COMPARE, "&", "|")

    def python(self, names: Mapping[str, str]) -> str:
        """Return it as Python with numpy, with the variables called as ``names`` says."""
        return self._python(names)[0]

    def _python(self, names: Mapping[str, str]) -> tuple[str, int]:
        """Return the text and how strongly its outermost operation binds."""
        if self.kind == "number":
            return self.word, 9
        if self.kind == "name":
            return names[self.word], 9
        if self.kind == "call" and self.word != "pow":
            return f"{FUNCTIONS[self.word][0]}({', '.join(part.python(names) for part in self.parts)})", 9
        if self.kind == "sign":
            text, binds = self.parts[0]._python(names)
            return f"{self.word}{text}" if binds >= 6 else f"{self.word}({text})", 6
        word = "**" if self.kind == "call" else self.word
        own = _BINDING[word]
        (left, before), (right, after) = (part._python(names) for part in self.parts)
        # Numpy's & and | bind more tightly than comparisons do.
        if word in "&|":
            own = 2
            return f"({left}) {word} ({right})", own
        left = left if before > own or (before == own and word != "**" and word not in _COMPARE) else f"({left})"
        right = right if after > own else f"({right})"
        return f"{left} {word} {right}", own

    def value(self, at: Mapping[str, float]) -> float:
        """Return the number that it is where the variables have these values."""
        if self.kind == "number":
            return float(self.word)
        if self.kind == "name":
            return float(np.pi) if self.word == "pi" else at[self.word]
        found = [part.value(at) for part in self.parts]
        with np.errstate(all="ignore"):
            if self.kind == "sign":
                return -found[0] if self.word == "-" else found[0]
            if self.kind == "call" and self.word != "pow":
                return float(getattr(np, FUNCTIONS[self.word][0][3:])(*found))
            a, b = np.float64(found[0]), np.float64(found[1])
            operations: dict[str, Callable[..., Any]] = {
                "+": np.add, "-": np.subtract, "*": np.multiply, "/": np.divide, "**": np.power, "pow": np.power,
                "<": np.less, "<=": np.less_equal, ">": np.greater, ">=": np.greater_equal, "==": np.equal,
                "!=": np.not_equal, "&": np.logical_and, "|": np.logical_or,
            }  # fmt: skip
            return float(operations[self.word](a, b))


def parse(text: str, where: str, allowed: set[str]) -> Node:
    """Parse a number of PeriLab.

    Parameters
    ----------
    text : str
        The expression; ``value = ...`` and a semicolon at the end do not matter.
    where : str
        What it is of the deck, for messages.
    allowed : set of str
        Variables that it may have; ``pi`` is the number.

    Raises
    ------
    CaseError
        It does not follow the grammar, has another variable or function, or is no number where one is needed.
    """
    return _Parser(text, where, allowed).number()


def parse_condition(text: str, where: str, allowed: set[str]) -> Node:
    """Parse an expression of PeriLab that is true or false; arguments and errors as of ``parse``."""
    return _Parser(text, where, allowed).condition()


def parse_peridigm(text: str, where: str, allowed: set[str]) -> Node:
    """Parse a number of Peridigm, which may be an ``if``; arguments and errors as of ``parse``."""
    return _PeridigmParser(text, where, allowed).number()


class _Parser:
    functions: ClassVar[Sequence[str]] = list(FUNCTIONS)

    def __init__(self, text: str, where: str, allowed: set[str]) -> None:
        plain = re.sub(r"\\([{}])", r"\1", text).strip()
        # Julia's operations on every member of a list are the same as those on one.
        plain = re.sub(r"\.(?=[*/+^-])|(?<=[a-z])\.(?=\()", " ", re.sub(r"(\d)\.(?=[*/+^-])", r"\1.0", plain))
        self._shown, self._where, self._allowed, self._depth = text, where, allowed | {"pi"}, 0
        self._tokens: list[tuple[str, str]] = []
        at = 0
        while at < len(plain):
            found = _TOKEN.match(plain, at)
            if found is None:
                if not plain[at:].strip():
                    break
                raise self._wrong(f"{plain[at:].strip()[:12]!r} is not understood")
            kind = str(found.lastgroup)
            self._tokens.append((kind, found[kind]))
            if len(self._tokens) > _LONGEST:
                raise self._wrong(f"it has more than {_LONGEST} words")
            at = found.end()
        self._at = 0

    def _wrong(self, why: str) -> CaseError:
        return CaseError(
            f"{self._where} of the deck is {shown(self._shown)}, an expression that cannot be translated: {why}; write "
            f"it with numbers, {', '.join(sorted(self._allowed))}, + - * / ^ and {', '.join(self.functions)}."
        )

    def _next(self) -> str:
        return self._tokens[self._at][1] if self._at < len(self._tokens) else ""

    def _take(self, *words: str) -> str:
        word = self._next()
        if word in words and word:
            self._at += 1
            return word
        return ""

    def number(self) -> Node:
        """Parse all of the text; raises CaseError unless it is a number."""
        found = self._whole()
        if found.logical:
            raise CaseError(f"{self._where} of the deck, {self._shown!r}, is true or false.")
        return found

    def condition(self) -> Node:
        """Parse all of the text; raises CaseError unless it is true or false."""
        found = self._whole()
        if not found.logical:
            raise CaseError(f"{self._where} of the deck, {self._shown!r}, is a number.")
        return found

    def _whole(self) -> Node:
        found = self._statement()
        if self._at < len(self._tokens):
            raise self._wrong(f"{self._next()!r} stands where nothing can")
        return found

    def _statement(self) -> Node:
        self._enter()
        if self._next() == "value":
            self._at += 1
            self._need("=")
        found = self._either()
        self._take(";")
        self._depth -= 1
        return found

    def _need(self, word: str) -> None:
        if not self._take(word):
            raise self._wrong(f"{word!r} is missing before {self._next() or 'its end'!r}")

    def _enter(self) -> None:
        self._depth += 1
        if self._depth > _DEEPEST:
            raise self._wrong("it is nested too deeply")

    def _either(self) -> Node:
        self._enter()
        found = self._both()
        while self._take("|", "||", "or"):
            found = self._joined("|", found, self._both())
        self._depth -= 1
        return found

    def _both(self) -> Node:
        found = self._compared()
        while self._take("&", "&&", "and"):
            found = self._joined("&", found, self._compared())
        return found

    def _joined(self, word: str, one: Node, other: Node) -> Node:
        if not (one.logical and other.logical):
            raise self._wrong(f"both sides of {word} must be comparisons")
        return Node("operation", word, (one, other))

    def _compared(self) -> Node:
        found = self._sum()
        word = self._take(*_COMPARE)
        if not word:
            return found
        found = Node("operation", word, (found, self._sum()))
        if self._next() in _COMPARE:
            raise self._wrong("two comparisons stand in a row; join them with &")
        return found

    def _sum(self) -> Node:
        found = self._product()
        while word := self._take("+", "-"):
            found = self._finite(Node("operation", word, (self._number(found), self._number(self._product()))))
        return found

    def _product(self) -> Node:
        found = self._factor()
        while word := self._take("*", "/"):
            found = self._finite(Node("operation", word, (self._number(found), self._number(self._factor()))))
        return found

    def _factor(self) -> Node:
        return self._signed()

    def _signed(self) -> Node:
        self._enter()
        word = self._take("+", "-")
        found = self._signed() if word else self._unsigned()
        self._depth -= 1
        return Node("sign", "-", (self._number(found),)) if word == "-" else found

    def _unsigned(self) -> Node:
        return self._power()

    def _power(self) -> Node:
        return self._raised(self._atom, self._signed, "^", "**")

    def _raised(self, base: Callable[[], Node], exponent: Callable[[], Node], *words: str) -> Node:
        self._enter()
        found = base()
        if self._take(*words):
            found = self._finite(Node("operation", "**", (self._number(found), self._number(exponent()))))
        self._depth -= 1
        return found

    def _finite(self, node: Node) -> Node:
        """Return a node; refuse constants that are not finite, which Python may compute without end."""
        if node.names <= {"pi"} and not math.isfinite(node.value({})):
            raise self._wrong("a part of it is no finite number")
        return node

    def _number(self, node: Node) -> Node:
        if node.logical:
            raise self._wrong("a comparison stands where a number must")
        return node

    def _atom(self) -> Node:
        if self._at == len(self._tokens):
            raise self._wrong("it ends too early")
        kind, word = self._tokens[self._at]
        self._at += 1
        if kind == "number":
            # Python reads no whole numbers that begin with zeros.
            return self._finite(Node("number", word.lstrip("0") or "0" if word.isdecimal() else word))
        if kind == "name" and self._next() == "(":
            return self._call(word)
        if kind == "name":
            if word not in self._allowed:
                raise self._wrong(f"{word} is not known")
            return Node("name", word)
        if word == "(":
            found = self._either()
            self._need(")")
            return found
        raise self._wrong(f"{word!r} stands where a number must")

    def _call(self, word: str) -> Node:
        if word not in self.functions:
            raise self._wrong(f"{word}() is not known")
        self._at += 1
        parts = [self._either()]
        while self._take(","):
            parts.append(self._either())
        self._need(")")
        if len(parts) != FUNCTIONS[word][1]:
            raise self._wrong(f"{word}() takes {FUNCTIONS[word][1]} numbers, not {len(parts)}")
        if any(part.logical != (word == "ifelse" and place == 0) for place, part in enumerate(parts)):
            raise self._wrong(f"{word}() has a comparison where a number must stand, or the other way round")
        return self._finite(Node("call", word, tuple(parts)))


class _PeridigmParser(_Parser):
    """A sign binds more tightly than a power, and an expression may be an ``if``."""

    functions: ClassVar[Sequence[str]] = [name for name in FUNCTIONS if name not in _NOT_PERIDIGM]

    def _statement(self) -> Node:
        if not self._take("if"):
            return super()._statement()
        self._enter()
        self._need("(")
        condition = self._either()
        self._need(")")
        if not condition.logical:
            raise self._wrong("what follows an if must be a comparison")
        value = self._block()
        if not self._take("else"):
            raise self._wrong("an if needs an else")
        other = self._statement() if self._next() == "if" else self._block()
        self._depth -= 1
        return Node("call", "ifelse", (condition, value, other))

    def _block(self) -> Node:
        self._need("{")
        found = self._number(self._statement())
        self._need("}")
        return found

    def _factor(self) -> Node:
        return self._power()

    def _unsigned(self) -> Node:
        return self._atom()

    def _power(self) -> Node:
        return self._raised(self._signed, self._power, "^")
