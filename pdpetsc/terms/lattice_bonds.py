"""Forces along bonds of a body on a lattice with shared families."""

from __future__ import annotations

from collections.abc import Callable
from functools import cached_property

import numpy as np

from pdpetsc.arrays import Float, GlobalIndex, LocalIndex, Lookup
from pdpetsc.bond_based import BondStiffness
from pdpetsc.discrete.families import Families
from pdpetsc.discrete.lattice_stencils import LatticeStencils, Part
from pdpetsc.gradient.base import GradientOperator, from_bond_weights, stencil_weights, whole_families
from pdpetsc.gradient.lattice_gradient import LatticeGradient
from pdpetsc.gradient.products import Entries, Product
from pdpetsc.kernels.lattice_stencils import (
    add_from_cells,
    rows_bond_blocks_kernel,
    rows_bond_energy_kernel,
    rows_bond_moduli_kernel,
    rows_bond_moments_kernel,
    rows_bonds_kernel,
    rows_least_length_kernel,
)
from pdpetsc.problem.body import Body
from pdpetsc.problem.material_term import MaterialTerm
from pdpetsc.problem.state import State
from pdpetsc.terms.bond_forces import BondForces


class LatticeBonds(BondForces):
    """Compute ``BondForces`` of one material without dilatation or damage, with one list of bonds per shared family.

    Parameters
    ----------
    body : Body
        Particles and bonds, with shared families.
    lattice : LatticeStencils
        Shared families.
    irregular : BondForces
        Term of ``lattice.irregular``.

    Notes
    -----
    Construction is collective.
    """

    def __init__(self, body: Body, lattice: LatticeStencils, irregular: BondForces) -> None:
        MaterialTerm.__init__(self, body)
        n = body.cloud.n_owned
        self._take(irregular.materials, np.zeros(n, dtype=np.int32), np.ones(n))
        self.horizons = 1
        own = lattice.irregular
        first = int(own.indptr[own.n])
        steps = np.concatenate(lattice.steps)
        centres = np.repeat(np.arange(own.n, own.n + lattice.n_patterns), [len(one) for one in lattice.steps])
        xi = own.cloud.x[own.neighbours[first:]] - own.cloud.x[centres]
        ptr: GlobalIndex = own.indptr[own.n :] - first
        self._lattice, self._irregular = lattice, irregular
        self._patterns = ptr, steps.astype(np.int64), xi, np.linalg.norm(xi, axis=1), irregular.k[first:].copy()
        # The rows of a pattern contain the forces of its representative.
        irregular.constants = BondStiffness(np.where(np.arange(len(irregular.k)) < first, irregular.k, 0.0))

    @cached_property
    def constants(self) -> BondStiffness:
        """Return the stiffness of all bonds, listed (not collective)."""
        families, lattice, own = self.body.families, self._lattice, self._lattice.irregular
        cell, k = lattice.grid.cell, np.empty(families.n_bonds)
        pattern = lattice.pattern_of[families.centres]
        step = cell[families.neighbours] - cell[families.centres]
        k[pattern < 0] = self._irregular.k[: own.indptr[own.n]]
        ptr, steps, _, _, stiffness = self._patterns
        for number in range(lattice.n_patterns):
            entries = slice(int(ptr[number]), int(ptr[number + 1]))
            mine = pattern == number
            k[mine] = stiffness[entries][Lookup(steps[entries]).of(step[mine])]
        return BondStiffness(k)

    @cached_property
    def _operator(self) -> GradientOperator:
        """Return the least-squares gradient of the families, zero in directions that they do not span."""
        own = self._lattice.irregular
        families = Families(own.indptr, own.neighbours)
        stencils = whole_families(own.cloud, families, self._irregular.omega * own.cloud.volume[own.neighbours])
        K = stencils.shape_tensors(own.cloud.x)
        weights = stencil_weights(stencils, own.cloud.x, np.linalg.pinv(K, rcond=1e-10, hermitian=True))
        listed = np.delete(weights, stencils.point_ptr[:-1], axis=0)
        return LatticeGradient(from_bond_weights(own.cloud, families, listed), self._lattice)

    def add_force(self, state: State, f: Float) -> None:
        """Add the forces of bonds under tension."""
        irregular = self.irregular_state(state)
        self._lattice.irregular.add(f, lambda forces: self._irregular.add_force(irregular, forces))
        self.add_row_forces(self._lattice.whole, state.u_local, None, f)

    def add_row_forces(self, part: Part, u: Float, du: Float | None, f: Float) -> None:
        """Add the forces of shared families at ``u``, or their change with ``du``, to ``f``, all (n_local, dim)."""
        if not part.rows.count:
            return
        grid, forces, (ptr, steps, xi, length, k) = self._lattice.grid, self._lattice.forces_on_cells, self._patterns
        u_cells = grid.onto(u)
        du_cells = u_cells if du is None else grid.onto(du)
        kernel = rows_bonds_kernel(self.body.dim, int(self.finite), int(du is not None))
        kernel(*part.loop, ptr, steps, xi, length, k, u_cells, du_cells, forces)
        add_from_cells(grid.cell, forces, f)

    def add_row_blocks(self, u: Float, blocks: Float) -> None:
        """Add the diagonal block of each local particle from shared families, at ``u`` (n_local, dim)."""
        part, grid = self._lattice.whole, self._lattice.grid
        kernel = rows_bond_blocks_kernel(self.body.dim, int(self.finite))
        kernel(*part.loop, grid.at, *self._patterns, grid.onto(u), blocks)

    def irregular_state(self, state: State) -> State:
        """Return the state of the particles with irregular families (collective on first use)."""
        u_local = state.u_local
        return state.kept(("irregular", id(self)), lambda: self._irregular_state(u_local))

    def _irregular_state(self, u_local: Float) -> State:
        u = u_local[self._lattice.irregular.local]
        return State(self._irregular.body, u[: self._lattice.irregular.cloud.n_owned], u_local=u)

    def admissible(self, state: State) -> bool:
        """Return True if every bond on this rank has a length above zero."""
        if not self.finite:
            return True
        part, (ptr, steps, xi, _, _) = self._lattice.whole, self._patterns
        u_cells = self._lattice.grid.onto(state.u_local)
        least = rows_least_length_kernel(self.body.dim)(*part.loop, ptr, steps, xi, u_cells)
        return self._irregular.admissible(self.irregular_state(state)) and bool(least > 0.0)

    def linearise(self, state: State) -> list[Product]:
        """Return the tangent with the directions and tensions at a state."""
        return [LatticeBondProduct(self, self._irregular, self._lattice, state)]

    def moduli(self, state: State) -> Float:
        """Compute the derivative of ``sum_j t n (x) xi`` by F (n_owned, dim, dim, dim, dim) [energy]."""
        own = self._lattice.irregular
        D = np.empty((self.body.cloud.n_owned, *(self.body.dim,) * 4))
        D[own.local[: own.n]] = self._irregular.product(self.irregular_state(state)).stiffness()[: own.n]
        self._of_rows(state, rows_bond_moduli_kernel(self.body.dim, int(self.finite)), D)
        return D

    def _of_rows(self, state: State, kernel: Callable[..., None], out: Float) -> None:
        """Write what a kernel computes for the particles with shared families to their rows of ``out``."""
        u_cells = self._lattice.grid.onto(state.u_local)
        kernel(*self._lattice.whole.loop, self._lattice.grid.at, *self._patterns, u_cells, out)

    def energy_density(self, state: State) -> Float:
        """Return the strain energy density of the own particles (n_owned,) [energy / volume]."""
        own, cloud = self._lattice.irregular, self.body.cloud
        density = np.zeros(cloud.n_owned)
        self._of_rows(state, rows_bond_energy_kernel(self.body.dim, int(self.finite)), density)
        density /= cloud.volume[: cloud.n_owned]
        density[own.local[: own.n]] = self._irregular.energy_density(self.irregular_state(state))[: own.n]
        return density

    def first_piola_stress(self, state: State) -> Float:
        """Return ``P_i = sum_j t_ij n (x) xi / V_i`` (n_owned, dim, dim) [stress]."""
        own, cloud, dim = self._lattice.irregular, self.body.cloud, self.body.dim
        P = np.zeros((cloud.n_owned, dim, dim))
        self._of_rows(state, rows_bond_moments_kernel(dim, int(self.finite)), P)
        P /= cloud.volume[: cloud.n_owned, None, None]
        P[own.local[: own.n]] = self._irregular.first_piola_stress(self.irregular_state(state))[: own.n]
        return P

    def deformation_gradient(self, state: State) -> Float:
        """Compute the least-squares gradient of the family (n_owned, dim, dim) [-], 1 in directions not spanned."""
        return np.asarray(np.eye(self.body.dim) + self._operator.gradient(state.u_local))

    def local_damage(self) -> Float:
        """Return zeros (n_owned,)."""
        return np.zeros(self.body.cloud.n_owned)


