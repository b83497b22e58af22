"""Motion of a rigid tool or region: prescribed, or that of a rigid body under its load."""

from __future__ import annotations

from collections.abc import Callable
from functools import cached_property

import numpy as np

from pdpetsc.arrays import Float, LocalIndex, Mask
from pdpetsc.declare.motion import ROTATIONS, RigidMotion
from pdpetsc.discrete.communicator import Comm, counted_once, total
from pdpetsc.errors import CaseError
from pdpetsc.problem.blend import Blend
from pdpetsc.problem.rigid_inertia import RigidInertia, about_point, rotation_vector, skew, spin_of_vector, turned
from pdpetsc.problem.state import State

# Number of load parameters at which loads are compared.
SAMPLES = 21
# Components of displacement and rotation by the dimension, among those of space.
COMPONENTS = {1: [0], 2: [0, 1, 5], 3: [0, 1, 2, 3, 4, 5]}
# Step of differences in time over a time step.
SMALL = 1e-3
# Number of iterations for the motion under constant forces, by Newton's method.
ITERATIONS = 6
# Largest rotation in an implicit step [rad].
MOST_TURN = 2.0
# Distance of the centre of mass from a point over the size of a region at which they agree.
NEAR = 1e-9
# Smallest moment of inertia of a region over the largest.
LEAST = 1e-10
# Rows of the rates: velocity of P in space and angular velocity in the axes of the body; their algorithmic rates; rates
# of momentum and angular momentum, and forces of the body less the load, in space.
VELOCITY, ACCELERATION, RATE, FORCE = range(4)


