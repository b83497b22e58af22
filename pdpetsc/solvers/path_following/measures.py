"""Measures of a path: their current values, and the constraint of the next step."""

from __future__ import annotations

import math
from abc import ABC, abstractmethod
from collections.abc import Callable

import numpy as np

from pdpetsc.arrays import Float
from pdpetsc.declare.solvers import ArcLength, BondStretch, Dissipation, Opening
from pdpetsc.discrete.communicator import anywhere, scalar_product, total
from pdpetsc.discrete.selection import select
from pdpetsc.errors import CaseError
from pdpetsc.problem.problem import Problem
from pdpetsc.solvers.path_following.constraint import Constraint

# The measure averages the bonds whose driving variable is within this relative distance of the largest.
BAND = 0.05


class Measure(ABC):
    """Define a measure of a path, which grows from step to step.

    Attributes
    ----------
    holds_while_bonds_break : bool
        Whether the measure keeps its meaning when bonds break. Equilibrium with fewer bonds is then sought at the value
        reached.
    restarts : bool
        Whether the measure is known from a converged state, so that a run can restart there.

    Notes
    -----
    Every method is collective.
    """

    holds_while_bonds_break: bool
    restarts: bool = True

    @abstractmethod
    def constraint(self, u: Float, load: float) -> tuple[Constraint, bool]:
        """Return the constraint of a step from unknowns ``u``, and True if it can only prescribe the load factor."""

    @abstractmethod
    def reached(self, u: Float, load: float) -> float:
        """Return the value at unknowns ``u``."""

    @abstractmethod
    def left(self, u: Float) -> float:
        """Return the remaining growth."""

    def overshot(self, u: Float, load: float) -> bool:
        """Return True if the measure grew too far in a step that could only prescribe the load factor."""
        return False

    @abstractmethod
    def at_end(self, u: Float) -> bool:
        """Return True if the measure has reached its declared end."""


class StretchMeasure(Measure):
    """Compute the largest driving variable of unfailed bonds; for a critical stretch, stretch over critical stretch.

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
        if not anywhere(problem.body.cloud.comm, len(bonds.phi) - len(bonds.protected)):
            raise CaseError(
                "Path following by bond stretches needs bonds that can fail, and all of them are protected; protect a "
                "smaller region, or take an Opening."
            )

    def constraint(self, u: Float, load: float) -> tuple[Constraint, bool]:
        """Return the mean driving variable of the most driven bonds, or the load factor if no bond is driven yet."""
        of, largest = self._damage.most_driven(self._problem.state(u, load), BAND)
        by_load = largest <= 0.0
        return Constraint(of, float(by_load), u, load), by_load

    def reached(self, u: Float, load: float) -> float:
        """Return the largest driving variable [-]."""
        return self._damage.most_driven(self._problem.state(u, load), BAND)[1]

    def left(self, u: Float) -> float:
        """Return infinity: the path ends when the forces have decreased."""
        return math.inf

    def at_end(self, u: Float) -> bool:
        return False


class OpeningMeasure(Measure):
    """Compute the mean displacement of one region relative to another."""

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
                self._weights[: cloud.n_owned, axis] += sign * share / total(cloud.comm, share.sum())

    def constraint(self, u: Float, load: float) -> tuple[Constraint, bool]:
        return Constraint(self._weights, 0.0, u, load), False

    def reached(self, u: Float, load: float) -> float:
        """Return the opening [length]."""
        return self._opened(u)

    def left(self, u: Float) -> float:
        """Return the remaining opening [length]."""
        return self._end - self._opened(u)

    def at_end(self, u: Float) -> bool:
        """Return True if the end is reached, up to round-off."""
        return self._opened(u) >= self._end * (1.0 - 1e-9)

    def _opened(self, u: Float) -> float:
        return scalar_product(self._comm, self._weights, u)


class DissipationMeasure(Measure):
    """Compute the energy dissipated at gradient points.

    A step prescribes its growth to first order, by the gradient over the points that fail at the last equilibrium.

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
        """Return the growth of the dissipated energy, or the load factor if no point fails yet."""
        self._before = self.reached(u, load)
        with self._damage.loading():
            of = self._damage.dissipation_gradient(self._problem.state(u, load))
        assert of is not None
        by_load = not anywhere(self._problem.body.cloud.comm, of)
        return Constraint(of, float(by_load), u, load), by_load

    def reached(self, u: Float, load: float) -> float:
        """Return the dissipated energy [energy]."""
        dissipated = self._problem.material_term.dissipated_energy()
        return 0.0 if dissipated is None else dissipated

    def overshot(self, u: Float, load: float) -> bool:
        """Return True if the step dissipated more than its declared energy."""
        return self.reached(u, load) - self._before > self._step

    def left(self, u: Float) -> float:
        """Return infinity: the path ends when the forces have decreased."""
        return math.inf

    def at_end(self, u: Float) -> bool:
        return False


class ArcLengthMeasure(Measure):
    """Compute the length of the path of the displacements, ``sum |du|`` with ``|du|^2 = int du . du dV / V``.

    A step prescribes its growth along the direction of the step before, by the load factor in the first step.
    """

    holds_while_bonds_break = True
    restarts = False

    def __init__(self, problem: Problem, declared: ArcLength) -> None:
        cloud = problem.body.cloud
        self._end, self._comm = declared.end, cloud.comm
        self._share = np.zeros((cloud.n_rows, 1))
        volume = cloud.volume[: cloud.n_owned]
        self._share[: cloud.n_owned, 0] = volume / total(cloud.comm, volume.sum())
        self._last: Float | None = None
        self._direction: Float | None = None
        self._length = 0.0

    def constraint(self, u: Float, load: float) -> tuple[Constraint, bool]:
        """Return the growth along the last step from ``u``, or the load factor in the first step."""
        if self._last is not None:
            moved = u - self._last
            size = self._size(moved)
            if size > 0.0:
                self._direction = moved / size
                self._length += size
        self._last = u.copy()
        if self._direction is None:
            return Constraint(np.zeros_like(u), 1.0, u, load), True
        return Constraint(self._share * self._direction, 0.0, u, load), False

    def reached(self, u: Float, load: float) -> float:
        """Return the length of the path up to ``u`` [length]."""
        return self._length if self._last is None else self._length + self._size(u - self._last)

    def left(self, u: Float) -> float:
        """Return the remaining length [length]."""
        return self._end - self.reached(u, 0.0)

    def at_end(self, u: Float) -> bool:
        """Return True if the end is reached, up to round-off."""
        return self.reached(u, 0.0) >= self._end * (1.0 - 1e-9)

    def _size(self, du: Float) -> float:
        return math.sqrt(scalar_product(self._comm, self._share, du**2))


# Class of each declared measure.
MEASURES: dict[type, Callable[..., Measure]] = {
    BondStretch: StretchMeasure,
    Opening: OpeningMeasure,
    Dissipation: DissipationMeasure,
    ArcLength: ArcLengthMeasure,
}


def measure_of(problem: Problem, declared: BondStretch | Opening | Dissipation | ArcLength) -> Measure:
    """Build the measure that a case declares (collective)."""
    return MEASURES[type(declared)](problem, declared)
