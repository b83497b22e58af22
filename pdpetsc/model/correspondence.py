"""Correspondence: residual, tangent and energy composed from scheme, materials and stabilisation."""

from __future__ import annotations

from collections.abc import Sequence
from functools import cached_property

import numpy as np

from pdpetsc.arrays import Float, LocalIndex, Mask
from pdpetsc.discrete.cloud import Cloud
from pdpetsc.discrete.communicator import total
from pdpetsc.discrete.families import Families
from pdpetsc.discrete.pattern import Rows, build_pattern, sharing_stencil
from pdpetsc.gradient.base import GradientOperator, Scheme
from pdpetsc.kernels.assembly import assemble_kernel
from pdpetsc.kernels.gradient import determinant_kernel
from pdpetsc.kernels.pattern import transpose
from pdpetsc.law import Law, make_law
from pdpetsc.material.base import Material
from pdpetsc.model.assembler import Assembler
from pdpetsc.model.base import Model
from pdpetsc.model.linearised import GradientTangent, Linearised
from pdpetsc.stabilisation.base import Control, Stabilisation, Stiffness


class CorrespondenceModel(Model):
    """Internal forces ``f = G^T (W P)`` and tangent ``K = G^T (W A) G`` of a body, with its zero-energy control.

    Parameters
    ----------
    cloud, families
        Particles of this rank and their bonds.
    omega : (n_bonds,) float64
        Influence of every bond [-].
    scheme : Scheme
        Where gradients are evaluated.
    materials : sequence of Material
        Materials of the body.
    material_of : (n_owned,) int
        Index into ``materials`` of each own particle.
    stabilisation : Stabilisation or None
        Zero-energy control.
    factor : (n_owned,) float64, optional
        What multiplies the moduli of each own particle [-].

    Raises
    ------
    CaseError
        A family is too small or flat, on every rank.

    Notes
    -----
    Construction and every method but ``deformation`` are collective.
    """

    def __init__(
        self,
        cloud: Cloud,
        families: Families,
        omega: Float,
        scheme: Scheme,
        materials: Sequence[Material],
        material_of: LocalIndex,
        stabilisation: Stabilisation | None,
        factor: Float | None = None,
    ) -> None:
        super().__init__(cloud, families)
        self.operator: GradientOperator = scheme.build(cloud, families, omega)
        self.note = self.operator.note
        law_of = material_of[self.operator.owner]
        self.laws: list[Law] = []
        for number, material in enumerate(materials):
            points = np.flatnonzero(law_of == number)
            at_points = None if factor is None else factor[self.operator.owner[points]]
            self.laws.append(make_law(material, points, cloud.dim, at_points))
        self._linear = all(material.linear for material in materials)
        self.control: Control | None = None
        if stabilisation is not None:
            stiffness = _stiffness(materials, material_of, factor, cloud)
            self.control = stabilisation.build(cloud, families, omega, stiffness)
            self.control_name = type(stabilisation).__name__

    @property
    def linear(self) -> bool:
        """Return whether all materials are linear."""
        return self._linear

    @property
    def n_points(self) -> int:
        """Return the gradient points of this rank."""
        return self.operator.n_points

    @property
    def parts(self) -> list[str]:
        """Return what the body is made of."""
        made = ["families", "gradient operator", *(f"material {type(law.material).__name__}" for law in self.laws)]
        return made + ([] if self.control is None else [f"control {self.control_name}"])

    def deformation(self, u_local: Float) -> Float:
        """Return ``F_p`` (n_points, dim, dim) for displacements with ghosts (not collective)."""
        F = self.operator.gradient(u_local)
        F += np.eye(self.dim)
        return F

    def admissible(self, F: Float) -> bool:
        """Return whether this rank's materials are defined at F: ``det F > 0`` unless all are linear."""
        return self.linear or bool(determinant_kernel(self.dim)(F) > 0.0)

    def stress(self, F: Float) -> Float:
        """Return ``P_p`` (n_points, dim, dim) [stress]."""
        P = np.empty_like(F)
        for law in self.laws:
            law.stress(F, P)
        return P

    def moduli(self, F: Float) -> Float:
        """Return ``A_p = dP/dF`` (n_points, dim, dim, dim, dim) [stress]."""
        A = np.empty((len(F), *(self.dim,) * 4))
        for law in self.laws:
            law.tangent(F, A)
        return A

    def internal_force(self, u: Float) -> Float | None:
        """Return the internal forces (n_rows, dim) [force]; None on all ranks where any rank has ``det F <= 0``."""
        u_local = self.with_ghosts(u)
        F = self.deformation(u_local)
        if int(total(self.cloud.comm, int(not self.admissible(F)))):
            return None
        f = np.zeros_like(u_local)
        self.put_forces(self.stress(F), u_local, f)
        return self.gather(f)

    def put_forces(self, P: Float, u_local: Float, f: Float) -> None:
        """Add the forces of stresses ``P`` (n_points, dim, dim) and of the control to ``f`` (not collective)."""
        self.operator.divergence(P, f)
        if self.control is not None:
            self.control.force(u_local, f, self.families.everyone)

    def all_admissible(self, u: Float) -> bool:
        """Return whether ``det F > 0`` on every rank."""
        F = self.deformation(self.with_ghosts(u))
        return int(total(self.cloud.comm, int(not self.admissible(F)))) == 0

    def linearised(self, u: Float) -> Linearised:
        """Return the tangent ``G^T W A G + K_control`` with the moduli A at u."""
        A = self.moduli(self.deformation(self.with_ghosts(u)))
        return GradientTangent(self, A, self.operator.g, self.shared_control)

    @cached_property
    def shared_control(self) -> tuple[Float, Float] | None:
        """Return stiffness and shape tensors of a control that shares the gradient, if it does (not collective)."""
        return None if self.control is None else self.control.of_gradient(self.operator)

    def uniform_stress_force(self, P: Float) -> Float:
        """Return ``G^T (W P)`` (n_rows, dim) [force] for stresses (n_owned, dim, dim) of the particles."""
        f = np.zeros((self.cloud.n_local, self.dim))
        self._intact_operator.divergence(P[self._intact_operator.owner], f)
        return self.gather(f)

    @cached_property
    def _intact_operator(self) -> GradientOperator:
        """Return the operator as it was when a load first asked: a dead load does not change when bonds break."""
        return self.operator

    def energy(self, u: Float) -> tuple[float, float]:
        """Return the strain energy of the body and that of its zero-energy control [energy]."""
        u_local = self.with_ghosts(u)
        elastic = float(self.operator.volume @ self.point_energy(self.deformation(u_local)))
        both = total(self.cloud.comm, [elastic, self.control_energy(u_local)])
        return float(both[0]), float(both[1])

    def control_energy(self, u_local: Float) -> float:
        """Return the energy of the zero-energy control on this rank [energy] (not collective)."""
        if self.control is None:
            return 0.0
        return self.control.force(u_local, np.zeros_like(u_local), self.families.everyone)

    def commit(self, u: Float) -> None:
        """Take ``u`` (n_owned, dim) as converged: materials with history remember it."""
        super().commit(u)
        if any(law.has_history for law in self.laws):
            F = self.deformation(self.with_ghosts(u))
            for law in self.laws:
                law.commit(F)
            self.version += 1

    @property
    def has_history(self) -> bool:
        """Return whether stresses depend on converged steps; the same on all ranks."""
        return any(law.has_history for law in self.laws)

    @property
    def kappa(self) -> float:
        """Return the largest ``lambda + 2 mu / dim`` of the materials [stress]."""
        return max(law.material.bulk_like_modulus(self.dim) for law in self.laws)

    @property
    def largest_modulus(self) -> float:
        """Return the largest entry of the small-strain stiffness on this rank [stress]."""
        return max(law.largest_modulus() for law in self.laws)

    def assembler(self) -> Assembler:
        """Return what fills the tangent matrix (collective)."""
        return CorrespondenceAssembler(self)

    def reach(self, marked: Float) -> Mask:
        """Return the own particles that share a gradient point with a marked local one (collective)."""
        return sharing_stencil(self.cloud, self.operator.point_ptr, self.operator.members, marked)

    def point_energy(self, F: Float) -> Float:
        """Return ``psi_p`` (n_points,) [energy / volume] (not collective)."""
        psi = np.empty(len(F))
        for law in self.laws:
            law.energy(F, psi)
        return psi

    def cauchy(self, F: Float) -> Float:
        """Return ``sigma_p = P F^T / J`` (n_points, dim, dim) [stress], J with the hidden stretches; P where linear."""
        sigma = self.stress(F)
        for law in self.laws:
            if not law.material.linear and len(law.points):
                part = F[law.points]
                J = np.linalg.det(part) * law.material.thickness_stretch(part)
                sigma[law.points] = np.einsum("pik,pjk->pij", sigma[law.points], part) / J[:, None, None]
        return sigma

    def deformation_gradient(self, u: Float) -> Float:
        """Return the mean of F over the points of each own particle (n_owned, dim, dim) [-]."""
        return self._mean(self.deformation(self.with_ghosts(u)))

    def first_piola_stress(self, u: Float) -> Float:
        """Return the mean of P over the points of each own particle (n_owned, dim, dim) [stress]."""
        return self.mean_stress(self.stress(self.deformation(self.with_ghosts(u))))

    def cauchy_stress(self, u: Float) -> Float:
        """Return the mean Cauchy stress over the points of each own particle (n_owned, dim, dim) [stress]."""
        return self.mean_stress(self.cauchy(self.deformation(self.with_ghosts(u))))

    def out_of_plane(self, u: Float) -> tuple[Float, Float, Float]:
        """Return stretch, P and Cauchy stress across a line or plane body (n_owned,)."""
        F = self.deformation(self.with_ghosts(u))
        stretch, P, sigma = np.ones(len(F)), np.zeros(len(F)), np.zeros(len(F))
        for law in self.laws:
            part = F[law.points]
            across = law.material.thickness_stretch(part)
            stretch[law.points] = np.sqrt(across) if self.dim == 1 else across
            P[law.points] = law.out_of_plane_stress(part)
            current = 1.0 if law.material.linear else stretch[law.points] / (np.linalg.det(part) * across)
            sigma[law.points] = P[law.points] * current
        return self._mean(stretch), self.mean_stress(P), self.mean_stress(sigma)

    def energy_density(self, u: Float) -> Float:
        """Return the mean of psi over the points of each own particle (n_owned,) [energy / volume]."""
        return self._mean(self.point_energy(self.deformation(self.with_ghosts(u))))

    def plastic_strain(self) -> Float:
        """Return the mean accumulated plastic strain over the points of each own particle (n_owned,) [-]."""
        alpha = np.zeros(self.operator.n_points)
        for law in self.laws:
            alpha[law.points] = law.plastic_strain()
        return self._mean(alpha)

    def mean_stress(self, stress: Float) -> Float:
        """Return the stress of the own particles (n_owned, ...) from that of their points (not collective)."""
        return self._mean(stress)

    def _mean(self, values: Float) -> Float:
        return self.operator.mean_over_points(values, self.cloud.n_owned)


