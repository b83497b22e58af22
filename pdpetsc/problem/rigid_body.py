"""Motion of a rigid tool or region: prescribed, or that of a rigid body in equilibrium with its load."""

from __future__ import annotations

from collections.abc import Callable
from functools import cached_property

import numpy as np
from scipy.spatial.transform import Rotation

from pdpetsc.arrays import Float, LocalIndex, Mask
from pdpetsc.declare.motion import ROTATIONS, RigidMotion
from pdpetsc.discrete.communicator import Comm
from pdpetsc.problem.blend import Blend
from pdpetsc.problem.state import State

# Number of load parameters at which loads are compared.
SAMPLES = 21


class RigidBody:
    """Store the motion of a rigid tool or region.

    A point X moves to ``R (X - c) + c + d`` with ``c = about``. Components of d with a force, and R with a moment, are
    found by solvers (``RigidBodies``); they move on linearly within a step.

    Parameters
    ----------
    declared : RigidMotion
        Declared motion and load.
    comm : Comm
        Ranks of the body.
    dim : int
        Dimension.
    owner : (n,) int32
        Own particles of this rank that the tool may touch or that move with the region, ascending.
    rows : (n_rows,) bool, optional
        Particles that move with a region; None for a tool.
    title : str
        What it is, in messages.

    Attributes
    ----------
    free : (dim + n_rotations,) bool
        Components of displacement and rotation that follow from the load.
    masses : (dim + n_rotations,) float64 or None
        Mass and moment of inertia by component; None for a body without mass.
    kept : (n, n_kept) float64
        Displacement, rotation and rates of the last converged step for a restart, the same for each owner.
    """

    def __init__(
        self, declared: RigidMotion, comm: Comm, dim: int, owner: LocalIndex, title: str, rows: Mask | None = None
    ) -> None:
        self.declared, self.rows, self.title = declared, rows, title
        self._comm, self._dim = comm, dim
        self.free = declared.free(dim)
        self._about = np.asarray(declared.about, dtype=float) if declared.turns else np.zeros(dim)
        # Displacement and rotation at the start of the step and now; for each owner those of the last converged step.
        self._d, self._R = np.zeros((2, dim)), np.stack([np.eye(3), np.eye(3)])
        self.masses = declared.masses(dim)
        # Velocity, acceleration, and the forces of the body less the load, by component, at both ends of the step; the
        # velocity in its middle.
        self._rates = np.zeros((3, len(self.free)))
        self._rates[0] = np.where(self.free, declared.velocities(dim), 0.0)
        self._ended_rates, self._half = self._rates.copy(), self._rates[0]
        self.kept = np.tile(self._both, (len(owner), 1))
        self._span = (0.0, 0.0)
        self._ended = False

    def motion(self, t: float) -> tuple[Float, Float]:
        """Return rotation (dim, dim) and displacement (dim,) [length] at a load parameter of the step."""
        R, d = self.declared.motion(t, self._dim)
        if not self.free.any():
            return R, d
        begin, end = self._span
        share = 0.0 if t <= begin else 1.0 if t >= end else (t - begin) / (end - begin)
        start, now = self._d
        d = np.where(self.free[: self._dim], start + share * (now - start), d)
        if self.declared.twisted:
            before, after = self._R
            turned = _rotation(share * _vector(after @ before.T)) @ before if share < 1.0 else after
            R = turned[: self._dim, : self._dim]
        return R, d

    @property
    def _both(self) -> Float:
        """Return displacement, rotation and rates at the end of the step, in one row."""
        return np.concatenate([self._d[1], self._R[1].ravel(), self._ended_rates.ravel()])

    def _take(self, both: Float) -> None:
        d, R, rates = np.split(both, (self._dim, self._dim + 9))
        self._d[1], self._R[1], self._ended_rates = d, R.reshape(3, 3), rates.reshape(3, -1)

    def angle(self, before: float, t: float) -> float:
        """Return the angle of the rotation between two load parameters [rad]; of a load at most half a turn."""
        if not self.declared.twisted:
            return self.declared.angle(before, t)
        return float(np.linalg.norm(_vector(self.motion(t)[0] @ self.motion(before)[0].T)))

    def relative(self, x: Float, u: Float, t: float) -> tuple[Float, Float]:
        """Compute the displacements (n, dim) [length] of points ``x`` as seen from the tool, and its rotation."""
        R, d = self.motion(t)
        if not self.declared.turns:
            return u - d, R
        return (u - d) @ R + (x - self._about) @ (R - np.eye(self._dim)), R

    def absolute(self, x: Float, v: Float, t: float) -> Float:
        """Compute the displacements (n, dim) [length] of points ``x`` from those as seen from the tool."""
        R, d = self.motion(t)
        if not self.declared.turns:
            return v + d
        return np.asarray((v - (x - self._about) @ (R - np.eye(self._dim))) @ R.T + d)

    @property
    def resultants(self) -> list[tuple[str, float, Float]]:
        """Return title, load parameter and force (dim,) at the end of the load (not collective)."""
        return [(self.title, 1.0, self.declared.load(1.0, self._dim)[: self._dim])]

    @property
    def way(self) -> float:
        """Return the size of the displacement now [length] (not collective)."""
        return float(np.linalg.norm(self._d[1]))

    @cached_property
    def largest_load(self) -> Float:
        """Return the largest loads of the free components at a few load parameters (n_free,) [force]."""
        return np.asarray(np.abs([self.load(t) for t in np.linspace(0.0, 1.0, SAMPLES)]).max(axis=0))

    def load(self, t: float) -> Float:
        """Return the loads of the free components (n_free,) [force], [force length]."""
        return self.declared.load(t, self._dim)[self.free]

    def velocities(self, y: Float, t: float) -> Float:
        """Return the velocities of points at positions ``y`` (n, dim) for unit rates of the free components.

        (n_free, n, dim): rates of displacement [-] and of rotation [length].
        """
        unit = np.broadcast_to(np.eye(self._dim)[:, None, :], (self._dim, *y.shape))
        around = y - self._about - self.motion(t)[1]
        return np.asarray(np.concatenate([unit, self.turned(around)])[self.free])

    def turned(self, vectors: Float) -> Float:
        """Return ``e_k x v`` for the unit rotations about each axis (n_rotations, n, dim)."""
        if self._dim == 1:
            return np.empty((0, *vectors.shape))
        if self._dim == 2:
            return np.asarray(np.stack([-vectors[:, 1], vectors[:, 0]], axis=1)[None])
        return np.stack([np.asarray(np.cross(axis, vectors)) for axis in np.eye(3)])

    def spun(self, vectors: Float) -> Float:
        """Return the changes of vectors (n, dim) that turn with the body, for unit rates of the free components."""
        still = np.zeros((self._dim, *vectors.shape))
        return np.asarray(np.concatenate([still, self.turned(vectors)])[self.free])

    def move(self, by: Float) -> None:
        """Move by increments of the free components (n_free,) [length], [rad] (not collective)."""
        step = np.zeros(len(self.free))
        step[self.free] = by
        self._d[1] += step[: self._dim]
        if self.declared.twisted:
            turn = step[self._dim :]
            self._R[1] = _rotation(turn if self._dim == 3 else np.array([0.0, 0.0, turn[0]])) @ self._R[1]

    def start_from(self, begin: float, end: float) -> None:
        """Begin or repeat the step between two load parameters (not collective)."""
        if self._ended:
            self._d[0], self._R[0], self._rates, self._ended = self._d[1], self._R[1], self._ended_rates.copy(), False
        self._span = (begin, end)

    def revert(self) -> None:
        """Return to the last converged step (not collective)."""
        if not self._ended:
            self._d[1], self._R[1] = self._d[0], self._R[0]

    def begin(self, unbalanced: Float) -> None:
        """Set the acceleration at the start of a motion from the loads that nothing balances (n_free,)."""
        self._rates[2, self.free] = -unbalanced
        self._rates[1] = -self._rates[2] / self._mass
        self._ended_rates = self._rates.copy()

    def fly(self, t: float, dt: float) -> None:
        """Move by a time step of central differences from load parameter ``t``, with the acceleration there."""
        self._span = (t, t)
        self._half = self._rates[0] + 0.5 * dt * self._rates[1]
        self.move(dt * self._half[self.free])

    def land(self, unbalanced: Float, dt: float) -> None:
        """Set the rates at the end of a time step of central differences from the loads that nothing balances there."""
        found = np.zeros_like(self._rates)
        found[2, self.free] = -unbalanced
        found[1] = -found[2] / self._mass
        found[0] = self._half + 0.5 * dt * found[1]
        self._ended_rates = found

    def accelerate(self, blend: Blend, dt: float) -> Float:
        """Set the rates at the end of a generalised-alpha step from the motion; return its inertia (n_free,) [force].

        The inertia is that of ``Inertia``: with the load and the forces of the body at the end of the step it is zero.
        """
        v, a, s = self._rates
        turned = _vector(self._R[1] @ self._R[0].T)[3 - ROTATIONS[self._dim] :]
        moved = np.concatenate([self._d[1] - self._d[0], turned])
        later = (moved - dt * v) / (blend.beta * dt**2) - (0.5 / blend.beta - 1.0) * a
        later = np.where(self.free, later, 0.0)
        force = self._mass * ((1.0 - blend.alpha_m) * later + blend.alpha_m * a) + blend.alpha_f * s
        force /= 1.0 - blend.alpha_f
        self._ended_rates = np.stack([v + dt * ((1.0 - blend.gamma) * a + blend.gamma * later), later, -force])
        return np.asarray(force[self.free])

    def mass_in_step(self, blend: Blend, dt: float) -> Float:
        """Return the derivative of the inertia of ``accelerate`` by the motion (n_free,)."""
        return np.asarray((1.0 - blend.alpha_m) / ((1.0 - blend.alpha_f) * blend.beta * dt**2) * self._mass[self.free])

    def stopping(self, dt: float) -> Float:
        """Return the forces that would stop the body within a time step (n_free,)."""
        return np.asarray(np.abs(self._mass * self._ended_rates[0])[self.free] / dt)

    @property
    def _mass(self) -> Float:
        assert self.masses is not None
        return self.masses

    def commit(self) -> None:
        """Keep the motion of a converged step (not collective)."""
        self.kept[:] = self._both
        self._ended = True

    def restored(self) -> None:
        """Continue with the motion of a checkpoint."""
        # A rank without particles of it has read nothing.
        read = self._comm.allgather(self.kept[0] if len(self.kept) else None)
        self._take(next(both for both in read if both is not None))
        self._ended = True

    def numbers(self) -> dict[str, Callable[[State], float]]:
        """Return displacement, rotation vector and, of a body with mass, rates for the history, on the first rank.

        Not collective.
        """

        def component(number: int) -> Callable[[State], float]:
            def value(state: State) -> float:
                R, d = self.motion(state.t)
                found = np.concatenate([d, _vector(R)[-ROTATIONS[self._dim] :]])
                return float(found[number]) if self._comm.rank == 0 else 0.0

            return value

        def rate(number: int) -> Callable[[State], float]:
            return lambda state: float(self._ended_rates[0, number]) if self._comm.rank == 0 else 0.0

        if not self.free.any():
            return {}
        names = [f"move_{axis}" for axis in "xyz"[: self._dim]]
        rates = [] if self.masses is None else [f"velocity_{axis}" for axis in "xyz"[: self._dim]]
        if self.declared.twisted:
            names += ["turn"] if self._dim == 2 else [f"turn_{axis}" for axis in "xyz"]
            if rates:
                rates += ["spin"] if self._dim == 2 else [f"spin_{axis}" for axis in "xyz"]
        found = {name: component(number) for number, name in enumerate(names)}
        return {**found, **{name: rate(number) for number, name in enumerate(rates)}}


def _vector(R: Float) -> Float:
    """Return the rotation vector (3,) of a rotation in the plane or in space [rad]."""
    whole = np.eye(3)
    whole[: len(R), : len(R)] = R
    return np.asarray(Rotation.from_matrix(whole).as_rotvec())


def _rotation(vector: Float) -> Float:
    """Return the rotation (3, 3) of a rotation vector (3,)."""
    return np.asarray(Rotation.from_rotvec(vector).as_matrix())
