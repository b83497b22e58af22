"""How the load is stepped from step time 0 to 1."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Literal, TypeAlias

from pdpetsc.declared import Declared
from pdpetsc.errors import CaseError

Unstable: TypeAlias = Literal["warn", "shorten", "refuse"]
# Files number steps with five digits.
MOST_STEPS = 99_999
# A shorter step is lost in the rounding of the step time.
LEAST_STEP = 1e-8


def refuse_bonds_at_once(bonds_at_once: int | None) -> None:
    """Raise CaseError unless at least one bond may break at once."""
    if bonds_at_once is not None and bonds_at_once < 1:
        raise CaseError(f"bonds_at_once is a number of bonds from 1 on, not {bonds_at_once}.")


def refuse_growth(plastic_growth: float | None) -> None:
    """Raise CaseError unless the largest growth of plastic strain in a step is positive."""
    if plastic_growth is not None and not plastic_growth > 0.0:
        raise CaseError(f"plastic_growth is a positive plastic strain, not {plastic_growth}.")


@dataclass(frozen=True)
class Steps(Declared):
    """Equal load steps; one that does not converge is halved, and steps grow again after easy ones.

    Parameters
    ----------
    count : int
        Number of steps.
    smallest : float
        Smallest step as a share of the whole load [-]; when it fails too the run ends with exit status 1. By default
        1/64 of a step.
    bonds_at_once : int, optional
        Bonds that break at once before equilibrium is sought again, the worst first. By default one, with those that
        tie with it, where bonds snap, and all that have lost their force where they soften.
    unstable : {"warn", "shorten", "refuse"}
        What becomes of an equilibrium whose tangent has negative pivots, as of a column loaded past its critical force;
        only the factorisation of a direct linear solver shows that. ``warn`` says so and goes on. ``shorten`` takes it
        as a step that failed, so that the run ends within the smallest step of the critical load; ``refuse`` ends the
        run there.
    plastic_growth : float, optional
        Largest growth of the accumulated plastic strain at any point in a step [-]: a step with more is taken as one
        that failed, and a step grows only as far as the growth of the last one allows.

    Examples
    --------
    >>> import pdpetsc as pd
    >>> pd.Steps(4).stops()
    [0.25, 0.5, 0.75, 1.0]
    """

    count: int = 1
    smallest: float | None = None
    bonds_at_once: int | None = None
    unstable: Unstable = "warn"
    plastic_growth: float | None = None

    def __post_init__(self) -> None:
        super().__post_init__()
        if not 1 <= self.count <= MOST_STEPS:
            raise CaseError(f"Steps needs a positive whole number up to {MOST_STEPS}, not {self.count}.")
        if self.smallest is not None and not LEAST_STEP <= self.smallest <= 1.0 / self.count:
            raise CaseError(
                f"The smallest of {self.count} steps must lie between {LEAST_STEP:g} and 1/{self.count}, "
                f"not {self.smallest}."
            )
        refuse_bonds_at_once(self.bonds_at_once)
        refuse_growth(self.plastic_growth)

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
        """Return the step times that are met exactly, ascending, ending with 1."""
        return [(n + 1) / self.count for n in range(self.count)]


@dataclass(frozen=True)
class AdaptiveSteps(Declared):
    """Load steps that grow by half after an easy step and are halved after a failure.

    Parameters
    ----------
    first, smallest, largest : float
        Step sizes as a share of the whole load.
    bonds_at_once, unstable, plastic_growth
        As in ``Steps``.

    Examples
    --------
    >>> import pdpetsc as pd
    >>> steps = pd.AdaptiveSteps(first=0.05, smallest=1e-3, largest=0.2)
    """

    first: float = 0.1
    smallest: float = 1e-4
    largest: float = 0.25
    bonds_at_once: int | None = None
    unstable: Unstable = "warn"
    plastic_growth: float | None = None

    def __post_init__(self) -> None:
        super().__post_init__()
        if not LEAST_STEP <= self.smallest <= self.first <= self.largest <= 1.0:
            raise CaseError(
                f"AdaptiveSteps needs {LEAST_STEP:g} <= smallest <= first <= largest <= 1, "
                f"not {self.smallest}, {self.first}, {self.largest}."
            )
        if self.largest < 1.0 / MOST_STEPS:
            raise CaseError(f"AdaptiveSteps needs a largest step of at least 1/{MOST_STEPS}, not {self.largest}.")
        refuse_bonds_at_once(self.bonds_at_once)
        refuse_growth(self.plastic_growth)

    @property
    def least(self) -> float:
        """Return the smallest step [-]."""
        return self.smallest

    def stops(self) -> list[float]:
        """Return the step times that are met exactly."""
        return [1.0]
