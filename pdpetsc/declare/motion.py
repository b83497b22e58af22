"""Rigid motions by schedules."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field

import numpy as np
import scipy

from pdpetsc.arrays import Float
from pdpetsc.declare.conditions import evaluated
from pdpetsc.declare.schedule import Ramp, Schedule
from pdpetsc.declared import Declared, Finite
from pdpetsc.errors import CaseError


@dataclass(frozen=True)
class RigidMotion(Declared):
    """A rigid motion: a point X moves to ``R (X - c) + c + d``.

    With the factor ``s(t)`` of the schedule, ``d = s move``, R is the rotation by ``s turn``, and ``c = about``. Each
    component of ``move`` may have a schedule of its own, so that a tool presses first and slides then.

    Parameters
    ----------
    move : sequence of float, optional
        Displacement of ``about`` at the end of the load (dim,) [length]; none by default.
    turn : float or sequence of float
        Rotation at the end of the load [rad]: the angle, anticlockwise, in 2D; the angle times the direction of the
        axis in space (3,). None by default.
    about : sequence of float, optional
        The point (dim,) about which it turns [length].
    schedule : callable or sequence of callables, optional
        Factor on ``move`` and ``turn`` as a function of the load parameter; ``Ramp()`` by default. A sequence has one
        for each component of ``move``, then one for ``turn`` if that is declared.
    """

    move: Sequence[float] = field(default=(), kw_only=True)
    turn: Finite | Sequence[float] = field(default=(), kw_only=True)
    about: Sequence[float] = field(default=(), kw_only=True)
    schedule: Schedule | Sequence[Schedule] = field(default_factory=Ramp, kw_only=True)

    @property
    def turns(self) -> bool:
        """Return True if a rotation is declared."""
        return len(np.ravel(self.turn)) > 0

    @property
    def rests(self) -> bool:
        """Return True if there is no motion."""
        return not (np.any(self.move) or np.any(np.ravel(self.turn)))

    def check(self, dim: int) -> None:
        """Raise CaseError if vectors have another number of components than ``dim``."""
        if len(self.move) not in (0, dim):
            raise CaseError(f"{type(self).__name__} moves by {len(self.move)} numbers in {dim} dimensions; give {dim}.")
        numbers = np.ravel(self.turn)
        if len(numbers) not in (0, {2: 1, 3: 3}.get(dim, 0)):
            raise CaseError(
                f"{type(self).__name__} turns by {len(numbers)} numbers in {dim} dimensions; give "
                f"{'an angle' if dim == 2 else 'the angle times the direction of the axis'}."
            )
        if len(numbers) and len(self.about) != dim:
            raise CaseError(f"{type(self).__name__} turns about a point of {dim} numbers, not {len(self.about)}.")

        if not callable(self.schedule):
            needed = len(self.move) + self.turns
            if len(self.schedule) != needed:
                raise CaseError(
                    f"{type(self).__name__} has {len(self.schedule)} schedules; give one for all, or {needed}: one for "
                    f"each component of move{', then one for turn' if self.turns else ''}."
                )

    def _factors(self, t: float) -> list[float]:
        """Return the factor of each component of ``move``, then that of ``turn``."""
        what = f"schedule of a {type(self).__name__}"
        if callable(self.schedule):
            return [float(evaluated(what, self.schedule, (), t, t))] * (len(self.move) + 1)
        found = [float(evaluated(what, one, (), t, t)) for one in self.schedule]
        return found if self.turns else [*found, 0.0]

    def angle(self, before: float, t: float) -> float:
        """Compute the angle of the rotation between two load parameters [rad]."""
        return float(np.linalg.norm(np.ravel(self.turn))) * abs(self._factors(t)[-1] - self._factors(before)[-1])

    def motion(self, t: float, dim: int) -> tuple[Float, Float]:
        """Compute rotation (dim, dim) and displacement (dim,) [length] at a load parameter."""
        *factors, factor = self._factors(t)
        moved = np.asarray(self.move, dtype=float) * factors if len(self.move) else np.zeros(dim)
        if not self.turns:
            return np.eye(dim), moved
        numbers = np.ravel(self.turn)
        about = numbers if dim == 3 else np.array([0.0, 0.0, numbers[0]])
        return scipy.spatial.transform.Rotation.from_rotvec(factor * about).as_matrix()[:dim, :dim], moved
