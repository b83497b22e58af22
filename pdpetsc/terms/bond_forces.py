"""Term of materials whose forces act along bonds."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from functools import cached_property

import numpy as np

from pdpetsc.arrays import Float, GlobalIndex, LocalIndex, Mask
from pdpetsc.bond_based import BondMaterial, BondStiffness, Neighbourhood, combine
from pdpetsc.discrete.sparsity import sharing_stencil
from pdpetsc.errors import CaseError
from pdpetsc.gradient import Correspondence
from pdpetsc.gradient.base import StencilMembers
from pdpetsc.gradient.products import Entries, Product, RankOneProduct
from pdpetsc.kernels.bonds import bond_force_kernel, bond_rows_kernel
from pdpetsc.kernels.point_blocks import bond_blocks_kernel
from pdpetsc.kernels.sparsity import sum_by
from pdpetsc.kernels.tangent import bond_moduli_kernel, bond_times_kernel
from pdpetsc.material import LinearElastic, SaintVenantKirchhoff
from pdpetsc.problem.body import Body
from pdpetsc.problem.damage import Damage
from pdpetsc.problem.material_term import MaterialTerm
from pdpetsc.problem.state import State
from pdpetsc.terms.damaged_points import DamagedPoints
from pdpetsc.terms.softening import softening_dilatation, softening_nonlocal


class BondForces(MaterialTerm):
    """Compute forces of ``sum_ij 1/2 mu_ij k_ij e_ij^2 + sum_i 1/2 B_i theta_i^2``, theta_i = sum_j mu_ij a_ij e_ij.

    A pair of particles contributes from both ends. The degradation factor ``mu`` is 1 without damage. At a fixed
    degradation factor, the forces are the derivative of this energy.

    Parameters
    ----------
    body : Body
        Particles and bonds.
    bonds : Neighbourhood
        Properties of the bonds for the materials.
    materials : sequence of BondMaterial
        Materials of the body, of one kinematics.
    material_of : (n_owned,) int
        Index into ``materials`` of each own particle.
    factor : (n_owned,) float64, optional
        Factor on the moduli of each own particle [-].

    Raises
    ------
    CaseError
        The materials do not fit together or the dimension, or depend on temperature; raised on every rank.

    Notes
    -----
    Construction is collective.
    """

    def __init__(
        self, body: Body, bonds: Neighbourhood, materials: Sequence[BondMaterial], material_of: LocalIndex,
        factor: Float | None = None,
    ) -> None:  # fmt: skip
        super().__init__(body)
        if len({material.kinematics for material in materials}) > 1:
            raise CaseError("All materials of a body need the same kinematics, small or finite.")
        if any(thermal is not None and thermal.softens for thermal in body.thermals or ()):
            raise CaseError(
                "The stiffness of bonds does not depend on temperature; leave the factor of Thermal out, or take a "
                "material of deformation gradients."
            )
        self._bonds = bonds
        self._take(materials, material_of, np.ones(body.cloud.n_owned) if factor is None else factor)
        self.horizons = 1 if self.a is None else 2

    def _take(self, materials: Sequence[BondMaterial], material_of: LocalIndex, factor: Float) -> None:
        """Store the materials of the own particles."""
        self.materials, self.material_of, self.factor = materials, material_of, factor
        self.finite = materials[0].kinematics == "finite"
        self.damage: Damage | None = None
        # Gradient points for the driving variable, if it needs them.
        self._driving: DamagedPoints | None = None
        # Bonds that keep their elastic stiffness in compression, at any damage (n_bonds,); None if no law closes
        # cracks.
        self._closing: Mask | None = None
        # Whether bonds depend on more than their own elongation because of damage.
        self._is_nonlocal = False
        self._elastic = [material.elastic(self.body.dim) for material in materials]

    @cached_property
    def constants(self) -> BondStiffness:
        """Return the stiffness of bonds and particles (collective on first use)."""
        return combine(self._bonds, self.materials, self.material_of, self.factor)

    @property
    def k(self) -> Float:
        """Return the stiffness of every bond (n_bonds,) [force / length]."""
        return self.constants.k

    @property
    def a(self) -> Float | None:
        """Return the weights of elongations in the dilatation (n_bonds,) [1 / length]; None without dilatation."""
        return self.constants.a

    @property
    def B(self) -> Float | None:
        """Return the stiffness of the dilatation of each own particle (n_owned,) [energy]; None without dilatation."""
        return self.constants.B

    @property
    def omega(self) -> Float:
        """Return the influence of every bond (n_bonds,) [-]."""
        return self._bonds.omega

    def take_damage(self, damage: Damage) -> None:
        """Bind the damage of the bonds (collective).

        Raises
        ------
        CaseError
            The driving variable does not fit bonds, or needs gradients for which a family is too small; raised on every
            rank.
        """
        if damage.driving_variable.reads_flow:
            raise CaseError(
                "Plastic strain drives damage, and bonds do not flow; take a body of deformation gradients."
            )
        self._closing = damage.bonds.laws.closing
        if self._closing is not None and self.a is not None:
            raise CaseError(
                "closes=True requires bond-based materials, because a dilatation is that of the whole family. Use "
                "BondBased, or leave closes out."
            )
        self.damage = damage
        if damage.driving_variable.reads_points:
            # Gradient over the unbroken bonds, with the elastic material that the bonds represent.
            kind = SaintVenantKirchhoff if self.finite else LinearElastic
            solids = [kind(one.E, one.nu, one.plane) for one in self._elastic]
            scheme, of, factor = Correspondence(), self.material_of, self.factor
            self._driving = DamagedPoints(self.body, self.omega, scheme, solids, of, factor, damage)
        self._is_nonlocal = damage.driving_variable.is_nonlocal
        # The force of each bond is then a function of its own elongation. A bond that snaps jumps to another energy.
        gradual = damage.softens and not (damage.reversible or damage.bonds.laws.snaps)
        damage.forces_have_energy = gradual and self.symmetric
        self.horizons = 2 if self._is_nonlocal or self.a is not None else 1

    # Bonds need no gradient points.
    n_points = 0

    @property
    def parts(self) -> list[str]:
        """Return the names of its parts."""
        made = [f"bonds {type(material).__name__}" for material in self.materials]
        return made + ([] if self.a is None else ["dilatation"])

    @property
    def piecewise_linear(self) -> bool:
        """Return True if bonds keep their directions, and their stiffness in compression."""
        return not self.finite and self._closing is None

    @property
    def linear(self) -> bool:  # type: ignore[override]
        """Return True if bonds also keep their degradation factor while the displacement changes."""
        return self.piecewise_linear and (self.damage is None or not self.damage.bonds.softens)

    @property
    def driving_points(self) -> DamagedPoints | None:
        """Return the gradient points of the driving variable; None if there are none."""
        return self._driving

    def bonds_changed(self, rebuild: bool) -> None:
        """Update the gradient points of the driving variable."""
        if self._driving is not None:
            self._driving.bonds_changed(rebuild)

    @property
    def symmetric(self) -> bool:  # type: ignore[override]
        """Return True if degradation factors depend on the elongation of their bond and scale its force only."""
        fades = self.damage is not None and self.damage.softens
        return not self._is_nonlocal and not (fades and self.a is not None)

    @property
    def stencils(self) -> tuple[GlobalIndex, LocalIndex] | None:
        """Return the bonds; the families if there is a dilatation or a nonlocal driving variable."""
        if self.a is not None or self._is_nonlocal:
            return self.body.with_centres.point_ptr, self.body.with_centres.members
        return self.bonds.point_ptr, self.bonds.members

    @property
    def whole_families(self) -> bool:
        """Return True if there is a dilatation."""
        return self.a is not None

    @cached_property
    def bonds(self) -> StencilMembers:
        """Return both particles of every bond."""
        centres, neighbours = self.body.families.centres, self.body.families.neighbours
        ends = np.stack([centres, neighbours], axis=1).ravel()
        return StencilMembers(centres, 2 * np.arange(len(neighbours) + 1, dtype=np.int64), ends)

    def elongation(self, state: State) -> Float:
        """Compute the elongation of every bond (n_bonds,) [length]."""
        return state.elongated(self.finite)[0]

    def secant(self, state: State) -> Float:
        """Compute ``phi k`` of every bond (n_bonds,) [force / length]; k for a shortened bond if cracks close."""
        if self.damage is None:
            return self.k
        T = self.damage.phi(state)
        if self._closing is not None:
            T = np.where(self._closing & (self.elongation(state) < 0.0), 1.0, T)
        return np.asarray(self.k * T)

    def tangent(self, state: State) -> Float:
        """Compute ``dt/de`` of every bond at the dilatation of its particle (n_bonds,) [force / length]."""
        if self.damage is None:
            return self.k
        gradient = self.damage.gradient(state)
        rate = np.array(self.secant(state))
        rate[gradient.bonds] += gradient.along * self._whole_tension(state)[gradient.bonds]
        return rate

    def _softening(self, state: State) -> list[Product]:
        """Return the parts of the tangent from degradation factors beyond the own force of a bond.

        They exist if a degradation factor depends on more than the elongation of the bond, or if there is a dilatation.
        """
        if self.damage is None or not (self._is_nonlocal or (self.a is not None and self.damage.bonds.softens)):
            return []
        gradient, families = self.damage.gradient(state), self.body.families
        bonds = gradient.bonds
        y = families.bonds(self.body.cloud.x) + self.finite * families.bonds(state.u_local)
        n = y / np.linalg.norm(y, axis=1)[:, None]
        v = self._whole_tension(state)[:, None] * n
        found = softening_nonlocal(self.body, gradient, v, self.damage.bonds.of.opposite.of_vectors)
        a = self.shares(state)
        if a is not None and self.a is not None and self.B is not None:
            force = (a * self.B[families.centres])[:, None] * n
            share = (self.a * self.elongation(state))[bonds]
            found.append(softening_dilatation(self.body, gradient, force, n, share))
        return found

    def shares(self, state: State) -> Float | None:
        """Return the weights of elongations in the dilatation, times ``phi`` of the bonds (n_bonds,) [1 / length]."""
        if self.a is None or self.damage is None:
            return self.a
        return np.asarray(self.damage.phi(state) * self.a)

    def _whole_tension(self, state: State) -> Float:
        """Return the derivative of the tension by ``phi`` of the bond, at constant dilatation (n_bonds,) [force]."""
        e = self.elongation(state)
        t = self.k * (e if self._closing is None else np.where(self._closing, np.maximum(e, 0.0), e))
        if self.a is None or self.B is None:
            return t
        return np.asarray(t + self.a * (self.B * self.dilatation(state))[self.body.families.centres])

    def tension(self, state: State) -> Float:
        """Compute the tension of every bond of every own particle (n_bonds,) [force]."""
        t, a = self.secant(state) * self.elongation(state), self.shares(state)
        if a is None or self.B is None:
            return t
        return np.asarray(t + a * (self.B * self.dilatation(state))[self.body.families.centres])

    def dilatation(self, state: State) -> Float:
        """Compute ``theta`` of the own particles (n_owned,) [-]; zeros for a material without dilatation."""
        a = self.shares(state)
        if a is None:
            return np.zeros(self.body.cloud.n_owned)
        return self.body.families.sums(a * self.elongation(state))

    def admissible(self, state: State) -> bool:
        """Return True if every bond on this rank has a length above zero."""
        least = state.elongated(self.finite)[1]
        return not self.finite or least > 0.0

    def add_force(self, state: State, f: Float) -> None:
        """Add the forces of bonds under tension."""
        families = self.body.families
        kernel = bond_force_kernel(self.body.dim, int(self.finite))
        u_local = state.u_local
        kernel(families.indptr, families.neighbours, self.body.cloud.x, u_local, self.tension(state), f)

    def linearise(self, state: State) -> list[Product]:
        """Return the tangent with the directions and tensions at a state."""
        return [self.product(state), *self._softening(state)]

    def product(self, state: State) -> BondProduct:
        """Return the tangent of the bonds at a state, without the effect of ``phi`` on other forces."""
        a, none = self.shares(state), np.empty(0)
        dilatation = (none, none) if a is None or self.B is None else (a, self.B)
        of_bonds = self.tangent(state), self.secant(state), self.tension(state)
        return BondProduct(self.body, self.finite, state.u_local, self.bonds, *of_bonds, *dilatation)

    def energy(self, state: State) -> float:
        """Compute the energy of the bonds."""
        return float(self.body.cloud.volume[: self.body.cloud.n_owned] @ self.energy_density(state))

    @property
    def has_history(self) -> bool:
        """Return True if bonds can fail."""
        return self.damage is not None

    def contact_modulus(self, particles: LocalIndex | GlobalIndex, friction: bool) -> float:
        """Return the largest ``lambda + 2 mu / dim`` times factor of own particles, with friction or without."""
        return self._largest(lambda elastic: elastic.bulk_like_modulus(self.body.dim), particles)

    @property
    def largest_modulus(self) -> float:
        """Return the largest ``lambda + 2 mu`` times factor of the materials on this rank [stress]."""

        def modulus(elastic: LinearElastic) -> float:
            lam, mu = elastic.lame(self.body.dim)
            return lam + 2.0 * mu

        return self._largest(modulus)

    def _largest(
        self, modulus: Callable[[LinearElastic], float], particles: LocalIndex | GlobalIndex | slice = slice(None)
    ) -> float:
        """Return the largest modulus times factor of own particles, by default of all [stress]."""
        moduli = np.array([modulus(elastic) for elastic in self._elastic])
        return float((moduli[self.material_of] * self.factor)[particles].max(initial=0.0))

    def dissipation_density(self) -> Float | None:
        """Compute the dissipation of failing bonds, half of it at each end (n_owned,) [energy / volume].

        None if the driving variable does not determine it (not collective).
        """
        cloud = self.body.cloud
        if self.damage is None:
            return np.zeros(cloud.n_owned)
        spent = None if self.a is not None else self.damage.dissipated(self.k)
        if spent is None:
            return None
        return np.asarray(self.body.families.sums(spent) / cloud.volume[: cloud.n_owned])

    def local_damage(self) -> Float:
        """Compute the lost share of the stiffness of the bonds of each own particle (n_owned,) [-] (not collective)."""
        whole = self.body.families.sums(self.k)
        left = whole if self.damage is None else self.body.families.sums(self.k * self.damage.bonds.phi)
        return np.asarray(1.0 - left / np.where(whole > 0.0, whole, 1.0))

    def deformation_gradient(self, state: State) -> Float:
        """Compute the least-squares gradient of the family (n_owned, dim, dim) [-], 1 in directions not spanned."""
        return np.eye(self.body.dim) + self.slopes(state.u_local)

    def slopes(self, values: Float, intact: Mask | None = None) -> Float:
        """Compute the slopes of best fit over families of values of local particles (n_local, k): (n_owned, k, dim).

        They are 0 in directions not spanned. By default all bonds count.
        """
        cloud, families = self.body.cloud, self.body.families
        xi = families.bonds(cloud.x)
        weight = self.omega * cloud.volume[families.neighbours] * (1.0 if intact is None else intact)
        K = sum_by(families.centres, np.einsum("b,bi,bj->bij", weight, xi, xi), cloud.n_owned)
        N = sum_by(families.centres, np.einsum("b,bc,bj->bcj", weight, families.bonds(values), xi), cloud.n_owned)
        return np.asarray(N @ np.linalg.pinv(K, rcond=1e-10, hermitian=True))

    def first_piola_stress(self, state: State) -> Float:
        """Compute ``P_i = sum_j t_ij n (x) xi / V_i`` (n_owned, dim, dim) [stress]: dW/dF in uniform deformation."""
        cloud, families = self.body.cloud, self.body.families
        xi = families.bonds(cloud.x)
        y = xi + self.finite * families.bonds(state.u_local)
        n = y / np.linalg.norm(y, axis=1)[:, None]
        moment = sum_by(families.centres, np.einsum("b,bi,bj->bij", self.tension(state), n, xi), cloud.n_owned)
        return np.asarray(moment / cloud.volume[: cloud.n_owned, None, None])

    def cauchy_stress(self, state: State) -> Float:
        """Compute ``P F^T / J`` (n_owned, dim, dim) [stress], hidden stretches to first order; P if linear."""
        P = self.first_piola_stress(state)
        if self.linear:
            return P
        F = self.deformation_gradient(state)
        J = np.linalg.det(F) * self._hidden_stretch(F, state)
        return np.asarray(np.einsum("pik,pjk->pij", P, F) / J[:, None, None])

    def out_of_plane(self, state: State) -> tuple[Float, Float, Float]:
        """Return stretch, P and Cauchy stress normal to a plane or line body (n_owned,), for small normal strain.

        In plane strain the stress is Poisson's ratio times the trace of that in the plane.
        """
        dim, expansion = self.body.dim, state.expansion
        across = self._hidden_stretch(self.deformation_gradient(state), state)
        strained = [elastic.nu if dim == 2 and elastic.plane == "strain" else 0.0 for elastic in self._elastic]
        ratio = np.array(strained)[self.material_of]
        P, sigma = self.first_piola_stress(state), self.cauchy_stress(state)
        traces = [ratio * np.einsum("pii->p", stress) for stress in (P, sigma)]
        if expansion is not None:
            young = np.array(
                [elastic.E if elastic.plane == "strain" and dim == 2 else 0.0 for elastic in self._elastic]
            )
            held = (young[self.material_of] * self.factor) * expansion.strain[:, 2, 2]
            traces = [trace - held for trace in traces]
        if dim == 1:  # the product of two equal stretches
            across = 1.0 + 0.5 * (across - 1.0) if not self.finite else np.sqrt(across)
        return across, traces[0], traces[1]

    def _hidden_stretch(self, F: Float, state: State) -> Float:
        """Compute the product of the stretches normal to the body (n_owned,) from F (n_owned, dim, dim).

        It is of first order (collective).
        """
        dim, expansion = self.body.dim, state.expansion
        elastic = F if expansion is None else F - expansion.in_body()
        stretch = np.array([one.thickness_stretch(elastic) for one in self._elastic])
        across = stretch[self.material_of, np.arange(len(F))]
        if expansion is not None:
            free = [float(dim == 1 or (dim == 2 and one.plane == "stress")) for one in self._elastic]
            hidden = expansion.strain[:, range(dim, 3), range(dim, 3)].sum(axis=1)
            across = across + np.array(free)[self.material_of] * hidden
        return np.asarray(across)

    def energy_density(self, state: State) -> Float:
        """Compute the strain energy density of the own particles (n_owned,) [energy / volume]."""
        psi = self.body.families.sums(0.5 * self.secant(state) * self.elongation(state) ** 2)
        if self.B is not None:
            psi += 0.5 * self.B * self.dilatation(state) ** 2
        return np.asarray(psi / self.body.cloud.volume[: self.body.cloud.n_owned])

    def uniform_stress_force(self, P: Float) -> Float:
        """Raise CaseError: a bond has no access to the stress of its particle."""
        raise CaseError('Bonds have no consistent traction; use distribution="layer", or a correspondence material.')

    def dependents(self, marked: Float) -> Mask:
        """Return the own particles in a family with a marked local particle (collective)."""
        whole = self.body.with_centres
        return sharing_stencil(self.body.cloud, whole.point_ptr, whole.members, marked)


class BondProduct(Product):
    """Apply the stiffness along bonds, the rotation of their tension, and the dilatation, over two horizons.

    Parameters
    ----------
    body : Body
        The body.
    finite : bool
        Whether bonds rotate.
    u : (n_local, dim) float64
        Displacements at which directions are evaluated [length].
    bonds : StencilMembers
        Both ends of every bond.
    tangent, secant : (n_bonds,) float64
        ``dt/de`` [force / length], and the secant, which is not negative, for preconditioners.
    tension : (n_bonds,) float64
        Tension [force].
    a, B : (n_bonds,), (n_owned,) float64
        Weights of elongations in the dilatation [1 / length], and its stiffness [energy]; empty without dilatation.
    """

    def __init__(
        self, body: Body, finite: bool, u: Float, bonds: StencilMembers, tangent: Float, secant: Float, tension: Float,
        a: Float, B: Float,
    ) -> None:  # fmt: skip
        self._body, self._finite, self._u, self._bonds = body, int(finite), u, bonds
        self._tangent, self._secant, self._tension, self._dilatation = tangent, secant, tension, (a, B)
        self._data = body.families.indptr, body.families.neighbours, body.cloud.x, u

    def add_product(self, du: Float, f: Float, particles: LocalIndex) -> None:
        """Add the forces of all bonds of the particles."""
        kernel = bond_times_kernel(self._body.dim, self._finite)
        kernel(particles, *self._data, self._tangent, self._tension, *self._dilatation, du, f)

    def stiffness(self) -> Float:
        """Compute the derivative of ``sum_j t_ij n_ij (x) xi_ij`` by the deformation gradient of each family.

        Softening bonds contribute their secant.
        """
        D = np.empty((self._body.cloud.n_owned, *(self._body.dim,) * 4))
        kernel = bond_moduli_kernel(self._body.dim, self._finite)
        kernel(*self._data, self._secant, self._tension, *self._dilatation, D)
        return D

    def add_point_blocks(self, blocks: Float) -> bool:
        """Add the blocks of all bonds with their secant, and of the dilatation."""
        kernel = bond_blocks_kernel(self._body.dim, self._finite)
        kernel(*self._data, self._secant, self._tension, *self._dilatation, blocks)
        return True

    def add_rows(self, entries: Entries) -> None:
        """Add the rows of bonds, and those of ``sum_i B_i grad theta_i (x) grad theta_i``."""
        body, bonds = self._body, self._bonds
        kernel = bond_rows_kernel(body.dim, self._finite)
        entries.add(kernel, bonds, bonds.members, body.cloud.x, self._u, self._tangent, self._tension)
        a, B = self._dilatation
        if len(a):
            n, families = body.cloud.n_owned, body.families
            y = families.bonds(body.cloud.x) + self._finite * families.bonds(self._u)
            each = a[:, None] * y / np.linalg.norm(y, axis=1)[:, None]
            g = np.insert(each, families.indptr[:-1], -sum_by(families.centres, each, n), axis=0)
            RankOneProduct(body.with_centres, n, g, g, B).add_rows(entries)
