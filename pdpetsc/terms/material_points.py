"""Correspondence: materials at gradient points."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from functools import cached_property

import numpy as np

from pdpetsc.arrays import Float, GlobalIndex, LocalIndex, Mask
from pdpetsc.control.tangent_scaled import tangent_share
from pdpetsc.discrete.communicator import agreed
from pdpetsc.discrete.sparsity import sharing_stencil
from pdpetsc.gradient.base import ControlledGradient, GradientOperator, Moduli
from pdpetsc.gradient.products import PointProduct, Product
from pdpetsc.kernels.gradient import determinant_kernel
from pdpetsc.material.at_points import MaterialAtPoints
from pdpetsc.material.base import Material
from pdpetsc.material.expanded import ExpandedAtPoints
from pdpetsc.problem.body import Body
from pdpetsc.problem.material_term import MaterialTerm
from pdpetsc.problem.state import State
from pdpetsc.problem.term import KeptArray, Term


class MaterialPoints(MaterialTerm):
    """Internal forces ``f = G^T (W P)`` with the tangent ``K = G^T (W A) G``.

    Parameters
    ----------
    body : Body
        Particles and bonds.
    operator : GradientOperator
        Gradients, with the weights that forces have too.
    materials : sequence of Material
        Materials of the body.
    material_of : (n_owned,) int
        Index into ``materials`` of each own particle.
    factor : (n_owned,) float64, optional
        What multiplies the moduli of each own particle [-].

    Notes
    -----
    Construction is collective.
    """

    def __init__(
        self,
        body: Body,
        operator: GradientOperator,
        materials: Sequence[Material],
        material_of: LocalIndex,
        factor: Float | None = None,
    ) -> None:
        super().__init__(body)
        self.operator = operator
        self.note = self.operator.note
        number_of = material_of[self.operator.owner]
        self.materials: list[MaterialAtPoints] = []
        for number, material in enumerate(materials):
            points = np.flatnonzero(number_of == number)
            of = self.operator.owner[points]
            factors = None if factor is None else factor[of]
            with agreed(body.cloud.comm):  # a function of place may fail on one rank
                self.materials.append(MaterialAtPoints(material, points, body.dim, factors, body.cloud.x[of]))
        self._linear = all(material.linear for material in materials)
        self._expanded: tuple[Float, GradientOperator] | None = None

    @property
    def linear(self) -> bool:  # type: ignore[override]
        """Return whether all materials are linear."""
        return self._linear and (self.body.expansion is None or not self.body.expansion.softens)

    def expand(self) -> None:
        """Let the materials see what is left of F when the stress-free deformation is taken off (collective)."""
        x, owner, expansion = self.body.cloud.x, self.operator.owner, self.body.expansion
        assert expansion is not None
        thermals = expansion.thermals or [None] * len(self.materials)
        with agreed(self.body.cloud.comm):
            self.materials = [
                ExpandedAtPoints(one.material, one.points, self.body.dim, one.factor, x[owner[one.points]], thermal)
                for one, thermal in zip(self.materials, thermals, strict=True)
            ]

    def _at_time(self, t: float) -> None:
        """Give the points their stress-free deformation at a step time (collective)."""
        expansion = self.body.expansion
        if expansion is None:
            return
        strain, factor, operator = expansion.strain(t), expansion.factor(t), self.operator
        if self._expanded is not None and self._expanded[0] is strain and self._expanded[1] is operator:
            return
        temperature = expansion.temperature(t)
        with agreed(self.body.cloud.comm):
            for one in self.materials:
                assert isinstance(one, ExpandedAtPoints)
                of = operator.owner[one.points]
                besides = [None if values is None else values[of] for values in (factor, temperature)]
                one.expand(strain[of], *besides)
        self._expanded = strain, operator

    @property
    def symmetric(self) -> bool:  # type: ignore[override]
        """Return whether the tangents of all materials are symmetric."""
        return all(at_points.material.symmetric for at_points in self.materials)

    @property
    def timed(self) -> bool:  # type: ignore[override]
        """Return whether a material depends on time."""
        return any(at_points.material.timed for at_points in self.materials)

    @property
    def n_points(self) -> int:
        """Return the gradient points of this rank."""
        return self.operator.n_points

    @property
    def parts(self) -> list[str]:
        """Return what it is made of."""
        return ["gradient operator", *(f"material {type(at_points.material).__name__}" for at_points in self.materials)]

    @property
    def stencils(self) -> tuple[GlobalIndex, LocalIndex] | None:
        """Return those of the operator."""
        return self.operator.point_ptr, self.operator.members

    def deformation(self, state: State) -> Float:
        """Return ``F_p`` (n_points, dim, dim) [-]; the materials are then those of the step time of the state."""
        u_local, operator = state.u_local, self.operator
        self._at_time(state.t)  # may make other laws, of other temperatures
        for at_points in self.materials:
            at_points.at_time(state.t)

        def make() -> Float:
            F = operator.gradient(u_local)
            F += np.eye(self.body.dim)
            return F

        # The operator is kept too: while it lives no other object can have its id.
        return state.kept(("F", id(operator)), lambda: (operator, make()))[1]

    def strained(self, state: State) -> tuple[Float, Float | None]:
        """Return what is left of F without the stress-free deformation, and that deformation (n_points, dim, dim) [-].

        ``F F_theta^-1`` and ``F_theta``; None where a body does not expand. Points of linear materials have ``F - eps``
        and 1.
        """
        F, expansion, dim = self.deformation(state), self.body.expansion, self.body.dim
        if expansion is None:
            return F, None
        strain = expansion.strain(state.t)[self.operator.owner, :dim, :dim]
        left, free = np.empty_like(F), np.tile(np.eye(dim), (len(F), 1, 1))
        for one in self.materials:
            at = one.points
            if one.material.linear:
                left[at] = F[at] - strain[at]
                continue
            free[at] += strain[at]
            left[at] = F[at] @ np.linalg.inv(free[at])
        return left, free

    def admissible(self, state: State) -> bool:
        """Return whether this rank's materials are defined: ``det F > 0`` unless all are linear."""
        F = self.deformation(state)
        if self._linear:
            return True
        if not determinant_kernel(self.body.dim)(F) > 0.0:
            return False
        return all(one.defined(F, self._without) for one in self.materials)

    @property
    def _without(self) -> Mask | None:
        """Return which points have no gradient any more, and so no stress to be defined (n_points,); None for none."""
        return None

    def stress(self, F: Float) -> Float:
        """Return ``P_p`` (n_points, dim, dim) [stress]."""
        P = np.empty_like(F)
        for at_points in self.materials:
            at_points.stress(F, P)
        return P

    def moduli(self, F: Float) -> Float:
        """Return ``A_p = dP/dF`` (n_points, dim, dim, dim, dim) [stress]."""
        A = np.empty((len(F), *(self.body.dim,) * 4))
        for at_points in self.materials:
            at_points.tangent(F, A)
        return A

    def moduli_sets(self, F: Float) -> Moduli:
        """Return the moduli, kept once for each material where they are the same at all its points."""
        found = [at_points.same_tangent(F) for at_points in self.materials if len(at_points.points)]
        if not found or any(A is None for A in found):
            return Moduli(self.moduli(F))
        of = np.empty(len(F), dtype=np.int32)
        for number, at_points in enumerate(one for one in self.materials if len(one.points)):
            of[at_points.points] = number
        return Moduli(np.array(found), of)

    def point_energy(self, F: Float) -> Float:
        """Return ``psi_p`` (n_points,) [energy / volume]."""
        psi = np.empty(len(F))
        for at_points in self.materials:
            at_points.energy(F, psi)
        return psi

    def conjugates(self, state: State) -> tuple[Float, Float, Float]:
        """Return F, the stress that forces have (n_points, dim, dim) and the energy density (n_points,) of the points.

        The stress is the derivative of the energy by F.
        """
        F = self.deformation(state)
        return F, self.stress(F), self.point_energy(F)

    def stress_by_temperature(self, state: State) -> Float:
        """Return the derivative of the stress of the points by their temperature (n_points, dim, dim) (collective)."""
        F, expansion, owner = self.deformation(state), self.body.expansion, self.operator.owner
        assert expansion is not None
        strain, factor, step = expansion.by_temperature(state.t)
        temperature, found = expansion.temperature(state.t), np.zeros_like(F)
        with agreed(self.body.cloud.comm):
            for one in self.materials:
                assert isinstance(one, ExpandedAtPoints)
                at = owner[one.points]
                T = None if temperature is None else temperature[at]
                found[one.points] = one.stress_along(F[one.points], strain[at], factor[at], T, step)
        return found

    def energy_at(self, F: Float, volume: Float) -> Float:
        """Return the energy density of all points (n_points,) at gradients F and volumes (n_points,) of one's own."""
        return self.point_energy(F)

    def add_force(self, state: State, f: Float) -> None:
        """Add ``G^T (W P)``."""
        self.operator.divergence(self.stress(self.deformation(state)), f)

    def add_force_together(self, other: Term, state: State, f: Float) -> bool:
        """Add the forces of a control on the same gradient in the same loop."""
        control = other.control_of(self.operator, state)
        if control is None or not self.operator.adds_together(control):
            return False
        F = self.deformation(state)
        same = ControlledGradient(control, F - np.eye(self.body.dim), state.u_local)
        self.operator.divergence(self.stress(F), f, same)
        return True

    def linearise(self, state: State) -> list[Product]:
        """Return ``G^T W A G`` with the moduli A at a state."""
        return [PointProduct(self.operator, self.moduli_sets(self.deformation(state)))]

    def tangent_share(self, state: State) -> Float:
        """Return what is left of the elastic modulus of the own particles (n_owned,) [-] (``control.tangent_share``).

        Elastic materials have all of it (not collective).
        """
        F = self.deformation(state)
        P, A, share = self.stress(F), self.moduli(F), np.ones(len(F))
        for one in self.materials:
            if one.has_history and len(one.points):
                share[one.points] = tangent_share(*one.elastic_response(F, P, A))
        return self._mean(share)

    def uniform_stress_force(self, P: Float) -> Float:
        """Return ``G^T (W P)`` (n_rows, dim) [force] for stresses (n_owned, dim, dim) of the particles."""
        f = np.zeros((self.body.cloud.n_local, self.body.dim))
        self._intact_operator.divergence(P[self._intact_operator.owner], f)
        return self.body.gather(f)

    @cached_property
    def _intact_operator(self) -> GradientOperator:
        """Return the operator as it was when a load first asked: a dead load does not change when bonds break."""
        return self.operator

    def energy(self, state: State) -> float:
        """Return ``sum_p W_p psi_p``."""
        return float(self.operator.volume @ self.point_energy(self.deformation(state)))

    def commit(self, state: State) -> None:
        """Let materials with history remember a converged state."""
        if self.has_history:
            F = self.deformation(state)
            for at_points in self.materials:
                at_points.commit(F)
            self.version += 1

    def plastic_growth(self, state: State) -> float:
        """Return how much plastic strain grows at most on this rank if the step ends at a state [-]."""
        F, grown = self.deformation(state), np.zeros(self.operator.n_points)
        for at_points in self.materials:
            grown[at_points.points] = at_points.plastic_growth(F)
        return self._most_growth(grown)

    def _most_growth(self, grown: Float) -> float:
        """Return the largest of what plastic strain at the points grows by (n_points,) [-]."""
        return float(grown.max(initial=0.0))

    @property
    def has_history(self) -> bool:
        """Return whether stresses depend on converged steps; the same on all ranks."""
        return any(at_points.has_history for at_points in self.materials)

    def arrays(self) -> Mapping[str, KeptArray]:
        """Return the histories of the materials that have one, by the number of the material."""
        owner = self.operator.owner
        return {
            f"history_{number}": KeptArray(owner[at_points.points], at_points.history)
            for number, at_points in enumerate(self.materials)
            if at_points.has_history
        }

    @property
    def kappa(self) -> float:
        """Return the largest ``lambda + 2 mu / dim`` of the materials [stress]."""
        return max(at_points.material.bulk_like_modulus(self.body.dim) for at_points in self.materials)

    @property
    def largest_modulus(self) -> float:
        """Return the largest entry of the small-strain stiffness on this rank [stress]."""
        return max(at_points.largest_modulus() for at_points in self.materials)

    def dependents(self, marked: Float) -> Mask:
        """Return the own particles that share a gradient point with a marked local one (collective)."""
        return sharing_stencil(self.body.cloud, self.operator.point_ptr, self.operator.members, marked)

    def cauchy(self, F: Float) -> Float:
        """Return ``sigma_p = P F^T / J`` (n_points, dim, dim) [stress], J with the hidden stretches; P where linear."""
        sigma = self.stress(F)
        for at_points in self.materials:
            if not at_points.material.linear and len(at_points.points):
                part = F[at_points.points]
                J = np.linalg.det(part) * at_points.hidden_stretch(part)
                sigma[at_points.points] = np.einsum("pik,pjk->pij", sigma[at_points.points], part) / J[:, None, None]
        return sigma

    def deformation_gradient(self, state: State) -> Float:
        """Return the mean of F over the points of each own particle (n_owned, dim, dim) [-]."""
        return self._mean(self.deformation(state))

    def first_piola_stress(self, state: State) -> Float:
        """Return the mean of P over the points of each own particle (n_owned, dim, dim) [stress]."""
        return self.mean_stress(self.stress(self.deformation(state)))

    def cauchy_stress(self, state: State) -> Float:
        """Return the mean Cauchy stress over the points of each own particle (n_owned, dim, dim) [stress]."""
        return self.mean_stress(self.cauchy(self.deformation(state)))

    def out_of_plane(self, state: State) -> tuple[Float, Float, Float]:
        """Return stretch, P and Cauchy stress across a line or plane body (n_owned,)."""
        F = self.deformation(state)
        stretch, P, sigma = np.ones(len(F)), np.zeros(len(F)), np.zeros(len(F))
        for at_points in self.materials:
            part = F[at_points.points]
            across = at_points.hidden_stretch(part)
            if self.body.dim > 1:
                stretch[at_points.points] = across
            else:  # of two equal ones the product, which to first order is one plus the sum of their strains
                linear = at_points.material.linear
                stretch[at_points.points] = 1.0 + 0.5 * (across - 1.0) if linear else np.sqrt(across)
            P[at_points.points] = at_points.out_of_plane_stress(part)
            current = 1.0 if at_points.material.linear else stretch[at_points.points] / (np.linalg.det(part) * across)
            sigma[at_points.points] = P[at_points.points] * current
        return self._mean(stretch), self.mean_stress(P), self.mean_stress(sigma)

    def energy_density(self, state: State) -> Float:
        """Return the mean of psi over the points of each own particle (n_owned,) [energy / volume]."""
        return self._mean(self.point_energy(self.deformation(state)))

    def plastic_strain(self) -> Float:
        """Return the mean accumulated plastic strain over the points of each own particle (n_owned,) [-]."""
        alpha = np.zeros(self.operator.n_points)
        for at_points in self.materials:
            alpha[at_points.points] = at_points.plastic_strain()
        return self._mean(alpha)

    def mean_stress(self, stress: Float) -> Float:
        """Return the stress of the own particles (n_owned, ...) from that of their points (not collective)."""
        return self._mean(stress)

    def _mean(self, values: Float) -> Float:
        return self.operator.mean_over_points(values, self.body.cloud.n_owned)
