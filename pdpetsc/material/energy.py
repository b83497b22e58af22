"""Strain energies written as text: parsed with a closed list of names, never executed."""

from __future__ import annotations

import ast
import math
import warnings
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from functools import cached_property, lru_cache
from itertools import permutations
from typing import Any

import sympy

from pdpetsc.declared import shown
from pdpetsc.errors import CaseError

# Largest length of the text, and largest number of bits of a power of numbers, to bound the time of parsing.
LONGEST_TEXT, MOST_BITS = 4000, 512
# Largest number of operations of a second derivative of an energy, by the rules of differentiation.
MOST_OPERATIONS = 3000
# Invariants of C = F^T F and of up to two fibre directions: I4, I5 of the first, I6, I7 of the second.
OF_FIBRES = {"I4": 0, "I5": 0, "I6": 1, "I7": 1}
INVARIANTS = ("I1", "I2", "J", *OF_FIBRES)
STRETCHES = ("l1", "l2", "l3")
SYMBOLS = {name: sympy.Symbol(name, positive=True) for name in (*INVARIANTS, *STRETCHES)}
_J = SYMBOLS["J"]
# Abbreviations; names with ``bar`` are those of the isochoric part J^(-1/3) F.
DERIVED = {
    "I3": _J**2,
    "I1bar": _J ** sympy.Rational(-2, 3) * SYMBOLS["I1"],
    "I2bar": _J ** sympy.Rational(-4, 3) * SYMBOLS["I2"],
    **{f"{name}bar": _J ** sympy.Rational(-2, 3) * SYMBOLS[name] for name in ("I4", "I6")},
    **{f"{name}bar": _J ** sympy.Rational(-4, 3) * SYMBOLS[name] for name in ("I5", "I7")},
    **{f"{name}bar": _J ** sympy.Rational(-1, 3) * SYMBOLS[name] for name in STRETCHES},
}


class Step(sympy.Function):  # type: ignore[misc]
    """1 if the argument is positive, else 0; its derivative is 0."""

    nargs = 1

    @classmethod
    def eval(cls, x: Any) -> Any:
        """Return the value for a number."""
        return sympy.Integer(1 if x > 0 else 0) if x.is_number and x.is_real else None

    def fdiff(self, argindex: int = 1) -> Any:
        return sympy.Integer(0)


class Pos(sympy.Function):  # type: ignore[misc]
    """The positive part of the argument."""

    nargs = 1

    @classmethod
    def eval(cls, x: Any) -> Any:
        """Return the value for a number."""
        return (x if x > 0 else sympy.Integer(0)) if x.is_number and x.is_real else None

    def fdiff(self, argindex: int = 1) -> Any:
        return Step(self.args[0])


FUNCTIONS: dict[str, Callable[[Any], Any]] = {
    "sqrt": sympy.sqrt, "exp": sympy.exp, "log": sympy.log, "sinh": sympy.sinh, "cosh": sympy.cosh,
    "tanh": sympy.tanh, "atan": sympy.atan, "pos": Pos,
}  # fmt: skip
KNOWN = {*SYMBOLS, *DERIVED, *FUNCTIONS, "pi"}


@dataclass(frozen=True)
class Energy:
    """A strain energy density as an expression.

    Attributes
    ----------
    text : str
        As written.
    names : tuple of str
        Names of its constants, in the order in which loops read them.
    expression : sympy expression
        In the symbols of ``SYMBOLS`` and the constants.
    """

    text: str
    names: tuple[str, ...]
    expression: Any

    @property
    def constants(self) -> list[Any]:
        """Return the symbols of the constants."""
        return [constant(name) for name in self.names]

    @cached_property
    def of_stretches(self) -> bool:
        """Return True if the energy is written in principal stretches."""
        return bool(self.expression.free_symbols & {SYMBOLS[name] for name in STRETCHES})

    @cached_property
    def bounds(self) -> list[Any]:
        """Return the bounds, expressions that must keep their sign at F = I: arguments of logarithms, and divisors.

        Beyond a bound the derivatives may be finite, but the energy is undefined or was infinite at the bound.
        """
        logarithms = {one.args[0] for one in self.expression.atoms(sympy.log)}
        divisors = {
            power.base for power in self.expression.atoms(sympy.Pow)
            if power.exp.is_negative or (not power.exp.is_number and power.exp.could_extract_minus_sign())
        }  # fmt: skip
        varying = set(SYMBOLS.values())
        found = [one for one in logarithms | divisors if one.free_symbols & varying and not one.is_positive]
        return sorted(found, key=str)

    @property
    def n_fibres(self) -> int:
        """Return the number of fibre directions."""
        used = [number for name, number in OF_FIBRES.items() if SYMBOLS[name] in self.expression.free_symbols]
        return 1 + max(used, default=-1)


