"""Mass and moments of inertia of a rigid body: momentum, and Euler's equations in time steps."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy.spatial.transform import Rotation

from pdpetsc.arrays import Float
from pdpetsc.errors import SolveError
from pdpetsc.problem.blend import Blend

# Largest number of iterations for the rotation of a step of central differences, and accuracy at which they end.
ITERATIONS, EXACT = 50, 4.0 * np.finfo(float).eps
# Largest rotation in a step of central differences [rad].
MOST_TURN = 0.5
# Angle below which coefficients of rotations have their limits [rad].
SMALL = 1e-3


@dataclass(frozen=True)
class RigidInertia:
    """Mass and moments of inertia of a rigid body about a point P: its centre of mass, or a point at rest.

    Momentum and angular momentum in space are ``p = M v`` and ``L = R J W``. v is the velocity of P, W the angular
    velocity in the axes of the body, and R their rotation. Their rates are force and moment about P, which are Euler's
    equations ``J W' + W x J W = R^T T``. Vectors of six numbers are a vector of P, then one of the rotation.

    Attributes
    ----------
    mass : float
        M [mass].
    tensor : (3, 3) float64
        J in the axes of the undeformed body [mass length^2].

    Notes
    -----
    No method is collective.

    References
    ----------
    Simo1991 (angular momentum and energy of implicit steps), Krysl2005 (explicit steps).
    """

    mass: float
    tensor: Float

    def momentum(self, v: Float, R: Float) -> Float:
        """Return momentum and angular momentum in space (6,) for ``(v, W)``."""
        return np.concatenate([self.mass * v[:3], R @ self.tensor @ v[3:]])

    def velocity(self, momentum: Float, R: Float) -> Float:
        """Return ``(v, W)`` (6,) for momentum and angular momentum in space."""
        return np.concatenate([momentum[:3] / self.mass, np.linalg.solve(self.tensor, R.T @ momentum[3:])])

    def acceleration(self, force: Float, v: Float, R: Float) -> Float:
        """Return ``(v', W')`` (6,) for force and moment in space (6,)."""
        turning = R.T @ force[3:] - np.cross(v[3:], self.tensor @ v[3:])
        return np.concatenate([force[:3] / self.mass, np.linalg.solve(self.tensor, turning)])

    def halfway(self, momentum: Float, R: Float, dt: float, title: str) -> Float:
        """Return the constant ``(v, W)`` (6,) of a step whose momentum in its middle is known.

        In the middle the axes are ``R exp(dt W / 2)``: ``J W = exp(-dt W / 2) R^T L``.

        Raises
        ------
        SolveError
            The body turns too far in a step.
        """
        found = self.velocity(momentum, R)
        if not np.any(self.tensor - self.tensor[0, 0] * np.eye(3)):  # W does not depend on the axes
            return found
        for _ in range(ITERATIONS):
            before = found
            found = self.velocity(momentum, R @ rotation(0.5 * dt * found[3:]))
            if np.linalg.norm(found[3:] - before[3:]) <= EXACT * np.linalg.norm(found[3:]):
                break
        turned = dt * float(np.linalg.norm(found[3:]))
        if not turned <= MOST_TURN:
            raise SolveError(
                f"{title} turns by {turned:.3g} rad in one time step, and central differences resolve {MOST_TURN:g}. "
                f"Take a smaller safety, more records, or Implicit."
            )
        return found

    def rate(self, change: Float, before: Float, blend: Blend, dt: float) -> Float:
        """Return the rate of momentum at the end of a generalised-alpha step (6,), from its change in the step."""
        return change / (blend.gamma * dt) - (1.0 / blend.gamma - 1.0) * before

    def stiffness(self, W: Float, turned: Float, R: Float, blend: Blend, dt: float) -> Float:
        """Return the derivative of the inertia of a generalised-alpha step by displacement and rotation (6, 6).

        Parameters
        ----------
        W, turned : (3,) float64
            Angular velocity at the end of the step, and rotation vector of the step, in the axes of the body.
        R : (3, 3) float64
            Rotation at the end of the step.
        """
        angle = float(np.linalg.norm(turned))
        ratio = 1.0 / 12.0
        if angle > SMALL:
            ratio = 1.0 / angle**2 - (1.0 + np.cos(angle)) / (2.0 * angle * np.sin(angle))
        cross = skew(turned)
        # Change of the rotation vector of the step with a rotation after it.
        by_rotation = (np.eye(3) + 0.5 * cross + ratio * cross @ cross) @ R.T
        per_way = blend.gamma / (blend.beta * dt)
        found = np.zeros((6, 6))
        found[:3, :3] = per_way * self.mass * np.eye(3)
        found[3:, 3:] = per_way * R @ self.tensor @ by_rotation - skew(R @ self.tensor @ W)
        return found * (1.0 - blend.alpha_m) / ((1.0 - blend.alpha_f) * blend.gamma * dt)

    def matrix(self, R: Float) -> Float:
        """Return the masses by displacement and rotation in space (6, 6)."""
        found = np.zeros((6, 6))
        found[:3, :3], found[3:, 3:] = self.mass * np.eye(3), R @ self.tensor @ R.T
        return found


def skew(vector: Float) -> Float:
    """Return the matrix of ``vector x`` (3, 3)."""
    x, y, z = vector
    return np.array([[0.0, -z, y], [z, 0.0, -x], [-y, x, 0.0]])


def rotation_vector(R: Float) -> Float:
    """Return the rotation vector (3,) of a rotation in the plane or in space [rad]."""
    whole = np.eye(3)
    whole[: len(R), : len(R)] = R
    return np.asarray(Rotation.from_matrix(whole).as_rotvec())


def rotation(vector: Float) -> Float:
    """Return the rotation (3, 3) of a rotation vector (3,)."""
    return np.asarray(Rotation.from_rotvec(vector).as_matrix())


def turned(vector: Float, R: Float) -> Float:
    """Return a rotation (3, 3) after a further one of a rotation vector (3,) in space, orthogonal to round-off."""
    return np.asarray((Rotation.from_rotvec(vector) * Rotation.from_matrix(R)).as_matrix())


def spin_of_vector(vector: Float) -> Float:
    """Return the angular velocities in space for unit rates of a rotation vector (3,), in columns (3, 3)."""
    angle, cross = float(np.linalg.norm(vector)), skew(vector)
    first, second = 0.5, 1.0 / 6.0
    if angle > SMALL:
        first, second = (1.0 - np.cos(angle)) / angle**2, (angle - np.sin(angle)) / angle**3
    return np.asarray(np.eye(3) + first * cross + second * cross @ cross)


def about_point(mass: Float, arm: Float) -> Float:
    """Return the moments of inertia (3, 3) of point masses (n,) at arms (n, 3) [mass length^2]."""
    squares = mass @ (arm**2).sum(axis=1)
    return np.asarray(squares * np.eye(3) - (mass[:, None] * arm).T @ arm)
