"""Solvers of a load step."""

from __future__ import annotations

import math
from dataclasses import dataclass, field
from typing import ClassVar, Literal, TypeAlias

from pdpetsc.declare.region import Region
from pdpetsc.declare.steps import LEAST_STEP, MOST_STEPS, AdaptiveSteps
from pdpetsc.declared import Count, Declared, Fraction, Natural, Positive
from pdpetsc.errors import CaseError

# Share of a time step that is not worth one more.
PART_OF_STEP = 1e-9
# Smallest time step over the largest one, if the error decides.
LEAST_SHARE = 1e-4


@dataclass(frozen=True)
class Needs:
    """Requirements of a solver on the body, its conditions and the linear algebra.

    Attributes
    ----------
    tangent : {"any", "assembled", "none"}
        ``any``: the tangent may be a matrix or matrix-free; ``assembled``: it must be a matrix; ``none``: the solver
        uses no tangent.
    proportional : {"no", "up to the whole load", "at any load"}
        The load parameters for which every condition must be the load parameter times its value at load parameter 1.
    piecewise_linear : bool
        If True, forces must be linear in the displacement as long as no bond fails.
    symmetric : bool
        If True, the tangent of every term must be symmetric.
    """

    tangent: Literal["any", "assembled", "none"] = "any"
    proportional: Literal["no", "up to the whole load", "at any load"] = "no"
    piecewise_linear: bool = False
    symmetric: bool = False


class DeclaredSolver(Declared):
    """Declaration of a solver in a case; ``pdpetsc.solvers.table`` has its implementation.

    Attributes
    ----------
    title : str
        Name in messages.
    needs : Needs
        Its requirements.
    of_energy : bool
        If True, the residual is the gradient of an energy if the terms have one. A line search may then search for a
        zero of the residual along the step.
    finds_load : bool
        If True, the load factor is an unknown: it may have any value, and unstable equilibria are accepted.
    restarts : bool
        If True, a run can continue from a checkpoint.
    duration : float or None
        Physical time from step time 0 to 1 of a motion [time]; None for equilibria.
    """

    title: ClassVar[str]
    needs: ClassVar[Needs] = Needs()
    of_energy: ClassVar[bool] = True
    finds_load: ClassVar[bool] = False
    restarts: ClassVar[bool] = True

    @property
    def conserving(self) -> bool:
        """Return True if stresses are those of steps that conserve energy and angular momentum."""
        return False

    @property
    def duration(self) -> float | None:
        """Return the physical time of a motion with inertia [time], None for equilibria."""
        return None

    @property
    def adaptive(self) -> AdaptiveSteps | None:
        """Return the steps of a motion whose sizes follow from its error, None for others."""
        return None

    def check(self, dim: int) -> None:
        """Raise CaseError if the declaration does not fit a body of ``dim`` dimensions (not collective)."""


@dataclass(frozen=True)
class Newton(DeclaredSolver):
    """Newton's method with the analytic tangent, by PETSc's SNES; its options are part of ``Case.options``.

    Examples
    --------
    >>> import pdpetsc as pd
    >>> solver, options = pd.Newton(), {"snes_rtol": 1e-8}
    """

    title = "Newton's method"


@dataclass(frozen=True)
class DynamicRelaxation(DeclaredSolver):
    """Adaptive dynamic relaxation: damped motion in artificial time until the body is at rest, without a matrix.

    Parameters
    ----------
    tolerance : float
        Bound on the residual and on the change of displacement, both relative to their first value in the load step,
        and on the residual relative to the norm of external forces and reactions [-].
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
    """Event-driven solver: computes the load of each failing bond without iterations, for piecewise linear laws.

    Between events the solution is linear in the load parameter, which determines the next failure exactly. A failing
    bond releases its force while the load increases or decreases to maintain equilibrium. All conditions must be
    proportional to the load parameter, which may decrease: snap-back is followed.

    Parameters
    ----------
    updates : int, optional
        Number of changed bonds after which the matrix is factored again; until then they are corrections of the old
        factor. By default it is proportional to the square root of the number of unknowns.
    most : int
        Largest number of events.
    fields_every : int
        Number of events between written fields; fields are also written at the end. 0: at the end only.

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


