"""Loops over points, written for one strain energy and one kind of body, and compiled.

SymPy differentiates an energy with respect to its scalars. Stress and tangent are sums of tensors with scalar factors
at each point; tensors with zero factors are omitted.
"""

from __future__ import annotations

import contextlib
import hashlib
import math
import os
import sys
import tempfile
from collections.abc import Callable, Iterable, Sequence
from functools import lru_cache
from pathlib import Path
from types import ModuleType
from typing import Any, NamedTuple

import sympy
from sympy.printing.numpy import NumPyPrinter

from pdpetsc.kernels.compile import note
from pdpetsc.material.base import HistoryKernels, Kind, remember_nothing
from pdpetsc.material.energy import INVARIANTS, OF_FIBRES, STRETCHES, SYMBOLS, UNDEFORMED, Energy, derivative

# A solid; a plane body without strain or without stress across it; a bar with free sides.
DIM: dict[Kind, int] = {"solid": 3, "strain": 2, "stress": 2, "bar": 1}
# Number of equal hidden stretches.
HIDDEN: dict[Kind, int] = {"solid": 0, "strain": 1, "stress": 1, "bar": 2}
# Newton's method for a hidden stretch: largest number of steps, largest step and final step of its logarithm.
STEPS, LONGEST, LAST = 100, 0.4, 1e-9
# Marks the end of a block.
BACK = "<"
# Largest number of terms of expanded products.
MOST_TERMS = 500

_b = sympy.Symbol("b", positive=True)
_i1 = sympy.Symbol("i1", positive=True)
_root = sympy.Symbol("root", positive=True)


class Loops(NamedTuple):
    """Compiled loops for an energy and a kind of body.

    ``kernels`` are those of every material, with the fibre directions of a point as history. ``across(F, select,
    constants, directions, result)`` writes the product of the hidden stretches, NaN if the iteration fails, or in plane
    strain the stress ``P_zz``; None for a solid. ``inside`` writes, in the same way, the distance to the nearest bound
    of the energy over that at F = I, not positive beyond it; None for an energy without bounds.
    """

    kernels: HistoryKernels
    across: Any
    inside: Any


@lru_cache
def loops_of(energy: Energy, kind: Kind) -> Loops:
    """Return the compiled loops of an energy for a kind of body.

    Parameters
    ----------
    energy : Energy
        The energy; the loops read its constants at run time.
    kind : {"solid", "strain", "stress", "bar"}
        The body.
    """
    text = (_stretch_text if energy.of_stretches else _invariant_text)(energy, kind)
    module = _module(text)
    kernels = HistoryKernels(module.stress, module.tangent, module.energy, remember_nothing)
    return Loops(kernels, module.across, module.inside if energy.bounds else None)


class Scalars(NamedTuple):
    """Derivatives of an energy with respect to its scalars, scaled to simplify the tensors.

    ``names`` of the scalars, first derivatives ``g`` and second ones ``h`` by pairs of names; of the hidden stretch b
    the residual ``r = d psi / db`` and its derivative.
    """

    names: tuple[str, ...]
    g: dict[str, Any]
    h: dict[tuple[str, str], Any]
    r: Any
    slope: Any