def constant(name: str) -> Any:
    """Return the symbol of a constant; its name cannot be that of an invariant."""
    return sympy.Symbol(f"constant_{name}", real=True)


@lru_cache
def parse(text: str, names: tuple[str, ...]) -> Energy:
    """Parse the text of an energy; the result is zero at F = I.

    Parameters
    ----------
    text : str
        Expression in invariants or principal stretches, with functions of ``FUNCTIONS``, numbers and constants.
    names : tuple of str
        The constants.

    Raises
    ------
    CaseError
        The text is no such expression, contains an unknown name, or does not use a constant.
    """
    taken = sorted(KNOWN & set(names))
    if taken:
        raise CaseError(f"{taken[0]} cannot be the name of a constant of an energy, because it has a meaning there.")
    wrong = [name for name in names if not name.isidentifier()]
    if wrong:
        raise CaseError(f"{shown(wrong[0])} cannot be the name of a constant of an energy; take letters and digits.")
    if len(text) > LONGEST_TEXT:
        raise CaseError(f"An energy may have {LONGEST_TEXT} characters, not {len(text)}.")
    reader = _Reader(text, names)
    try:
        with warnings.catch_warnings():
            # Python warns about numbers followed by letters before it raises an error.
            warnings.simplefilter("ignore", SyntaxWarning)
            tree = ast.parse(text.strip(), mode="eval").body
        _refuse_long(tree, reader)
        expression = reader.of(tree)
    except CaseError:
        raise
    except SyntaxError as error:
        raise reader.refused(f"cannot be read at character {error.offset or 1}") from None
    except (ValueError, TypeError, RecursionError, MemoryError, ArithmeticError, AttributeError) as error:
        raise reader.refused(f"cannot be read: {type(error).__name__}") from None
    if reader.unused:
        raise reader.refused(f"does not use the constant {sorted(reader.unused)[0]}; leave it out")
    return _checked(Energy(text, names, expression), reader)


def _checked(energy: Energy, reader: _Reader) -> Energy:
    """Return the energy in the variables of its loops, minus its value at F = I."""
    used, expression = energy.expression.free_symbols, energy.expression
    if expression.has(sympy.nan, sympy.zoo, sympy.oo, -sympy.oo, sympy.I):
        raise reader.refused("is not finite")
    if energy.of_stretches:
        if any(SYMBOLS[name] in used for name in OF_FIBRES):
            raise reader.refused("has principal stretches and invariants of fibres; write it with invariants alone")
        squares = [SYMBOLS[name] ** 2 for name in STRETCHES]
        a, b, c = squares
        product = SYMBOLS["l1"] * SYMBOLS["l2"] * SYMBOLS["l3"]
        in_stretches = {SYMBOLS["I1"]: a + b + c, SYMBOLS["I2"]: a * b + b * c + c * a, _J: product}
        expression = expression.xreplace(in_stretches)
        if not _symmetric(expression, energy.constants):
            raise reader.refused("changes when l1, l2 and l3 are exchanged, so it is not that of an isotropic material")
    if overflows(expression, UNDEFORMED):
        raise reader.refused("is no finite number at F = I")
    at_rest = expression.xreplace(UNDEFORMED)
    if at_rest.has(sympy.nan, sympy.zoo, sympy.oo, -sympy.oo, sympy.I):
        raise reader.refused("is no finite number at F = I")
    return Energy(energy.text, energy.names, expression - at_rest)


