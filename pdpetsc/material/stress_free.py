"""Maps between deformation gradients with a stress-free part and material laws."""

from __future__ import annotations

import numpy as np

from pdpetsc.arrays import Float, GlobalIndex
from pdpetsc.kernels.expanded import pull_back_kernel, pull_back_stress_kernel


class Unexpanded:
    """Map without stress-free deformation: laws read F and write their results in place.

    Parameters
    ----------
    points : (n,) int64
        Gradient points of the material.
    dim : int
        Dimension of the body.
    multiplier : (n,) float64 or None
        Factor of the moduli [-].
    """

    expands = False

    def __init__(self, points: GlobalIndex, dim: int, multiplier: Float | None) -> None:
        self.points, self.dim, self.multiplier = points, dim, multiplier

    def elastic(self, F: Float) -> tuple[Float, GlobalIndex]:
        """Return the deformation gradients for the laws, from F of all points, and the rows of the points in them."""
        return F, self.points

    def elastic_part(self, F: Float) -> Float:
        """Return the elastic part (n, inside, inside) of F (n, dim, dim) at the points of the material."""
        return F

    def room(self, result: Float) -> Float:
        """Return the array to which laws write, for a result of all points."""
        return result

    def stress(self, elastic: Float, P: Float) -> None:
        """Write P of all points from the stress of the law."""
        self._scale(P)

    def tangent(self, elastic: Float, A: Float) -> None:
        """Write ``dP/dF`` of all points from the tangent of the law."""
        self._scale(A)

    def energy(self, elastic: Float, psi: Float) -> None:
        """Write the energy density of all points from that of the law."""
        self._scale(psi)

    def hidden(self, elastic: Float) -> Float:
        """Return the product of hidden stretches from their elastic part (n,) [-]."""
        return elastic

    def times(self, values: Float) -> Float:
        """Return values of the points times the factor of the moduli."""
        if self.multiplier is None:
            return values
        return np.asarray(values * self.multiplier.reshape(-1, *(1,) * (values.ndim - 1)))

    def _scale(self, values: Float) -> None:
        if self.multiplier is not None:
            values[self.points] = self.times(values[self.points])


class StressFreeStrain(Unexpanded):
    """Eigenstrain of linear laws, ``P = P_e(F - eps)``.

    A body in plane strain is treated as a solid with ``F_zz = 1``: its elastic part has an out-of-plane strain.

    Parameters
    ----------
    points, dim, multiplier
        As for ``Unexpanded``.
    inside : int
        Dimension of the law.
    strain : (n, 3, 3) float64
        ``eps`` at the points of the material [-].
    """

    expands = True

    def __init__(
        self, points: GlobalIndex, dim: int, multiplier: Float | None, inside: int, strain: Float
    ) -> None:  # fmt: skip
        super().__init__(points, dim, multiplier)
        self.inside = inside
        self._rows = np.arange(len(points))
        self._strain = np.ascontiguousarray(strain[:, :inside, :inside])
        # Stretches of the hidden directions.
        self._across = 1.0 + strain[:, range(dim, 3), range(dim, 3)]
        self.stretch = np.eye(dim)[None]

    def elastic(self, F: Float) -> tuple[Float, GlobalIndex]:
        """Return the elastic part of F at the points of the material."""
        return self.elastic_part(F[self.points]), self._rows

    def elastic_part(self, F: Float) -> Float:
        """Return ``F - eps``."""
        return np.ascontiguousarray(self._of_solid(F) - self._strain)

    def room(self, result: Float) -> Float:
        """Return an array for the points of the material."""
        return np.empty((len(self.points), *(self.inside,) * (result.ndim - 1)))

    def stress(self, elastic: Float, P: Float) -> None:
        P[self.points] = self.first_piola(elastic)[:, : self.dim, : self.dim]

    def tangent(self, elastic: Float, A: Float) -> None:
        """Write ``dP/dF`` of all points."""
        d = self.dim
        A[self.points] = self.times(elastic[:, :d, :d, :d, :d])

    def energy(self, elastic: Float, psi: Float) -> None:
        """Write the energy per undeformed volume of all points."""
        psi[self.points] = self.energy_density(elastic)

    def first_piola(self, elastic: Float) -> Float:
        """Return P (n, inside, inside) from the stress of the law."""
        return self.times(elastic)

    def energy_density(self, elastic: Float) -> Float:
        """Return the energy per undeformed volume (n,) from that of the law."""
        return self.times(elastic)

    def hidden(self, elastic: Float) -> Float:
        """Return the product of hidden stretches to first order."""
        return np.asarray(elastic + (self._across - 1.0).sum(axis=1))

    def energy_by_strain(self, F_e: Float, P: Float, psi: Float) -> Float:
        """Return the derivative of the energy density by eps at constant F (n, 3, 3) [stress]: ``-P``.

        Parameters
        ----------
        F_e, P : (n, inside, inside) float64
            Elastic part of F [-] and stress.
        psi : (n,) float64
            Energy density.
        """
        S = np.zeros((len(P), 3, 3))
        S[:, : self.inside, : self.inside] = -P
        return S

    def _of_solid(self, F: Float) -> Float:
        """Return F with ``F_zz = 1`` if the law is that of a solid and the body is plane."""
        if self.inside == self.dim:
            return F
        solid = np.zeros((len(F), 3, 3))
        solid[:, :2, :2] = F
        solid[:, 2, 2] = 1.0
        return solid