@lru_cache
def invariant_scalars(energy: Energy, kind: Kind) -> Scalars:
    """Compute the factors of ``F, I1 F - F C, F^-T, f (x) a, f (x) c + F c (x) a`` and their products.

    With ``D`` these tensors, ``f = F a`` and ``c = C a``, the stress is ``sum_a g_a D_a`` and the tangent
    ``sum_ab h_ab D_a (x) D_b`` plus terms in g only. h includes the parts of second derivatives of I2 and J of this
    form, and for a free hidden stretch the condensation ``- r_a r_b / slope``.
    """
    psi, hidden = energy.expression, HIDDEN[kind]
    names = tuple(name for name in INVARIANTS if SYMBOLS[name] in psi.free_symbols)
    J = SYMBOLS["J"]
    scale = {name: J if name == "J" else sympy.Integer(2) for name in names}
    first = {name: derivative(psi, SYMBOLS[name]) for name in names}
    second = {(m, n): derivative(first[m], SYMBOLS[n]) for m in names for n in names}
    g = {name: scale[name] * first[name] for name in names}
    h = {(m, n): scale[m] * scale[n] * value for (m, n), value in second.items()}
    if "I2" in names:
        h["I1", "I1"] = h.get(("I1", "I1"), 0) + 4 * first["I2"]
        for name in names if "I1" not in names else ():
            h["I1", name] = h[name, "I1"] = sympy.Integer(0)
    if "J" in names:
        h["J", "J"] += J * first["J"]
    g, h = {name: _tidy(value) for name, value in g.items()}, {pair: _tidy(value) for pair, value in h.items()}
    r = slope = sympy.Integer(0)
    if hidden:
        along, bend, mixed = _hidden_derivatives(hidden)
        present = [name for name in ("I1", "I2", "J") if name in names]
        r = sum((first[name] * along[name] for name in present), sympy.Integer(0))
        slope = sum((first[name] * bend[name] for name in present), sympy.Integer(0))
        slope += sum((second[m, n] * along[m] * along[n] for m in present for n in present), sympy.Integer(0))
        r, slope = _tidy(r), _tidy(slope)
        if kind != "strain":
            change = {n: sum(scale[n] * second[m, n] * along[m] for m in present) for n in names}
            if "I2" in names:
                change["I1"] = change.get("I1", 0) + mixed * first["I2"]
            if "J" in names:
                change["J"] += J * first["J"] * hidden / _b
            change = {name: _tidy(value) for name, value in change.items()}
            for m in change:
                for n in change:
                    h[m, n] = h.get((m, n), sympy.Integer(0)) - change[m] * change[n] / slope
    return Scalars(names, g, {pair: h[min(pair), max(pair)] for pair in h}, r, slope)


def _hidden_derivatives(hidden: int) -> tuple[dict[str, Any], dict[str, Any], Any]:
    """Return first and second derivatives of invariants with respect to b, and the mixed derivative of I2 with F."""
    J, b = SYMBOLS["J"], _b
    if hidden == 1:
        return {"I1": 2 * b, "I2": 2 * b * _i1, "J": J / b}, {"I1": 2, "I2": 2 * _i1, "J": 0}, 4 * b
    along = {"I1": 4 * b, "I2": 4 * b * _i1 + 4 * b**3, "J": 2 * J / b}
    return along, {"I1": 4, "I2": 4 * _i1 + 12 * b**2, "J": 2 * J / b**2}, 8 * b


def _tidy(value: Any) -> Any:
    """Return the shorter of an expression and its expanded form, in which terms may cancel."""
    value = sympy.sympify(value)
    if _terms(value) > MOST_TERMS:
        return value
    spread = sympy.expand_mul(value)
    return spread if spread.count_ops() < value.count_ops() else value


def _terms(value: Any) -> int:
    """Return the number of terms of the expanded expression: 2^n for n factors with two terms each."""
    terms: dict[Any, int] = {}
    for node in sympy.postorder_traversal(value):
        parts = [terms[part] for part in node.args]
        terms[node] = sum(parts) if node.is_Add else math.prod(parts) if node.is_Mul else 1
    return max(terms.values())


class _Printer(NumPyPrinter):  # type: ignore[misc]
    """Prints integer powers, which are compiled to products, and positive parts."""

    def __init__(self) -> None:
        super().__init__({"fully_qualified_modules": True})

    def _print_Pow(self, expr: Any, rational: bool = False) -> str:
        base, power = expr.base, expr.exp
        if power.is_Integer and abs(int(power)) <= 16:
            inner = f"({self._print(base)})" if not base.is_Symbol else self._print(base)
            whole = f"{inner}**{abs(int(power))}" if abs(int(power)) != 1 else inner
            return f"(1.0/{whole})" if power < 0 else whole
        if power.is_Rational and int(power.q) == 2:
            root = f"numpy.sqrt({self._print(base)})**{abs(int(power.p))}"
            return f"(1.0/{root})" if power < 0 else root
        return str(super()._print_Pow(expr, rational=rational))

    def _print_Pos(self, expr: Any) -> str:
        return f"max({self._print(expr.args[0])}, 0.0)"

    def _print_Step(self, expr: Any) -> str:
        return f"(1.0 if {self._print(expr.args[0])} > 0.0 else 0.0)"


