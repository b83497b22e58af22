"""Controls on ``z = eta - H xi``: the deformation of a bond minus that of the gradient H of its family."""

from __future__ import annotations

import copy
from collections.abc import Callable
from functools import cached_property

import numpy as np

from pdpetsc.arrays import Float, LocalIndex, entries_of, row_of_entries
from pdpetsc.control.base import BlockMatrix, Control, ControlMatrix, Stencil, fill, isotropic, with_centre_forces
from pdpetsc.discrete.cloud import Cloud
from pdpetsc.discrete.families import Families
from pdpetsc.discrete.sparsity import Sparsity
from pdpetsc.gradient.base import (
    FLAT,
    BondGradient,
    GradientOperator,
    SameGradient,
    Springs,
    StencilMembers,
    flat,
    shape_tensors,
    whole_families,
    with_centres,
)
from pdpetsc.kernels.control import (
    directed_force_kernel,
    directed_matrix_kernel,
    non_uniform_force_kernel,
    non_uniform_matrix_kernel,
)
from pdpetsc.kernels.gradient import inverses
from pdpetsc.kernels.point_blocks import directed_blocks_kernel, non_uniform_blocks_kernel
from pdpetsc.kernels.sparsity import sum_by


class NonUniform(Control):
    """Energy ``1/2 sum_i sum_j s_ij |z_ij|^2`` with scalar bond stiffness, forces ``T_ij s_ij z_ij``.

    Parameters
    ----------
    cloud, families
        The bonds.
    stiffness : (n_bonds,) float64 or callable
        ``s_ij`` [force / length], or a function that returns it as a new array on every call. Loops over bonds in every
        evaluation keep the array.
    K_inverse : (n_owned, dim, dim) float64
        Inverse of ``sum_j s_ij xi (x) xi``, which makes H the best fit to the family; zero for H = 0.
    phi : (n_bonds,) float64, optional
        ``T_ij`` [-], on the forces but not in H, so that the forces do not derive from an energy; 1 by default.
    """

    def __init__(
        self, cloud: Cloud, families: Families, stiffness: Float | Callable[[], Float], K_inverse: Float,
        phi: Float | None = None,
    ) -> None:  # fmt: skip
        self._cloud = cloud
        self._families = families
        if callable(stiffness):
            self._new_stiffness = stiffness
        else:
            self._new_stiffness = stiffness.copy
            self._stiffness = stiffness
        self._K_inverse = K_inverse
        self._phi = phi
        # The control with the same H and other stiffnesses of whole families from which this one was made, with their
        # shares.
        self._scaled_from: tuple[NonUniform, Float] | None = None

    @classmethod
    def proportional(cls, cloud: Cloud, families: Families, omega: Float, K: Float, coefficient: Float) -> NonUniform:
        """Return the control ``T_z = c_i omega z``, with ``s_ij = c_i V_i omega V_j`` computed on use.

        Parameters
        ----------
        omega : (n_bonds,) float64
            Influence [-].
        K : (n_owned, dim, dim) float64
            Shape tensors for the weights ``omega V_j``.
        coefficient : (n_owned,) float64
            ``c_i`` [force / length^(2 dim + 1), thickness counted as a length]; all zero or all positive.
        """
        factor = coefficient * cloud.volume[: cloud.n_owned]
        K_inverse = inverses(K * factor[:, None, None]) if np.any(factor) else np.zeros_like(K)

        def stiffness() -> Float:
            found = families.weights(omega, cloud.volume)
            families.multiply(found, factor)
            return found

        return cls(cloud, families, stiffness, K_inverse)

    @property
    def bond_stiffness(self) -> Float:
        """Return ``s_ij`` (n_bonds,) [force / length], computed unless it is kept."""
        listed: Float | None = self.__dict__.get("_stiffness")
        return self._new_stiffness() if listed is None else listed

    @cached_property
    def _stiffness(self) -> Float:
        """Return ``s_ij``, and keep it for loops over bonds in every evaluation."""
        return self._new_stiffness()

    @cached_property
    def _forces(self) -> Float:
        """Return ``T_ij s_ij`` (n_bonds,) [force / length]."""
        return self._stiffness if self._phi is None else self._stiffness * self._phi

    @property
    def _on_use(self) -> tuple[Float, Float]:
        """Return ``T_ij s_ij`` and ``s_ij`` without keeping them."""
        s = self.bond_stiffness
        return s if self._phi is None else self._forces, s

    @property
    def K_inverse(self) -> Float:
        """Return the inverse shape tensors (n_owned, dim, dim) [1 / (force length)]."""
        return self._K_inverse

    @property
    def stencils(self) -> Stencil:
        """Return the families with their centre first."""
        with_centre = whole_families(self._cloud, self._families, self.bond_stiffness)
        return with_centre.point_ptr, with_centre.members

    def force(self, u: Float, f: Float, particles: LocalIndex) -> float:
        """Add ``T_ij s_ij z_ij`` to ``j`` and its opposite to ``i``; return the energy ``1/2 sum T s |z|^2``."""
        return float(self._add_force(self._forces, self._stiffness, u, f, particles).sum())

    def energy(self, u: Float, particles: LocalIndex) -> float:
        """Return ``1/2 sum T s |z|^2``."""
        return float(self._add_force(*self._on_use, u, np.zeros_like(u), particles).sum())

    def family_energy(self, u: Float) -> Float:
        """Return ``1/2 sum_j T s |z|^2`` of every own particle."""
        return self._add_force(self._forces, self._stiffness, u, np.zeros_like(u), self._families.everyone)

    def _add_force(self, forces: Float, s: Float, u: Float, f: Float, particles: LocalIndex) -> Float:
        """Add the forces for ``T s`` and ``s`` (n_bonds,); return the energies of the families (n_particles,)."""
        kernel, family, energy = non_uniform_force_kernel(self._cloud.dim), self._families, np.empty(len(particles))
        data = family.indptr, family.neighbours, forces, s, self._K_inverse, self._cloud.x
        kernel(particles, *data, u, f, energy)
        return energy

    def families_at(self, particles: LocalIndex) -> StencilMembers:
        """Return the families of selected own particles, with the centre first."""
        return self.springs_at(particles)[0]

    def springs_at(self, particles: LocalIndex) -> tuple[StencilMembers, Float, Float]:
        """Return the families of selected own particles, ``s`` (n_entries,) of their members and ``K_i^-1``.

        ``s`` is zero for the centres, which come first.
        """
        family = self._families
        bonds, first = entries_of(family.indptr, particles)
        with_centre = with_centres(particles, first, family.neighbours[bonds], self._stiffness[bonds])
        return with_centre, with_centre.weight, self._K_inverse[particles]

    def forces_at(self, u: Float, particles: LocalIndex) -> Float:
        """Return ``T_ij s_ij z_ij`` in the families of selected own particles, and minus their sum on ``i``."""
        if self._phi is not None:
            return super().forces_at(u, particles)
        return forces_on_members(*self.springs_at(particles), self._cloud.x, u)

    def matrix(self, sparsity: Sparsity) -> ControlMatrix:
        """Return the scalar matrix of the control (collective)."""
        kernel = non_uniform_matrix_kernel(self._cloud.dim)
        with_centre = whole_families(self._cloud, self._families, self._stiffness)
        forces = np.insert(self._forces, self._families.indptr[:-1], 0.0)
        data = forces, with_centre.weight, self._K_inverse, self._cloud.x
        stencils = with_centre.point_ptr, with_centre.members
        return isotropic(sparsity, kernel, stencils, *data)

    def add_point_blocks(self, blocks: Float) -> bool:
        """Add multiples of the identity to the blocks of local particles (n_local, dim, dim)."""
        family, kernel = self._families, non_uniform_blocks_kernel(self._cloud.dim)
        kernel(family.indptr, family.neighbours, *self._on_use, self._K_inverse, self._cloud.x, blocks)
        return True

    def of_gradient(self, operator: GradientOperator) -> SameGradient | None:
        """Return the data of the control for the loop over ``operator`` if H is its gradient, else None."""
        if self._phi is not None:
            return None
        if self._scaled_from is not None:
            original, share = self._scaled_from
            same = original.shared_gradient(operator)
            if isinstance(same, BondGradient):
                return BondGradient(self._stiffness, same.K * share[:, None, None])
        springs = Springs(self._families, self.bond_stiffness, self._K_inverse, self._cloud.x, self.force)
        found = operator.same_gradient(springs)
        if isinstance(found, BondGradient):  # which keeps the array
            self._stiffness = found.stiffness
        return found

    def scaled(self, share: Float) -> NonUniform:
        """Return the control with ``s_ij`` times the share of ``i``; H is unchanged."""
        stiffness = self._stiffness * share[self._families.centres]
        K_inverse = self._K_inverse / share[:, None, None]
        scaled = NonUniform(self._cloud, self._families, stiffness, K_inverse, self._phi)
        scaled._scaled_from = self, share
        return scaled

    def family_forces(self, u: Float) -> Float:
        """Return ``T_ij s_ij z_ij`` on ``j`` and minus their sum on ``i``."""
        forces = self.bond_forces(u)
        if self._phi is not None:
            forces *= self._phi[:, None]
        return with_centre_forces(self._families.indptr, forces)

    def damaged(self, phi: Float) -> Control:
        """Return the control with ``s_ij`` times the degradation factor; H is zero in directions without bonds."""
        of_intact, lost = self._new_stiffness, np.flatnonzero(phi != 1.0)
        if not len(lost):
            # Another control as on ranks that have lost bonds, because its matrix is computed by all ranks together.
            intact = copy.copy(self)
            intact._filled = intact._shared = None
            return intact
        factor = phi[lost]

        def stiffness() -> Float:
            found = of_intact()
            found[lost] *= factor
            return found

        hurt = np.zeros(self._cloud.n_owned, dtype=bool)
        hurt[self._families.centres[lost]] = True
        hurt &= self._K_inverse.any(axis=(1, 2))
        K_inverse = self._K_inverse.copy()
        K_inverse[hurt] = _pseudo_inverses(shape_tensors(self._families, stiffness(), self._cloud.x)[hurt])
        return NonUniform(self._cloud, self._families, stiffness, K_inverse)

    def faded(self, phi: Float) -> Control:
        """Return the control with the degradation factor as ``T_ij``."""
        return NonUniform(self._cloud, self._families, self._stiffness, self._K_inverse, phi)

    def bond_forces(self, u: Float) -> Float:
        """Return ``s_ij z_ij``."""
        family = self._families
        xi, eta = family.bonds(self._cloud.x), family.bonds(u)
        weighted = np.einsum("b,bi,bj->bij", self._stiffness, eta, xi)
        H = sum_by(family.centres, weighted, self._cloud.n_owned) @ self._K_inverse
        return np.asarray(self._stiffness[:, None] * (eta - np.einsum("bij,bj->bi", H[family.centres], xi)))


