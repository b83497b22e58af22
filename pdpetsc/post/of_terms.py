"""Numbers and fields of the terms of a problem for the history and the files."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

from pdpetsc.arrays import Float
from pdpetsc.post.quantities import Quantity
from pdpetsc.post.solution import Field, Solution
from pdpetsc.problem.problem import Problem
from pdpetsc.problem.state import State


@dataclass(frozen=True)
class TermNumber(Quantity):
    """Sum over ranks of a number of a term (``Term.numbers``)."""

    of_rank: Callable[[State], float]

    def evaluate(self, solution: Solution) -> float:
        return float(solution.sum(float(self.of_rank(solution.state))))


def numbers_of_terms(problem: Problem) -> dict[str, Quantity]:
    """Return the numbers of all terms by name (not collective)."""
    return {name: TermNumber(number) for term in problem.terms for name, number in term.numbers().items()}


def fields_of_terms(problem: Problem) -> list[Field]:
    """Return the fields of all terms (not collective)."""
    return [_field(name, values) for term in problem.terms for name, values in term.fields().items()]


def _field(name: str, values: Callable[[State], Float]) -> Field:
    def field(solution: Solution) -> Float:
        return values(solution.state)

    field.__name__ = name
    return field