class _Text:
    """A module of loops, line by line."""

    def __init__(self, energy: Energy, kind: Kind) -> None:
        self.energy, self.kind = energy, kind
        self.dim, self.hidden = DIM[kind], HIDDEN[kind]
        self.lines: list[str] = []
        self.depth = 0

    def add(self, *lines: str) -> None:
        """Add lines at the present indentation; a line that ends with a colon indents the next lines until ``BACK``."""
        for line in lines:
            if line == BACK:
                self.depth -= 1
                continue
            self.lines.append("    " * self.depth + line)
            self.depth += line.endswith(":")

    def block(self, *lines: str) -> None:
        """Add lines, and close the blocks that they open."""
        depth = self.depth
        self.add(*lines)
        self.depth = depth

    def each(self, indices: str, *lines: str) -> None:
        """Add lines in loops of indices over the dimension."""
        self.block(*(f"for {index} in range({self.dim}):" for index in indices), *lines)

    def sum(self, term: str, index: str = "k", start: str = "0.0", sign: str = "+") -> tuple[str, ...]:
        """Return lines that add the sum of a term over an index to ``value``."""
        return f"value = {start}", f"for {index} in range({self.dim}):", f"value {sign}= {term}", BACK

    def values(self, named: dict[str, Any]) -> None:
        """Add lines that compute expressions, with common subexpressions once."""
        J = SYMBOLS["J"]

        def of_root(power: Any) -> bool:
            return bool(power.is_Pow and power.base == J and power.exp.is_Rational and power.exp.q == 3)

        # Powers of J^(-1/3) are integer powers of the root, which are much faster than powers of J.
        wanted = [
            sympy.sympify(value).replace(of_root, lambda power: _root ** int(3 * power.exp)) for value in named.values()
        ]
        used = set().union(*(value.free_symbols for value in wanted)) if wanted else set()
        if _root in used:
            self.add("root = numpy.cbrt(J)")
        shared, reduced = sympy.cse(wanted, symbols=sympy.numbered_symbols("x"), optimizations="basic")
        printer = _Printer()
        self.add(*(f"{symbol} = {printer.doprint(value)}" for symbol, value in shared))
        self.add(*(f"{name} = {printer.doprint(value)}" for name, value in zip(named, reduced, strict=True)))

    def constants(self) -> None:
        """Add lines that read the constants."""
        self.add(*(f"{symbol} = constants[{number}]" for number, symbol in enumerate(self.energy.constants)))

    def start(self, name: str, result: str, arrays: Iterable[str] = (), vectors: Iterable[str] = ()) -> None:
        """Open a loop over points."""
        self.add("", "", "@compiled", f"def {name}(F, select, constants, directions, {result}):")
        self.constants()
        self.add(*(f"{array} = numpy.empty(({self.dim}, {self.dim}))" for array in arrays))
        self.add(*(f"{vector} = numpy.empty({self.dim})" for vector in vectors))
        self.add("for row in range(select.size):", "p = select[row]")

    def end(self) -> None:
        """Close the loop over points."""
        self.depth -= 2

    def whole(self) -> str:
        """Return the text."""
        return "\n".join(self.lines) + "\n"


_HEADER = (
    '"""Made by pdpetsc from a strain energy."""',
    "",
    "import numpy",
    "",
    "from pdpetsc.kernels.compile import compiled",
    "from pdpetsc.kernels.principal import add_pair, inverse, principal_axes",
)


