"""Adaptive dynamic relaxation of one load step."""

from __future__ import annotations

import math
from collections.abc import Callable

import numpy as np

from pdpetsc.arrays import Float, irregular
from pdpetsc.declare.solvers import DynamicRelaxation
from pdpetsc.declare.steps import AdaptiveSteps, Steps
from pdpetsc.discrete.communicator import anywhere, largest, norm, smallest, total
from pdpetsc.kernels.relaxation import SUMS, advance, compare
from pdpetsc.problem.problem import Problem
from pdpetsc.problem.scales import nearest_distances
from pdpetsc.solvers.load_steps import LoadStepSolver
from pdpetsc.solvers.protocol import Setting, StepResult

# Iterations that estimate the largest frequency, and the share of the critical time step that is used.
POWER_ITERATIONS = 30
SAFETY = 0.9
# Iterations between estimates of the stable time step: the stiffness changes with the deformation.
RENEWED = 2000
# Time steps between records of the norm and checks for signals.
KEPT = 100
# An unloaded body has no forces to compare its residual with. The residual is compared with this share of the largest
# forces in a state at rest so far, or at the start of a solve of the step. Forces of a motion that does not come to
# rest do not count.
UNLOADED = 1e-3
# A residual of this share of these forces is round-off: a body that begins close to equilibrium may not reach the
# tolerance times its first values.
ROUND_OFF = 1e-12