def _pseudo_inverses(K: Float) -> Float:
    """Return the inverses of shape tensors (n, dim, dim), zero in directions without bonds."""
    found, full = np.empty_like(K), ~flat(K, K.shape[1] * FLAT)
    found[full], found[~full] = inverses(K[full]), np.linalg.pinv(K[~full], rcond=FLAT, hermitian=True)
    return found


def forces_on_members(families: StencilMembers, s: Float, K_inverse: Float, x: Float, u: Float) -> Float:
    """Return ``s_ij z_ij`` on the members of families, and minus their sum on the centres (n_entries, dim) [force].

    Parameters
    ----------
    families : StencilMembers
        Families, with the centre first.
    s : (n_entries,) float64
        Stiffness, 0 for centres [force / length].
    K_inverse : (n, dim, dim) float64
        As for ``NonUniform``.
    x, u : (n_local, dim) float64
        Positions and displacements [length].
    """
    centres = np.repeat(families.owner, np.diff(families.point_ptr))
    xi, eta = x[families.members] - x[centres], u[families.members] - u[centres]
    first = families.point_ptr[:-1]
    H = np.add.reduceat(np.einsum("e,ei,ej->eij", s, eta, xi), first, axis=0) @ K_inverse
    of = row_of_entries(families.point_ptr)
    m = s[:, None] * (eta - np.einsum("eij,ej->ei", H[of], xi))
    m[first] = -np.add.reduceat(m, first, axis=0)
    return np.asarray(m)