def _lateral(text: _Text, arguments: Sequence[str], known: Sequence[str], r: Any, slope: Any) -> None:
    """Write the function for the hidden stretch: ``r(b) = 0`` by Newton's method in ``ln b``, NaN if it fails.

    The residual of ``ln b`` is ``b r`` with the slope ``b r + b^2 r'``. If the slope is not positive, the energy has no
    minimum nearby, and the step descends the energy. The initial value is that of the linear law. The last constant is
    its ratio of ``ln b`` to the logarithm of the determinant of F.
    """
    depth = text.depth
    text.add("", "", "@compiled", f"def lateral({', '.join(arguments)}, logarithm, constants):")
    text.constants()
    text.add(
        f"s = constants[{len(text.energy.names)}] * logarithm", f"for _ in range({STEPS}):", "b = numpy.exp(s)", *known
    )
    # ln J and the exponential of the small last change are reused, which saves a logarithm and an exponential per step.
    text.add(f"log_J = logarithm + {text.hidden + 0.0} * s")
    log_J = {sympy.log(SYMBOLS["J"]): sympy.Symbol("log_J", real=True)}
    text.values({"residual": (_b * r).subs(log_J), "bend": (_b**2 * slope).subs(log_J)})
    text.add(
        "rise = residual + bend", "change = residual / rise", f"if not (rise > 0.0 and abs(change) < {LONGEST}):",
        f"change = {LONGEST} if residual > 0.0 else -{LONGEST}", BACK, "s -= change", f"if abs(change) < {LAST}:",
        "return b * (1.0 - change)", BACK, BACK, "return numpy.nan",
    )  # fmt: skip
    text.depth = depth


