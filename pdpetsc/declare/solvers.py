"""How equilibrium of a load step is found."""

from __future__ import annotations

import math
from dataclasses import dataclass, field
from typing import ClassVar, Literal, TypeAlias

from pdpetsc.declare.region import Region
from pdpetsc.declare.steps import refuse_breaks
from pdpetsc.declared import Declared
from pdpetsc.errors import CaseError


@dataclass(frozen=True)
class Needs:
    """What a way to equilibrium needs of the body, its conditions and the linear algebra.

    Attributes
    ----------
    tangent : {"any", "assembled", "none"}
        Whether its tangent may be applied without a matrix, must be one, or is not asked for.
    proportional : {"no", "up to the whole load", "at any load"}
        At which step times all conditions must be their values at step time 1 times the step time.
    piecewise_linear : bool
        Whether forces must be linear in the displacement where no bond fails.
    symmetric : bool
        Whether the tangent of every term must be symmetric.
    """

    tangent: Literal["any", "assembled", "none"] = "any"
    proportional: Literal["no", "up to the whole load", "at any load"] = "no"
    piecewise_linear: bool = False
    symmetric: bool = False


class DeclaredSolver(Declared):
    """How equilibrium is found, as a scene declares it; ``pdpetsc.solvers.table`` knows what does it.

    Attributes
    ----------
    title : str
        What messages call it.
    needs : Needs
        What it needs.
    of_energy : bool
        Whether its residual is the gradient of an energy where the terms have one, so that a line search may look for
        a zero of the residual along the step.
    finds_load : bool
        Whether the load factor is among its unknowns: it may be any number, and unstable equilibria are meant.
    restarts : bool
        Whether it goes on from a checkpoint.
    """

    title: ClassVar[str]
    needs: ClassVar[Needs] = Needs()
    of_energy: ClassVar[bool] = True
    finds_load: ClassVar[bool] = False
    restarts: ClassVar[bool] = True

    def check(self, dim: int) -> None:
        """Raise CaseError where a body of ``dim`` dimensions lacks what this asks for (not collective)."""


@dataclass(frozen=True)
class Newton(DeclaredSolver):
    """Newton's method with the analytic tangent, on PETSc's SNES; its options come with ``Case.options``."""

    title = "Newton's method"


@dataclass(frozen=True)
class DynamicRelaxation(DeclaredSolver):
    """Adaptive dynamic relaxation: damped motion in time until the body is at rest, without a matrix.

    Parameters
    ----------
    tolerance : float
        What residual and change of displacement, each over its first value in the step, and the residual over forces
        and reactions must fall below [-].
    most : int
        Largest number of time steps in a load step.
    """

    tolerance: float = 1e-6
    most: int = 1_000_000

    title = "Dynamic relaxation"
    needs = Needs(tangent="none")

    def __post_init__(self) -> None:
        super().__post_init__()
        if not (math.isfinite(self.tolerance) and 0.0 < self.tolerance < 1.0):
            raise CaseError(f"The tolerance of dynamic relaxation lies between 0 and 1, not {self.tolerance}.")
        if self.most < 1:
            raise CaseError(f"Dynamic relaxation needs at least one time step, not {self.most}.")


@dataclass(frozen=True)
class EventDriven(DeclaredSolver):
    """From one failing bond to the next, without iterations: for bodies whose laws are piecewise linear.

    Between events everything is linear in the step time, so the time of the next failure is known exactly. A failing
    bond releases its force while the load goes up or down as equilibrium demands: the step time, to which all
    conditions must be proportional, need not grow, and snap-back is followed.

    Parameters
    ----------
    updates : int, optional
        Changed bonds at which the matrix is factored anew; until then they are corrections to the old factor. By
        default their number grows with the square root of the number of unknowns.
    most : int
        Largest number of events.
    fields_every : int
        Fields are written every so many events, and at the end; 0 for the end only.
    """

    updates: int | None = None
    most: int = 1_000_000
    fields_every: int = 0

    title = "The event-driven solver"
    needs = Needs(tangent="assembled", proportional="up to the whole load", piecewise_linear=True, symmetric=True)
    finds_load = True
    restarts = False

    def __post_init__(self) -> None:
        super().__post_init__()
        if self.updates is not None and self.updates < 1:
            raise CaseError(f"The event-driven solver needs updates >= 1, not {self.updates}.")
        if self.most < 1 or self.fields_every < 0:
            raise CaseError("The event-driven solver needs most >= 1 and fields_every >= 0.")


