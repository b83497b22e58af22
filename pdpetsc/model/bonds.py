"""Bodies whose forces act along bonds: residual, tangent, energy and bond damage."""

from __future__ import annotations

from collections.abc import Sequence
from functools import cached_property

import numpy as np

from pdpetsc.arrays import Float, GlobalIndex, LocalIndex, Mask
from pdpetsc.bond_based import BondMaterial, Neighbourhood
from pdpetsc.damage import BondDamage
from pdpetsc.discrete.communicator import agreed, largest, total
from pdpetsc.discrete.pattern import Rows, build_pattern, sharing_stencil
from pdpetsc.errors import CaseError
from pdpetsc.gradient.base import Stencils, whole_families
from pdpetsc.kernels.assembly import assemble_kernel
from pdpetsc.kernels.bonds import (
    bond_force_kernel,
    bond_rows_kernel,
    elongation_kernel,
    elongation_rate_kernel,
    turning_force_kernel,
)
from pdpetsc.kernels.pattern import transpose
from pdpetsc.model.base import Assembler, Linearised, Model

# Bonds this close to the most overstretched one break with it: symmetric pairs, and both ends of one bond.
TOGETHER = 1e-8


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
        factor: Float | None = None, damage: BondDamage | None = None,
    ) -> None:  # fmt: skip
        cloud, families = bonds.cloud, bonds.families
        super().__init__(cloud, families)
        if len({material.kinematics for material in materials}) > 1:
            raise CaseError("All materials of a body need the same kinematics, small or finite.")
        self.finite = int(materials[0].kinematics == "finite")
        self.linear = not self.finite
        self.damage = damage
        self._bonds = bonds
        self._materials = materials
        self._material_of = material_of
        self._elastic = [material.elastic(cloud.dim) for material in materials]
        self._factor = np.ones(cloud.n_owned) if factor is None else factor
        self._combine(bonds, materials, material_of)
        self.integrity: Float = np.ones(len(families.neighbours) if damage is not None else 0)
        self.limit: Float = np.empty(0) if damage is None else self._limits(damage)

    @property
    def n_points(self) -> int:
        """Return 0: there are no gradient points."""
        return 0

    @property
    def parts(self) -> list[str]:
        """Return what the body is made of."""
        made = ["families", *(f"bonds {type(material).__name__}" for material in self._materials)]
        made += [] if self.a is None else ["dilatation"]
        return made + ([] if self.damage is None else [f"damage {type(self.damage).__name__}"])

    @property
    def stiffness(self) -> Float:
        """Return ``mu k`` of every bond (n_bonds,) [force / length]."""
        return self.k if self.damage is None else self.integrity * self.k

    def elongation(self, u_local: Float) -> tuple[Float, float]:
        """Return ``e`` (n_bonds,) [length] for displacements with ghosts, and the least current length of a bond."""
        e = np.empty(len(self.families.neighbours))
        kernel = elongation_kernel(self.dim, self.finite)
        least = kernel(self.families.indptr, self.families.neighbours, self.cloud.x, u_local, e)
        return e, float(least)

    def elongation_rate(self, u_local: Float, du_local: Float) -> Float:
        """Return ``de`` (n_bonds,) [length] in the direction ``du`` at ``u``, both with ghosts."""
        de = np.empty(len(self.families.neighbours))
        kernel = elongation_rate_kernel(self.dim, self.finite)
        kernel(self.families.indptr, self.families.neighbours, self.cloud.x, u_local, du_local, de)
        return de

    def tension(self, e: Float) -> Float:
        """Return the tension of every bond of every own particle (n_bonds,) [force] for elongations e."""
        t = self.stiffness * e
        if self.a is not None:
            assert self.B is not None
            t += self.a * (self.B * self.dilatation(e))[self.families.centres]
        return t

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
        e, least = self.elongation(u_local)
        if self.finite and int(total(self.cloud.comm, int(least <= 0.0))):
            return None
        return self.gather(self.bond_forces(u_local, self.tension(e)))

    def all_admissible(self, u: Float) -> bool:
        """Return whether no bond has lost its length on any rank."""
        if not self.finite:
            return True
        return int(total(self.cloud.comm, int(self.elongation(self.with_ghosts(u))[1] <= 0.0))) == 0

    def linearised(self, u: Float) -> Linearised:
        """Return ``du -> K du`` with the directions and tensions at u."""
        u_local = self.with_ghosts(u).copy()
        tension = self.tension(self.elongation(u_local)[0]) if self.finite else np.empty(0)

        def times(du: Float) -> Float:
            du_local = self.with_ghosts(du)
            f = self.bond_forces(u_local, self.tension(self.elongation_rate(u_local, du_local)))
            if self.finite:
                family = self.families
                kernel = turning_force_kernel(self.dim)
                kernel(family.indptr, family.neighbours, self.cloud.x, u_local, tension, du_local, f)
            return self.gather(f)

        return times

    def energy(self, u: Float) -> tuple[float, float]:
        """Return the strain energy of the body and 0 [energy]."""
        volume = self.cloud.volume[: self.cloud.n_owned]
        return float(total(self.cloud.comm, volume @ self.energy_density(u))), 0.0

    def commit(self, u: Float) -> None:
        """Do nothing: the integrity changes where ``break_bonds`` or a solver changes it."""

    @property
    def has_history(self) -> bool:
        """Return whether bonds can fail."""
        return self.damage is not None

    @property
    def kappa(self) -> float:
        """Return the largest ``lambda + 2 mu / dim`` of the materials [stress]."""
        return max(elastic.bulk_like_modulus(self.dim) for elastic in self._elastic)

    @property
    def largest_modulus(self) -> float:
        """Return the largest ``lambda + 2 mu`` of the materials times the largest factor on this rank [stress]."""
        lame = [elastic.lame(self.dim) for elastic in self._elastic]
        return max(lam + 2.0 * mu for lam, mu in lame) * float(self._factor.max(initial=0.0))

    def break_bonds(self, u: Float) -> int:
        """Break the bonds most beyond their critical stretch, and those within 1e-8 of them; return how many pairs."""
        if self.damage is None:
            return 0
        if self.damage.final_ratio > 1.0:
            raise CaseError("Newton and relaxation take bonds that snap; softening bonds need the event-driven solver.")
        e, _ = self.elongation(self.with_ghosts(u))
        over = np.where(self.integrity > 0.0, e / self.limit, 0.0)
        most = largest(self.cloud.comm, float(over.max(initial=0.0)))
        if most <= 1.0:
            return 0
        broken = over >= max(1.0, most * (1.0 - TOGETHER))
        self.integrity[broken] = 0.0
        return int(total(self.cloud.comm, np.count_nonzero(broken))) // 2

    def dissipated_energy(self) -> float:
        """Return what bonds have dissipated in failing [energy]."""
        if self.damage is None:
            return 0.0
        return float(total(self.cloud.comm, self.damage.dissipated(self.integrity, self.k, self.limit).sum()))

    def local_damage(self) -> Float:
        """Return the lost share of the stiffness of each own particle's bonds (n_owned,) [-] (not collective)."""
        if self.damage is None:
            return np.zeros(self.cloud.n_owned)
        centres, n = self.families.centres, self.cloud.n_owned
        whole = np.bincount(centres, self.k, n)
        return np.asarray(1.0 - np.bincount(centres, self.k * self.integrity, n) / np.where(whole > 0.0, whole, 1.0))

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
        K = _sum_by(centres, np.einsum("b,bi,bj->bij", weight, xi, xi), self.cloud.n_owned)
        N = _sum_by(centres, np.einsum("b,bi,bj->bij", weight, eta, xi), self.cloud.n_owned)
        return np.asarray(np.eye(self.dim) + N @ np.linalg.pinv(K, rcond=1e-10, hermitian=True))

    def first_piola_stress(self, u: Float) -> Float:
        """Return ``P_i = sum_j t_ij n (x) xi / V_i`` (n_owned, dim, dim) [stress]: dW/dF in uniform deformation."""
        u_local = self.with_ghosts(u)
        centres, neighbours = self.families.centres, self.families.neighbours
        t = self.tension(self.elongation(u_local)[0])
        xi = self.families.bonds(self.cloud.x)
        y = xi + self.finite * (u_local[neighbours] - u_local[centres])
        n = y / np.linalg.norm(y, axis=1)[:, None]
        moment = _sum_by(centres, np.einsum("b,bi,bj->bij", t, n, xi), self.cloud.n_owned)
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

    def energy_density(self, u: Float) -> Float:
        """Return the strain energy density of the own particles (n_owned,) [energy / volume]."""
        e, _ = self.elongation(self.with_ghosts(u))
        n = self.cloud.n_owned
        psi = np.bincount(self.families.centres, 0.5 * self.stiffness * e**2, n)
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

    @cached_property
    def ordered_ends(self) -> tuple[LocalIndex, LocalIndex]:
        """Return both ends of every bond, that with the lower key first: the same from both (not collective)."""
        order, centres, neighbours = self.cloud.order, self.families.centres, self.families.neighbours
        low = order[centres] <= order[neighbours]
        return np.where(low, centres, neighbours), np.where(low, neighbours, centres)

    def _combine(self, bonds: Neighbourhood, materials: Sequence[BondMaterial], material_of: LocalIndex) -> None:
        """Take the constants of each bond from the material of its centre (collective)."""
        n_bonds, n = len(bonds.omega), bonds.cloud.n_owned
        parts = [material.stiffness(bonds) for material in materials]
        self.k: Float = np.zeros(n_bonds)
        self.a: Float | None = None if all(part.a is None for part in parts) else np.zeros(n_bonds)
        self.B: Float | None = None if self.a is None else np.zeros(n)
        centres = bonds.families.centres
        for number, part in enumerate(parts):
            mine, own = material_of[centres] == number, material_of == number
            self.k[mine] = part.k[mine] * self._factor[centres[mine]]
            if part.a is not None and part.B is not None and self.a is not None and self.B is not None:
                self.a[mine] = part.a[mine]
                self.B[own] = part.B[own] * self._factor[own]

    def _limits(self, damage: BondDamage) -> Float:
        """Return the critical elongation of every bond (n_bonds,) [length], the same from both of its ends."""
        x = self.cloud.x
        if self.a is not None:
            raise CaseError("Bond damage takes bond-based materials; LinearSolid has no damage.")
        one, other = self.ordered_ends
        middle = 0.5 * (x[one] + x[other])
        if self.cloud.images is not None:
            home = np.concatenate([np.zeros((self.cloud.n_owned, self.dim)), self.cloud.offset])
            middle -= home[one]
        with agreed(self.cloud.comm):
            stretch = damage.critical(self._bonds.length, middle)
            bad = np.flatnonzero(~(np.isfinite(stretch) & (stretch > 0.0)))
            if len(bad):
                length, value = self._bonds.length[bad[0]], stretch[bad[0]]
                raise CaseError(
                    f"The critical stretch of a bond of length {length:g} is {value:g}; it must be positive."
                )
        return np.asarray(stretch * self._bonds.length)