def _invariant_text(energy: Energy, kind: Kind) -> str:
    """Return the loops of an energy of invariants."""
    scalars = invariant_scalars(energy, kind)
    text = _Text(energy, kind)
    text.add(*_HEADER)
    names = scalars.names
    free = kind in ("stress", "bar")
    fibres = [name for name in OF_FIBRES if name in names]
    known = {"stress": ["I1 = i1 + b * b", "I2 = j * j + b * b * i1", "J = j * b"],
             "bar": ["I1 = i1 + 2.0 * b * b", "I2 = 2.0 * b * b * i1 + b**4", "J = j * b * b"],
             "strain": ["b = 1.0", "I1 = i1 + 1.0", "I2 = j * j + i1", "J = j"],
             "solid": ["I1 = i1", "I2 = 0.5 * (i1 * i1 - square)", "J = j"]}[kind]  # fmt: skip
    if free:
        _lateral(text, ["i1", "j", *fibres], known, scalars.r, scalars.slope)

    with_fibres = sorted({OF_FIBRES[name] for name in fibres})
    fifth = [number for number in with_fibres if f"I{5 + 2 * number}" in names]

    def at_point(inverse: bool, cauchy_green: bool) -> None:
        """Write G, C and the invariants of the point."""
        needs_c = cauchy_green or (kind == "solid" and "I2" in names)
        if inverse:
            text.add(f"j = inverse(F[p], {text.dim}, G)")
        else:
            text.add({1: "j = F[p, 0, 0]", 2: "j = F[p, 0, 0] * F[p, 1, 1] - F[p, 0, 1] * F[p, 1, 0]",
                      3: "j = inverse(F[p], 3, G)" if "J" in names else "j = 1.0"}[text.dim])  # fmt: skip
        text.add("i1 = 0.0", "square = 0.0")
        text.each("im", "i1 += F[p, i, m] * F[p, i, m]")
        if needs_c:
            text.each("im", *text.sum("F[p, k, i] * F[p, k, m]"), "C[i, m] = value", "square += value * value")
        for number in with_fibres:
            text.each("i", *text.sum(f"F[p, i, k] * directions[row, {number * text.dim} + k]"), f"f{number}[i] = value")
            if (four := f"I{4 + 2 * number}") in names:
                text.add(f"{four} = 0.0")
                text.each("i", f"{four} += f{number}[i] * f{number}[i]")
        for number in fifth:
            text.add(f"I{5 + 2 * number} = 0.0")
            square = f"I{5 + 2 * number} += value * value"
            text.each("i", *text.sum(f"F[p, k, i] * f{number}[k]"), f"c{number}[i] = value", square)
            text.each("i", *text.sum(f"F[p, i, k] * c{number}[k]"), f"h{number}[i] = value")
        if free:
            text.add(f"b = lateral({', '.join(['i1', 'j', *fibres])}, numpy.log(j), constants)")
        text.add(*known)

    vectors = [f"f{number}" for number in with_fibres]
    vectors += [f"{letter}{number}" for number in fifth for letter in "ch"]

    def tensor(name: str, i: str, m: str) -> str:
        """Return an entry of the tensor beside a scalar."""
        if name == "I1":
            return f"F[p, {i}, {m}]"
        if name == "I2":
            return f"Q[{i}, {m}]"
        if name == "J":
            return f"G[{m}, {i}]"
        number = OF_FIBRES[name]
        a = f"directions[row, {number * text.dim} + {m}]"
        if name in ("I4", "I6"):
            return f"f{number}[{i}] * {a}"
        return f"(f{number}[{i}] * c{number}[{m}] + h{number}[{i}] * {a})"

    def isochoric() -> None:
        """Write ``Q = I1 F - F C``."""
        summed = text.sum("F[p, i, k] * C[k, m]", start="I1 * F[p, i, m]", sign="-")
        text.each("im", *summed, "Q[i, m] = value")

    second = "I2" in names
    text.start("stress", "P", ["G", "C", "Q"], vectors)
    at_point("J" in names, second)
    text.values({f"g{name}": value for name, value in scalars.g.items()})
    if second:
        isochoric()
    text.each("im", "P[p, i, m] = " + " + ".join(f"g{name} * {tensor(name, 'i', 'm')}" for name in names))
    text.end()

    pairs = {pair: value for pair, value in scalars.h.items() if value != 0}
    of_h = [name for name in INVARIANTS if any(name == pair[0] for pair in pairs)]
    arrays = ["G", "C", "Q", "B", "T", "U", *(f"E{name}" for name in of_h)]
    text.start("tangent", "A", arrays, vectors)
    at_point("J" in names, second)
    h = {f"h{m}{n}": value for (m, n), value in pairs.items() if m <= n}
    text.values({**{f"g{name}": value for name, value in scalars.g.items()}, **h})
    if second or fifth:
        if second:
            isochoric()
        text.each("ik", *text.sum("F[p, i, m] * F[p, k, m]", "m"), "B[i, k] = value")
    # A scalar that is coupled to itself only requires no array for the product.
    alone = [name for name in of_h if [n for m, n in pairs if m == name] == [name]]
    for name in of_h:
        if name in alone:
            continue
        beside = [(min(name, n), max(name, n), n) for m, n in pairs if m == name]
        text.each("im", f"E{name}[i, m] = " + " + ".join(f"h{m}{n} * {tensor(o, 'i', 'm')}" for m, n, o in beside))
    # The parts with delta_ik and with delta_mn.
    one, other = [], []
    if "I1" in names:
        one.append("(gI1 if m == n else 0.0)")
    if second:
        one += ["((gI2 * I1 if m == n else 0.0) - gI2 * C[m, n])"]
        other += ["- gI2 * B[m, n]"]
    for number in with_fibres:
        a, a_other = (f"directions[row, {number * text.dim} + {index}]" for index in "mn")
        if f"I{4 + 2 * number}" in names:
            one.append(f"gI{4 + 2 * number} * {a} * {a_other}")
        if number in fifth:
            five = f"gI{5 + 2 * number}"
            one.append(f"{five} * ({a_other} * c{number}[m] + {a} * c{number}[n])")
            other.append(f"+ {five} * f{number}[m] * f{number}[n]")
    diagonal = one == ["(gI1 if m == n else 0.0)"]
    if other or (one and not diagonal):
        text.each("mn", "T[m, n] = " + (" + ".join(one) or "0.0"), "U[m, n] = 0.0 " + " ".join(other))
    terms = [
        f"h{name}{name} * {tensor(name, 'i', 'm')} * {tensor(name, 'k', 'n')}"
        if name in alone
        else f"{tensor(name, 'i', 'm')} * E{name}[k, n]"
        for name in of_h
    ]
    if "J" in names:
        terms.append("(-gJ) * G[n, i] * G[m, k]")
    if second:
        terms.append("(-gI2) * F[p, i, n] * F[p, k, m]")
    for number in fifth:
        a, a_other = (f"directions[row, {number * text.dim} + {index}]" for index in "mn")
        terms.append(
            f"gI{5 + 2 * number} * (f{number}[i] * {a_other} * F[p, k, m] + F[p, i, n] * {a} * f{number}[k] "
            f"+ B[i, k] * {a} * {a_other})"
        )
    value = ["value = " + (" + ".join(terms) or "0.0")]
    if diagonal:
        value += ["if i == k and m == n:", "value += gI1", BACK]
    elif one:
        value += ["if i == k:", "value += T[m, n]", BACK]
    if other:
        value += ["if m == n:", "value += U[i, k]", BACK]
    text.each("imkn", *value, "A[p, i, m, k, n] = value")
    text.end()

    _add_scalar_loops(text, ["G", "C"], vectors, lambda: at_point(False, False), energy.expression, scalars.r, {})
    return text.whole()


