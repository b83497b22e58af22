"""Expressions of decks, such as ``0.001*y*t``: parsed as Python, checked node by node, never evaluated as code.

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

import ast
import functools
import math
import re
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field
from typing import Any, ClassVar

import numpy as np

from pdpetsc.declared import shown
from pdpetsc.errors import CaseError

_TOKEN = re.compile(
    r"\s*(?:(?P<number>(?:\d+\.?\d*|\.\d+)(?:[eE][+-]?\d+)?)|(?P<name>[A-Za-z_]\w*)"
    r"|(?P<mark>\*\*|<=|>=|==|!=|&&|\|\||[-+*/^()<>,&|{};=]))",
    re.ASCII,
)
# Functions of decks with their names in numpy and numbers of arguments.
FUNCTIONS: dict[str, tuple[str, int]] = {
    "sin": ("np.sin", 1), "cos": ("np.cos", 1), "tan": ("np.tan", 1), "asin": ("np.arcsin", 1),
    "acos": ("np.arccos", 1), "atan": ("np.arctan", 1), "sinh": ("np.sinh", 1), "cosh": ("np.cosh", 1),
    "tanh": ("np.tanh", 1), "exp": ("np.exp", 1), "log": ("np.log", 1), "log10": ("np.log10", 1),
    "sqrt": ("np.sqrt", 1), "abs": ("np.abs", 1), "fabs": ("np.abs", 1), "pow": ("**", 2),
    "min": ("np.minimum", 2), "max": ("np.maximum", 2), "ifelse": ("np.where", 3),
}  # fmt: skip
# Functions that Peridigm does not have.
_NOT_PERIDIGM = ("abs", "min", "max", "ifelse")
# Operations in Python; "and" and "or" of numpy are & and |.
_IN_PYTHON = {"^": "**", "&": "and", "&&": "and", "|": "or", "||": "or"}
_ELEMENTWISE = {ast.And: ast.BitAnd, ast.Or: ast.BitOr}
_OPERATIONS: dict[type[ast.AST], np.ufunc] = {
    ast.UAdd: np.positive, ast.USub: np.negative, ast.Add: np.add, ast.Sub: np.subtract, ast.Mult: np.multiply,
    ast.Div: np.divide, ast.Pow: np.power, ast.Lt: np.less, ast.LtE: np.less_equal, ast.Gt: np.greater,
    ast.GtE: np.greater_equal, ast.Eq: np.equal, ast.NotEq: np.not_equal, ast.BitAnd: np.logical_and,
    ast.BitOr: np.logical_or,
}  # fmt: skip
# Limits of nested brackets, signs and powers, and of words: a chain of sums is as deep as its terms.
_DEEPEST, _LONGEST = 60, 400


@dataclass(frozen=True)
class Expression:
    """An expression of a deck.

    Attributes
    ----------
    code : str
        The expression as Python with numpy, with the variables of the deck.
    tree : ast.expr
        Its tree.
    """

    code: str
    tree: ast.expr = field(compare=False, repr=False)

    @property
    def names(self) -> set[str]:
        """Return the variables in it."""
        return _names(self.tree)

    def python(self, names: Mapping[str, str]) -> str:
        """Return the expression as Python with numpy, with variables renamed by ``names``."""
        return re.sub(r"(?<![\w.])[A-Za-z]\w*", lambda word: names.get(word[0], word[0]), self.code)

    def value(self, at: Mapping[str, Any]) -> Any:
        """Evaluate the expression for values of the variables; arrays for arrays."""
        with np.errstate(all="ignore"):
            return _value(self.tree, {"pi": np.pi, **at})


def parse(text: str, where: str, allowed: set[str]) -> Expression:
    """Parse a number of PeriLab.

    Parameters
    ----------
    text : str
        The expression; ``value = ...`` and a final semicolon are optional.
    where : str
        Its place in the deck, for messages.
    allowed : set of str
        Allowed variables; ``pi`` is the number.

    Raises
    ------
    CaseError
        The text does not follow the grammar, has another variable or function, or is not a number.
    """
    return _Parser(text, where, allowed).number()


def parse_condition(text: str, where: str, allowed: set[str]) -> Expression:
    """Parse a logical expression of PeriLab; arguments and errors as for ``parse``."""
    return _Parser(text, where, allowed).condition()


def parse_peridigm(text: str, where: str, allowed: set[str]) -> Expression:
    """Parse a number of Peridigm, which may be an ``if``; arguments and errors as for ``parse``."""
    return _PeridigmParser(text, where, allowed).number()


def _names(tree: ast.AST) -> set[str]:
    """Return the variables of a tree; functions have names of numpy."""
    return {node.id for node in ast.walk(tree) if isinstance(node, ast.Name) and not node.id.startswith("np.")}


def _value(node: ast.expr, at: Mapping[str, Any]) -> Any:
    """Evaluate a checked tree for values of the variables."""
    match node:
        case ast.Name(id=name):
            return at[name]
        case ast.UnaryOp(op=operation, operand=operand):
            return _OPERATIONS[type(operation)](_value(operand, at))
        case (
            ast.BinOp(left=left, op=operation, right=right)
            | ast.Compare(left=left, ops=[operation], comparators=[right])
        ):
            return _OPERATIONS[type(operation)](_value(left, at), _value(right, at))
        case ast.Call(func=ast.Name(id=name), args=arguments):
            return getattr(np, name.removeprefix("np."))(*(_value(argument, at) for argument in arguments))
    return np.float64(ast.literal_eval(node))


def _is_logical(node: ast.expr) -> bool:
    """Return True if a checked tree is a logical expression."""
    return isinstance(node, ast.Compare) or (
        isinstance(node, ast.BinOp) and isinstance(node.op, ast.BitAnd | ast.BitOr)
    )


class _Parser:
    """Translates the words of an expression to Python, and checks the tree that Python parses."""

    functions: ClassVar[Sequence[str]] = list(FUNCTIONS)
    power: ClassVar[Sequence[str]] = ("^", "**")

    def __init__(self, text: str, where: str, allowed: set[str]) -> None:
        plain = re.sub(r"\\([{}])", r"\1", text).strip()
        # Elementwise operations of Julia are translated as scalar ones.
        plain = re.sub(r"\.(?=[*/+^-])|(?<=[a-z])\.(?=\()", " ", re.sub(r"(\d)\.(?=[*/+^-])", r"\1.0", plain))
        self._shown, self._where, self._allowed, self._depth = text, where, allowed | {"pi"}, 0
        self._words: list[str] = []
        at = 0
        while at < len(plain):
            found = _TOKEN.match(plain, at)
            if found is None:
                raise self._wrong(f"{plain[at:].strip()[:12]!r} is not understood")
            word = found[str(found.lastgroup)]
            if found["number"] and not math.isfinite(float(word)):
                raise self._wrong(f"{word[:12]} is no finite number")
            # Python does not accept integers with leading zeros.
            self._words.append(word.lstrip("0") or "0" if word.isdecimal() else word)
            if len(self._words) > _LONGEST:
                raise self._wrong(f"it has more than {_LONGEST} words")
            at = found.end()
        self._at = 0

    def _wrong(self, why: str) -> CaseError:
        return CaseError(
            f"{self._where} of the deck is {shown(self._shown)}, an expression that cannot be translated: {why}; write "
            f"it with numbers, {', '.join(sorted(self._allowed))}, + - * / ^ and {', '.join(self.functions)}."
        )

    def number(self) -> Expression:
        """Parse the whole text; raise CaseError unless it is a number."""
        return self._whole(self._number)

    def condition(self) -> Expression:
        """Parse the whole text; raise CaseError unless it is logical."""
        return self._whole(self._condition)

    def _whole(self, checked: Callable[[ast.expr], ast.expr]) -> Expression:
        source = self._statement()
        if self._next():
            raise self._wrong(f"{self._next()!r} stands where nothing can")
        try:
            tree = checked(self._bound(ast.parse(source, mode="eval").body))
            return Expression(ast.unparse(tree), tree)
        except SyntaxError as error:
            raise self._wrong(error.msg) from None
        except (RecursionError, MemoryError):
            raise self._wrong("it is nested too deeply") from None

    # --- words to Python

    def _next(self) -> str:
        return self._words[self._at] if self._at < len(self._words) else ""

    def _accept(self, word: str) -> bool:
        found = self._next() == word
        self._at += found
        return found

    def _expect(self, word: str) -> None:
        if not self._accept(word):
            raise self._wrong(f"{word!r} is missing before {self._next() or 'its end'!r}")

    def _statement(self) -> str:
        """Return the next statement as Python."""
        if self._accept("value"):
            self._expect("=")
        found = self._expression()
        self._accept(";")
        return found

    def _expression(self) -> str:
        """Return the words up to a semicolon, a brace, or a bracket that was opened before, as Python."""
        words, depth = list[str](), 0
        while (word := self._next()) and word not in (";", "{", "}") and (word != ")" or depth):
            self._at += 1
            depth += (word == "(") - (word == ")")
            called = self._next() == "("
            if word == "=" or (word in ("^", "**") and word not in self.power):
                raise self._wrong(f"{word!r} stands where nothing can")
            if word == "(" and (not words or words[-1] not in self.functions):
                # A call without effect distinguishes -(x^2) from -x^2 in the tree.
                words.append("_")
            elif word.isidentifier() and word not in (*self._allowed, "and", "or", *(self.functions if called else ())):
                raise self._wrong(f"{word}{'()' if called else ''} is not known")
            if depth >= _DEEPEST:
                raise self._wrong("it is nested too deeply")
            words.append(_IN_PYTHON.get(word, word))
        return " ".join(words)

    # --- the tree

    def _bound(self, tree: ast.expr) -> ast.expr:
        """Return a tree of Python with the operator precedence of the program of the deck."""
        return tree

    def _checked(self, node: ast.expr) -> ast.expr:
        """Return a tree with functions of numpy; refuse all other constructs of Python."""
        match node:
            case ast.Constant() | ast.Name():
                # The words have no other names, and only numbers as constants.
                return node
            case ast.Call(func=ast.Name(id="_"), args=[inner], keywords=[]):
                return self._checked(inner)
            case ast.Compare(left=left, ops=[operation], comparators=[right]):
                return ast.Compare(self._number(left), [operation], [self._number(right)])
            case ast.Compare():
                raise self._wrong("two comparisons stand in a row; join them with &")
            case ast.BoolOp(op=operation, values=values):
                joined = _ELEMENTWISE[type(operation)]()
                return functools.reduce(lambda one, other: ast.BinOp(one, joined, other), map(self._condition, values))
            case ast.UnaryOp(op=operation, operand=operand):
                return ast.UnaryOp(operation, self._number(operand))
            case ast.BinOp(left=left, op=operation, right=right):
                # A chain of sums is no deeper than its terms.
                return self._finite(ast.BinOp(self._number(left, deeper=0), operation, self._number(right)))
            case ast.Call(func=ast.Name(id=name), args=arguments, keywords=[]):
                return self._finite(self._called(name, arguments))
        raise self._wrong("a number is missing")

    def _called(self, name: str, arguments: Sequence[ast.expr]) -> ast.expr:
        word, count = FUNCTIONS[name]
        if len(arguments) != count:
            raise self._wrong(f"{name}() takes {count} numbers, not {len(arguments)}")
        if name == "pow":
            return ast.BinOp(self._number(arguments[0]), ast.Pow(), self._number(arguments[1]))
        conditions = 1 if name == "ifelse" else 0
        found = [*map(self._condition, arguments[:conditions]), *map(self._number, arguments[conditions:])]
        return ast.Call(ast.Name(word), found, [])

    def _number(self, node: ast.expr, deeper: int = 1) -> ast.expr:
        self._depth += deeper
        if self._depth > _DEEPEST:
            raise self._wrong("it is nested too deeply")
        found = self._checked(node)
        self._depth -= deeper
        if _is_logical(found):
            raise self._wrong("a comparison stands where a number must")
        return found

    def _condition(self, node: ast.expr) -> ast.expr:
        found = self._checked(node)
        if not _is_logical(found):
            raise self._wrong("what an if, & or | takes must be a comparison")
        return found

    def _finite(self, node: ast.expr) -> ast.expr:
        """Return a node; refuse constants that are not finite or take too long to compute."""
        if _names(node) <= {"pi"} and not np.isfinite(Expression("", node).value({})):
            raise self._wrong("a part of it is no finite number")
        return node


class _PeridigmParser(_Parser):
    """A parser for Peridigm: a sign binds more tightly than a power, and an expression may be an ``if``."""

    functions: ClassVar[Sequence[str]] = [name for name in FUNCTIONS if name not in _NOT_PERIDIGM]
    power: ClassVar[Sequence[str]] = ("^",)

    def _statement(self) -> str:
        if not self._accept("if"):
            return super()._statement()
        self._expect("(")
        condition = self._expression()
        self._expect(")")
        value = self._block()
        if not self._accept("else"):
            raise self._wrong("an if needs an else")
        other = self._statement() if self._next() == "if" else self._block()
        return f"ifelse({condition}, {value}, {other})"

    def _block(self) -> str:
        self._expect("{")
        found = self._statement()
        self._expect("}")
        return found

    def _bound(self, tree: ast.expr) -> ast.expr:
        return _SignsFirst().visit(tree)  # type: ignore[no-any-return]


class _SignsFirst(ast.NodeTransformer):
    """Moves a sign before a power to the base of the power."""

    def visit_UnaryOp(self, node: ast.UnaryOp) -> ast.expr:
        """Return -x^2 as the square of -x."""
        self.generic_visit(node)
        power = node.operand
        if isinstance(power, ast.BinOp) and isinstance(power.op, ast.Pow):
            return ast.BinOp(ast.UnaryOp(node.op, power.left), power.op, power.right)
        return node