class LatticeBondProduct(Product):
    """Apply the tangent of bonds with shared families.

    Parameters
    ----------
    term : LatticeBonds
        The bonds.
    irregular : BondForces
        Term of the particles with irregular families.
    lattice : LatticeStencils
        Shared families.
    state : State
        State of the tangent.
    """

    def __init__(self, term: LatticeBonds, irregular: BondForces, lattice: LatticeStencils, state: State) -> None:
        self._term, self._lattice, self._state = term, lattice, state
        self._u = state.u_local
        self._irregular = irregular.product(term.irregular_state(state))

    def add_product(self, du: Float, f: Float, particles: LocalIndex) -> None:
        """Add the forces of all bonds of the particles."""
        part, own = self._lattice.part(particles), self._lattice.irregular
        if len(part.alone):
            own.add(f, lambda forces: self._irregular.add_product(du[own.local], forces, part.alone))
        self._term.add_row_forces(part, self._u, du, f)

    def stiffness(self) -> Float:
        """Return the derivative of ``sum_j t_ij n_ij (x) xi_ij`` by the deformation gradient of each family."""
        return self._term.moduli(self._state)

    def add_point_blocks(self, blocks: Float) -> bool:
        """Add the contributions of all bonds to the blocks of local particles (n_local, dim, dim)."""
        self._lattice.irregular.add(blocks, self._irregular.add_point_blocks)
        self._term.add_row_blocks(self._u, blocks)
        return True

    def add_rows(self, entries: Entries) -> None:
        """Add the rows of the bonds, all listed."""
        self._term.product(self._state).add_rows(entries)
