"""The discrete body: residual, tangent and energy composed from scheme, materials and stabilisation."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from pdpetsc.arrays import Float, LocalIndex
from pdpetsc.discrete.cloud import Cloud
from pdpetsc.discrete.communicator import total
from pdpetsc.discrete.families import Families
from pdpetsc.discrete.pattern import Pattern, Rows, build_pattern
from pdpetsc.gradient.base import GradientOperator, Scheme
from pdpetsc.kernels.assembly import assemble_kernel
from pdpetsc.kernels.gradient import determinant_kernel
from pdpetsc.kernels.pattern import transpose
from pdpetsc.law import Law, make_law
from pdpetsc.material.base import Material
from pdpetsc.stabilisation.base import Control, Stabilisation, Stiffness


class Model:
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
        self.cloud = cloud
        self.families = families
        self.operator: GradientOperator = scheme.build(cloud, families, omega)
        law_of = material_of[self.operator.owner]
        self.laws: list[Law] = []
        for number, material in enumerate(materials):
            points = np.flatnonzero(law_of == number)
            at_points = None if factor is None else factor[self.operator.owner[points]]
            self.laws.append(make_law(material, points, cloud.dim, at_points))
        self.linear = all(material.linear for material in materials)
        self.control: Control | None = None
        if stabilisation is not None:
            stiffness = _stiffness(materials, material_of, factor, cloud)
            self.control = stabilisation.build(cloud, families, omega, stiffness)
        self._u = np.zeros((cloud.n_local, cloud.dim))

    @property
    def dim(self) -> int:
        """Return the dimension."""
        return self.cloud.dim

    def with_ghosts(self, u: Float) -> Float:
        """Return ``u`` (n_owned, dim) extended by the ghosts; the array is reused by the next call."""
        self._u[: self.cloud.n_owned] = u
        self.cloud.halo.forward(self._u)
        return self._u

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
        """Return the internal forces of the own particles (n_owned, dim) [force].

        Returns
        -------
        (n_owned, dim) float64 or None
            None on all ranks where any rank has ``det F <= 0``.
        """
        u_local = self.with_ghosts(u)
        F = self.deformation(u_local)
        if int(total(self.cloud.comm, int(not self.admissible(F)))):
            return None
        f = np.zeros_like(u_local)
        self.operator.divergence(self.stress(F), f)
        if self.control is not None:
            self.control.force(u_local, f)
        self.cloud.halo.reverse(f)
        return f[: self.cloud.n_owned]

    def all_admissible(self, u: Float) -> bool:
        """Return whether ``det F > 0`` on every rank."""
        F = self.deformation(self.with_ghosts(u))
        return int(total(self.cloud.comm, int(not self.admissible(F)))) == 0

    def tangent_times(self, u: Float, du: Float) -> Float:
        """Return ``K(u) du`` (n_owned, dim) [force] without assembling K."""
        return self.moduli_times(self.moduli(self.deformation(self.with_ghosts(u))), du)

    def moduli_times(self, A: Float, du: Float) -> Float:
        """Return ``(G^T W A G + K_control) du`` (n_owned, dim) [force] for moduli A at the points."""
        du_local = self.with_ghosts(du)
        f = np.zeros_like(du_local)
        self.operator.divergence(np.einsum("pimkn,pkn->pim", A, self.operator.gradient(du_local)), f)
        if self.control is not None:
            self.control.force(du_local, f)
        self.cloud.halo.reverse(f)
        return f[: self.cloud.n_owned]

    def weighted_divergence(self, P: Float) -> Float:
        """Return ``G^T (W P)`` (n_owned, dim) [force] for given stresses (n_points, dim, dim)."""
        f = np.zeros((self.cloud.n_local, self.dim))
        self.operator.divergence(P, f)
        self.cloud.halo.reverse(f)
        return f[: self.cloud.n_owned]

    def energy(self, u: Float) -> tuple[float, float]:
        """Return the strain energy of the body and that of its zero-energy control [energy]."""
        u_local = self.with_ghosts(u)
        elastic = float(self.operator.volume @ self.energy_density(self.deformation(u_local)))
        control = 0.0 if self.control is None else self.control.force(u_local, np.zeros_like(u_local))
        both = total(self.cloud.comm, [elastic, control])
        return float(both[0]), float(both[1])

    def commit(self, u: Float) -> None:
        """Take ``u`` (n_owned, dim) as converged: materials with history remember it."""
        if self.has_history:
            F = self.deformation(self.with_ghosts(u))
            for law in self.laws:
                law.commit(F)

    @property
    def has_history(self) -> bool:
        """Return whether stresses depend on converged steps; the same on all ranks."""
        return any(law.has_history for law in self.laws)

    def plastic_strain(self) -> Float:
        """Return the accumulated plastic strain (n_points,) [-]."""
        alpha = np.zeros(self.operator.n_points)
        for law in self.laws:
            alpha[law.points] = law.plastic_strain()
        return alpha

    def energy_density(self, F: Float) -> Float:
        """Return ``psi_p`` (n_points,) [energy / volume]."""
        psi = np.empty(len(F))
        for law in self.laws:
            law.energy(F, psi)
        return psi

    def cauchy_stress(self, F: Float) -> Float:
        """Return ``sigma_p = P F^T / J`` (n_points, dim, dim) [stress], J with the hidden stretches; P where linear."""
        sigma = self.stress(F)
        for law in self.laws:
            if not law.material.linear and len(law.points):
                part = F[law.points]
                J = np.linalg.det(part) * law.material.thickness_stretch(part)
                sigma[law.points] = np.einsum("pik,pjk->pij", sigma[law.points], part) / J[:, None, None]
        return sigma


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


class Assembler:
    """Fills the value arrays of the tangent matrix of a model.

    The index arrays and the constant matrix of the zero-energy control are computed once.

    Notes
    -----
    Construction and ``assemble`` are collective.
    """

    def __init__(self, model: Model) -> None:
        self.model = model
        operator, control = model.operator, model.control
        # The stencil of every scheme lies inside its owner's family, which is what a control couples.
        stencils = (operator.point_ptr, operator.members) if control is None else (control.point_ptr, control.members)
        self.pattern: Pattern = build_pattern(model.cloud, *stencils)
        self._transposed = transpose(operator.point_ptr, operator.members, model.cloud.n_local)
        self._control = None if control is None else control.matrix(self.pattern)
        self._ghost = np.empty(model.dim**2 * int(self.pattern.ghost.diag_ptr[-1]))

    def assemble(self, u: Float, diag: Float, off: Float) -> None:
        """Write the values of K(u) for the own rows: own columns into ``diag``, the others into ``off``.

        Parameters
        ----------
        u : (n_owned, dim) float64
            Displacement [length], admissible on all ranks.
        diag, off : float64
            Scalar CSR values in ``pattern.owned`` order.
        """
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
            rows.first, rows.diag_ptr, rows.off_ptr, rows.columns, self.pattern.local_of_column, *self._transposed,
            operator.point_ptr, operator.members, operator.g, operator.volume, A, diag, off,
        )  # fmt: skip
