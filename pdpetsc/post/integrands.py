"""Fields of a plane body for integrals about a crack tip: from gradient points, or from bonds."""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Sequence
from dataclasses import dataclass
from typing import cast

import numpy as np

from pdpetsc.arrays import Float, GlobalIndex, Mask
from pdpetsc.discrete.communicator import bounds
from pdpetsc.errors import CaseError
from pdpetsc.kernels.sparsity import sum_by
from pdpetsc.material.base import IsotropicMaterial
from pdpetsc.material.linear_elastic import LinearElastic
from pdpetsc.post.solution import Solution
from pdpetsc.problem.expansion import FreeDeformation
from pdpetsc.terms.bond_forces import BondForces
from pdpetsc.terms.material_points import MaterialPoints

# Step of the temperature, as a share of its range, for the derivative of the energy of a law.
LAW_STEP = 1e-4


@dataclass(frozen=True)
class Continuum:
    """The fields of owned particles for the integrals.

    Attributes
    ----------
    H : (n_owned, 2, 2) float64
        Gradient of the displacement [-].
    P : (n_owned, 2, 2) float64
        First Piola-Kirchhoff stress [stress].
    psi : (n_owned,) float64
        Energy density [energy / volume].
    momentum : (n_owned, 2, 2) float64
        ``psi I - H^T P``, the energy-momentum tensor [energy / volume].
    """

    H: Float
    P: Float
    psi: Float
    momentum: Float


class Integrands(ABC):
    """The fields of a body in one state for the integrals.

    Attributes
    ----------
    remembers : bool
        True if a material at gradient points has a history; equal on all ranks.

    Notes
    -----
    Methods are collective unless stated otherwise.
    """

    remembers = False

    def __init__(self, solution: Solution) -> None:
        self.solution = solution
        self.state = solution.state

    @abstractmethod
    def continuum(self) -> Continuum:
        """Return gradient, stress and energy-momentum tensor of the owned particles."""

    @abstractmethod
    def materials(self) -> tuple[GlobalIndex, Float]:
        """Return the material number of each owned particle, and the factor of its moduli by position [-]."""

    @abstractmethod
    def law(self, number: int, inside: Mask) -> object:
        """Return the law of a material in a part of the body (n_owned,) bool; None if it has none at small strain."""

    def elastic_law(self, number: int, inside: Mask) -> LinearElastic | None:
        """Return the isotropic linear law of a material at small strain in a part of the body; None for others."""
        law = self.law(number, inside)
        return LinearElastic(law.E, law.nu, law.plane) if isinstance(law, IsotropicMaterial) else None

    def directions(self) -> Float:
        """Return numbers (n_owned, n) that differ between particles whose laws have different axes (not collective)."""
        return np.zeros((len(self.solution.x), 0))

    def strain_of_body(self, expansion: FreeDeformation) -> Float:
        """Return the effective eigenstrain of the body (n_owned, 3, 3) [-] (not collective)."""
        return expansion.strain

    def trace(self, fields: Continuum, free: Float | None) -> Float:
        """Return the trace of the energy-momentum tensor (n_owned,); zero in a linear body without eigenstrain.

        Parameters
        ----------
        fields : Continuum
            Fields returned by ``continuum``.
        free : (n_owned, 2, 2) float64 or None
            Eigenstrain in the plane [-].
        """
        return np.asarray(np.einsum("pii->p", fields.momentum))

    @abstractmethod
    def slopes(self, values: Float) -> Float:
        """Return the slopes (n_owned, columns, dim) of numbers of the local particles (n_local, columns)."""

    @abstractmethod
    def explicit_derivative(self, moduli: Float, strain: Float | None, temperature: Float | None) -> Float:
        """Return the position derivative of the energy density at fixed F (n_owned, 2) [energy / volume / length].

        ``psi_,m = S : eps_,m + psi / c c_,m + psi_,T T_,m`` with the eigenstrain eps, the factor c of the moduli, and
        the temperature T if a law depends on it in another way. Their slopes are computed with the weights of the body,
        exact for linear fields. ``S = psi F_theta^-1 - F_e^T P``, and ``-P`` for linear bodies and bonds
        (``MaterialLaw.energy_by_strain``).

        Parameters
        ----------
        moduli : (n_local,) float64
            Factor of the moduli [-].
        strain : (n_local, 4) float64 or None
            Eigenstrain, xx, yy, xy and zz [-].
        temperature : (n_local,) float64 or None
            Temperature, if a law depends on it in another way.
        """

    @abstractmethod
    def released(self, shifts: Sequence[Float], step: float) -> Float:
        """Return the energy released at each gradient point per length of a move of the particles (n_points,).

        Parameters
        ----------
        shifts : sequence of (n_local, dim) float64
            Moves in the undeformed body, over their length [-]; released energies are summed.
        step : float
            Length of the moves forwards and backwards [length].

        Raises
        ------
        CaseError
            The body has no gradient points.
        """


