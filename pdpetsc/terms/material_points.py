"""Term of correspondence materials at gradient points."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from functools import cached_property

import numpy as np

from pdpetsc.arrays import Float, GlobalIndex, LocalIndex, Mask
from pdpetsc.control.by_shear import twice_shear
from pdpetsc.control.tangent_scaled import tangent_share
from pdpetsc.discrete.communicator import agreed
from pdpetsc.discrete.sparsity import sharing_stencil
from pdpetsc.gradient.base import ControlledGradient, GradientOperator, Moduli
from pdpetsc.gradient.products import PointProduct, Product
from pdpetsc.kernels.gradient import determinant_kernel
from pdpetsc.material.at_points import Conditions, MaterialAtPoints
from pdpetsc.material.base import Material
from pdpetsc.material.point_laws import PointLaws
from pdpetsc.problem.body import Body
from pdpetsc.problem.expansion import FreeDeformation
from pdpetsc.problem.material_term import MaterialTerm
from pdpetsc.problem.state import State
from pdpetsc.problem.term import KeptArray, Term

# Largest modulus of contact with friction over the shear modulus [-]: kappa in the plane at nu = 0.4. With the bulk
# modulus of nearly incompressible bodies Newton's method does not converge.
FRICTION = 5.0


class MaterialPoints(MaterialTerm):
    """Compute internal forces ``f = G^T (W P)`` with the tangent ``K = G^T (W A) G``.

    Parameters
    ----------
    body : Body
        Particles and bonds.
    operator : GradientOperator
        Gradient operator, whose weights the forces also use.
    materials : sequence of Material
        Materials of the body.
    material_of : (n_owned,) int
        Index into ``materials`` of each own particle.
    factor : (n_owned,) float64, optional
        Factor on the moduli of each own particle [-].

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
        self.note, self.unsuited = self.operator.note, self.operator.unsuited
        number_of = material_of[self.operator.owner]
        self.materials: list[MaterialAtPoints] = []
        for number, material in enumerate(materials):
            points = np.flatnonzero(number_of == number)
            of = self.operator.owner[points]
            factors = None if factor is None else factor[of]
            thermal = None if body.thermals is None else body.thermals[number]
            with agreed(body.cloud.comm):  # a function of place may fail on one rank
                self.materials.append(
                    MaterialAtPoints(material, points, body.dim, factors, body.cloud.x[of], body.expands, thermal)
                )
        self._linear = all(material.linear for material in materials)
        # Conditions of the points, with the stress-free deformation and the operator for which they were computed.
        self._conditions: tuple[FreeDeformation, GradientOperator, list[Conditions]] | None = None

    @property
    def linear(self) -> bool:  # type: ignore[override]
        """Return True if all materials are linear."""
        return self._linear and (self.body.expansion is None or not self.body.expansion.softens)

    def laws(self, state: State) -> PointLaws:
        """Return the laws of the points at the load parameter and temperature of a state (collective)."""
        operator, expansion = self.operator, state.expansion

        def make() -> PointLaws:
            if expansion is None:
                return PointLaws([material.at(state.clock.dt) for material in self.materials], self.body.dim)
            conditions = self._conditions_at(expansion)
            laws = [material.at(state.clock.dt, of) for material, of in zip(self.materials, conditions, strict=True)]
            return PointLaws(laws, self.body.dim)

        # The operator is kept too: while it lives no other object can have its id.
        return state.kept(("laws", id(self), id(operator)), lambda: (operator, make()))[1]

    def _conditions_at(self, expansion: FreeDeformation) -> list[Conditions]:
        """Return stress-free deformation and laws of the points of each material, cached for a temperature."""
        operator, last = self.operator, self._conditions
        if last is None or last[0] is not expansion or last[1] is not operator:
            of_particles, made = (expansion.strain, expansion.factor, expansion.temperature), []
            with agreed(self.body.cloud.comm):
                for material in self.materials:
                    of = operator.owner[material.points]
                    of_points = (None if values is None else values[of] for values in of_particles)
                    made.append(material.conditions(*of_points))
            self._conditions = last = expansion, operator, made
        return last[2]

    @property
    def small_strain(self) -> bool:
        """Return True if all materials are those of small strain."""
        return all(at_points.material.small_strain for at_points in self.materials)

    @property
    def symmetric(self) -> bool:  # type: ignore[override]
        """Return True if the tangents of all materials are symmetric."""
        return all(at_points.material.symmetric for at_points in self.materials)

    @property
    def timed(self) -> bool:  # type: ignore[override]
        """Return True if a material depends on time."""
        return any(at_points.material.timed for at_points in self.materials)

    @property
    def n_points(self) -> int:
        """Return the gradient points of this rank."""
        return self.operator.n_points

    @property
    def parts(self) -> list[str]:
        """Return the names of its parts."""
        return ["gradient operator", *(f"material {type(at_points.material).__name__}" for at_points in self.materials)]

    @property
    def stencils(self) -> tuple[GlobalIndex, LocalIndex] | None:
        """Return the stencils of the operator."""
        return self.operator.point_ptr, self.operator.members

    def deformation(self, state: State) -> Float:
        """Return ``F_p`` (n_points, dim, dim) [-]."""
        u_local, operator = state.u_local, self.operator

        def make() -> Float:
            F = operator.gradient(u_local)
            F += np.eye(self.body.dim)
            return F

        # The operator is kept too: while it lives no other object can have its id.
        return state.kept(("F", id(operator)), lambda: (operator, make()))[1]

    def point_gradient(self, state: State) -> Float:
        """Return F of the points (n_points, dim, dim) [-]; materials use ``deformation``."""
        return self.deformation(state)

    def strained(self, state: State) -> tuple[Float, Float | None]:
        """Return the elastic part of F, and the stress-free deformation (n_points, dim, dim) [-].

        These are ``F F_theta^-1`` and ``F_theta``, or None if the body does not expand. Points of linear materials have
        ``F - eps`` and 1.
        """
        F = self.deformation(state)
        if state.expansion is None:
            return F, None
        elastic, free = np.empty_like(F), np.empty_like(F)
        for law in self.laws(state).materials:
            elastic[law.points], free[law.points] = law.strained(F[law.points])
        return elastic, free

    def admissible(self, state: State) -> bool:
        """Return True if the materials of this rank are defined: ``det F > 0`` unless all are linear."""
        # Laws are collective on first use: compute them on every rank before one returns.
        F, laws = self.deformation(state), self.laws(state)
        if self._linear:
            return True
        if not determinant_kernel(self.body.dim)(F) > 0.0:
            return False
        return laws.defined(F, self.lost)

    @property
    def lost(self) -> Mask | None:
        """Return the points without gradient, whose stress need not be defined (n_points,); None if there are none."""
        return None

    def stress(self, state: State) -> Float:
        """Compute ``P_p`` (n_points, dim, dim) [stress]."""
        return self.laws(state).stress(self.deformation(state))

    def moduli_sets(self, state: State) -> Moduli:
        """Return the moduli at a state, stored once per material if they are equal at all its points."""
        F, laws = self.deformation(state), self.laws(state)
        present = [law for law in laws.materials if len(law.points)]
        tangents = [law.same_tangent(F) for law in present]
        if not present or any(A is None for A in tangents):
            return Moduli(laws.moduli(F))
        of = np.empty(len(F), dtype=np.int32)
        for number, law in enumerate(present):
            of[law.points] = number
        return Moduli(np.array(tangents), of)

    def point_energy(self, state: State) -> Float:
        """Compute ``psi_p`` (n_points,) [energy / volume]."""
        return self.laws(state).energy(self.deformation(state))

    def conjugates(self, state: State) -> tuple[Float, Float, Float]:
        """Return F, the stress of the forces (n_points, dim, dim) and the energy density (n_points,) of the points.

        The stress is the derivative of the energy by F.
        """
        return self.point_gradient(state), self.stress(state), self.point_energy(state)

    def energy_by_strain(self, state: State) -> Float:
        """Compute the derivative of the energy density by the eigenstrain at constant F (n_points, 3, 3)."""
        return self.laws(state).energy_by_strain(self.deformation(state))

    def energy_by_temperature(self, state: State, temperature: Float, step: float) -> Float:
        """Compute the derivative of the energy density by the temperature of the law at constant F (n_points,).

        Central differences of ``step`` are used. ``temperature`` is that of the local particles.
        """
        F = self.deformation(state)
        return self.laws(state).energy_by_temperature(F, temperature[self.operator.owner], step)

    def energy_at(self, state: State, F: Float, volume: Float) -> Float:
        """Compute the energy density of all points (n_points,) at other gradients F and volumes (n_points,)."""
        return self.laws(state).energy(F)

    def add_force(self, state: State, f: Float) -> None:
        """Add ``G^T (W P)``."""
        self.operator.divergence(self.stress(state), f)

    def add_force_together(self, other: Term, state: State, f: Float) -> bool:
        """Add the forces of a control on the same gradient in the same loop."""
        control = other.control_of(self.operator, state)
        if control is None:
            return False
        same = ControlledGradient(control, self.point_gradient(state) - np.eye(self.body.dim), state.u_local)
        self.operator.divergence(self.stress(state), f, same)
        return True

    def linearise(self, state: State) -> list[Product]:
        """Return ``G^T W A G`` with the moduli A at a state."""
        return [PointProduct(self.operator, self.moduli_sets(state))]

    def tangent_share(self, state: State) -> Float:
        """Return the remaining share of the elastic modulus of the own particles (n_owned,) [-].

        See ``control.tangent_share``; 1 for elastic materials (not collective).
        """
        F = self.deformation(state)
        share = np.ones(len(F))
        for law in self.laws(state).materials:
            if law.has_history and len(law.points):
                share[law.points] = tangent_share(*law.elastic_response(F))
        return self._mean(share)

    def uniform_stress_force(self, P: Float) -> Float:
        """Compute ``G^T (W P)`` (n_rows, dim) [force] for stresses (n_owned, dim, dim) of the particles."""
        f = np.zeros((self.body.cloud.n_local, self.body.dim))
        self._intact_operator.divergence(P[self._intact_operator.owner], f)
        return self.body.gather(f)

    @cached_property
    def _intact_operator(self) -> GradientOperator:
        """Return the operator at the first request of a load: a dead load does not change when bonds break."""
        return self.operator

    def energy(self, state: State) -> float:
        """Compute ``sum_p W_p psi_p``."""
        return float(self.operator.volume @ self.point_energy(state))

    def commit(self, state: State) -> None:
        """Update the histories of materials at a converged state; lost points keep their history."""
        if not self.has_history:
            return
        lost = self.lost
        before = [] if lost is None else [at_points.history.copy() for at_points in self.materials]
        self.laws(state).commit(self.deformation(state))
        self.version += 1
        if lost is not None:
            for at_points, history in zip(self.materials, before, strict=True):
                gone = lost[at_points.points]
                at_points.history[gone] = history[gone]

    def plastic_growth(self, state: State) -> float:
        """Return the largest increase of the plastic strain on this rank if the step ends at a state [-]."""
        grown = self.laws(state).plastic_growth(self.deformation(state))
        return float((grown if self.lost is None else grown[~self.lost]).max(initial=0.0))

    @property
    def has_history(self) -> bool:
        """Return True if stresses depend on converged steps; the same on all ranks."""
        return any(at_points.has_history for at_points in self.materials)

    def arrays(self) -> Mapping[str, KeptArray]:
        """Return the histories of the materials with history, by the number of the material."""
        owner = self.operator.owner
        return {
            f"history_{number}": KeptArray(owner[at_points.points], at_points.history)
            for number, at_points in enumerate(self.materials)
            if at_points.has_history
        }

    def contact_modulus(self, particles: LocalIndex | GlobalIndex, friction: bool) -> float:
        """Return the modulus of the stiffest of own particles, with friction ``FRICTION`` shear moduli if less."""
        dim = self.body.dim

        def modulus(law: Material) -> float:
            kappa = law.bulk_like_modulus(dim)
            return kappa if dim == 1 or not friction else min(kappa, 0.5 * FRICTION * twice_shear(law.moduli(dim)))

        chosen = np.zeros(self.body.cloud.n_owned, dtype=bool)
        chosen[particles] = True
        return self._largest(modulus, chosen[self.operator.owner])

    def _largest(self, modulus: Callable[[Material], float], points: Mask | None = None) -> float:
        """Return the largest modulus times factor of the materials of points, by default of all on this rank [stress].

        ``points`` is (n_points,).
        """
        found = [0.0]
        for at_points in self.materials:
            factor = np.ones(len(at_points.points)) if at_points.factor is None else at_points.factor
            chosen = factor if points is None else factor[points[at_points.points]]
            found.append(modulus(at_points.material) * float(chosen.max(initial=0.0)))
        return max(found)

    @property
    def largest_modulus(self) -> float:
        """Return the largest entry of the small-strain stiffness on this rank [stress]."""
        expansion, owner = self.body.expansion, self.operator.owner
        factors = [None] if expansion is None else [expansion.at(t).factor for t in (0.0, 1.0)]
        return max(
            material.largest_modulus(None if factor is None else factor[owner[material.points]])
            for factor in factors
            for material in self.materials
        )

    def dependents(self, marked: Float) -> Mask:
        """Return the own particles that share a gradient point with a marked local one (collective)."""
        return sharing_stencil(self.body.cloud, self.operator.point_ptr, self.operator.members, marked)

    def deformation_gradient(self, state: State) -> Float:
        """Return the mean of F over the points of each own particle (n_owned, dim, dim) [-]."""
        return self._mean(self.point_gradient(state))

    def first_piola_stress(self, state: State) -> Float:
        """Return the mean of P over the points of each own particle (n_owned, dim, dim) [stress]."""
        return self.mean_stress(self.stress(state))

    def cauchy_stress(self, state: State) -> Float:
        """Return the mean Cauchy stress over the points of each own particle (n_owned, dim, dim) [stress]."""
        return self.mean_stress(self.laws(state).cauchy_of(self.stress(state), self.deformation(state)))

    def out_of_plane(self, state: State) -> tuple[Float, Float, Float]:
        """Return stretch, P and Cauchy stress normal to a plane or line body (n_owned,)."""
        stretch, P, sigma = self.laws(state).out_of_plane(self.deformation(state))
        return self._mean(stretch), self.mean_stress(P), self.mean_stress(sigma)

    def energy_density(self, state: State) -> Float:
        """Return the mean of psi over the points of each own particle (n_owned,) [energy / volume]."""
        return self._mean(self.point_energy(state))

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
