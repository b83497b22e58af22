"""How equilibrium of a load step is found."""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import ClassVar, Literal, TypeAlias

from pdpetsc.declare.region import Region
from pdpetsc.declared import Count, Declared, Fraction, Natural, Positive
from pdpetsc.errors import CaseError


@dataclass(frozen=True)
class Needs:
    """What a solver needs of the body, its conditions and the linear algebra.

    Attributes
    ----------
    tangent : {"any", "assembled", "none"}
        ``any``: the tangent may be a matrix or be applied without one; ``assembled``: it must be a matrix; ``none``:
        the solver needs no tangent.
    proportional : {"no", "up to the whole load", "at any load"}
        For which step times every condition must be the step time times its value at step time 1.
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
    """How equilibrium is found, as a case declares it; ``pdpetsc.solvers.table`` knows what does it.

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
        Whether the load factor is one of its unknowns: it may then take any value, and unstable equilibria are wanted.
    restarts : bool
        Whether a run with it can go on from a checkpoint.
    """

    title: ClassVar[str]
    needs: ClassVar[Needs] = Needs()
    of_energy: ClassVar[bool] = True
    finds_load: ClassVar[bool] = False
    restarts: ClassVar[bool] = True

    def check(self, dim: int) -> None:
        """Raise CaseError where a body of ``dim`` dimensions lacks what the declaration names (not collective)."""


@dataclass(frozen=True)
class Newton(DeclaredSolver):
    """Newton's method with the analytic tangent, on PETSc's SNES; its options come with ``Case.options``.

    Examples
    --------
    >>> import pdpetsc as pd
    >>> solver, options = pd.Newton(), {"snes_rtol": 1e-8}
    """

    title = "Newton's method"


@dataclass(frozen=True)
class DynamicRelaxation(DeclaredSolver):
    """Adaptive dynamic relaxation: damped motion in time until the body is at rest, without a matrix.

    Parameters
    ----------
    tolerance : float
        Bound on the residual and the change of displacement, each over its first value in the load step, and on the
        residual over the norm of external forces and reactions [-].
    most : int
        Largest number of time steps in a load step.

    Examples
    --------
    >>> import pdpetsc as pd
    >>> solver = pd.DynamicRelaxation(tolerance=1e-5)
    """

    tolerance: Fraction = 1e-6
    most: Count = 1_000_000

    title = "Dynamic relaxation"
    needs = Needs(tangent="none")


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

    Examples
    --------
    >>> import pdpetsc as pd
    >>> solver = pd.EventDriven(fields_every=100)
    """

    updates: Count | None = None
    most: Count = 1_000_000
    fields_every: Natural = 0

    title = "The event-driven solver"
    needs = Needs(tangent="assembled", proportional="up to the whole load", piecewise_linear=True, symmetric=True)
    finds_load = True
    restarts = False


@dataclass(frozen=True)
class BondStretch(Declared):
    """Measure of a path: the drive of the most driven bonds that have not failed, of stretches the most stretched ones.

    It grows from step to step, whatever the load does.

    Parameters
    ----------
    step : float
        Largest growth of what drives their damage in a step, of a stretch over the critical one [-].

    Examples
    --------
    >>> import pdpetsc as pd
    >>> solver = pd.PathFollowing(measure=pd.BondStretch(step=0.05))
    """

    step: Positive = 0.1

    def check(self, dim: int) -> None:
        """Accept every dimension."""


@dataclass(frozen=True)
class Opening(Declared):
    """Measure of a path: the mean displacement of a region relative to another, such as the opening of a notch.

    It grows from step to step, whatever the load does.

    Parameters
    ----------
    component : str
        ``"x"``, ``"y"`` or ``"z"``.
    region : Region
        The region that moves in the direction of the component.
    against : Region, optional
        The region whose mean displacement is subtracted; nothing is where absent.
    step, end : float
        Largest growth in a step, and the value at which the run ends [length]; both are positive: exchange the
        regions if they close.

    Examples
    --------
    >>> import pdpetsc as pd
    >>> right, left = pd.region.Nearest((51.0, 0.0)), pd.region.Nearest((49.0, 0.0))
    >>> mouth = pd.Opening("x", right, against=left, step=0.01, end=0.5)
    """

    component: Literal["x", "y", "z"]
    region: Region
    against: Region | None = field(default=None, kw_only=True)
    step: Positive = field(kw_only=True)
    end: Positive = field(kw_only=True)

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
class Dissipation(Declared):
    """Measure of a path: the energy that damage at gradient points has dissipated (``PointDamage``).

    It grows whatever the load does, as long as a crack does. As long as nothing fails the load grows.

    Parameters
    ----------
    step : float
        Largest growth in a step, to first order [energy], positive; about what a crack dissipates that grows by a
        spacing.

    Examples
    --------
    >>> import pdpetsc as pd
    >>> solver = pd.PathFollowing(measure=pd.Dissipation(step=0.05))
    """

    step: Positive

    def check(self, dim: int) -> None:
        """Accept every dimension."""


@dataclass(frozen=True)
class PathFollowing(DeclaredSolver):
    """Newton's method along the path of equilibria, which may turn back: the load is an unknown.

    All conditions are multiplied with one factor, which rises and falls as equilibrium demands while the
    ``measure`` grows. Step times in history and log are that factor; the steps of the case do not matter.

    Parameters
    ----------
    measure : BondStretch, Opening or Dissipation
        What grows from step to step.
    first : float
        Growth of the load factor in the first step [-], when no bond is stretched that the measure could prescribe.
    smallest : float
        Smallest step of the measure over the largest one [-]; when it fails too the run ends with exit status 1.
    until : float
        The run ends when the forces have fallen to this share of the largest so far [-].
    most : int
        Largest number of steps.
    bonds_at_once : int, optional
        As in ``Steps``.

    Examples
    --------
    >>> import pdpetsc as pd
    >>> solver = pd.PathFollowing(first=0.01, until=0.05)
    """

    measure: BondStretch | Opening | Dissipation = field(default_factory=BondStretch)
    first: float = 1e-3
    smallest: float = 1e-4
    until: float = 0.01
    most: Count = 10_000
    bonds_at_once: Count | None = None

    title = "Path following"
    needs = Needs(proportional="at any load")
    # With the constraint as one more row the residual is not the gradient of an energy.
    of_energy = False
    finds_load = True

    def __post_init__(self) -> None:
        super().__post_init__()
        if not (0.0 < self.first <= 1.0 and 0.0 < self.smallest <= 1.0 and 0.0 <= self.until < 1.0):
            raise CaseError(
                f"PathFollowing needs first and smallest in (0, 1], until in [0, 1), not {self.first}, "
                f"{self.smallest} and {self.until}."
            )

    def check(self, dim: int) -> None:
        """Raise CaseError where the measure names what a body of ``dim`` dimensions lacks."""
        self.measure.check(dim)


# What a case takes as its solver; messages name the classes of this module.
AnySolver: TypeAlias = Newton | DynamicRelaxation | EventDriven | PathFollowing | DeclaredSolver

# Every solver with its default options, under the word by which the command line selects it.
SOLVERS: dict[str, DeclaredSolver] = {
    "newton": Newton(),
    "relaxation": DynamicRelaxation(),
    "events": EventDriven(),
    "path": PathFollowing(),
}