class OfPoints(Integrands):
    """Integrands of a body with gradient points: fields are summed over the points of a particle."""

    def __init__(self, solution: Solution, term: MaterialPoints) -> None:
        super().__init__(solution)
        self.term = term
        self.remembers = any(material.has_history for material in term.materials)

    @property
    def share(self) -> Float:
        """Return the volume of each point over that of its particle (n_points,) [-]."""
        return self.term.operator.volume / self.solution.volume[self.term.operator.owner]

    def continuum(self) -> Continuum:
        """Return the volume-weighted means over the points of each particle."""
        operator, one, share = self.term.operator, np.eye(self.solution.problem.dim), self.share
        F, P, psi = self.term.conjugates(self.state)
        H = F - one
        tensors = [H, P, psi[:, None, None] * one - np.einsum("pki,pkj->pij", H, P)]
        H, P, momentum = (operator.sum_over_points(share[:, None, None] * T) for T in tensors)
        return Continuum(H, P, operator.sum_over_points(share * psi), momentum)

    def materials(self) -> tuple[GlobalIndex, Float]:
        """Return the number of the material at the points of each particle, and its factor."""
        numbers, factor = np.zeros(len(self.solution.x), dtype=np.int64), np.ones(len(self.solution.x))
        for number, at_points in enumerate(self.term.materials):
            of = self.term.operator.owner[at_points.points]
            numbers[of] = number
            if at_points.factor is not None:
                factor[of] = at_points.factor
        return numbers, factor

    def law(self, number: int, inside: Mask) -> object:
        """Return the law at the uniform temperature of the particles; other temperatures are refused."""
        law = self.term.materials[number].material
        expansion, temperature = self.solution.problem.body.expansion, self.state.temperature
        thermal = None if expansion is None else expansion.thermals[number]
        if thermal is None or thermal.law is None or temperature is None:
            return law
        return thermal.material_at(self.solution.largest(temperature[inside]), law)

    def directions(self) -> Float:
        """Return position-dependent constants of laws without history, as fibre directions."""
        placed = [one for one in self.term.materials if not one.has_history]
        numbers = np.zeros((len(self.solution.x), max((one.history.shape[1] for one in placed), default=0)))
        for one in placed:
            numbers[self.term.operator.owner[one.points], : one.history.shape[1]] = one.history
        return numbers

    def slopes(self, values: Float) -> Float:
        """Return the means of the slopes at the points of each particle."""
        return self.term.operator.mean_over_points(self._slopes_at_points(values), len(self.solution.x))

    def explicit_derivative(self, moduli: Float, strain: Float | None, temperature: Float | None) -> Float:
        """Return the sum over the points of each particle."""
        term, owner = self.term, self.term.operator.owner
        psi = term.conjugates(self.state)[2]
        found = (psi / moduli[owner])[:, None] * self._slopes_at_points(moduli[:, None])[:, 0]
        if strain is not None:
            S, slope = term.energy_by_strain(self.state), self._slopes_at_points(strain)
            by_strain = np.stack([S[:, 0, 0], S[:, 1, 1], S[:, 0, 1] + S[:, 1, 0], S[:, 2, 2]], axis=1)
            found += np.einsum("pc,pcm->pm", by_strain, slope)
        if temperature is not None:
            low, high = range_on_ranks(self.solution, temperature)
            step = LAW_STEP * (high - low) if high > low else 1.0
            by = term.energy_by_temperature(self.state, temperature, step)
            found += by[:, None] * self._slopes_at_points(temperature[:, None])[:, 0]
        return term.operator.sum_over_points(self.share[:, None] * found)

    def released(self, shifts: Sequence[Float], step: float) -> Float:
        """Return the difference of the energies of both moves, from the new gradients of the points."""
        operator, one = self.term.operator, np.eye(2)
        F, _, _ = self.term.conjugates(self.state)
        H, found = F - one, np.zeros(len(F))
        for shift in shifts:
            D = operator.gradient(np.ascontiguousarray(shift))
            moved = np.flatnonzero(np.abs(D).max(axis=(1, 2)) > 0.0)
            for d in (step, -step):
                by = one + d * D[moved]
                at = F.copy()
                at[moved] = one + np.einsum("pij,pjk->pik", H[moved], np.linalg.inv(by))
                volume = operator.volume.copy()
                volume[moved] *= np.linalg.det(by)
                found -= volume * self.term.energy_at(self.state, at, volume) / (2.0 * d)
        return found

    def _slopes_at_points(self, values: Float) -> Float:
        """Return the slopes (n_points, columns, dim) of numbers of the local particles (n_local, columns)."""
        dim, n = self.term.body.dim, values.shape[1]
        padded = np.zeros((len(values), -(-n // dim) * dim))
        padded[:, :n] = values
        parts = [
            self.term.operator.gradient(np.ascontiguousarray(padded[:, first : first + dim]))
            for first in range(0, padded.shape[1], dim)
        ]
        return np.concatenate(parts, axis=1)[:, :n]


class OfBonds(Integrands):
    """Integrands of a body of bonds: the gradient of best fit of each family, with its stress and energy density."""

    def __init__(self, solution: Solution, term: BondForces) -> None:
        super().__init__(solution)
        self.term = term
        self.families = solution.problem.body.families

    def continuum(self) -> Continuum:
        """Return the means of the families."""
        one = np.eye(self.solution.problem.dim)
        H, P = self.term.deformation_gradient(self.state) - one, self.term.first_piola_stress(self.state)
        psi = self.term.energy_density(self.state)
        return Continuum(H, P, psi, psi[:, None, None] * one - np.einsum("pki,pkj->pij", H, P))

    def materials(self) -> tuple[GlobalIndex, Float]:
        """Return the numbers and factors of the particles."""
        return self.term.material_of.astype(np.int64), self.term.factor

    def law(self, number: int, inside: Mask) -> object:
        """Return the equivalent solid of the bonds."""
        return self.term.materials[number].elastic(self.solution.problem.dim)

    def strain_of_body(self, expansion: FreeDeformation) -> Float:
        """Return the effective eigenstrain in the plane of the bonds."""
        strain = expansion.strain.copy()
        strain[:, :2, :2] = expansion.in_body()
        return strain

    def trace(self, fields: Continuum, free: Float | None) -> Float:
        """Return the trace from the eigenstrain in a linear body.

        The trace from bonds at a tip is only the error of their gradient of best fit.
        """
        if not self.term.linear:
            return super().trace(fields, free)
        return np.zeros(len(fields.P)) if free is None else -np.einsum("pik,pik->p", fields.P, free)

    def slopes(self, values: Float) -> Float:
        """Return the slopes of best fit of families, over remaining bonds."""
        damage = self.solution.problem.bond_damage
        return self.term.slopes(values, None if damage is None else damage.bonds.intact)

    def explicit_derivative(self, moduli: Float, strain: Float | None, temperature: Float | None) -> Float:
        """Return the sum over the bonds of each particle.

        Bonds have the energy of their elongation beyond ``|(I + eps) xi| - |xi|``, or ``n . eps xi`` at small strain.
        """
        cloud, centres, n = self.solution.cloud, self.families.centres, len(self.solution.x)
        by_moduli = (self.term.energy_density(self.state) / moduli[:n])[:, None] * self.slopes(moduli[:, None])[:, 0]
        expansion = self.state.expansion
        if strain is None or expansion is None:
            return np.asarray(by_moduli)
        along = xi = self.families.bonds(cloud.x)
        if self.term.finite:
            along = xi + np.einsum("bij,bj->bi", expansion.in_body()[centres], xi)
        direction = along / np.linalg.norm(along, axis=1)[:, None]
        moment = sum_by(centres, np.einsum("b,bi,bj->bij", self.term.tension(self.state), direction, xi), n)
        moment /= cloud.volume[:n, None, None]
        shear = moment[:, 0, 1] + moment[:, 1, 0]
        by_strain = np.stack([moment[:, 0, 0], moment[:, 1, 1], shear, np.zeros(n)], axis=1)
        return np.asarray(by_moduli - np.einsum("pc,pcm->pm", by_strain, self.slopes(strain)))

    def released(self, shifts: Sequence[Float], step: float) -> Float:
        """Refuse: bonds have no gradient points."""
        raise CaseError("An EnergyReleaseRate moves gradient points, and a body of bonds has none; take a JIntegral.")


def integrands_of(solution: Solution) -> Integrands:
    """Return the integrands of the body of a solution (not collective)."""
    term = solution.problem.material_term
    return OfPoints(solution, term) if isinstance(term, MaterialPoints) else OfBonds(solution, cast(BondForces, term))


def range_on_ranks(solution: Solution, values: Float) -> tuple[float, float]:
    """Return the smallest and the largest of numbers on all ranks (collective)."""
    low, high = bounds(solution.cloud.comm, values)
    return float(low), float(high)
