"""Measures of a path: their current values, and the constraint of the next step."""

from __future__ import annotations

import math
from abc import ABC, abstractmethod
from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from pdpetsc.arrays import Float
from pdpetsc.declare.solvers import ArcLength, BondStretch, Dissipation, Opening
from pdpetsc.discrete.communicator import Comm, anywhere, scalar_product, total
from pdpetsc.discrete.selection import select
from pdpetsc.errors import CaseError
from pdpetsc.problem.last_step import LastStep
from pdpetsc.problem.problem import Problem

# The measure averages the bonds whose driving variable is within this relative distance of the largest.
BAND = 0.05
# Relative difference of a measure and its end that are equal.
SAME_END = 1e-9


@dataclass(frozen=True)
class Constraint:
    """Prescribe the growth of ``of . (u - u0)``, or of the load factor.

    Attributes
    ----------
    of : (n_rows, dim) float64
        Weights of the unknowns, zero if the load factor is prescribed.
    by_load : bool
        Whether it prescribes the load factor: the measure does not determine it yet.
    u0, load0
        Unknowns [length] and load factor [-] at the start of the step.
    """

    of: Float
    by_load: bool
    u0: Float
    load0: float

    def grown(self, comm: Comm, u: Float, load: float) -> float:
        """Compute the growth (collective)."""
        return scalar_product(comm, self.of, u - self.u0) + self.by_load * (load - self.load0)


class Measure(ABC):
    """Define a measure of a path, which grows from step to step.

    Attributes
    ----------
    end : float
        Value at which the path ends; infinite if it ends when the forces have decreased.
    holds_while_bonds_break : bool
        Whether the measure keeps its meaning when bonds break. Equilibrium with fewer bonds is then sought at the value
        reached.

    Notes
    -----
    Every method is collective.
    """

    end: float = math.inf
    holds_while_bonds_break: bool = True

    @abstractmethod
    def constraint(self, u: Float, load: float) -> Constraint:
        """Return the constraint of a step from unknowns ``u``."""

    @abstractmethod
    def reached(self, u: Float, load: float) -> float:
        """Return the value at unknowns ``u``."""

    def restore(self, reached: float) -> None:  # noqa: B027
        """Set the value at a restart, if the state does not determine it."""

    def left(self, u: Float, load: float) -> float:
        """Return the remaining growth."""
        return math.inf if self.end == math.inf else self.end - self.reached(u, load)

    def overshot(self, u: Float, load: float) -> bool:
        """Return True if the measure grew too far in a step that could only prescribe the load factor."""
        return False

    def at_end(self, u: Float, load: float) -> bool:
        """Return True if the measure has reached its end, up to round-off."""
        return self.end < math.inf and self.reached(u, load) >= self.end * (1.0 - SAME_END)


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

    def constraint(self, u: Float, load: float) -> Constraint:
        """Return the mean driving variable of the most driven bonds, or the load factor if no bond is driven yet."""
        of, largest = self._damage.most_driven(self._problem.state(u, load), BAND)
        return Constraint(of, largest <= 0.0, u, load)

    def reached(self, u: Float, load: float) -> float:
        """Return the largest driving variable [-]."""
        return self._damage.most_driven(self._problem.state(u, load), BAND)[1]


class OpeningMeasure(Measure):
    """Compute the mean displacement of one region relative to another."""

    def __init__(self, problem: Problem, declared: Opening) -> None:
        self.end = declared.end
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

    def constraint(self, u: Float, load: float) -> Constraint:
        return Constraint(self._weights, False, u, load)

    def reached(self, u: Float, load: float) -> float:
        """Return the opening [length]."""
        return scalar_product(self._comm, self._weights, u)


class DissipationMeasure(Measure):
    """Compute the energy dissipated at gradient points.

    A step prescribes its growth to first order, by the gradient over the points that fail at the last equilibrium.

    Raises
    ------
    CaseError
        The body has no damage at gradient points.
    """

    def __init__(self, problem: Problem, declared: Dissipation) -> None:
        damage = problem.damage
        if damage is None or damage.of_bonds is not None:
            raise CaseError("Path following by dissipation needs PointDamage; take it, or BondStretch, or an Opening.")
        self._problem, self._damage, self._step, self._before = problem, damage, declared.step, 0.0

    def constraint(self, u: Float, load: float) -> Constraint:
        """Return the growth of the dissipated energy, or the load factor if no point fails yet."""
        self._before = self.reached(u, load)
        with self._damage.loading():
            of = self._damage.dissipation_gradient(self._problem.state(u, load))
        assert of is not None
        return Constraint(of, not anywhere(self._problem.body.cloud.comm, of), u, load)

    def reached(self, u: Float, load: float) -> float:
        """Return the dissipated energy [energy]."""
        dissipated = self._problem.material_term.dissipated_energy()
        return 0.0 if dissipated is None else dissipated

    def overshot(self, u: Float, load: float) -> bool:
        """Return True if the step dissipated more than its declared energy."""
        return self.reached(u, load) - self._before > self._step


class ArcLengthMeasure(Measure):
    """Compute the length of the path of the displacements, ``sum |du|`` with ``|du|^2 = int du . du dV / V``.

    A step prescribes its growth along the direction of the step before, by the load factor in the first step. The
    change of the displacement in the last step is in checkpoints (``LastStep``).
    """

    def __init__(self, problem: Problem, declared: ArcLength) -> None:
        cloud = problem.body.cloud
        self.end, self._comm = declared.end, cloud.comm
        self._share = np.zeros((cloud.n_rows, 1))
        volume = cloud.volume[: cloud.n_owned]
        self._share[: cloud.n_owned, 0] = volume / total(cloud.comm, volume.sum())
        if problem.last_step is None:
            problem.last_step = LastStep(problem)
        self._step = problem.last_step
        # Unknowns at the start of the step, and the length of the path up to them.
        self._start: Float | None = None
        self._length = 0.0

    def constraint(self, u: Float, load: float) -> Constraint:
        """Return the growth along the last step from ``u``, or the load factor in the first step."""
        self._length, self._start = self.reached(u, load), u.copy()
        self._step.begin(u)
        direction = np.zeros_like(u)
        direction[: len(self._step.change)] = self._step.change
        size = self._size(direction)
        if size == 0.0:
            return Constraint(direction, True, u, load)
        return Constraint(self._share * direction / size, False, u, load)

    def reached(self, u: Float, load: float) -> float:
        """Return the length of the path up to ``u`` [length]."""
        return self._length if self._start is None else self._length + self._size(u - self._start)

    def restore(self, reached: float) -> None:
        self._length = reached

    def _size(self, du: Float) -> float:
        return math.sqrt(scalar_product(self._comm, self._share, du**2))


# Class of each declared measure.
MEASURES: dict[type, Callable[..., Measure]] = {
    BondStretch: StretchMeasure,
    Opening: OpeningMeasure,
    Dissipation: DissipationMeasure,
    ArcLength: ArcLengthMeasure,
}