class PathMeasure(Declared):
    """Measure of a path, which grows in every step."""

    def check(self, dim: int) -> None:
        """Raise CaseError if the measure does not fit a body of ``dim`` dimensions."""


@dataclass(frozen=True)
class BondStretch(PathMeasure):
    """Measure of a path: the largest driving variable of the bonds that have not failed, such as the stretch.

    It increases in every step, also if the load decreases.

    Parameters
    ----------
    step : float
        Largest growth of the driving variable in a step, such as stretch over critical stretch [-].

    Examples
    --------
    >>> import pdpetsc as pd
    >>> solver = pd.PathFollowing(measure=pd.BondStretch(step=0.05))
    """

    step: Positive = 0.1


@dataclass(frozen=True)
class Opening(PathMeasure):
    """Measure of a path: the mean displacement of a region relative to another, such as the opening of a notch.

    It increases in every step, also if the load decreases.

    Parameters
    ----------
    component : str
        ``"x"``, ``"y"`` or ``"z"``.
    region : Region
        The region that moves along the component.
    against : Region, optional
        The region whose mean displacement is subtracted, if declared.
    step, end : float
        Largest growth in a step, and the value at which the run ends [length]. Both are positive; exchange the regions
        if they approach each other.

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
        """Raise CaseError if the component or a region does not fit a body of ``dim`` dimensions."""
        if self.component not in "xyz"[:dim]:
            raise CaseError(f"The Opening of a {dim}-dimensional body has no component {self.component}.")
        for side in (self.region, self.against):
            if side is not None:
                try:
                    side.check(dim)
                except CaseError as error:
                    raise CaseError(f"The Opening: {error}") from None


@dataclass(frozen=True)
class Dissipation(PathMeasure):
    """Measure of a path: the energy dissipated by damage at gradient points (``PointDamage``).

    It increases while a crack grows, also if the load decreases. As long as no point fails, the load increases.

    Parameters
    ----------
    step : float
        Largest growth in a step, to first order [energy], positive; about the energy that a crack dissipates per
        spacing.

    Examples
    --------
    >>> import pdpetsc as pd
    >>> solver = pd.PathFollowing(measure=pd.Dissipation(step=0.05))
    """

    step: Positive


@dataclass(frozen=True)
class ArcLength(PathMeasure):
    """Measure of a path: its length, from the root mean square of the displacement increments over the volume.

    It passes limit points of load and of displacement, for bodies that snap. A step goes on in the direction of the
    step before, in the plane normal to it. The path does not turn back by itself, and a run cannot restart.

    Parameters
    ----------
    step, end : float
        Largest growth in a step, and the length at which the run ends [length], both positive.

    References
    ----------
    deBorst2012, section 4.2 (updated normal plane).

    Examples
    --------
    >>> import pdpetsc as pd
    >>> solver = pd.PathFollowing(pd.ArcLength(step=0.1, end=4.0), first=0.01, until=0.0)
    """

    step: Positive
    end: Positive


@dataclass(frozen=True)
class PathFollowing(DeclaredSolver):
    """Newton's method along the path of equilibria, with the load as an unknown; follows snap-back.

    All conditions are multiplied by one load factor, which increases or decreases while the ``measure`` grows. It is
    ``t`` in history and log. Rigid tools move with it. The steps of the case are not used.

    Parameters
    ----------
    measure : BondStretch, Opening, Dissipation or ArcLength
        The quantity that grows in every step.
    first : float
        Growth of the load factor in the first step [-], in which no bond is stretched yet, and until tools touch.
    smallest : float
        Smallest step of the measure over the largest one [-]; if it fails, the run ends with exit status 1.
    until : float
        The run ends when the forces have decreased to this share of the largest so far [-].
    most : int
        Largest number of steps.
    bonds_at_once : int, optional
        As in ``Steps``.

    Examples
    --------
    >>> import pdpetsc as pd
    >>> solver = pd.PathFollowing(first=0.01, until=0.05)
    """

    measure: BondStretch | Opening | Dissipation | ArcLength = field(default_factory=BondStretch)
    first: float = 1e-3
    smallest: float = 1e-4
    until: float = 0.01
    most: Count = 10_000
    bonds_at_once: Count | None = None

    title = "Path following"
    needs = Needs(proportional="at any load")
    # With the constraint as an additional row the residual is not the gradient of an energy.
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
        """Raise CaseError if the measure does not fit a body of ``dim`` dimensions."""
        self.measure.check(dim)


@dataclass(frozen=True)
class Implicit(DeclaredSolver):
    """Motion with inertia by generalised-alpha steps, each solved by Newton's method with PETSc's SNES.

    ``M ((1 - alpha_m) a + alpha_m a_0) + (1 - alpha_f) r(u) + alpha_f r(u_0) = 0`` with the residual ``r`` of statics
    at both ends of a step, of second order in the time step. A step that fails is halved. All materials have a
    ``density``; masses are lumped. Step times from 0 to 1 are the times from 0 to ``end``: the schedules and functions
    of conditions get ``t / end``. The case has no ``steps``.

    Parameters
    ----------
    dt : float
        Largest time step [time].
    end : float
        Time at the end [time].
    radius : float
        Spectral radius at infinite frequency [-]: 1 conserves the energy of a linear body, less damps waves that the
        time step does not resolve.
    preload : bool
        If True, the motion starts from the equilibrium of the conditions at step time 0, not from the undeformed body.
    every : int
        Time steps between records in history and files.
    error : float, optional
        Largest local error of a time step, over the largest displacement so far, both as root mean squares over the
        mass [-]. A step with a larger error is halved, and the next ones grow as far as the error allows, up to ``dt``.
        The error is ``|beta - 1 / 6| dt^2 |a - a_0|``. Steps also end at the times of tables, as of ``AdaptiveSteps``.
        By default all steps are ``dt``.
    energy_momentum : bool
        If True, energy and angular momentum are conserved at finite deformation too: the stress of a step is that of
        ``EnergyMomentum``. It needs a radius of 1, deformation gradients and elastic materials without damage,
        temperature and ``MeanDilatation``.

    References
    ----------
    Chung1993; Zienkiewicz1991 (error); Gonzalez2000 (energy and momentum).

    Examples
    --------
    >>> import pdpetsc as pd
    >>> solver = pd.Implicit(dt=1e-6, end=1e-4, radius=0.9)
    """

    dt: Positive
    end: Positive
    radius: float = 1.0
    preload: bool = field(default=False, kw_only=True)
    every: Count = field(default=1, kw_only=True)
    error: Positive | None = field(default=None, kw_only=True)
    energy_momentum: bool = field(default=False, kw_only=True)

    title = "Implicit dynamics"

    def __post_init__(self) -> None:
        super().__post_init__()
        if not 0.0 <= self.radius <= 1.0:
            raise CaseError(f"Implicit takes a radius from 0 to 1, not {self.radius:g}.")
        if self.energy_momentum and self.radius != 1.0:
            raise CaseError(f"energy_momentum of Implicit needs a radius of 1, not {self.radius:g}, which damps.")
        if self.dt > self.end or self.end / self.dt > MOST_STEPS:
            raise CaseError(
                f"Implicit goes from 0 to {self.end:g} in steps of {self.dt:g}; take at least 1 and at most "
                f"{MOST_STEPS} steps."
            )

    @property
    def count(self) -> int:
        """Return the number of time steps if none is shortened."""
        return math.ceil(self.end / self.dt * (1.0 - PART_OF_STEP))

    @property
    def conserving(self) -> bool:
        return self.energy_momentum

    @property
    def duration(self) -> float:
        """Return the time at the end."""
        return self.end

    @property
    def adaptive(self) -> AdaptiveSteps | None:
        """Return time steps up to ``dt``, in shares of the whole time, if the error decides."""
        if self.error is None:
            return None
        step = 1.0 / self.count
        return AdaptiveSteps(first=step, smallest=max(LEAST_SHARE * step, LEAST_STEP), largest=step)


@dataclass(frozen=True)
class SnapThrough(DeclaredSolver):
    """Load steps by Newton's method; the smallest step without equilibrium goes on as a motion until the body rests.

    Beyond a limit point of the load the body snaps to another equilibrium. From the last one it moves with inertia
    under constant conditions, those of the end of the step, by the steps of ``Implicit``. When kinetic energy and
    inertia forces have become small, Newton's method seeks the equilibrium there; the next load steps start from it.
    All materials have a ``density``; ``RayleighDamping(mass=...)`` and ``AbsorbingBoundary`` act while the body moves.
    The equilibrium on which a body ends that swings past several depends on the damping. Parts that come loose under
    load never rest.

    Newton's method may find an equilibrium beyond the limit without a motion. In a body without damage, temperature,
    friction and moving tools a step is refused if the work on it exceeds the change of the stored energy by 5 % of
    both. They are those of the whole body: a local snap of less is not noticed.

    Parameters
    ----------
    dt : float
        Largest time step of a motion [time].
    end : float
        Longest time of a motion [time]; the run ends with an error if the body has not come to rest.
    radius : float
        Spectral radius at infinite frequency [-]: with 0 motions are damped that a time step does not resolve.

    Examples
    --------
    >>> import pdpetsc as pd
    >>> solver, steps = pd.SnapThrough(dt=1e-3, end=1.0), pd.Steps(20, smallest=1e-3)
    """

    dt: Positive
    end: Positive
    radius: float = 0.0

    title = "Load steps with snaps"

    def __post_init__(self) -> None:
        super().__post_init__()
        if not 0.0 <= self.radius <= 1.0:
            raise CaseError(f"SnapThrough takes a radius from 0 to 1, not {self.radius:g}.")
        if self.dt > self.end:
            raise CaseError(f"SnapThrough moves for at most {self.end:g} in steps of {self.dt:g}; take a smaller dt.")


@dataclass(frozen=True)
class Explicit(DeclaredSolver):
    """Motion with inertia by central differences (velocity Verlet), without a matrix.

    The time step is ``safety`` times the stable one, ``2 / w`` with the largest frequency of the tangent, found by
    Lanczos' method, again as often as it changes; it is never above that at the start. All materials have a
    ``density``; masses are lumped. Step times from 0 to 1 are the times from 0 to ``end``, as for ``Implicit``. A run
    whose energy does not balance ends with an error. The case has no ``steps``.

    Parameters
    ----------
    end : float
        Time at the end [time].
    safety : float
        Time step over the stable one [-].
    preload : bool
        If True, the motion starts from the equilibrium of the conditions at step time 0, not from the undeformed body;
        it is found by dynamic relaxation.
    records : int
        Number of records in history and files, at equal times.
    least_step : float, optional
        Time step of the undeformed body, ``safety`` included [time], for which stiff and light particles get more
        mass: ``m_i = max(rho V_i, c k_i)`` with the mean ``k_i`` of the diagonal of the tangent and one ``c`` for the
        body. The log states the added mass, and warns above 5 %. For slow processes and a few small particles: waves
        slow down, and kinetic energy, J and stress intensity are those of the raised mass.

    References
    ----------
    Hughes1987, section 9.1 (central differences). Olovsson2005 adds mass that keeps translations; here masses stay
    lumped.

    Examples
    --------
    >>> import pdpetsc as pd
    >>> solver = pd.Explicit(end=1e-4, records=200)
    """

    end: Positive
    safety: Fraction = 0.9
    preload: bool = field(default=False, kw_only=True)
    records: Count = field(default=100, kw_only=True)
    least_step: Positive | None = field(default=None, kw_only=True)

    title = "Explicit dynamics"
    needs = Needs(tangent="none")

    def __post_init__(self) -> None:
        super().__post_init__()
        if self.records > MOST_STEPS:
            raise CaseError(f"Explicit takes at most {MOST_STEPS} records, not {self.records}.")

    @property
    def duration(self) -> float:
        """Return the time at the end."""
        return self.end


# Solvers that a case accepts; messages name the classes of this module.
AnySolver: TypeAlias = (
    Newton | DynamicRelaxation | EventDriven | PathFollowing | Implicit | Explicit | SnapThrough | DeclaredSolver
)

# Every solver with its default options, by its word on the command line.
SOLVERS: dict[str, DeclaredSolver] = {
    "newton": Newton(),
    "relaxation": DynamicRelaxation(),
    "events": EventDriven(),
    "path": PathFollowing(),
}
