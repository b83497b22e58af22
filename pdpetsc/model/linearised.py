"""Tangents of bodies at one displacement, applied to others without a matrix."""

from __future__ import annotations

from abc import ABC, abstractmethod
from typing import TYPE_CHECKING

import numpy as np

from pdpetsc.arrays import Float, LocalIndex
from pdpetsc.kernels.tangent import (
    bond_moduli_kernel,
    bond_times_kernel,
    gradient_times_kernel,
    outer_times_kernel,
)

if TYPE_CHECKING:
    from pdpetsc.model.base import Model
    from pdpetsc.model.bonds import BondModel
    from pdpetsc.model.correspondence import CorrespondenceModel
    from pdpetsc.model.damaged import DamagedCorrespondenceModel

# In place of stiffness and shape tensors of a control that does not share the pass.
NOTHING = np.empty(0), np.empty((0, 0, 0))


class Linearised(ABC):
    """The tangent ``K(u)`` of a body.

    Notes
    -----
    Construction and application are collective.
    """

    model: Model

    def __call__(self, du: Float) -> Float:
        """Return ``K du`` (n_rows, dim) [force]; the next call may overwrite it."""
        return self.model.spread(du, self.forces)

    @abstractmethod
    def forces(self, du: Float, f: Float, particles: LocalIndex) -> None:
        """Add the forces of the families of some own particles (not collective): all arrays (n_local, dim)."""

    @abstractmethod
    def stiffness(self) -> Float:
        """Return ``sum_p W_p dP/dF`` of every own particle (n_owned, dim, dim, dim, dim) [energy] (not collective)."""

    def strength(self) -> Float:
        """Return the trace of ``stiffness`` (n_owned,) [energy] (not collective)."""
        return np.asarray(np.einsum("pikik->p", self.stiffness()))


class GradientTangent(Linearised):
    """``G^T (W A) G`` and the zero-energy control."""

    model: CorrespondenceModel

    def __init__(
        self, model: CorrespondenceModel, A: Float, h: Float, shared: tuple[Float, Float] | None = None
    ) -> None:
        # Moduli and force weights; ``shared`` is a control that takes the same pass.
        self.model = model
        self._control = model.control
        self._A, self._h, self._shared = A, h, shared

    def forces(self, du: Float, f: Float, particles: LocalIndex) -> None:
        """Add those of moduli and control, in one pass where they share the gradient."""
        operator, control = self.model.operator, self._control
        gradient_times_kernel(self.model.dim, int(self._shared is not None))(
            particles, operator.points_of, operator.point_ptr, operator.members, operator.g, self._h, operator.volume,
            self._A, *(self._shared or NOTHING), du, f,
        )  # fmt: skip
        if control is not None and self._shared is None:
            control.force(du, f, particles)

    def stiffness(self) -> Float:
        """Return the sum over the points of each particle."""
        operator = self.model.operator
        return operator.sum_over_points(operator.volume[:, None, None, None, None] * self._A)

    def strength(self) -> Float:
        """Return the trace of ``stiffness`` without forming it."""
        operator = self.model.operator
        return operator.sum_over_points(operator.volume * np.einsum("pikik->p", self._A))


class DamagedTangent(GradientTangent):
    """``H^T (W A) G + d(H^T)/du (W P)`` and the control: forces fade with the stretch of each bond."""

    model: DamagedCorrespondenceModel

    def __init__(self, model: DamagedCorrespondenceModel, u: Float) -> None:
        u_local = model.with_ghosts(u)
        F = model.deformation(u_local)
        self._T, slope = model.failure.at(model.elongation(u_local))
        super().__init__(model, model.moduli(F), model.scaled_weights(self._T))
        self._control = model.control_at(self._T)
        self._ptr = None
        if model.failure.softens:
            bonds, self._v, self._w = model.softening(u_local, F, slope)
            self._neighbours = model.families.neighbours[bonds]
            self._ptr = np.searchsorted(bonds, model.families.indptr)

    def forces(self, du: Float, f: Float, particles: LocalIndex) -> None:
        """Add those of moduli and control, and of the bonds whose integrity falls."""
        super().forces(du, f, particles)
        if self._ptr is not None:
            kernel = outer_times_kernel(self.model.dim)
            kernel(particles, self._ptr, self._neighbours, self._v, self._w, du, f)

    def stiffness(self) -> Float:
        """Return the sum over the points of each particle, times the mean integrity of its bonds."""
        centres, n = self.model.families.centres, self.model.cloud.n_owned
        intact = self.model.failure.intact
        left = np.bincount(centres, self._T, n) / np.maximum(np.bincount(centres, intact, n), 1)
        return np.asarray(super().stiffness() * left[:, None, None, None, None])


class BondTangent(Linearised):
    """Stiffness along bonds, tension that turns with them, and dilatation."""

    model: BondModel

    def __init__(self, model: BondModel, u: Float) -> None:
        self.model = model
        self._u = model.with_ghosts(u).copy()
        e = model.elongation(self._u)
        none = np.empty(0)
        a, B = (none, none) if model.a is None or model.B is None else (model.a, model.B)
        self._data = model.families.indptr, model.families.neighbours, model.cloud.x, self._u
        self._state = model.tangent(e), model.tension(e), a, B
        self._secant = model.secant(e)

    def forces(self, du: Float, f: Float, particles: LocalIndex) -> None:
        """Add those of all bonds of the particles."""
        bond_times_kernel(self.model.dim, self.model.finite)(particles, *self._data, *self._state, du, f)

    def stiffness(self) -> Float:
        """Return the derivative of ``sum_j t_ij n_ij (x) xi_ij`` by the deformation gradient of each family.

        Bonds that soften count with their secant, which is not negative.
        """
        D = np.empty((self.model.cloud.n_owned, *(self.model.dim,) * 4))
        bond_moduli_kernel(self.model.dim, self.model.finite)(*self._data, self._secant, *self._state[1:], D)
        return D