class BondAssembler(Assembler):
    """Rows of bonds: a particle couples to its family alone."""

    model: BondModel

    def __init__(self, model: BondModel) -> None:
        self.model = model
        self._start(2 * np.arange(len(model.families.neighbours) + 1, dtype=np.int64), _ends(model))

    def assemble_particles(self, u: Float, diag: Float, off: Float) -> None:
        """Write the rows of the own particles."""
        diag[:] = 0.0
        off[:] = 0.0
        self._ghost[:] = 0.0
        u_local = self.model.with_ghosts(u)
        tension = self.model.tension(self.model.elongation(u_local)[0])
        self._add_bonds(u_local, tension, diag, off)
        self.pattern.complete(self._ghost, diag, off, self.model.dim)

    def _start(self, point_ptr: GlobalIndex, members: LocalIndex) -> None:
        model = self.model
        self.pattern = build_pattern(model.cloud, point_ptr, members)
        self._ends = _ends(model)
        ends_ptr = 2 * np.arange(len(model.families.neighbours) + 1, dtype=np.int64)
        self._by_particle = transpose(ends_ptr, self._ends, model.cloud.n_local)
        self._ghost = np.empty(model.dim**2 * int(self.pattern.ghost.diag_ptr[-1]))

    def _add_bonds(self, u_local: Float, tension: Float, diag: Float, off: Float) -> None:
        model, pattern = self.model, self.pattern
        kernel = bond_rows_kernel(model.dim, model.finite)
        for rows, own in ((pattern.owned, diag), (pattern.ghost, self._ghost)):
            kernel(
                rows.first, rows.diag_ptr, rows.off_ptr, rows.columns, *pattern.locals_of_columns, *self._by_particle,
                self._ends, model.cloud.x, u_local, model.stiffness, tension, own, off,
            )  # fmt: skip