def _refuse_long(tree: ast.expr, reader: _Reader) -> None:
    """Raise CaseError if the derivatives of an energy have too many operations, before SymPy is called.

    A product u v has ``u'' v + 2 u' v' + u v''`` and a function of u ``f'' u' u' + f' u''``: the second derivatives of
    nested products or functions grow with the third power of the depth.
    """

    def sizes(node: ast.expr) -> tuple[int, int, int]:
        """Estimate the number of operations of a node and its first and second derivatives."""
        if not isinstance(node, ast.BinOp | ast.UnaryOp | ast.Call):
            return 1, int(isinstance(node, ast.Name) and node.id not in reader.names), 0
        if isinstance(node, ast.BinOp):
            parts = [sizes(node.left), sizes(node.right)]
        else:
            parts = [sizes(part) for part in ([node.operand] if isinstance(node, ast.UnaryOp) else node.args)]
        own, first, second = (sum(part[k] for part in parts) for k in range(3))
        if first and not isinstance(getattr(node, "op", None), ast.Add | ast.Sub | ast.UAdd | ast.USub):
            first, second = first + own, second + 2 * first + own
        if own + first + second > MOST_OPERATIONS:
            raise reader.refused(f"has derivatives of more than {MOST_OPERATIONS} operations; write a shorter one")
        return own + 1, first, second

    sizes(tree)


def overflows(expression: Any, numbers: Mapping[Any, Any]) -> bool:
    """Return True if a part of an expression exceeds the largest float for these values of the symbols.

    SymPy would compute it with all digits. Parts with other symbols are ignored.
    """
    values: dict[Any, float] = {symbol: float(number) for symbol, number in numbers.items()}
    for node in sympy.postorder_traversal(expression):
        if node in values:
            continue
        parts = [values.get(part, math.nan) for part in node.args]
        try:
            if not node.args:
                values[node] = float(node) if node.is_number else math.nan
            elif node.is_Add:
                values[node] = math.fsum(parts)
            elif node.is_Mul:
                values[node] = math.prod(parts)
            elif node.is_Pow:
                values[node] = abs(parts[0]) ** parts[1]
            elif isinstance(node, sympy.exp | sympy.sinh | sympy.cosh):
                values[node] = math.exp(parts[0] if isinstance(node, sympy.exp) else abs(parts[0]))
            else:
                values[node] = parts[0]
        except ZeroDivisionError:
            values[node] = math.nan
        except (OverflowError, ValueError):
            return True
        if math.isinf(values[node]):
            return True
    return False


UNDEFORMED = {symbol: sympy.Integer(3 if name in ("I1", "I2") else 1) for name, symbol in SYMBOLS.items()}


def derivative(expression: Any, symbol: Any) -> Any:
    """Return the derivative of an expression by a symbol.

    Assumptions on symbols are removed first: with them SymPy determines the sign of every part and roots of
    polynomials.
    """
    plain = {one: sympy.Dummy(one.name) for one in expression.free_symbols | {symbol}}
    found = sympy.diff(expression.xreplace(plain), plain[symbol])
    return found.xreplace({dummy: one for one, dummy in plain.items()})


def _symmetric(expression: Any, constants: Sequence[Any]) -> bool:
    """Return True if the value is unchanged for exchanged stretches, tested at generic numbers."""
    numbers = {symbol: sympy.Float(0.7 + 0.31 * n) for n, symbol in enumerate(constants)}
    stretches = [SYMBOLS[name] for name in STRETCHES]
    values = []
    if overflows(expression, {**numbers, **{symbol: sympy.Float(1.29) for symbol in stretches}}):
        return False
    for order in permutations((sympy.Float(0.83), sympy.Float(1.07), sympy.Float(1.29))):
        value = expression.xreplace({**numbers, **dict(zip(stretches, order, strict=True))})
        values.append(complex(value.evalf()))
    size = max(1.0, *(abs(value) for value in values))
    return max(abs(value - values[0]) for value in values) < 1e-9 * size