class Directed(Control):
    """Energy ``1/2 sum_i sum_j z_ij . S_ij z_ij`` with a tensor ``S_ij`` per bond.

    Parameters
    ----------
    cloud, families
        The bonds.
    S : (n_bonds, dim, dim) float64
        Symmetric stiffness of the bonds [force / length].
    g : (n_bonds, dim) float64
        Weights of the gradient, ``H_i = sum_j eta_ij (x) g_ij`` [1 / length].
    """

    def __init__(self, cloud: Cloud, families: Families, S: Float, g: Float) -> None:
        self._cloud = cloud
        self._families = families
        self._S = S
        self._g = g

    @property
    def stencils(self) -> Stencil:
        """Return the families with their centre first."""
        with_centre = whole_families(self._cloud, self._families, np.zeros(len(self._g)))
        return with_centre.point_ptr, with_centre.members

    def force(self, u: Float, f: Float, particles: LocalIndex) -> float:
        """Add the forces and return the energy."""
        family = self._families
        kernel = directed_force_kernel(self._cloud.dim)
        return float(kernel(particles, family.indptr, family.neighbours, self._S, self._g, self._cloud.x, u, f))

    def scaled(self, share: Float) -> Directed:
        """Return the control with ``S_ij`` times the share of ``i``."""
        of_bonds = share[self._families.centres]
        return Directed(self._cloud, self._families, self._S * of_bonds[:, None, None], self._g)

    def family_forces(self, u: Float) -> Float:
        """Return ``S_ij z_ij - (sum_l S_il z_il (x) xi_il) g_ij`` on ``j`` and minus their sum on ``i``."""
        family, n = self._families, self._cloud.n_owned
        xi, eta = family.bonds(self._cloud.x), family.bonds(u)
        H = sum_by(family.centres, np.einsum("bi,bj->bij", eta, self._g), n)
        forces = np.einsum("bij,bj->bi", self._S, eta - np.einsum("bij,bj->bi", H[family.centres], xi))
        moment = sum_by(family.centres, np.einsum("bi,bj->bij", forces, xi), n)
        forces -= np.einsum("bij,bj->bi", moment[family.centres], self._g)
        return with_centre_forces(family.indptr, forces)

    def matrix(self, sparsity: Sparsity) -> ControlMatrix:
        """Return the block matrix of the control (collective)."""
        dim, cloud = self._cloud.dim, self._cloud
        xi = self._families.bonds(cloud.x)
        T = np.zeros((cloud.n_owned, dim, dim, dim, dim))
        np.add.at(T, self._families.centres, np.einsum("bij,bm,bn->bijmn", self._S, xi, xi))
        data = self._S, self._g, T, cloud.x
        return BlockMatrix(*fill(sparsity, directed_matrix_kernel(dim), self.stencils, *data))

    def add_point_blocks(self, blocks: Float) -> bool:
        """Add the diagonal blocks to those of local particles (n_local, dim, dim)."""
        family, kernel = self._families, directed_blocks_kernel(self._cloud.dim)
        kernel(family.indptr, family.neighbours, self._S, self._g, self._cloud.x, blocks)
        return True

    def damaged(self, phi: Float) -> Control:
        """Return the control with ``S_ij`` and the weights of its gradient times the degradation factor.

        ``g'_ij = T_ij M_i^-1 g_ij`` with ``M_i = sum_j T_ij g_ij (x) xi_ij``, so that ``sum_j xi_ij (x) g'_ij = I``:
        affine displacements have no force. H is zero in directions without intact bonds.
        """
        centres, xi = self._families.centres, self._families.bonds(self._cloud.x)
        g = phi[:, None] * self._g
        M = sum_by(centres, g[:, :, None] * xi[:, None, :], self._cloud.n_owned)
        g = np.einsum("bmn,bn->bm", np.linalg.pinv(M, rcond=FLAT)[centres], g)
        return Directed(self._cloud, self._families, self._S * phi[:, None, None], g)
