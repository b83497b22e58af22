"""Materials at the gradient points that they apply to."""

from __future__ import annotations

from abc import ABC, abstractmethod

import numpy as np

from pdpetsc.arrays import Float, GlobalIndex
from pdpetsc.errors import CaseError
from pdpetsc.material.base import ElasticMaterial, HistoryKernels, HistoryMaterial, Material, PointKernels


class MaterialAtPoints(ABC):
    """A material and the gradient points that it applies to.

    Parameters
    ----------
    material : Material
        The law.
    kernels
        Its compiled loops.
    points : int64
        Numbers of its gradient points on this rank.
    dim : int
        Dimension of the body.
    factor : (n_points,) float64 or None
        What multiplies its moduli at each of these points [-], where it is graded.
    history : (n_points, n_history) float64, optional
        State of the last converged step, which its loops read besides the constants.
    """

    def __init__(
        self, material: Material, kernels: PointKernels | HistoryKernels, points: GlobalIndex, dim: int,
        factor: Float | None, *history: Float,
    ) -> None:  # fmt: skip
        self.material = material
        self.points = points
        self.dim = dim
        self.factor = factor
        self._kernels = kernels
        # What every loop reads: constants, and the history where there is one.
        self._inputs = (material.constants(dim), *history)

    def stress(self, F: Float, P: Float) -> None:
        """Write P (all points, dim, dim) at its points."""
        self._kernels.stress(F, self.points, *self._inputs, P)
        self._scale(P)

    def tangent(self, F: Float, A: Float) -> None:
        """Write A (all points, dim, dim, dim, dim) at its points."""
        self._kernels.tangent(F, self.points, *self._inputs, A)
        self._scale(A)

    def energy(self, F: Float, psi: Float) -> None:
        """Write the energy density (all points,) at its points."""
        self._kernels.energy(F, self.points, *self._inputs, psi)
        self._scale(psi)

    def out_of_plane_stress(self, F: Float) -> Float:
        """Return ``P_zz`` at its points (n,) [stress] where F (n, dim, dim) are theirs; 0 except in plane strain."""
        if self.dim != 2 or self.material.plane == "stress":
            return np.zeros(len(F))
        return self._out_of_plane_stress(F) * (1.0 if self.factor is None else self.factor)

    @abstractmethod
    def _out_of_plane_stress(self, F: Float) -> Float:
        """Return ``P_zz`` in plane strain without the factor (n,) [stress]."""

    @abstractmethod
    def commit(self, F: Float) -> None:
        """Take F as the converged state that the next step starts from."""

    @abstractmethod
    def plastic_strain(self) -> Float:
        """Return the accumulated plastic strain at its points (n,) [-]."""

    @property
    @abstractmethod
    def has_history(self) -> bool:
        """Return whether its stress depends on converged steps."""

    @property
    def history(self) -> Float:
        """Return its state of the last converged step (n, n_history); no columns where it has no history."""
        return np.empty((len(self.points), 0))

    def largest_modulus(self) -> float:
        """Return the largest entry of its small-strain stiffness [stress], 0 where it has no points here."""
        if len(self.points) == 0:
            return 0.0
        lam, mu = self.material.lame(self.dim)
        return (lam + 2.0 * mu) * (1.0 if self.factor is None else float(self.factor.max()))

    def _scale(self, values: Float) -> None:
        if self.factor is not None:
            values[self.points] *= self.factor.reshape(-1, *(1,) * (values.ndim - 1))


class ElasticAtPoints(MaterialAtPoints):
    """An elastic material at its points."""

    def __init__(self, material: ElasticMaterial, points: GlobalIndex, dim: int, factor: Float | None) -> None:
        super().__init__(material, material.kernels(dim), points, dim, factor)
        self._out_of_plane = material.out_of_plane_stress

    def _out_of_plane_stress(self, F: Float) -> Float:
        return self._out_of_plane(F)

    def commit(self, F: Float) -> None:
        """Do nothing: the stress depends on F alone."""

    def plastic_strain(self) -> Float:
        """Return zeros."""
        return np.zeros(len(self.points))

    @property
    def has_history(self) -> bool:
        """Return False."""
        return False


class HistoryAtPoints(MaterialAtPoints):
    """A material with history at its points."""

    def __init__(self, material: HistoryMaterial, points: GlobalIndex, dim: int, factor: Float | None) -> None:
        self._history: Float = material.initial_history(dim, len(points))
        kernels = material.history_kernels(dim)
        super().__init__(material, kernels, points, dim, factor, self._history)
        self._commit = kernels.commit
        self._plastic_strain = material.plastic_strain
        self._out_of_plane = material.out_of_plane_stress

    @property
    def history(self) -> Float:
        """Return its state of the last converged step (n, n_history), to be overwritten in place."""
        return self._history

    def _out_of_plane_stress(self, F: Float) -> Float:
        return self._out_of_plane(F, self._history)

    def commit(self, F: Float) -> None:
        """Make the state at F the one that the next step starts from."""
        self._commit(F, self.points, *self._inputs)

    def plastic_strain(self) -> Float:
        """Return the accumulated plastic strain at its points (n,) [-]."""
        return self._plastic_strain(self._history)

    @property
    def has_history(self) -> bool:
        """Return True."""
        return True


def make_at_points(material: Material, points: GlobalIndex, dim: int, factor: Float | None) -> MaterialAtPoints:
    """Return the law of a material at its points."""
    if isinstance(material, ElasticMaterial):
        return ElasticAtPoints(material, points, dim, factor)
    if isinstance(material, HistoryMaterial):
        return HistoryAtPoints(material, points, dim, factor)
    raise CaseError(f"{type(material).__name__} is neither an elastic material nor one with history.")