def _stiffness(materials: Sequence[Material], material_of: LocalIndex, factor: Float | None, cloud: Cloud) -> Stiffness:
    dim = cloud.dim
    factor = np.ones(cloud.n_owned) if factor is None else factor
    kappa = np.array([material.bulk_like_modulus(dim) for material in materials])[material_of] * factor
    one = np.eye(dim)
    moduli = np.empty((len(materials), *(dim,) * 4))
    for number, material in enumerate(materials):
        lam, mu = material.lame(dim)
        symmetric = np.einsum("ik,mn->imkn", one, one) + np.einsum("in,mk->imkn", one, one)
        moduli[number] = lam * np.einsum("im,kn->imkn", one, one) + mu * symmetric
    return Stiffness(kappa, moduli, material_of, factor)


class CorrespondenceAssembler(Assembler):
    """Row-wise assembly; index arrays and the constant matrix of the zero-energy control are computed once."""

    model: CorrespondenceModel

    def __init__(self, model: CorrespondenceModel) -> None:
        self.model = model
        operator, control = model.operator, model.control
        # The stencil of every scheme lies inside its owner's family, which is what a control couples.
        stencils = (operator.point_ptr, operator.members) if control is None else control.stencils
        self.pattern = build_pattern(model.cloud, *stencils)
        self._transpose()
        self._control = None if control is None else control.matrix(self.pattern)
        self._ghost = np.empty(model.dim**2 * int(self.pattern.ghost.diag_ptr[-1]))

    @property
    def force_weights(self) -> Float:
        """Return the weights with which points put forces on particles: those of the gradient."""
        return self.model.operator.g

    def _transpose(self) -> None:
        operator = self.model.operator
        self._transposed = transpose(operator.point_ptr, operator.members, self.model.cloud.n_local)

    def assemble_particles(self, u: Float, diag: Float, off: Float) -> None:
        """Write the rows of the own particles."""
        model, pattern, dim = self.model, self.pattern, self.model.dim
        A = model.moduli(model.deformation(model.with_ghosts(u)))
        self._rows(pattern.owned, A, diag, off)
        self._rows(pattern.ghost, A, self._ghost, off)
        pattern.complete(self._ghost, diag, off, dim)
        if self._control is not None:
            self._control.add(dim, diag, off)

    def _rows(self, rows: Rows, A: Float, diag: Float, off: Float) -> None:
        operator = self.model.operator
        assemble_kernel(self.model.dim)(
            rows.first, rows.diag_ptr, rows.off_ptr, rows.columns, *self.pattern.locals_of_columns, *self._transposed,
            operator.point_ptr, operator.members, self.force_weights, operator.g, operator.volume, A, diag, off,
        )  # fmt: skip
