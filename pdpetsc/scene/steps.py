"""How the load is stepped from step time 0 to 1."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Literal, TypeAlias, get_args

from pdpetsc.errors import CaseError

Unstable: TypeAlias = Literal["warn", "shorten", "refuse"]


@dataclass(frozen=True)
class Steps:
    """Equal load steps; one that does not converge is halved, and grown back after easy ones.

    Parameters
    ----------
    count : int
        Number of steps.
    smallest : float
        Smallest step [-]; when it fails too the run ends with exit status 1. By default 1/64 of a step.
    breaks : int, optional
        Bonds that break at once before equilibrium is sought again, the worst first. By default one, with those that
        tie with it, where bonds snap, and all that have lost their force where they soften.
    unstable : {"warn", "shorten", "refuse"}
        What becomes of an equilibrium whose tangent has negative pivots, as of a column loaded past its critical force,
        where a factorisation tells. ``warn`` says so and goes on. ``shorten`` takes it as a step that failed, so that
        the run ends within the smallest step of the critical load; ``refuse`` ends it there.
    """

    count: int = 1
    smallest: float | None = None
    breaks: int | None = None
    unstable: Unstable = "warn"

    def __post_init__(self) -> None:
        if not (isinstance(self.count, int) and self.count >= 1):
            raise CaseError(f"Steps needs a positive whole number, not {self.count}.")
        if self.smallest is not None and not 0.0 < self.smallest <= 1.0 / self.count:
            raise CaseError(f"The smallest of {self.count} steps must lie in (0, 1/{self.count}], not {self.smallest}.")
        _refuse_word(self.unstable)

    @property
    def first(self) -> float:
        """Return the first step [-]."""
        return 1.0 / self.count

    @property
    def largest(self) -> float:
        """Return the largest step [-]."""
        return 1.0 / self.count

    @property
    def least(self) -> float:
        """Return the smallest step [-]."""
        return 1.0 / (64.0 * self.count) if self.smallest is None else self.smallest

    def stops(self) -> list[float]:
        """Return the times that are met exactly, ascending, ending with 1."""
        return [(n + 1) / self.count for n in range(self.count)]


@dataclass(frozen=True)
class AdaptiveSteps:
    """Load steps that grow by half after an easy step and are halved after a failure.

    Parameters
    ----------
    first, smallest, largest : float
        Step sizes as a share of the whole load.
    breaks, unstable
        As in ``Steps``.
    """

    first: float = 0.1
    smallest: float = 1e-4
    largest: float = 0.25
    breaks: int | None = None
    unstable: Unstable = "warn"

    def __post_init__(self) -> None:
        _refuse_word(self.unstable)
        if not 0.0 < self.smallest <= self.first <= self.largest <= 1.0:
            raise CaseError(
                f"AdaptiveSteps needs 0 < smallest <= first <= largest <= 1, "
                f"not {self.smallest}, {self.first}, {self.largest}."
            )

    @property
    def least(self) -> float:
        """Return the smallest step [-]."""
        return self.smallest

    def stops(self) -> list[float]:
        """Return the times that are met exactly."""
        return [1.0]


def _refuse_word(unstable: str) -> None:
    if unstable not in get_args(Unstable):
        raise CaseError(
            f"What becomes of unstable equilibria is one of {', '.join(get_args(Unstable))}, not {unstable!r}."
        )