class StressFreeStretch(StressFreeStrain):
    """A stress-free deformation ``F_theta = I + eps`` of laws of finite strain, ``F_e = F F_theta^-1``.

    ``P = J_theta P_e(F_e) F_theta^-T``, ``A_imkn = J_theta (A_e)_iakb (F_theta^-1)_ma (F_theta^-1)_nb``, and the energy
    per undeformed volume is ``J_theta psi_e(F_e)``. ``J_theta`` is the determinant in 3D: hidden directions expand as
    well.
    """

    def __init__(
        self, points: GlobalIndex, dim: int, multiplier: Float | None, inside: int, strain: Float
    ) -> None:  # fmt: skip
        super().__init__(points, dim, multiplier, inside, strain)
        stretch = np.eye(3) + strain
        self._inverse = np.linalg.inv(stretch[:, :inside, :inside])
        self._J = np.linalg.det(stretch)
        self.stretch = stretch[:, :dim, :dim]

    def elastic_part(self, F: Float) -> Float:
        """Return ``F F_theta^-1``."""
        return np.ascontiguousarray(self._of_solid(F) @ self._inverse)

    def first_piola(self, elastic: Float) -> Float:
        """Return P (n, inside, inside) from the stress of the law."""
        P = np.empty_like(elastic)
        pull_back_stress_kernel(self.inside)(elastic, self._inverse, self.times(self._J), P)
        return P

    def tangent(self, elastic: Float, A: Float) -> None:
        """Write ``dP/dF`` of all points."""
        pull_back_kernel(self.inside, self.dim)(elastic, self._inverse, self.times(self._J), self.points, A)

    def energy_density(self, elastic: Float) -> Float:
        """Return the energy per undeformed volume (n,) from that of the law."""
        return self.times(self._J * elastic)

    def hidden(self, elastic: Float) -> Float:
        """Return the product of hidden stretches."""
        return np.asarray(elastic * self._across.prod(axis=1))

    def energy_by_strain(self, F_e: Float, P: Float, psi: Float) -> Float:
        """Return the derivative of the energy density by eps at constant F (n, 3, 3) [stress].

        ``S = psi F_theta^-1 - F_e^T P``; in the hidden directions of plane stress and of a bar only the first term.
        """
        inside, S = self.inside, np.zeros((len(P), 3, 3))
        S[:, :inside, :inside] = psi[:, None, None] * self._inverse - np.einsum("pki,pkj->pij", F_e, P)
        for axis in range(inside, 3):
            S[:, axis, axis] = psi / self._across[:, axis - self.dim]
        return S