class RigidBody:
    """Store the motion of a rigid tool or region.

    A point X moves to ``R (X - P) + P + d``, with P the point ``about``; the centre of mass of a region in free motion.
    Components of d with a force, and R with a moment, are found by solvers (``RigidBodies``); they move on linearly
    within a step.

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
    title : str
        Its name in messages.
    rows : (n_rows,) bool, optional
        Particles that move with a region; None for a tool.
    fictitious : bool
        Whether the particles of a region lie outside the body.

    Attributes
    ----------
    free : (dim + n_rotations,) bool
        Components of displacement and rotation that follow from the load.
    inertia : RigidInertia or None
        Mass and moments of inertia; None for a body without mass.
    about : (dim,) float64
        The point P [length].
    fictitious : bool
        As given.
    kept : (n, n_kept) float64
        Displacement, rotation and rates of the last converged step for a restart, the same for each owner.
    """

    def __init__(
        self, declared: RigidMotion, comm: Comm, dim: int, owner: LocalIndex, title: str, rows: Mask | None = None,
        fictitious: bool = False,
    ) -> None:  # fmt: skip
        self.declared, self.rows, self.title = declared, rows, title
        self._comm, self._dim, self.fictitious = comm, dim, fictitious
        self.free = declared.free(dim)
        self._of = np.array(COMPONENTS[dim])
        self._free = self._in_space(self.free) > 0.0
        self.about = np.asarray(declared.about, dtype=float) if declared.turns else np.zeros(dim)
        # The point of the load as seen from P, in the axes of the body.
        self._arm = np.zeros(3)
        # Displacement and rotation at the start of the step and now; for each owner those of the last converged step.
        self._d, self._R = np.zeros((2, dim)), np.stack([np.eye(3), np.eye(3)])
        self.inertia: RigidInertia | None = None
        lacks_mass = self.free[:dim].any() and declared.mass is None
        if declared.loaded and not lacks_mass and not (declared.twisted and declared.inertia is None):
            self.inertia = RigidInertia(declared.mass or 1.0, declared.tensor if declared.twisted else np.eye(3))
        # At both ends of the step; the momentum in its middle, of central differences.
        self._rates = np.zeros((4, 6))
        self._rates[VELOCITY] = self._in_space(np.where(self.free, declared.velocities(dim), 0.0))
        self._ended_rates, self._middle = self._rates.copy(), np.zeros(6)
        self._way = np.zeros(6)
        self.kept = np.tile(self._both, (len(owner), 1))
        self._span = (0.0, 0.0)
        self._ended, self._fresh, self._at_any = False, True, False

    @property
    def what(self) -> str:
        """Return the title as it stands within a sentence."""
        return self.title[0].lower() + self.title[1:]

    def _in_space(self, components: Float | Mask) -> Float:
        """Return six numbers of space for components of displacement and rotation."""
        found = np.zeros(6)
        found[self._of] = components
        return found

    def _of_free(self, matrix: Float) -> Float:
        """Return the rows and columns (n_free, n_free) of the free components of a matrix of space (6, 6)."""
        return np.asarray(matrix[np.ix_(self._free, self._free)])

    def weigh(self, mass: Float, x: Float, velocity: Float) -> None:
        """Set the inertia of a region in motion from its particles, and its initial velocity (collective).

        Particles have the moments of inertia of points. The region begins with the momentum and angular momentum of
        its particles; declared mass moves with it.

        Parameters
        ----------
        mass, x, velocity : (n,), (n, dim), (n, dim) float64
            Masses, positions and initial velocities of the particles of this rank [mass], [length], [length / time].

        Raises
        ------
        CaseError
            On all ranks: the load does not determine the motion, or an axis has no moment of inertia.
        """
        if self.fictitious:
            raise CaseError(
                f"{self.title} is the layers beyond a side of a Lattice, which have no mass of their own. Use "
                f"LatticeNodes, or name a region of particles."
            )
        declared, dim = self.declared, self._dim
        whole = np.zeros((2, len(mass), 3))
        whole[:, :, :dim] = x, velocity
        x, velocity = whole
        about = self._whole(self.about)
        added = declared.mass or 0.0
        sums = total(self._comm, np.concatenate([[mass.sum()], mass @ x, mass @ velocity]))
        M, first, momentum = float(sums[0]) + added, sums[1:4], sums[4:]
        centre = (first + added * about) / M if declared.turns else first / sums[0]
        point, pushed = about, self.free[:dim]
        if pushed.all() or not declared.turns:
            point = centre
        elif pushed.any() or np.any(declared.move):
            size = np.sqrt(total(self._comm, float(mass @ ((x - centre) ** 2).sum(axis=1))) / M)
            if np.linalg.norm(centre - about) > NEAR * (size + np.linalg.norm(centre)):
                at = ", ".join(f"{one:g}" for one in centre[:dim])
                raise CaseError(
                    f"{self.title} turns about a point that is not its centre of mass ({at}), with some directions "
                    f"prescribed. Turn it about that, or give a force in every direction, or none."
                )
        self.about, self._arm = point[:dim], about - point if declared.turns else np.zeros(3)
        arms = x - point
        of_particles = total(self._comm, about_point(mass, arms))
        J = of_particles + declared.tensor + about_point(np.array([added]), self._arm[None])
        if not declared.twisted:
            J = np.eye(3)
        principal = np.linalg.eigvalsh(J) if dim == 3 else J[2:, 2]
        if principal[0] <= LEAST * principal[-1]:
            raise CaseError(f"{self.title} has particles on a line, without a moment of inertia. Give it an inertia.")
        if dim < 3:
            J = J[2, 2] * np.eye(3)
        self.inertia = RigidInertia(M, J)
        # The rigid motion with the momenta of the particles.
        spun = total(self._comm, np.cross(mass[:, None] * arms, velocity).sum(axis=0))
        offset = skew(first - sums[0] * point)
        G = self._of_free(np.block([[sums[0] * np.eye(3), -offset], [offset, of_particles]]))
        size = float(np.sqrt(np.trace(of_particles) / sums[0])) or 1.0
        scale = np.repeat([1.0, 1.0 / size], 3)[self._free]
        momenta = scale * np.concatenate([momentum, spun])[self._free]
        self._rates[VELOCITY, self._free] = scale * np.linalg.lstsq(scale[:, None] * G * scale, momenta, rcond=LEAST)[0]
        self._ended_rates[:] = self._rates
        self.kept[:] = self._both

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
            between = turned(share * rotation_vector(after @ before.T), before) if share < 1.0 else after
            # ``move`` changes the rotation in place.
            R = between[: self._dim, : self._dim].copy()
        return R, d

    @property
    def _both(self) -> Float:
        """Return displacement, rotation and rates at the end of the step, in one row."""
        return np.concatenate([self._d[1], self._R[1].ravel(), self._ended_rates.ravel()])

    def _take(self, both: Float) -> None:
        d, R, rates = np.split(both, (self._dim, self._dim + 9))
        self._d[1], self._R[1], self._ended_rates = d, R.reshape(3, 3), rates.reshape(4, 6)

    def angle(self, before: float, t: float) -> float:
        """Return the angle of the rotation between two load parameters [rad]; of a load at most half a turn."""
        if not self.declared.twisted:
            return self.declared.angle(before, t)
        return float(np.linalg.norm(rotation_vector(self.motion(t)[0] @ self.motion(before)[0].T)))

    def relative(self, x: Float, u: Float, t: float) -> tuple[Float, Float]:
        """Compute the displacements (n, dim) [length] of points ``x`` as seen from the tool, and its rotation."""
        R, d = self.motion(t)
        if not self.declared.turns:
            return u - d, R
        return (u - d) @ R + (x - self.about) @ (R - np.eye(self._dim)), R

    def absolute(self, x: Float, v: Float, t: float) -> Float:
        """Compute the displacements (n, dim) [length] of points ``x`` from those as seen from the tool."""
        R, d = self.motion(t)
        if not self.declared.turns:
            return v + d
        return np.asarray((v - (x - self.about) @ (R - np.eye(self._dim))) @ R.T + d)

    @property
    def resultants(self) -> list[tuple[str, float, Float]]:
        """Return title, load parameter and declared force (dim,) at the end of the load (not collective)."""
        title = f"{self.title}, in axes that turn with it" if self.declared.follows else self.title
        return [(title, 1.0, self.declared.load(1.0, self._dim)[: self._dim])]

    @property
    def way(self) -> float:
        """Return the size of the displacement now [length] (not collective)."""
        return float(np.linalg.norm(self._d[1]))

    @cached_property
    def largest_load(self) -> Float:
        """Return the largest loads of the free components at a few load parameters (n_free,) [force]."""
        return np.asarray(np.abs([self.load(t) for t in np.linspace(0.0, 1.0, SAMPLES)]).max(axis=0))

    @property
    def driven(self) -> Float:
        """Return the prescribed components of the displacement at load parameter 1 (dim,) [length]."""
        return np.where(self.free[: self._dim], 0.0, self.declared.motion(1.0, self._dim)[1])

    def load(self, t: float) -> Float:
        """Return the loads of the free components about P (n_free,) [force], [force length]."""
        return np.asarray(self._load_about_point(t)[self._free])

    def load_stiffness(self, t: float) -> Float:
        """Return the derivative of ``load`` by the motion (n_free, n_free)."""
        found = np.zeros((6, 6))
        if self.declared.follows:
            force, moment = np.split(self._load_about_point(t), 2)
            found[:3, 3:], found[3:, 3:] = -skew(force), -skew(moment)
        else:
            found[3:, 3:] = skew(self._load_in_space(t)[:3]) @ skew(self._pose(t) @ self._arm)
        return self._of_free(found)

    @property
    def conservative(self) -> bool:
        """Return True if the load has an energy: a force of fixed direction, and in a plane any moment."""
        declared = self.declared
        follows = declared.follows and declared.twisted and any(declared.force)
        return not (follows or (self._dim == 3 and np.any(np.ravel(declared.moment))))

    def _load_in_space(self, t: float) -> Float:
        """Return force and moment (6,) about the point of the load, in the axes of space."""
        found = self._in_space(self.declared.load(t, self._dim))
        return np.ravel(found.reshape(2, 3) @ self._pose(t).T) if self.declared.follows else found

    def _load_about_point(self, t: float) -> Float:
        """Return force and moment (6,) about P, in the axes of space."""
        found = self._load_in_space(t)
        found[3:] += np.cross(self._pose(t) @ self._arm, found[:3])
        return found

    def _pose(self, t: float) -> Float:
        """Return the rotation (3, 3) at a load parameter of the step."""
        found = np.eye(3)
        found[: self._dim, : self._dim] = self.motion(t)[0]
        return found

    def velocities(self, y: Float, t: float) -> Float:
        """Return the velocities of points at positions ``y`` (n, dim) for unit rates of the free components.

        (n_free, n, dim): rates of displacement [-] and of rotation [length].
        """
        unit = np.broadcast_to(np.eye(self._dim)[:, None, :], (self._dim, *y.shape))
        around = y - self.about - self.motion(t)[1]
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
            self._R[1] = turned(turn if self._dim == 3 else np.array([0.0, 0.0, turn[0]]), self._R[1])

    @property
    def placed(self) -> Float:
        """Return displacement and rotation vector since the start of the step, free components only (n_free,)."""
        if self._ended:
            return np.zeros(np.count_nonzero(self._free))
        turn = rotation_vector(self._R[1] @ self._R[0].T)
        return np.asarray(np.concatenate([self._whole(self._d[1] - self._d[0]), turn])[self._free])

    def place(self, way: Float) -> None:
        """Move to a displacement and rotation vector since the start of the step (n_free,) (not collective)."""
        self._d[1], self._R[1] = self._d[0], self._R[0]
        self.move(way)

    @property
    def spins(self) -> Float:
        """Return the velocities and angular velocities for unit rates of ``placed``, in columns (n_free, n_free)."""
        found = np.eye(6)
        found[3:, 3:] = spin_of_vector(rotation_vector(self._R[1] @ self._R[0].T))
        return self._of_free(found)

    def follow_load(self) -> None:
        """Let the motion be the same at every load parameter: along a path a step has no known end."""
        self._at_any = True

    def start_from(self, begin: float, end: float) -> None:
        """Begin or repeat the step between two load parameters (not collective)."""
        if self._ended:
            self._d[0], self._R[0], self._rates = self._d[1], self._R[1], self._ended_rates.copy()
            self._ended, self._fresh = False, True
        self._span = (-np.inf, -np.inf) if self._at_any else (begin, end)

    def revert(self) -> None:
        """Return to the last converged step (not collective)."""
        if not self._ended:
            self._d[1], self._R[1], self._fresh = self._d[0], self._R[0], True

    def begin(self, unbalanced: Float) -> None:
        """Set the acceleration at the start of a motion from the loads that nothing balances (n_free,)."""
        force = np.zeros(6)
        force[self._free] = unbalanced
        found = self._mass.acceleration(force, self._rates[VELOCITY], np.eye(3))
        self._rates[1:] = np.where(self._free, [found, force, -force], 0.0)
        self._ended_rates = self._rates.copy()

    def fly(self, begin: float, end: float, dt: float) -> None:
        """Move by a time step of central differences between two load parameters, with the forces at its start."""
        self._span = (begin, end)
        R = self._R[0]
        begun = self._mass.momentum(self._rates[VELOCITY], R)
        self._middle = np.where(self._free, begun - 0.5 * dt * self._rates[FORCE], 0.0)
        half = self._mass.halfway(self._middle, R, dt, self.title)
        self._way = dt * np.concatenate([half[:3], R @ half[3:]])
        self.move(self._way[self._free])

    def land(self, unbalanced: Float, dt: float) -> None:
        """Set the rates at the end of a time step of central differences from the loads that nothing balances there."""
        R, found, force = self._R[1], np.zeros_like(self._rates), np.zeros(6)
        force[self._free] = unbalanced
        v = self._mass.velocity(self._middle + 0.5 * dt * force, R)
        found[VELOCITY] = np.where(self._free, v, self._prescribed_velocity(dt))
        found[ACCELERATION] = np.where(self._free, self._mass.acceleration(force, v, R), 0.0)
        found[RATE], found[FORCE] = force, -force
        self._ended_rates = found

    def push(self, unbalanced: Float, dt: float) -> float:
        """Set other loads that nothing balances at the end of a converged time step (n_free,).

        Return the change of ``kinetic`` by ``dt``: the forces of the two halves of the kick at this time differ.
        """
        before = self.kinetic(dt)
        self._ended_rates[FORCE, self._free] = -unbalanced
        self.kept[:] = self._both
        return self.kinetic(dt) - before

    def _end(self, blend: Blend, dt: float) -> Float:
        """Return the rates (4, 6) at the end of a generalised-alpha step of the length ``dt``, from the motion."""
        v, a, rate, s = self._rates
        moved = np.concatenate([self._whole(self._d[1] - self._d[0]), self._turn()])
        later = (moved - dt * v) / (blend.beta * dt**2) - (0.5 / blend.beta - 1.0) * a
        ended = np.where(self._free, v + dt * ((1.0 - blend.gamma) * a + blend.gamma * later), 0.0)
        change = self._mass.momentum(ended, self._R[1]) - self._mass.momentum(v, self._R[0])
        new = self._mass.rate(change, rate, blend, dt)
        force = ((1.0 - blend.alpha_m) * new + blend.alpha_m * rate + blend.alpha_f * s) / (1.0 - blend.alpha_f)
        ended = np.where(self._free, ended, self._prescribed_velocity(dt))
        return np.stack([ended, *np.where(self._free, [later, new, -force], 0.0)])

    def _whole(self, vector: Float) -> Float:
        """Return a vector (dim,) in space (3,)."""
        found = np.zeros(3)
        found[: self._dim] = vector
        return found

    def _turn(self) -> Float:
        """Return the rotation vector of the step in the axes of the body (3,)."""
        return rotation_vector(self._R[0].T @ self._R[1])

    def _prescribed_velocity(self, dt: float) -> Float:
        """Return the velocities (6,) of the prescribed components at the end of a step of the length ``dt`` [time]."""
        found, t, share = np.zeros(6), self._span[1], self._span[1] - self._span[0]
        if self._free[self._of].all() or share <= 0.0 or self.declared.rests:
            return found
        before, after = max(t - SMALL * share, 0.0), min(t + SMALL * share, 1.0)
        (R, d), (Q, e) = self.declared.motion(before, self._dim), self.declared.motion(after, self._dim)
        found[: self._dim] = e - d
        found[3:] = rotation_vector(R.T @ Q)
        return np.asarray(np.where(self._free, 0.0, found) * share / (dt * (after - before)))

    def accelerate(self, blend: Blend, dt: float) -> Float:
        """Set the rates at the end of a generalised-alpha step from the motion; return its inertia (n_free,).

        The inertia is that of ``Inertia``: with the load and the forces of the body at the end of the step it is zero.
        """
        self._ended_rates = self._end(blend, dt)
        self._way = np.concatenate([self._whole(self._d[1] - self._d[0]), self._R[0] @ self._turn()])
        return np.asarray(-self._ended_rates[FORCE, self._free])

    def predict(self, blend: Blend, dt: float) -> None:
        """Move to the end of a generalised-alpha step with the forces of its start, if no solve has moved the body."""
        if not self._fresh:
            return
        self._fresh = False
        v, a = self._rates[:2]
        way = dt * v + 0.5 * dt**2 * a
        self.move(np.concatenate([way[:3], self._R[0] @ way[3:]])[self._free])
        for _ in range(ITERATIONS):
            if self.turned_in_step(dt) > MOST_TURN:
                break
            missed = (self._end(blend, dt)[FORCE] - self._rates[FORCE])[self._free]
            self.move(np.linalg.solve(self.stiffness_in_step(blend, dt), missed))

    def stiffness_in_step(self, blend: Blend, dt: float) -> Float:
        """Return the derivative of the inertia of a generalised-alpha step by the motion (n_free, n_free)."""
        W = self._end(blend, dt)[VELOCITY, 3:]
        return self._of_free(self._mass.stiffness(W, self._turn(), self._R[1], blend, dt))

    def local_error(self, blend: Blend, dt: float, longest: float) -> Float:
        """Return three squares times masses (3,) [mass length^2] that judge an implicit step.

        They are those of the local error of the step, of the motion so far, and of the way that the acceleration at its
        end makes in the ``longest`` time step. Rotations count from the start of the run, at most half a turn.
        """
        rates, old = self._ended_rates, self._rates
        missed = (blend.beta - 1.0 / 6.0) * dt**2 * (rates[ACCELERATION] - old[ACCELERATION])
        moved = np.concatenate([self._whole(self._d[1]), rotation_vector(self._R[1])])
        masses = self._mass.matrix(np.eye(3))
        ways = [np.where(self._free, one, 0.0) for one in (missed, moved, 0.5 * longest**2 * rates[ACCELERATION])]
        return np.array([way @ masses @ way for way in ways])

    def turned_in_step(self, dt: float) -> float:
        """Return the rotation in a time step, or that with the velocity at its start if it is larger [rad].

        It is 0 for a prescribed rotation.
        """
        if not self.declared.twisted:
            return 0.0
        ahead = dt * float(np.linalg.norm(self._rates[VELOCITY, 3:]))
        return max(ahead, float(np.linalg.norm(self._turn())))

    def stopping(self, dt: float) -> Float:
        """Return the forces that would stop the body within a time step (n_free,)."""
        momentum = self._mass.momentum(self._ended_rates[VELOCITY], self._R[1])
        return np.asarray(np.abs(momentum)[self._free] / dt)

    def masses(self, t: float) -> Float:
        """Return the masses of the free components (n_free, n_free)."""
        return self._of_free(self._mass.matrix(self._pose(t)))

    def added_masses(self, t: float) -> Float:
        """Return the declared masses of the free components (n_free, n_free), without those of particles."""
        declared = self.declared
        return self._of_free(RigidInertia(declared.mass or 0.0, declared.tensor).matrix(self._pose(t)))

    @property
    def _mass(self) -> RigidInertia:
        assert self.inertia is not None
        return self.inertia

    def work(self, forces: Float, moved: Float) -> float:
        """Return the work of the load and of the forces of the body in the last step on this rank [energy].

        It is that of mean forces on the way of the point where each acts; of tools on the rotation vector of the step,
        on the first rank (not collective).

        Parameters
        ----------
        forces : (n_owned, dim) float64
            Mean forces on the particles, less damping [force].
        moved : (n_owned, dim) float64
            Their displacements in the step [length].
        """
        of_particles, first = 0.0, self._comm.rank == 0
        mean = -0.5 * (self._rates[FORCE] + self._ended_rates[FORCE])
        if self.rows is not None and self.declared.twisted:
            rows = self.rows[: len(forces)]
            of_particles = float((forces[rows] * (moved[rows] - self._d[1] + self._d[0])).sum())
            # The moment of a load that turns is constant along a rotation; a dead force acts along the way of its arm.
            turns = self.declared.follows
            loads = [self._load_about_point(t) if turns else self._load_in_space(t) for t in self._span]
            load = 0.5 * (loads[0] + loads[1])
            mean[3:] = load[3:]
            of_particles += float(load[:3] @ (self._R[1] - self._R[0]) @ self._arm) if first and not turns else 0.0
        return of_particles + (float(mean @ self._way) if first else 0.0)

    def kinetic(self, dt: float = 0.0) -> float:
        """Return the kinetic energy of the free components [energy] (not collective).

        With the time step of central differences, it is the product of the motions half a step before and after.
        """
        if self.inertia is None:
            return 0.0
        R, (v, _, _, s) = self._pose(self._span[1]), self._ended_rates
        h = np.where(self._free, self._mass.momentum(np.where(self._free, v, 0.0), R), 0.0)
        by_momentum = np.linalg.inv(self._mass.matrix(R))
        return 0.5 * float(h @ by_momentum @ h - (0.5 * dt) ** 2 * s @ by_momentum @ s)

    @property
    def added_kinetic(self) -> float:
        """Return the kinetic energy of declared mass and moments of inertia [energy] (not collective)."""
        v, declared = self._ended_rates[VELOCITY], self.declared
        at_load = v[:3] + self._pose(self._span[1]) @ np.cross(v[3:], self._arm)
        of_mass = 0.0 if declared.mass is None else declared.mass * float(at_load @ at_load)
        return 0.5 * (of_mass + float(v[3:] @ declared.tensor @ v[3:]))

    def carried(self, x: Float, u: Float, t: float, blend: Blend | None = None, dt: float = 0.0) -> Float:
        """Return the velocities (n, dim) [length / time] of points that move with the body.

        With a ``blend``, at the end of a generalised-alpha step of the length ``dt``; else at the end of the last step.

        Parameters
        ----------
        x, u : (n, dim) float64
            Reference positions and displacements [length].
        """
        v = (self._ended_rates if blend is None else self._end(blend, dt))[VELOCITY]
        arms = np.zeros((len(x), 3))
        arms[:, : self._dim] = x + u - self.about - self.motion(t)[1]
        found: Float = v[:3] + np.cross(self._pose(t) @ v[3:], arms)
        return np.asarray(found[:, : self._dim])

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

        Displacement and velocity are those of the point of the load (not collective).
        """

        def motion(state: State) -> Float:
            R, d = self.motion(state.t)
            arm = self._arm[: self._dim]
            return np.concatenate([d + R @ arm - arm, rotation_vector(R)[-ROTATIONS[self._dim] :]])

        def rates(state: State) -> Float:
            R, v = self._pose(state.t), self._ended_rates[VELOCITY]
            return np.asarray(np.concatenate([v[:3] + R @ np.cross(v[3:], self._arm), R @ v[3:]])[self._of])

        def number(of: Callable[[State], Float], index: int) -> Callable[[State], float]:
            return lambda state: counted_once(self._comm, float(of(state)[index]))

        if not self.free.any():
            return {}
        axes, turns = [f"_{axis}" for axis in "xyz"[: self._dim]], [""] if self._dim == 2 else ["_x", "_y", "_z"]
        turns = turns if self.declared.twisted else []
        names = [f"move{axis}" for axis in axes] + [f"turn{axis}" for axis in turns]
        found = {name: number(motion, index) for index, name in enumerate(names)}
        if self.inertia is not None:
            names = [f"velocity{axis}" for axis in axes] + [f"spin{axis}" for axis in turns]
            found |= {name: number(rates, index) for index, name in enumerate(names)}
        return found