def _stretch_text(energy: Energy, kind: Kind) -> str:
    """Return the loops of an energy of principal stretches."""
    dim, free = DIM[kind], kind in ("stress", "bar")
    l1, l2, l3 = (SYMBOLS[name] for name in STRETCHES)
    hidden = {"solid": {}, "strain": {l3: _b}, "stress": {l3: _b}, "bar": {l2: _b, l3: _b}}[kind]
    shown = [l1, l2, l3][:dim]
    psi = energy.expression.subs(hidden)
    r = derivative(psi, _b)
    slope = derivative(r, _b)
    first = [derivative(psi, stretch) for stretch in shown]
    second = [[derivative(value, stretch) for stretch in shown] for value in first]
    if free:
        mixed = [derivative(value, _b) for value in first]
        second = [[second[a][b] - mixed[a] * mixed[b] / slope for b in range(dim)] for a in range(dim)]
    text = _Text(energy, kind)
    text.add(*_HEADER)
    stretches = [str(stretch) for stretch in shown]
    if free:
        _lateral(text, stretches, [], r, slope)

    def at_point() -> None:
        text.add(f"principal_axes(F[p], {dim}, C, stretch, N, n)")
        text.add(*(f"{name} = stretch[{a}]" for a, name in enumerate(stretches)))
        if free:
            text.add(f"b = lateral({', '.join(stretches)}, numpy.log({' * '.join(stretches)}), constants)")
        elif hidden:
            text.add("b = 1.0")

    text.start("stress", "P", ["C", "N", "n"], ["stretch", "g"])
    at_point()
    text.values({f"g[{a}]": value for a, value in enumerate(first)})
    text.each("im", *text.sum("g[a] * n[i, a] * N[m, a]", "a"), "P[p, i, m] = value")
    text.end()

    text.start("tangent", "A", ["C", "N", "n", "h"], ["stretch", "g"])
    at_point()
    upper = {f"h[{a}, {b}]": second[a][b] for a in range(dim) for b in range(a, dim)}
    text.values({**{f"g[{a}]": value for a, value in enumerate(first)}, **upper})
    text.each("imko", "A[p, i, m, k, o] = 0.0")
    text.each(
        "ac", "normal = h[min(a, c), max(a, c)]", "same = 0.0", "swapped = 0.0", "if a != c:",
        "apart = stretch[a] - stretch[c]",
        # The difference quotient loses digits for nearly equal stretches; its limit is exact to second order.
        "if abs(apart) > 1e-5 * (stretch[a] + stretch[c]):", "difference = (g[a] - g[c]) / apart", BACK,
        "else:", "difference = 0.5 * (h[a, a] + h[c, c]) - h[min(a, c), max(a, c)]", BACK,
        "total = (g[a] + g[c]) / (stretch[a] + stretch[c])", "same = 0.5 * (difference + total)",
        "swapped = 0.5 * (difference - total)", BACK,
        f"add_pair({dim}, a, c, normal, same, swapped, n, N, A[p])",
    )  # fmt: skip
    text.end()

    _add_scalar_loops(text, ["C", "N", "n"], ["stretch"], at_point, psi, r, hidden)
    return text.whole()


