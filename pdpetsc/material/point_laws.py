"""The laws of all gradient points of a body at one state."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from pdpetsc.arrays import Float, Mask
from pdpetsc.material.at_points import MaterialLaw


class PointLaws:
    """Stress, tangent and energy of all points as functions of F (n_points, dim, dim).

    Parameters
    ----------
    materials : sequence of MaterialLaw
        The laws, at the load parameter and temperature of a state, with their points.
    dim : int
        Dimension of the body.
    """

    def __init__(self, materials: Sequence[MaterialLaw], dim: int) -> None:
        self.materials = list(materials)
        self.dim = dim

    def stress(self, F: Float, only: Mask | None = None) -> Float:
        """Return ``P_p`` (n_points, dim, dim) [stress]; values at points outside ``only`` are undefined."""
        P = _room(only, F.shape)
        for law in self.materials:
            law.stress(F, P, only)
        return P

    def moduli(self, F: Float, only: Mask | None = None) -> Float:
        """Return ``A_p = dP/dF`` (n_points, dim, dim, dim, dim) [stress], likewise."""
        A = _room(only, (len(F), *(self.dim,) * 4))
        for law in self.materials:
            law.tangent(F, A, only)
        return A

    def energy(self, F: Float, only: Mask | None = None) -> Float:
        """Return ``psi_p`` (n_points,) [energy / volume], likewise."""
        psi = _room(only, (len(F),))
        for law in self.materials:
            law.energy(F, psi, only)
        return psi

    def energy_by_strain(self, F: Float) -> Float:
        """Return the derivative of ``psi_p`` by the eigenstrain at constant F (n_points, 3, 3)."""
        S = np.zeros((len(F), 3, 3))
        for law in self.materials:
            S[law.points] = law.energy_by_strain(F[law.points])
        return S

    def energy_by_temperature(self, F: Float, temperature: Float, step: float) -> Float:
        """Return the derivative of ``psi_p`` by the temperature (n_points,) of the laws, by differences of ``step``."""
        by = np.zeros(len(F))
        for law in self.materials:
            by[law.points] = law.energy_by_temperature(F[law.points], temperature[law.points], step)
        return by

    def cauchy(self, F: Float) -> Float:
        """Return ``sigma_p = P F^T / J`` (n_points, dim, dim) [stress], J with the hidden stretches; P if linear."""
        return self.cauchy_of(self.stress(F), F)

    def cauchy_of(self, P: Float, F: Float) -> Float:
        """Return the Cauchy stress (n_points, dim, dim) [stress] of P at F, both (n_points, dim, dim)."""
        sigma = P.copy()
        for law in self.materials:
            if not law.material.small_strain and len(law.points):
                part = F[law.points]
                J = np.linalg.det(part) * law.hidden_stretch(part)
                sigma[law.points] = np.einsum("pik,pjk->pij", sigma[law.points], part) / J[:, None, None]
        return sigma

    def out_of_plane(self, F: Float) -> tuple[Float, Float, Float]:
        """Return stretch, P and Cauchy stress in one hidden direction of a bar or plane body (n_points,)."""
        stretch, P, sigma = np.ones(len(F)), np.zeros(len(F)), np.zeros(len(F))
        for law in self.materials:
            part, linear = F[law.points], law.material.small_strain
            across = law.hidden_stretch(part)
            if self.dim > 1:
                stretch[law.points] = across
            else:  # product of two equal stretches, to first order 1 plus the sum of their strains
                stretch[law.points] = 1.0 + 0.5 * (across - 1.0) if linear else np.sqrt(across)
            P[law.points] = law.out_of_plane_stress(part)
            current = 1.0 if linear else stretch[law.points] / (np.linalg.det(part) * across)
            sigma[law.points] = P[law.points] * current
        return stretch, P, sigma

    def defined(self, F: Float, lost: Mask | None = None) -> bool:
        """Return True if all laws have a stress, ignoring lost points (n_points,)."""
        return all(law.defined(F, lost) for law in self.materials)

    def plastic_growth(self, F: Float) -> Float:
        """Return the growth of the accumulated plastic strain (n_points,) [-] if the step ends at F."""
        growth = np.zeros(len(F))
        for law in self.materials:
            growth[law.points] = law.plastic_growth(F)
        return growth

    def commit(self, F: Float) -> None:
        """Commit the state at F as the start of the next step."""
        for law in self.materials:
            law.commit(F)


def _room(only: Mask | None, shape: tuple[int, ...]) -> Float:
    """Return an array for results, zeros if only some points are computed."""
    return np.empty(shape) if only is None else np.zeros(shape)
