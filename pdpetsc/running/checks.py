"""Comparison of the results of a run with the expected results of its case."""

from __future__ import annotations

import dataclasses
import difflib
import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

from pdpetsc.declare.expected import Expected
from pdpetsc.errors import CaseError, CheckError
from pdpetsc.output.tables import aligned, text_of


@dataclass(frozen=True)
class Check:
    """One result with its expected value.

    Attributes
    ----------
    name : str
        Name of the result.
    expected : Expected
        The expected result.
    got : float
        Value of the result; nan if the run does not have it.
    known : tuple of str
        The names of the results of the run.
    """

    name: str
    expected: Expected
    got: float
    known: tuple[str, ...]

    @property
    def ok(self) -> bool:
        """Return True if the result is as expected."""
        return self.expected.holds(self.got)

    @property
    def difference(self) -> float:
        """Return the result minus the expected value, in the unit of the result."""
        return self.got - self.expected.value

    def __str__(self) -> str:
        if self.name not in self.known:
            near = difflib.get_close_matches(self.name, self.known, n=1)
            hint = f"did you mean {near[0]}" if near else f"it has {', '.join(self.known) or 'none'}"
            return f"there is no result {self.name} ({hint})"
        expected = self.expected
        within = f"{expected.tolerance:.4g}" + (f" ({expected.relative:.3%})" if expected.relative is not None else "")
        wanted = f"{expected.value:.8g} is expected within {within}, {expected.source}"
        return f"{self.name} is {self.got:.8g}, but {wanted}"


def refuse_unchecked(expect: Mapping[str, Expected]) -> None:
    """Raise CaseError if a case has no expected results."""
    if not expect:
        raise CaseError(
            "The case has no `expect` with these parameters. Add expect={name of a result: pd.Expected(...)}."
        )


def compared(expect: Mapping[str, Expected], results: Mapping[str, float]) -> list[Check]:
    """Return a check of every expected result, in the order of the case."""
    known = tuple(results)
    return [Check(name, one, float(results.get(name, math.nan)), known) for name, one in expect.items()]


def failure(checks: Sequence[Check]) -> CheckError | None:
    """Return the error for failed checks; None if all hold."""
    failed = [check for check in checks if not check.ok]
    if not failed:
        return None
    return CheckError(f"{len(failed)} of {len(checks)} checks failed: {'; '.join(map(str, failed))}.")


def lines(checks: Sequence[Check]) -> list[str]:
    """Return a readable table of checks, one line each below a header."""
    rows: list[tuple[str, ...]] = [("check", "expected", "got", "difference", "tolerance", "", "source")]
    for check in checks:
        numbers = (check.expected.value, check.got, check.difference, check.expected.tolerance)
        rows.append((check.name, *map(text_of, numbers), "ok" if check.ok else "FAILED", check.expected.source))
    return [f"  {line}" for line in aligned(rows, left=(0, 6))]


def recorded(checks: Sequence[Check]) -> list[dict[str, Any]]:
    """Return checks as entries of ``summary.json``."""
    return [
        {
            "result": check.name, **dataclasses.asdict(check.expected), "got": check.got,
            "difference": check.difference, "tolerance": check.expected.tolerance, "ok": check.ok,
        }
        for check in checks
    ]  # fmt: skip


def expected_of(summary: Mapping[str, Any]) -> dict[str, Expected]:
    """Return the expected results of a checked run from its summary.

    Raises
    ------
    CaseError
        The entries are no expected results.
    """
    try:
        return {
            str(row["result"]): Expected(row["value"], row["relative"], row["absolute"], row["source"])
            for row in summary.get("checks") or []
        }
    except (TypeError, KeyError, ValueError) as error:
        raise CaseError(f"The checks in summary.json cannot be read: {error}. Repeat the run.") from error