def _add_scalar_loops(
    text: _Text, arrays: Sequence[str], vectors: Sequence[str], at_point: Callable[[], None], psi: Any, r: Any,
    hidden: dict[Any, Any],
) -> None:  # fmt: skip
    """Add the loops for the energy, for the hidden stretch or stress, and for the distance from the bounds.

    Parameters
    ----------
    text : _Text
        The module.
    arrays, vectors : sequence of str
        Arrays that ``at_point`` fills.
    at_point : callable
        Adds the lines for the state of a point.
    psi, r
        The energy, and its derivative by the hidden stretch.
    hidden : dict
        Symbols of the bounds that the hidden stretch replaces.
    """
    across = {"solid": sympy.Integer(1), "strain": r, "stress": _b, "bar": _b**2}[text.kind]
    for name, result, values in (
        ("energy", "psi", {"psi[p]": psi}),
        ("across", "result", {"result[row]": across}),
    ):
        text.start(name, result, arrays, vectors)
        at_point()
        text.values(values)
        text.end()
    if not text.energy.bounds:
        return
    text.start("inside", "result", arrays, vectors)
    at_point()
    shares = [one.subs(hidden) / one.xreplace(UNDEFORMED) for one in text.energy.bounds]
    text.values({f"share{number}": share for number, share in enumerate(shares)})
    text.add("result[row] = share0")
    for number in range(1, len(shares)):
        # NaN is outside as well.
        text.block(f"if not share{number} > result[row]:", f"result[row] = share{number}")
    text.end()


def _module(text: str) -> ModuleType:
    """Execute a generated text as a module; its compiled loops are cached on disk if possible.

    Numba stores machine code beside a source file with a constant name. The file serves the cache only: the text is
    executed.
    """
    digest = hashlib.blake2b(text.encode(), digest_size=12).hexdigest()
    name = f"energy_{digest}"
    full = f"pdpetsc.material.made.{name}"
    if full not in sys.modules:
        module = ModuleType(full)
        module.__file__ = str(_written(text, name) or f"<{name}>")
        sys.modules[full] = module
        try:
            exec(compile(text, module.__file__, "exec"), module.__dict__)
        except BaseException:
            del sys.modules[full]
            raise
    return sys.modules[full]


def _written(text: str, name: str) -> Path | None:
    """Write the text to a file unless it exists; return its path, None if no folder is writable."""
    chosen = os.environ.get("NUMBA_CACHE_DIR")
    homes = [Path(chosen)] if chosen else [Path(__file__).parent / "__pycache__", *_of_user()]
    for home in homes:
        path = home / "pdpetsc_made" / f"{name}.py"
        try:
            with contextlib.suppress(OSError, UnicodeDecodeError):
                if path.read_text() == text:
                    return path
            path.parent.mkdir(parents=True, exist_ok=True)
            # Atomic, because another process may read the file at any time.
            handle, draft = tempfile.mkstemp(dir=path.parent, suffix=".part")
            with os.fdopen(handle, "w") as file:
                file.write(text)
            Path(draft).replace(path)
            return path
        except OSError as error:
            note(error)
    return None


def _of_user() -> list[Path]:
    """Return the cache folder of this user; none without a home folder, as in a container."""
    folder = Path(os.environ.get("XDG_CACHE_HOME") or os.path.expanduser("~/.cache"))
    return [folder] if folder.is_absolute() else []
