"""Measures of a path: how far each has grown, and the constraint of the next step."""

from __future__ import annotations

import math
from abc import ABC, abstractmethod
from collections.abc import Callable

import numpy as np

from pdpetsc.arrays import Float
from pdpetsc.declare.solvers import BondStretch, Dissipation, Opening
from pdpetsc.discrete.communicator import total
from pdpetsc.discrete.selection import select
from pdpetsc.errors import CaseError
from pdpetsc.problem.problem import Problem
from pdpetsc.solvers.path_following.constraint import Constraint

# Bonds whose drive is within this of the largest share the measure, relatively.
BAND = 0.05


class Measure(ABC):
    """A measure of a path, which grows from step to step.

    Attributes
    ----------
    holds_while_bonds_break : bool
        Whether it stays the same quantity when bonds break, so that equilibrium with fewer bonds is sought at the value
        reached.

    Notes
    -----
    Every method is collective.
    """

    holds_while_bonds_break: bool

    @abstractmethod
    def constraint(self, u: Float, load: float) -> tuple[Constraint, bool]:
        """Return the constraint of a step from unknowns ``u``, and whether it can only prescribe the load factor."""

    @abstractmethod
    def reached(self, u: Float, load: float) -> float:
        """Return how far it has grown at unknowns ``u``."""

    @abstractmethod
    def left(self, u: Float) -> float:
        """Return by how much it may still grow."""

    def overshot(self, u: Float, load: float) -> bool:
        """Return True if it grew too far in a step that could only prescribe the load factor."""
        return False

    @abstractmethod
    def at_end(self, u: Float) -> bool:
        """Return whether it has grown as far as the case asks."""


class StretchMeasure(Measure):
    """The largest drive of the bonds that have not failed; of a critical stretch, the stretch over it.

    Raises
    ------
    CaseError
        No bond of the body can fail.
    """

    holds_while_bonds_break = False

    def __init__(self, problem: Problem, declared: BondStretch) -> None:
        if problem.bond_damage is None:
            raise CaseError("Path following by bond stretches needs bonds that can fail; give damage, or an Opening.")
        self._problem = problem
        self._damage = problem.bond_damage
        bonds = problem.bond_damage.bonds
        if not int(total(problem.body.cloud.comm, len(bonds.length) - len(bonds.protected))):
            raise CaseError(
                "Path following by bond stretches needs bonds that can fail, and all of them are protected; protect a "
                "smaller region, or take an Opening."
            )

    def constraint(self, u: Float, load: float) -> tuple[Constraint, bool]:
        """Return the mean drive of the bonds that are driven most, or the load factor where none is driven yet."""
        of, largest = self._damage.most_driven(self._problem.state(u, load), BAND)
        by_load = largest <= 0.0
        return Constraint(of, float(by_load), u, load), by_load

    def reached(self, u: Float, load: float) -> float:
        """Return the largest drive [-]."""
        return self._damage.most_driven(self._problem.state(u, load), BAND)[1]

    def left(self, u: Float) -> float:
        """Return infinity: the path ends where the forces have fallen."""
        return math.inf

    def at_end(self, u: Float) -> bool:
        """Return False."""
        return False


class OpeningMeasure(Measure):
    """The mean displacement of one region against that of another."""

    holds_while_bonds_break = True

    def __init__(self, problem: Problem, declared: Opening) -> None:
        self._end = declared.end
        cloud, dim = problem.body.cloud, problem.dim
        self._comm = cloud.comm
        axis = "xyz".index(declared.component)
        if axis >= dim:
            raise CaseError(f"The Opening of a {dim}-dimensional body has no component {declared.component}.")
        self._weights = np.zeros((cloud.n_rows, dim))
        for sign, region in ((1.0, declared.region), (-1.0, declared.against)):
            if region is not None:
                share = np.where(select(cloud, region, "the Opening"), cloud.volume[: cloud.n_owned], 0.0)
                self._weights[: cloud.n_owned, axis] += sign * share / float(total(cloud.comm, float(share.sum())))

    def constraint(self, u: Float, load: float) -> tuple[Constraint, bool]:
        """Return the opening."""
        return Constraint(self._weights, 0.0, u, load), False

    def reached(self, u: Float, load: float) -> float:
        """Return the opening [length]."""
        return self._opened(u)

    def left(self, u: Float) -> float:
        """Return the opening that is left to the end [length]."""
        return self._end - self._opened(u)

    def at_end(self, u: Float) -> bool:
        """Return whether the end is reached, up to round-off."""
        return self._opened(u) >= self._end * (1.0 - 1e-9)

    def _opened(self, u: Float) -> float:
        return float(total(self._comm, float((self._weights * u).sum())))


class DissipationMeasure(Measure):
    """The energy that gradient points have dissipated.

    A step prescribes its growth to first order, by its gradient where points fail at the equilibrium before.

    Raises
    ------
    CaseError
        The body has no damage at gradient points.
    """

    holds_while_bonds_break = True

    def __init__(self, problem: Problem, declared: Dissipation) -> None:
        damage = problem.damage
        if damage is None or not damage.forces_have_energy:
            raise CaseError("Path following by dissipation needs PointDamage; take it, or BondStretch, or an Opening.")
        self._problem, self._damage, self._step, self._before = problem, damage, declared.step, 0.0

    def constraint(self, u: Float, load: float) -> tuple[Constraint, bool]:
        """Return the growth of the dissipated energy, or the load factor where nothing fails yet."""
        self._before = self.reached(u, load)
        with self._damage.loading():
            of = self._damage.dissipation_gradient(self._problem.state(u, load))
        assert of is not None
        by_load = not float(total(self._problem.body.cloud.comm, float((of**2).sum()))) > 0.0
        return Constraint(of, float(by_load), u, load), by_load

    def reached(self, u: Float, load: float) -> float:
        """Return the dissipated energy [energy]."""
        dissipated = self._problem.material_term.dissipated_energy()
        return 0.0 if dissipated is None else dissipated

    def overshot(self, u: Float, load: float) -> bool:
        """Return True if the step dissipated more than its energy."""
        return self.reached(u, load) - self._before > self._step

    def left(self, u: Float) -> float:
        """Return infinity: the path ends where the forces have fallen."""
        return math.inf

    def at_end(self, u: Float) -> bool:
        """Return False."""
        return False


# The class that computes each measure that a case can declare.
MEASURES: dict[type, Callable[..., Measure]] = {
    BondStretch: StretchMeasure,
    Opening: OpeningMeasure,
    Dissipation: DissipationMeasure,
}


def measure_of(problem: Problem, declared: BondStretch | Opening | Dissipation) -> Measure:
    """Return the measure that a case declares (collective)."""
    return MEASURES[type(declared)](problem, declared)
