"""Bodies whose forces act along bonds: residual, tangent, energy and bond damage."""

from __future__ import annotations

from collections.abc import Sequence
from functools import cached_property

import numpy as np

from pdpetsc.arrays import Float, LocalIndex, Mask
from pdpetsc.bond_based import BondMaterial, Neighbourhood, combine
from pdpetsc.bond_based.fracture import resolve
from pdpetsc.damage import BondDamage
from pdpetsc.discrete.communicator import total
from pdpetsc.discrete.pattern import sharing_stencil
from pdpetsc.errors import CaseError
from pdpetsc.gradient.base import Stencils, whole_families
from pdpetsc.kernels.bonds import bond_force_kernel
from pdpetsc.kernels.pattern import sum_by
from pdpetsc.model.assembler import Assembler
from pdpetsc.model.base import Model
from pdpetsc.model.bond_assembly import BondAssembler, DilatationAssembler
from pdpetsc.model.failure import BondFailure
from pdpetsc.model.linearised import BondTangent, Linearised


class BondModel(Model):
    """A body with the energy ``sum_ij 1/2 mu_ij k_ij e_ij^2 + sum_i 1/2 B_i theta_i^2``, ``theta_i = sum_j a_ij e_ij``.

    A pair of particles counts from both ends. The integrity ``mu`` is 1 without damage.

    Parameters
    ----------
    bonds : Neighbourhood
        Particles and bonds of this rank.
    materials : sequence of BondMaterial
        Materials of the body, of one kinematics.
    material_of : (n_owned,) int
        Index into ``materials`` of each own particle.
    factor : (n_owned,) float64, optional
        What multiplies the moduli of each own particle [-].
    damage : BondDamage, optional
        How bonds fail; they do not where absent.
    protected : (n_local,) bool, optional
        Particles whose bonds do not fail.

    Raises
    ------
    CaseError
        The materials do not fit together or the dimension, or a critical stretch is not positive; on every rank.

    Notes
    -----
    Construction is collective.
    """

    def __init__(
        self, bonds: Neighbourhood, materials: Sequence[BondMaterial], material_of: LocalIndex,
        factor: Float | None = None, damage: BondDamage | None = None, protected: Mask | None = None,
    ) -> None:  # fmt: skip
        cloud, families = bonds.cloud, bonds.families
        super().__init__(cloud, families)
        if len({material.kinematics for material in materials}) > 1:
            raise CaseError("All materials of a body need the same kinematics, small or finite.")
        self.finite = int(materials[0].kinematics == "finite")
        self._bonds = bonds
        self._materials = materials
        self._material_of = material_of
        self._elastic = [material.elastic(cloud.dim) for material in materials]
        self._factor = np.ones(cloud.n_owned) if factor is None else factor
        constants = combine(bonds, materials, material_of, self._factor)
        self.k, self.a, self.B = constants.k, constants.a, constants.B
        self.coupling = 1 if self.a is None else 2
        if damage is not None:
            if self.a is not None:
                raise CaseError("Bond damage takes bond-based materials; LinearSolid has no damage.")
            self.failure = BondFailure(cloud, families, resolve(damage, bonds, self.k), protected)

    @property
    def n_points(self) -> int:
        """Return 0: there are no gradient points."""
        return 0

    @property
    def parts(self) -> list[str]:
        """Return what the body is made of."""
        made = ["families", *(f"bonds {type(material).__name__}" for material in self._materials)]
        made += [] if self.a is None else ["dilatation"]
        return made + ([] if self.failure is None else [f"damage {type(self.failure.law).__name__}"])

    @property
    def linear(self) -> bool:
        """Return whether bonds keep their directions and their integrity while the displacement changes."""
        return not self.finite and (self.failure is None or not self.failure.softens)

    def secant(self, e: Float) -> Float:
        """Return ``T k`` of every bond (n_bonds,) [force / length] at elongations e."""
        return self.k if self.failure is None else self.failure.at(e)[0] * self.k

    def tangent(self, e: Float) -> Float:
        """Return ``d(T k e)/de`` of every bond (n_bonds,) [force / length] at elongations e."""
        if self.failure is None:
            return self.k
        T, slope = self.failure.at(e)
        return self.k * (T + slope * e)

    def tension(self, e: Float) -> Float:
        """Return the tension of every bond of every own particle (n_bonds,) [force] for elongations e."""
        return self._with_pressure(self.secant(e) * e, e)

    def _with_pressure(self, t: Float, e: Float) -> Float:
        """Return tensions with those of the dilatation at elongations e, or at rates of both."""
        if self.a is None or self.B is None:
            return t
        return np.asarray(t + self.a * (self.B * self.dilatation(e))[self.families.centres])

    def dilatation(self, e: Float) -> Float:
        """Return ``theta`` of the own particles (n_owned,) [-]; zeros for a material without it."""
        if self.a is None:
            return np.zeros(self.cloud.n_owned)
        return np.asarray(np.bincount(self.families.centres, self.a * e, self.cloud.n_owned), dtype=float)

    def bond_forces(self, u_local: Float, tension: Float) -> Float:
        """Return the forces on local particles (n_local, dim) [force] of bonds under tension."""
        f = np.zeros_like(u_local)
        kernel = bond_force_kernel(self.dim, self.finite)
        kernel(self.families.indptr, self.families.neighbours, self.cloud.x, u_local, tension, f)
        return f

    def internal_force(self, u: Float) -> Float | None:
        """Return the internal forces (n_rows, dim) [force]; None on all ranks where two particles of a bond meet."""
        u_local = self.with_ghosts(u)
        e, least = self.elongated(u_local)
        if self.finite and int(total(self.cloud.comm, int(least <= 0.0))):
            return None
        return self.gather(self.bond_forces(u_local, self.tension(e)))

    def all_admissible(self, u: Float) -> bool:
        """Return whether no bond has lost its length on any rank."""
        if not self.finite:
            return True
        return int(total(self.cloud.comm, int(self.elongated(self.with_ghosts(u))[1] <= 0.0))) == 0

    def linearised(self, u: Float) -> Linearised:
        """Return the tangent with the directions and tensions at u."""
        return BondTangent(self, u)

    def energy(self, u: Float) -> tuple[float, float]:
        """Return the strain energy of the body and 0 [energy]."""
        volume = self.cloud.volume[: self.cloud.n_owned]
        return float(total(self.cloud.comm, volume @ self.energy_density(u))), 0.0

    @property
    def has_history(self) -> bool:
        """Return whether bonds can fail."""
        return self.failure is not None

    @property
    def restartable(self) -> bool:
        """Return True."""
        return True

    @property
    def kappa(self) -> float:
        """Return the largest ``lambda + 2 mu / dim`` of the materials [stress]."""
        return max(elastic.bulk_like_modulus(self.dim) for elastic in self._elastic)

    @property
    def largest_modulus(self) -> float:
        """Return the largest ``lambda + 2 mu`` of the materials times the largest factor on this rank [stress]."""
        lame = [elastic.lame(self.dim) for elastic in self._elastic]
        return max(lam + 2.0 * mu for lam, mu in lame) * float(self._factor.max(initial=0.0))

    def dissipated_energy(self) -> float:
        """Return what bonds have dissipated in failing [energy]."""
        return 0.0 if self.failure is None else self.failure.dissipated(self.k)

    def local_damage(self) -> Float:
        """Return the lost share of the stiffness of each own particle's bonds (n_owned,) [-] (not collective)."""
        centres, n = self.families.centres, self.cloud.n_owned
        whole = np.bincount(centres, self.k, n)
        left = whole if self.failure is None else np.bincount(centres, self.k * self.failure.integrity, n)
        return np.asarray(1.0 - left / np.where(whole > 0.0, whole, 1.0))

    def assembler(self) -> Assembler:
        """Return what fills the tangent matrix (collective)."""
        return BondAssembler(self) if self.a is None else DilatationAssembler(self)

    def deformation_gradient(self, u: Float) -> Float:
        """Return the gradient that fits the family best (n_owned, dim, dim) [-], 1 in directions that it lacks."""
        u_local = self.with_ghosts(u)
        centres, neighbours = self.families.centres, self.families.neighbours
        xi = self.families.bonds(self.cloud.x)
        eta = u_local[neighbours] - u_local[centres]
        weight = self._bonds.omega * self.cloud.volume[neighbours]
        K = sum_by(centres, np.einsum("b,bi,bj->bij", weight, xi, xi), self.cloud.n_owned)
        N = sum_by(centres, np.einsum("b,bi,bj->bij", weight, eta, xi), self.cloud.n_owned)
        return np.asarray(np.eye(self.dim) + N @ np.linalg.pinv(K, rcond=1e-10, hermitian=True))

    def first_piola_stress(self, u: Float) -> Float:
        """Return ``P_i = sum_j t_ij n (x) xi / V_i`` (n_owned, dim, dim) [stress]: dW/dF in uniform deformation."""
        u_local = self.with_ghosts(u)
        centres, neighbours = self.families.centres, self.families.neighbours
        t = self.tension(self.elongation(u_local))
        xi = self.families.bonds(self.cloud.x)
        y = xi + self.finite * (u_local[neighbours] - u_local[centres])
        n = y / np.linalg.norm(y, axis=1)[:, None]
        moment = sum_by(centres, np.einsum("b,bi,bj->bij", t, n, xi), self.cloud.n_owned)
        return np.asarray(moment / self.cloud.volume[: self.cloud.n_owned, None, None])

    def cauchy_stress(self, u: Float) -> Float:
        """Return ``P F^T / J`` (n_owned, dim, dim) [stress], hidden stretches to first order; P where linear."""
        P = self.first_piola_stress(u)
        if self.linear:
            return P
        F = self.deformation_gradient(u)
        stretch = np.array([elastic.thickness_stretch(F) for elastic in self._elastic])
        J = np.linalg.det(F) * stretch[self._material_of, np.arange(len(F))]
        return np.asarray(np.einsum("pik,pjk->pij", P, F) / J[:, None, None])

    def out_of_plane(self, u: Float) -> tuple[Float, Float, Float]:
        """Return stretch, P and Cauchy stress across a line or plane body (n_owned,), of small strain across it.

        In plane strain the stress is Poisson's ratio times the trace of that in the plane.
        """
        here = np.arange(self.cloud.n_owned)
        F = self.deformation_gradient(u)
        across = np.array([elastic.thickness_stretch(F) for elastic in self._elastic])[self._material_of, here]
        strained = [elastic.nu if self.dim == 2 and elastic.plane == "strain" else 0.0 for elastic in self._elastic]
        ratio = np.array(strained)[self._material_of]
        P, sigma = self.first_piola_stress(u), self.cauchy_stress(u)
        traces = [ratio * np.einsum("pii->p", stress) for stress in (P, sigma)]
        return np.sqrt(across) if self.dim == 1 else across, traces[0], traces[1]

    def energy_density(self, u: Float) -> Float:
        """Return the strain energy density of the own particles (n_owned,) [energy / volume]."""
        e = self.elongation(self.with_ghosts(u))
        n = self.cloud.n_owned
        psi = np.bincount(self.families.centres, 0.5 * self.secant(e) * e**2, n)
        if self.B is not None:
            psi += 0.5 * self.B * self.dilatation(e) ** 2
        return np.asarray(psi / self.cloud.volume[:n])

    def plastic_strain(self) -> Float:
        """Return zeros."""
        return np.zeros(self.cloud.n_owned)

    def uniform_stress_force(self, P: Float) -> Float:
        """Refuse: a bond does not know the stress of its particle."""
        raise CaseError('Bonds have no consistent traction; use distribution="layer", or a correspondence material.')

    def reach(self, marked: Float) -> Mask:
        """Return the own particles in a family with a marked local particle (collective)."""
        return sharing_stencil(self.cloud, self.with_centres.point_ptr, self.with_centres.members, marked)

    @cached_property
    def with_centres(self) -> Stencils:
        """Return the families with their centre first (not collective)."""
        return whole_families(self.cloud, self.families, self.k)
