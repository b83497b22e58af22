"""Comparing the results of a run with what its case expects."""

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
    """One result beside what was expected.

    Attributes
    ----------
    name : str
        Of the result.
    expected : Expected
        What it should be.
    got : float
        What it is; nan where the run has no such result.
    known : tuple of str
        The names of the results of the run.
    """

    name: str
    expected: Expected
    got: float
    known: tuple[str, ...]

    @property
    def ok(self) -> bool:
        """Return True if the result is what was expected."""
        return self.expected.holds(self.got)

    @property
    def difference(self) -> float:
        """Return the result less the expected value, in its unit."""
        return self.got - self.expected.value

    def __str__(self) -> str:
        if self.name not in self.known:
            near = difflib.get_close_matches(self.name, self.known, n=1)
            hint = f"did you mean {near[0]}" if near else f"it has {', '.join(self.known) or 'none'}"
            return f"there is no result {self.name} ({hint})"
        expected = self.expected
        within = f"{expected.tolerance:.4g}" + (f" ({expected.relative:.3%})" if expected.relative is not None else "")
        wanted = f"{expected.value:.8g} is expected within {within}, {expected.source}"
        return f"{self.name} is {self.got:.8g} where {wanted}"


def refuse_unchecked(expect: Mapping[str, Expected]) -> None:
    """Raise CaseError where a case expects nothing, so that checking it could not fail."""
    if not expect:
        raise CaseError(
            "There is nothing to check: the case expects nothing, or not with these parameters; give it "
            "expect={name of a result: pd.Expected(...)}."
        )


def compared(expect: Mapping[str, Expected], results: Mapping[str, float]) -> list[Check]:
    """Return every expected result beside what it is, in the order of the case."""
    known = tuple(results)
    return [Check(name, one, float(results.get(name, math.nan)), known) for name, one in expect.items()]


def failure(checks: Sequence[Check]) -> CheckError | None:
    """Return the error of checks that do not hold, None where all do."""
    failed = [check for check in checks if not check.ok]
    if not failed:
        return None
    return CheckError(f"{len(failed)} of {len(checks)} checks failed: {'; '.join(map(str, failed))}.")


def lines(checks: Sequence[Check]) -> list[str]:
    """Return a table of checks for people, a line each below its header."""
    rows: list[tuple[str, ...]] = [("check", "expected", "got", "difference", "tolerance", "", "source")]
    for check in checks:
        numbers = (check.expected.value, check.got, check.difference, check.expected.tolerance)
        rows.append((check.name, *map(text_of, numbers), "ok" if check.ok else "FAILED", check.expected.source))
    return [f"  {line}" for line in aligned(rows, left=(0, 6))]


def recorded(checks: Sequence[Check]) -> list[dict[str, Any]]:
    """Return checks as ``summary.json`` has them."""
    return [
        {
            "result": check.name, **dataclasses.asdict(check.expected), "got": check.got,
            "difference": check.difference, "tolerance": check.expected.tolerance, "ok": check.ok,
        }
        for check in checks
    ]  # fmt: skip


def expected_of(summary: Mapping[str, Any]) -> dict[str, Expected]:
    """Return what a run that was checked expected, from its summary.

    Raises
    ------
    CaseError
        Something else stands there.
    """
    try:
        return {
            str(row["result"]): Expected(row["value"], row["relative"], row["absolute"], row["source"])
            for row in summary.get("checks") or []
        }
    except (TypeError, KeyError, ValueError) as error:
        raise CaseError(f"summary.json holds checks that are none: {error}.") from error
