"""The state after a converged step, as outputs and quantities of interest see it."""

from __future__ import annotations

from collections.abc import Callable
from functools import cached_property
from typing import Any, TypeAlias

import numpy as np

from pdpetsc.arrays import Float
from pdpetsc.discrete.communicator import largest, total
from pdpetsc.loading import Loading, select
from pdpetsc.model import Model
from pdpetsc.scene.region import Region


class Solution:
    """Displacements of the own particles and what follows from them.

    Parameters
    ----------
    model, loading
        The body and its conditions.
    u : (n_owned, dim) float64
        Converged displacement [length].
    t : float
        Step time [-].
    step : int
        Number of the step, 0 for the undeformed state.

    Notes
    -----
    Every property that is computed, ``sum`` and ``select`` are collective.
    """

    def __init__(self, model: Model, loading: Loading, u: Float, t: float, step: int) -> None:
        self.model = model
        self.loading = loading
        self.u = u
        self.t = t
        self.step = step

    @property
    def x(self) -> Float:
        """Return the reference positions of the own particles (n_owned, dim) [length]."""
        return self.model.cloud.x[: self.model.cloud.n_owned]

    @property
    def volume(self) -> Float:
        """Return the volumes of the own particles (n_owned,)."""
        return self.model.cloud.volume[: self.model.cloud.n_owned]

    @cached_property
    def F(self) -> Float:
        """Return the deformation gradients at the gradient points (n_points, dim, dim) [-]."""
        return self.model.deformation(self.model.with_ghosts(self.u))

    @cached_property
    def internal_force(self) -> Float:
        """Return the internal forces (n_owned, dim) [force]."""
        force = self.model.internal_force(self.u)
        if force is None:
            raise FloatingPointError("a converged state has det F <= 0")
        return force

    @cached_property
    def reaction(self) -> Float:
        """Return the forces that supports exert, ``f_int - f_ext`` where prescribed, else 0 (n_owned, dim) [force]."""
        return np.where(self.loading.fixed, self.internal_force - self.loading.forces(self.t), 0.0)

    @cached_property
    def energies(self) -> tuple[float, float]:
        """Return the strain energy of the body and that of its zero-energy control [energy]."""
        return self.model.energy(self.u)

    def particle_mean(self, values: Float) -> Float:
        """Return the mean over the gradient points of each own particle."""
        return self.model.operator.mean_over_points(values, self.model.cloud.n_owned)

    def select(self, region: Region) -> Any:
        """Return which own particles a region selects (n_owned,) bool."""
        return select(self.model.cloud, region, "a quantity of interest")

    def sum(self, values: Any) -> Any:
        """Return the sum over all ranks of numbers summed on each."""
        return total(self.model.cloud.comm, values)

    def largest(self, value: float) -> float:
        """Return the maximum over all ranks."""
        return largest(self.model.cloud.comm, value)


# A field of the own particles, (n_owned,) or (n_owned, dim) or (n_owned, dim, dim); its name is the function's.
Field: TypeAlias = Callable[[Solution], Float]


def displacement(solution: Solution) -> Float:
    """Return u (n_owned, dim) [length]."""
    return solution.u


def deformation_gradient(solution: Solution) -> Float:
    """Return F, the mean over the points of each particle (n_owned, dim, dim) [-]."""
    return solution.particle_mean(solution.F)


def stress(solution: Solution) -> Float:
    """Return the Cauchy stress, the mean over the points of each particle (n_owned, dim, dim) [stress]."""
    return solution.particle_mean(solution.model.cauchy_stress(solution.F))


def first_piola_stress(solution: Solution) -> Float:
    """Return P, the mean over the points of each particle (n_owned, dim, dim) [stress]."""
    return solution.particle_mean(solution.model.stress(solution.F))


def energy_density(solution: Solution) -> Float:
    """Return the strain energy density, the mean over the points of each particle (n_owned,) [energy / volume]."""
    return solution.particle_mean(solution.model.energy_density(solution.F))


def reaction(solution: Solution) -> Float:
    """Return the support forces (n_owned, dim) [force]."""
    return solution.reaction


def plastic_strain(solution: Solution) -> Float:
    """Return the accumulated plastic strain, the mean over the points of each particle (n_owned,) [-]."""
    return solution.particle_mean(solution.model.plastic_strain())
