"""Rigid motions by schedules."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field

import numpy as np
import scipy

from pdpetsc.arrays import Float, Mask
from pdpetsc.declare.conditions import evaluated
from pdpetsc.declare.schedule import Ramp, Schedule
from pdpetsc.declared import Declared, Finite, Positive
from pdpetsc.errors import CaseError

# Number of components of a rotation by the dimension.
ROTATIONS = {1: 0, 2: 1, 3: 3}
# Relative difference of moments of inertia that are equal.
SAME_INERTIA = 1e-9


@dataclass(frozen=True)
class RigidMotion(Declared):
    """A rigid motion: a point X moves to ``R (X - c) + c + d``.

    With the factor ``s(t)`` of the schedule, ``d = s move``, R is the rotation by ``s turn``, and ``c = about``. Each
    component may have a schedule of its own, so that a tool presses first and slides then.

    A tool or region with a load is a rigid body, in equilibrium or in motion. Components of d with a force, and the
    rotation with a moment, follow from it.

    Parameters
    ----------
    move : sequence of float, optional
        Displacement of ``about`` at the end of the load (dim,) [length]; none by default.
    turn : float or sequence of float
        Rotation at the end of the load [rad]: the angle, anticlockwise, in 2D; the angle times the direction of the
        axis in space (3,). None by default.
    about : sequence of float, optional
        The point (dim,) about which it turns [length].
    force : sequence of float or None, optional
        Force on the tool or region at the end of the load (dim,) [force], at ``about``. None for the components in
        which ``move`` prescribes the motion. No force by default.
    moment : float or sequence of float, optional
        Moment about ``about`` at the end of the load [force length]: a number in 2D, (3,) in space; 0 lets it turn
        freely. By default ``turn`` prescribes the rotation.
    follows : bool
        Whether force and moment keep their directions in axes that turn with the body, so that ``R force`` acts in
        space, with a prescribed or free rotation R. By default they keep their directions in space.
    schedule : callable or sequence of callables, optional
        Factor on motions and loads as a function of the load parameter; ``Ramp()`` by default. A sequence has one for
        each direction, then one for the rotation if ``turn`` or ``moment`` is declared.
    mass : float, optional
        Mass at ``about``, with ``force``, in a motion (``Implicit``, ``Explicit``) or for frequencies (``Modes``)
        [mass].
    inertia : float, sequence of float or of such sequences, optional
        Moment of inertia of that mass about ``about``, with ``moment``, in a motion [mass length^2]. In space one
        number for all axes, three for the axes x, y, z at the start, or a symmetric matrix (3, 3) for them.
    """

    move: Sequence[float] = field(default=(), kw_only=True)
    turn: Finite | Sequence[float] = field(default=(), kw_only=True)
    about: Sequence[float] = field(default=(), kw_only=True)
    force: Sequence[float | None] = field(default=(), kw_only=True)
    moment: Finite | Sequence[float] = field(default=(), kw_only=True)
    follows: bool = field(default=False, kw_only=True)
    schedule: Schedule | Sequence[Schedule] = field(default_factory=Ramp, kw_only=True)
    mass: Positive | None = field(default=None, kw_only=True)
    inertia: Positive | Sequence[float] | Sequence[Sequence[float]] | None = field(default=None, kw_only=True)

    @property
    def turns(self) -> bool:
        """Return True if a rotation or a moment is declared."""
        return len(np.ravel(self.turn)) > 0 or self.twisted

    @property
    def twisted(self) -> bool:
        """Return True if a moment is declared."""
        return len(np.ravel(self.moment)) > 0

    @property
    def loaded(self) -> bool:
        """Return True if a part of the motion follows from a load."""
        return self.twisted or any(component is not None for component in self.force)

    def free(self, dim: int) -> Mask:
        """Return which components of displacement and rotation follow from a load (dim + rotations,)."""
        pushed = [component is not None for component in self.force] or [False] * dim
        return np.array(pushed + [self.twisted] * ROTATIONS[dim], dtype=bool)

    @property
    def rests(self) -> bool:
        """Return True if there is no motion."""
        return not (np.any(self.move) or np.any(np.ravel(self.turn)) or self.loaded)

    def check(self, dim: int) -> None:
        """Raise CaseError if vectors have another number of components than ``dim``, or motion and load conflict."""
        title = type(self).__name__
        for does, given in (("moves", self.move), ("is pushed", self.force)):
            if len(given) not in (0, dim):
                raise CaseError(f"{title} {does} by {len(given)} numbers in {dim} dimensions; give {dim}.")
        for does, numbers, single in (
            ("turns", np.ravel(self.turn), "an angle"),
            ("is turned", np.ravel(self.moment), "a moment"),
        ):
            if len(numbers) not in (0, {2: 1, 3: 3}.get(dim, 0)):
                raise CaseError(
                    f"{title} {does} by {len(numbers)} numbers in {dim} dimensions; give "
                    f"{single if dim == 2 else f'{single} times the direction of the axis'}."
                )
        if self.turns and len(self.about) != dim:
            raise CaseError(f"{title} turns about a point of {dim} numbers, not {len(self.about)}.")
        both = [axis for axis, m, f in zip("xyz", self.move, self.force, strict=False) if f is not None and m != 0.0]
        if both or (self.twisted and np.any(np.ravel(self.turn))):
            what = f"a motion and a force in {both[0]}" if both else "a turn and a moment"
            raise CaseError(f"{title} has {what}. Leave one of them out: the load determines the motion.")
        if self.follows:
            self._check_follower(dim)
        lacking = [("mass", "force")] if self.mass is not None and not self.free(dim)[:dim].any() else []
        lacking += [("inertia", "moment")] if self.inertia is not None and not self.twisted else []
        for has, needs in lacking:
            raise CaseError(f"{title} has {has} without {needs}. Give a {needs}, such as 0.")
        if self.inertia is not None:
            self._check_inertia(dim)
        if not callable(self.schedule):
            needed = max(len(self.move), len(self.force)) + self.turns
            if len(self.schedule) != needed:
                raise CaseError(
                    f"{title} has {len(self.schedule)} schedules; give one for all, or {needed}: one for each "
                    f"direction{', then one for the rotation' if self.turns else ''}."
                )

    def _check_follower(self, dim: int) -> None:
        """Raise CaseError if there is no load that follows, or if its direction in space has no meaning."""
        title, pushed = type(self).__name__, self.free(dim)[:dim]
        if not (self.loaded and self.turns):
            lacks = "a moment, such as 0, or a turn" if self.loaded else "a force or a moment"
            raise CaseError(f"{title} follows, and has no {'rotation' if self.loaded else 'load'}. Give {lacks}.")
        if pushed.any() and not pushed.all():
            raise CaseError(
                f"{title} has a force that follows, in some directions only: those of the force turn, and those of "
                f"move do not. Give a force in every direction, such as 0."
            )

    def _check_inertia(self, dim: int) -> None:
        """Raise CaseError if no body has the declared moments of inertia."""
        title, given = type(self).__name__, np.asarray(self.inertia).shape
        if given not in ((), (3,), (3, 3)) or (dim != 3 and given != ()):
            needed = "three numbers or a matrix (3, 3)" if dim == 3 else "a number"
            raise CaseError(f"{title} has an inertia of shape {given} in {dim} dimensions; give {needed}.")
        J = self.tensor
        principal = np.linalg.eigvalsh(0.5 * (J + J.T))
        if not np.allclose(J, J.T, rtol=0.0, atol=SAME_INERTIA * np.abs(J).max()) or principal[0] <= 0.0:
            raise CaseError(f"{title} has an inertia that is not symmetric and positive. Correct it.")
        if principal[2] > (principal[0] + principal[1]) * (1.0 + SAME_INERTIA):
            raise CaseError(
                f"{title} has principal moments of inertia {', '.join(f'{one:g}' for one in principal)}, and no body "
                f"has one that exceeds the sum of the others. Correct them."
            )

    @property
    def tensor(self) -> Float:
        """Return the declared moments of inertia (3, 3) [mass length^2]; 0 for none."""
        J = np.asarray(0.0 if self.inertia is None else self.inertia, dtype=float)
        return J if J.ndim == 2 else np.eye(3) * J

    def _factors(self, t: float) -> list[float]:
        """Return the factor of each direction, then that of the rotation."""
        what = f"schedule of a {type(self).__name__}"
        if callable(self.schedule):
            return [float(evaluated(what, self.schedule, (), t, t))] * (max(len(self.move), len(self.force)) + 1)
        found = [float(evaluated(what, one, (), t, t)) for one in self.schedule]
        return found if self.turns else [*found, 0.0]

    def velocities(self, dim: int) -> Float:
        """Return the initial velocity by component (dim + rotations,) [length / time], [1 / time]."""
        return np.zeros(dim + ROTATIONS[dim])

    def angle(self, before: float, t: float) -> float:
        """Compute the angle of the prescribed rotation between two load parameters [rad]."""
        return float(np.linalg.norm(np.ravel(self.turn))) * abs(self._factors(t)[-1] - self._factors(before)[-1])

    def motion(self, t: float, dim: int) -> tuple[Float, Float]:
        """Compute rotation (dim, dim) and displacement (dim,) [length] at a load parameter, as without load."""
        *factors, factor = self._factors(t)
        moved = np.asarray(self.move, dtype=float) * factors if len(self.move) else np.zeros(dim)
        numbers = np.ravel(self.turn)
        if len(numbers) == 0:
            return np.eye(dim), moved
        about = numbers if dim == 3 else np.array([0.0, 0.0, numbers[0]])
        return scipy.spatial.transform.Rotation.from_rotvec(factor * about).as_matrix()[:dim, :dim], moved

    def load(self, t: float, dim: int) -> Float:
        """Compute force and moment at a load parameter (dim + rotations,) [force], [force length].

        Those that follow are in the axes of the body. The moment has one component in 2D, three in space, none in 1D.
        """
        *factors, factor = self._factors(t)
        found = np.zeros(dim + ROTATIONS[dim])
        if len(self.force):
            found[:dim] = np.array([component or 0.0 for component in self.force]) * factors
        if self.twisted:
            found[dim:] = factor * np.ravel(self.moment)
        return found