class _Reader:
    """Converts the syntax tree of an expression to SymPy, node by node; the text is never executed."""

    def __init__(self, text: str, names: Sequence[str]) -> None:
        self.text = text
        self.names = set(names)
        self.unused = set(names)

    def refused(self, why: str) -> CaseError:
        return CaseError(f"The energy {shown(self.text)} {why}.")

    def of(self, node: ast.expr) -> Any:
        """Return the expression of a node."""
        if isinstance(node, ast.Constant):
            return self._number(node.value)
        if isinstance(node, ast.Name):
            return self._named(node.id)
        if isinstance(node, ast.UnaryOp) and isinstance(node.op, ast.UAdd | ast.USub):
            value = self.of(node.operand)
            return -value if isinstance(node.op, ast.USub) else value
        if isinstance(node, ast.BinOp):
            return self._combined(node.op, self.of(node.left), self.of(node.right))
        if isinstance(node, ast.Call):
            return self._called(node)
        raise self.refused("may have numbers, names, + - * / ** and functions of one argument only")

    def _number(self, value: object) -> Any:
        if isinstance(value, bool) or not isinstance(value, int | float):
            raise self.refused(f"has {shown(value)} where a number belongs")
        if isinstance(value, int) and value.bit_length() > MOST_BITS:
            raise self.refused("has a number with too many digits")
        if not math.isfinite(value):
            raise self.refused("has a number that is not finite")
        return sympy.Rational(repr(value))

    def _named(self, name: str) -> Any:
        self.unused.discard(name)
        if name in self.names:
            return constant(name)
        if name in SYMBOLS or name in DERIVED:
            return SYMBOLS.get(name, DERIVED.get(name))
        if name == "pi":
            return sympy.pi
        if name in FUNCTIONS:
            raise self.refused(f"names the function {name} without an argument")
        known = ", ".join(["I1", "I2", "I3", "J", "I1bar", "I2bar", "I4", "I5", "l1", "l2", "l3"])
        raise self.refused(f"names {name}, which is neither a constant that was given nor one of {known}")

    def _combined(self, operator: ast.operator, left: Any, right: Any) -> Any:
        if isinstance(operator, ast.Add):
            return left + right
        if isinstance(operator, ast.Sub):
            return left - right
        if isinstance(operator, ast.Mult):
            return left * right
        if isinstance(operator, ast.Div):
            if right.is_zero:
                raise self.refused("divides by zero")
            return left / right
        if isinstance(operator, ast.Pow):
            # SymPy computes powers of numbers exactly, with all digits.
            if left.is_number and right.is_number and not (
                right.is_Rational and abs(right) * _bits(left) <= MOST_BITS
            ):  # fmt: skip
                raise self.refused("has a power of numbers that is no fraction or too large")
            power = left**right
            exponent = power.exp if power.is_Pow else right
            if exponent.is_number and not abs(float(exponent)) <= MOST_BITS:
                raise self.refused(f"has an exponent beyond {MOST_BITS}")
            return power
        raise self.refused("may have + - * / ** only; a power is **")

    def _called(self, node: ast.Call) -> Any:
        if not isinstance(node.func, ast.Name) or node.func.id not in FUNCTIONS:
            raise self.refused(f"calls a function that is not one of {', '.join(FUNCTIONS)}")
        if len(node.args) != 1 or node.keywords or isinstance(node.args[0], ast.Starred):
            raise self.refused(f"has not one argument in {node.func.id}")
        argument = self.of(node.args[0])
        if argument.is_number and node.func.id in ("exp", "sinh", "cosh") and not abs(float(argument)) <= MOST_BITS:
            raise self.refused(f"has {node.func.id} of a number that is too large")
        return FUNCTIONS[node.func.id](argument)


def _bits(number: Any) -> int:
    """Return the number of bits of the base of a power."""
    return sum(max(int(part.p).bit_length(), int(part.q).bit_length()) for part in number.atoms(sympy.Rational)) + 1