class RelaxationSolver(LoadStepSolver):
    """Integrate the damped motion ``m a + c m v = f_ext - f_int`` with unit density by central differences, to rest.

    The time step is ``2 / n dx sqrt(rho / E_max)``, half of it for schemes with several points per particle. It is at
    most 0.9 of the critical time step ``2 / omega_max``. Power iterations give the largest frequency of ``M^-1 K``.

    The body is at rest if residual and change of displacement have decreased to the tolerance times their first values.
    The residual must also have decreased to the tolerance times the norm of external forces and reactions. A residual
    of round-off suffices.

    The damping ``c = 2 sqrt(u K u / u M u)`` follows the Rayleigh quotient of the displacement of the step, with the
    diagonal stiffness from two successive residuals.

    Parameters
    ----------
    problem : Problem
        The problem.
    options : DynamicRelaxation
        Tolerance and largest number of time steps.
    steps : Steps or AdaptiveSteps
        Load steps.
    stop : callable
        Called repeatedly and collectively; True ends the solve (a signal arrived).

    References
    ----------
    Luo2018, section 4, Eq. (14)-(17); Kilic2010.
    """

    unit = "relaxation"
    advice = "look for zero-energy modes, add or raise the zero-energy control, take more steps or more iterations"

    def __init__(
        self, problem: Problem, options: DynamicRelaxation, steps: Steps | AdaptiveSteps, stop: Callable[[], bool]
    ) -> None:
        self.problem = problem
        self.steps = steps
        self._comm = problem.body.cloud.comm
        self._options = options
        self.stop = stop
        self._free = ~problem.supports.fixed
        cloud = problem.body.cloud
        whole = float(total(cloud.comm, cloud.volume[: cloud.n_owned].sum()))
        mass = np.concatenate([cloud.volume[: cloud.n_owned], np.full(cloud.n_virtual, whole)])
        self._mass = problem.supports.lumped_mass(mass)
        self._courant = _courant_step(problem)
        self._largest = self._at_start = 0.0

    @classmethod
    def make(cls, setting: Setting) -> RelaxationSolver:
        """Build the solver of a setting (collective)."""
        return cls(setting.problem, setting.declared, setting.steps, setting.stop)

    def description(self) -> str:
        """Return a short description of the solver."""
        return f"dynamic relaxation, tolerance {self._options.tolerance:g}"

    def solve(self, u: Float, t: float) -> tuple[Float, StepResult]:
        """Integrate from ``u`` to rest under the conditions at load parameter ``t`` (collective)."""
        if t != self.t:
            self._at_start = 0.0
        self.t = t
        self._prescribed = self.problem.supports.prescribed(t)
        self.problem.start_from(self.problem.state(u, t))
        unknowns, result = self._relax(np.where(self._free, u, self._prescribed))
        while result.converged and self.problem.follow(self.problem.state(self._completed(unknowns), t)):
            unknowns, result = self._relax(unknowns)
        moved = self._completed(unknowns)
        objection = self.problem.objection(self.problem.state(moved, t)) if result.converged else ""
        return moved, result.refused(objection) if objection else result

    def _relax(self, start: Float) -> tuple[Float, StepResult]:
        """Integrate from unknowns ``start`` to rest; dependent unknowns do not change."""
        moved = start.copy()
        forces = self._forces(moved)
        if forces is None:
            return moved, StepResult(False, "det F <= 0 at the start of the step: the prescribed step is too long")
        unbalanced, external = forces
        residual = np.where(self._free, unbalanced, 0.0)
        reference = self._reference(unbalanced - residual, external)
        velocity = np.zeros_like(moved)
        norms = [norm(self._comm, residual)]
        sums, size = np.zeros(SUMS + 1), norms[0]
        first_change, dt, damping = 0.0, self._time_step(moved), 0.0
        density = norm(self._comm, residual / self._mass[:, None])
        self._at_start = max(self._at_start, reference)
        most = max(self._largest, self._at_start)
        least = UNLOADED * most
        tolerance = self._options.tolerance
        if norms[0] <= tolerance * max(reference, least):
            # The body is in equilibrium already: the first residual is too small as a reference.
            self._largest = max(self._largest, reference)
            return moved, StepResult(True, "at rest", norms, reference, 0)
        for iteration in range(1, self._options.most + 1):
            if iteration % RENEWED == 0:
                dt = self._time_step(moved)
            u, moved = moved, np.empty_like(moved)
            sums[SUMS] = advance(residual, self._mass, dt, damping, iteration == 1, u, velocity, moved)
            forces = self._forces(moved)
            if forces is None:
                return moved, StepResult(False, "det F <= 0 in the motion", norms, reference, iteration)
            unbalanced, external = forces
            compare(unbalanced, external, self._free, self._mass, velocity, dt, start, moved, residual, sums)
            stiff, heavy, outer, reaction, *squares = total(self._comm, sums).tolist()
            reference, (size, dense, moving) = math.sqrt(max(outer, reaction)), map(math.sqrt, squares)
            rayleigh = stiff / heavy if heavy > 0.0 else 0.0
            damping = min(2.0 * math.sqrt(max(rayleigh, 0.0)), 1.9 / dt)
            first_change = first_change or moving
            if iteration % KEPT == 0:
                norms.append(size)
                if self.stop():
                    return moved, StepResult(False, "a signal asked the run to stop", norms, reference, iteration)
            if not math.isfinite(size):
                return moved, StepResult(False, "the motion is unstable", norms, reference, iteration)
            decreased = dense <= tolerance * density and moving <= tolerance * first_change
            balanced = decreased and size <= tolerance * max(reference, least)
            if balanced or size <= ROUND_OFF * max(reference, most):
                self._largest = max(self._largest, reference)
                norms.append(size)
                return moved, StepResult(True, "at rest", norms, reference, iteration)
        norms.append(size)
        return moved, StepResult(False, "too many time steps", norms, reference, self._options.most)

    def _completed(self, unknowns: Float) -> Float:
        """Compute unknowns that satisfy the constraints (n_rows, dim) [length] from the independent ones."""
        return self.problem.supports.completed(unknowns, self._prescribed)

    def _forces(self, unknowns: Float) -> tuple[Float, Float] | None:
        """Compute unbalanced and external forces (n_rows, dim) [force]; None if they are undefined.

        For independent unknowns, unbalanced forces are ``C^T (f_ext - f_int)``. For the others, they are the part of
        ``f_ext - f_int`` that constraints balance.
        """
        state = self.state(self._completed(unknowns))
        force = self.problem.internal_force(state)
        if force is None:
            return None
        external = self.problem.external_force(state)
        unbalanced = external - force
        return np.where(self._free, self.problem.supports.reduced(unbalanced), unbalanced), external

    def _reference(self, reaction: Float, external: Float) -> float:
        """Compute the norm of forces and reactions [force]."""
        unstrained = self.problem.force_without_strain(self.t)
        held = 0.0 if unstrained is None else float((unstrained**2).sum())
        sums = total(self._comm, [(external**2).sum(), (reaction**2).sum(), held])
        size = max(sums[:2]) if not np.isfinite(sums[2]) else max(sums)
        return float(np.sqrt(size))

    def _time_step(self, u: Float) -> float:
        """Compute a stable time step at ``u``."""
        cloud = self.problem.body.cloud
        gid = np.concatenate([cloud.gid[: cloud.n_owned], cloud.n_global + np.arange(cloud.n_virtual)])
        v = np.where(self._free, irregular(gid, cloud.dim), 0.0)
        supports = self.problem.supports
        tangent = self.problem.linearised(self.state(self._completed(u)))
        square = 0.0
        for _ in range(POWER_ITERATIONS):
            v = v / max(norm(self._comm, v), np.finfo(float).tiny)
            v = supports.reduced(tangent(supports.completed(v))) / self._mass[:, None]
            square = norm(self._comm, v)
        # Power iterations approach the largest frequency from below.
        critical = 2.0 / np.sqrt(1.1 * square) if square > 0.0 else np.inf
        return float(min(self._courant, SAFETY * critical))


def _courant_step(problem: Problem) -> float:
    """Compute ``2 / n dx sqrt(rho / E_max)`` with unit density, half of it for several points per particle."""
    cloud = problem.body.cloud
    shortest = smallest(cloud.comm, nearest_distances(problem.body))
    stiffest = largest(cloud.comm, problem.material_term.largest_modulus)
    several = anywhere(cloud.comm, problem.material_term.n_points > cloud.n_owned)
    return float((1.0 if several else 2.0) / problem.dim * shortest / np.sqrt(stiffest))