@dataclass(frozen=True)
class BondStretch(Declared):
    """The bonds that have not failed and are driven most, the most stretched, go further, whatever the load does.

    Parameters
    ----------
    step : float
        Largest growth of what drives their damage in a step, of a stretch over the critical one [-].
    """

    step: float = 0.1

    def __post_init__(self) -> None:
        super().__post_init__()
        _refuse_step(self.step)

    def check(self, dim: int) -> None:
        """Accept every dimension."""


@dataclass(frozen=True)
class Opening(Declared):
    """The mean displacement of one region against that of another grows, such as that of the lips of a notch.

    Parameters
    ----------
    component : str
        ``"x"``, ``"y"`` or ``"z"``.
    region : Region
        What moves in its direction.
    against : Region, optional
        What it moves against; the laboratory where absent.
    step, end : float
        Largest growth in a step and where to end [length].
    """

    component: str
    region: Region
    against: Region | None = field(default=None, kw_only=True)
    step: float = field(kw_only=True)
    end: float = field(kw_only=True)

    def __post_init__(self) -> None:
        super().__post_init__()
        _refuse_step(self.step)
        if self.component not in ("x", "y", "z"):
            raise CaseError(f'An Opening has the component "x", "y" or "z", not {self.component!r}.')
        if not (math.isfinite(self.end) and self.end > 0.0):
            raise CaseError(f"An Opening ends at a positive value, not {self.end}; turn the regions round.")

    def check(self, dim: int) -> None:
        """Raise CaseError where a body of ``dim`` dimensions has no such component or cannot select its regions."""
        if self.component not in "xyz"[:dim]:
            raise CaseError(f"The Opening of a {dim}-dimensional body has no component {self.component}.")
        for side in (self.region, self.against):
            if side is not None:
                try:
                    side.check(dim)
                except CaseError as error:
                    raise CaseError(f"The Opening: {error}") from None


@dataclass(frozen=True)
class PathFollowing(DeclaredSolver):
    """Newton's method along the path of equilibria, which may turn back: the load is an unknown.

    All conditions are multiplied with one factor, which rises and falls as equilibrium demands while the
    ``measure`` grows. Step times in history and log are that factor; the steps of the case do not matter.

    Parameters
    ----------
    measure : BondStretch or Opening
        What grows from step to step.
    first : float
        Load factor of the first step, from which the path is taken up.
    smallest : float
        Smallest step over the largest one; when it fails too the run ends with exit status 1.
    until : float
        The run ends when the forces have fallen to this share of their largest.
    most : int
        Largest number of steps.
    breaks : int, optional
        As in ``Steps``.
    """

    measure: BondStretch | Opening = field(default_factory=BondStretch)
    first: float = 1e-3
    smallest: float = 1e-4
    until: float = 0.01
    most: int = 10_000
    breaks: int | None = None

    title = "Path following"
    needs = Needs(proportional="at any load")
    # With the row of its constraint the residual is the gradient of nothing.
    of_energy = False
    finds_load = True

    def __post_init__(self) -> None:
        super().__post_init__()
        if not (0.0 < self.first <= 1.0 and 0.0 < self.smallest <= 1.0 and 0.0 <= self.until < 1.0 and self.most >= 1):
            raise CaseError(
                f"PathFollowing needs first and smallest in (0, 1], until in [0, 1) and most >= 1, not {self.first}, "
                f"{self.smallest}, {self.until} and {self.most}."
            )
        refuse_breaks(self.breaks)

    def check(self, dim: int) -> None:
        """Raise CaseError where the measure names what a body of ``dim`` dimensions lacks."""
        self.measure.check(dim)


def _refuse_step(step: float) -> None:
    if not (math.isfinite(step) and step > 0.0):
        raise CaseError(f"The measure of a path needs a positive step, not {step}.")


# What a case takes; those of this module are named in messages.
AnySolver: TypeAlias = Newton | DynamicRelaxation | EventDriven | PathFollowing | DeclaredSolver

# The ways to equilibrium by the word that the command line uses.
SOLVERS: dict[str, DeclaredSolver] = {
    "newton": Newton(),
    "relaxation": DynamicRelaxation(),
    "events": EventDriven(),
    "path": PathFollowing(),
}