class DilatationAssembler(BondAssembler):
    """Rows of bonds and of the dilatation, ``sum_i B_i grad theta_i (x) grad theta_i``, which reaches two horizons."""

    def __init__(self, model: BondModel) -> None:
        self.model = model
        stencils = model.with_centres
        self._start(stencils.point_ptr, stencils.members)
        self._transposed = transpose(stencils.point_ptr, stencils.members, model.cloud.n_local)

    def assemble_particles(self, u: Float, diag: Float, off: Float) -> None:
        """Write the rows of the own particles."""
        model = self.model
        assert model.a is not None and model.B is not None
        u_local = model.with_ghosts(u)
        tension = model.tension(model.elongation(u_local)[0])
        xi = model.families.bonds(model.cloud.x)
        y = xi + model.finite * (u_local[model.families.neighbours] - u_local[model.families.centres])
        bond = model.a[:, None] * y / np.linalg.norm(y, axis=1)[:, None]
        at = model.families.indptr[:-1]
        g = np.insert(bond, at, -_sum_by(model.families.centres, bond, model.cloud.n_owned), axis=0)
        one = np.eye(model.dim)
        A = np.tile(np.einsum("im,kn->imkn", one, one), (model.cloud.n_owned, 1, 1, 1, 1))
        for rows, own in ((self.pattern.owned, diag), (self.pattern.ghost, self._ghost)):
            self._dilatation_rows(rows, g, A, own, off)
        self._add_bonds(u_local, tension, diag, off)
        self.pattern.complete(self._ghost, diag, off, model.dim)

    def _dilatation_rows(self, rows: Rows, g: Float, A: Float, diag: Float, off: Float) -> None:
        model, stencils = self.model, self.model.with_centres
        assemble_kernel(model.dim)(
            rows.first, rows.diag_ptr, rows.off_ptr, rows.columns, *self.pattern.locals_of_columns, *self._transposed,
            stencils.point_ptr, stencils.members, g, model.B, A, diag, off,
        )  # fmt: skip


def _ends(model: BondModel) -> LocalIndex:
    """Return both particles of every bond one after the other, (2 n_bonds,)."""
    return np.stack([model.families.centres, model.families.neighbours], axis=1).ravel()


def _sum_by(index: LocalIndex, values: Float, n: int) -> Float:
    """Return the sums of the rows of ``values`` with the same index, (n, ...)."""
    flat = values.reshape(len(values), -1)
    sums = np.stack([np.bincount(index, column, n) for column in flat.T], axis=1)
    return np.asarray(sums.reshape(n, *values.shape[1:]))
