"""The problem that solvers see: terms, supports and damage."""

from __future__ import annotations

from collections import Counter
from collections.abc import Iterator, Sequence

import numpy as np

from pdpetsc.arrays import Float, LocalIndex, Mask
from pdpetsc.clock import Clock
from pdpetsc.discrete.communicator import anywhere, largest, total
from pdpetsc.discrete.sparsity import build_sparsity, positions_of_own_blocks
from pdpetsc.gradient.products import ConstraintProduct, Entries, Loop, Product
from pdpetsc.problem.body import Body
from pdpetsc.problem.damage import Damage, DamageModel
from pdpetsc.problem.expansion import FreeDeformation
from pdpetsc.problem.inertia import Inertia
from pdpetsc.problem.last_step import LastStep
from pdpetsc.problem.loose_springs import LooseSprings
from pdpetsc.problem.material_term import MaterialTerm
from pdpetsc.problem.rigid_body import RigidBody
from pdpetsc.problem.solved_field import SolvedField
from pdpetsc.problem.state import State
from pdpetsc.problem.supports import Supports
from pdpetsc.problem.term import KeptArray, Term


class Problem:
    """Represent the residual ``sum of terms`` of a body with prescribed unknowns, its tangent and its energy.

    Parameters
    ----------
    body : Body
        Particles and bonds.
    material_term : MaterialTerm
        The term of the material.
    terms : sequence of Term
        The other terms: zero-energy control, loads, extra terms.
    supports : Supports
        Prescribed unknowns.
    damage : DamageModel, optional
        Damage of bonds or points.
    duration : float
        Physical time from load parameter 0 to 1 [time].

    Attributes
    ----------
    bond_damage : Damage or None
        The damage of bonds; None if bonds do not fail.
    springs : LooseSprings or None
        Term with the springs on loose particles, which solvers move; None if bonds cannot fail.
    inertia : Inertia or None
        Term with masses and velocities; None for equilibria.
    snap_inertia : Inertia or None
        Inertia of motions between equilibria; None for solvers without such motions.
    converged : float
        Load parameter of the last committed state [-].
    fields : list of SolvedField
        Fields that are solved for besides the displacement, at most one.
    last_step : LastStep or None
        Change of the displacement in the last load step. Only for a material with history or contact, without damage,
        expansion or cell.

    Notes
    -----
    Every method is collective unless stated otherwise.
    """

    def __init__(
        self,
        body: Body,
        material_term: MaterialTerm,
        terms: Sequence[Term],
        supports: Supports,
        damage: DamageModel | None = None,
        duration: float = 1.0,
    ) -> None:
        self.body = body
        self.duration = duration
        self.converged = 0.0
        self.material_term = material_term
        self.terms: list[Term] = [material_term, *terms]
        self.supports = supports
        self.damage = damage
        self.bond_damage: Damage | None = None if damage is None else damage.of_bonds
        self.springs: LooseSprings | None = None
        self.inertia: Inertia | None = None
        self.snap_inertia: Inertia | None = None
        self.fields: list[SolvedField] = []
        # Cells, expansion and damage do not continue as in the last step.
        goes_on = damage is None and body.expansion is None and not body.cloud.n_virtual
        self.last_step = LastStep(self) if goes_on and (material_term.has_history or self.touches) else None
        points = material_term.driving_points
        if self.bond_damage is not None and points is not None:
            self.bond_damage.driving_variable.take(points)
        self._last: State | None = None
        self._last_version = -1
        # Stress-free deformation, version, and the forces without strain that belong to both.
        self._unstrained: tuple[FreeDeformation | None, int, Float] | None = None

    @property
    def dim(self) -> int:
        """Return the dimension (not collective)."""
        return self.body.dim

    @property
    def linear(self) -> bool:
        """Return True if the residual is currently linear in the unknowns (not collective)."""
        return all(term.linear for term in self.terms)

    @property
    def piecewise_linear(self) -> bool:
        """Return True if the residual is linear in the unknowns as long as no bond fails (not collective)."""
        return all(term.piecewise_linear for term in self.terms)

    @property
    def symmetric(self) -> bool:
        """Return True if the tangent is symmetric (not collective)."""
        return all(term.symmetric for term in self.terms)

    @property
    def coupled(self) -> bool:
        """Return True if another field is solved together with the displacement (not collective)."""
        return any(field.monolithic for field in self.fields)

    @property
    def stiff(self) -> bool:
        """Return True if a tangent has springs that are many times stiffer than the body (not collective)."""
        return any(term.stiff for term in self.terms)

    @property
    def touches(self) -> bool:
        """Return True if there is contact (not collective)."""
        return any(term.stiff and not term.linear for term in self.terms)

    @property
    def constrained(self) -> bool:
        """Return True if the tangent has a stiff low-rank part, see ``Product.constraint`` (not collective)."""
        return any(term.constrained for term in self.terms)

    @property
    def horizons(self) -> int:
        """Return the number of horizons over which particles are coupled (not collective)."""
        return max(term.horizons for term in self.terms)

    @property
    def version(self) -> int:
        """Return a number that increases if the tangent at the same unknowns changes (not collective)."""
        return sum(term.version for term in self.terms) + (0 if self.damage is None else self.damage.version)

    @property
    def rebuilds(self) -> int:
        """Return a number that increases if bonds break or mend (not collective)."""
        return 0 if self.damage is None else self.damage.breaks

    @property
    def has_history(self) -> bool:
        """Return True if the forces depend on converged steps; the same on all ranks (not collective)."""
        return self.damage is not None or any(term.has_history for term in self.terms)

    @property
    def held(self) -> Mask:
        """Return which displacements of the own particles are prescribed or tied to the ground (not collective)."""
        held = self.supports.fixed[: self.body.cloud.n_owned].copy()
        for term in self.terms:
            if term.grounded is not None:
                held |= term.grounded
        return held

    def resisted(self, modes: Float) -> Float:
        """Return the parts of displacements (n_owned, dim) that supports and terms resist (n_owned, parts) [length]."""
        parts = [self.supports.violation(modes), *(term.resisted(modes) for term in self.terms)]
        return np.concatenate([part for part in parts if part is not None], axis=1)

    @property
    def outside(self) -> list[Term]:
        """Return the terms, besides loads, whose work on the body is not a change of their energy (not collective)."""
        terms = [term for term in self.terms if not (term.load or term.of_solver)]
        return [term for term in terms if term.works or type(term).energy is Term.energy]

    @property
    def rigid_bodies(self) -> list[tuple[Term, RigidBody]]:
        """Return the loaded rigid bodies, each with its term (not collective)."""
        return [(term, term.rigid) for term in self.terms if term.rigid is not None]

    def tool_forces(self, state: State) -> list[Float]:
        """Return the forces of moving tools at a state, by term."""
        return [term.tool_forces(state) for term in self._with_tools]

    def tool_work(self, before: State, after: State, forces: Sequence[Float], later: Sequence[Float]) -> float:
        """Return the work of tools between two states with their ``tool_forces`` on this rank [energy]."""
        terms = zip(self._with_tools, forces, later, strict=True)
        return sum(term.tool_work(one + other, before, after) for term, one, other in terms)

    @property
    def driven_tools(self) -> list[Term]:
        """Return the terms with a tool of prescribed motion (not collective)."""
        return [term for term in self.terms if term.tool_way is not None]

    def force_of_tools(self, state: State) -> Float:
        """Return the forces of rigid tools (n_rows, dim) [force]; a single zero (1,) without tools."""
        tools = self._with_tools
        return self.force_of(tools, state) if tools else np.zeros(1)

    def force_by_tools(self, state: State) -> Float:
        """Compute the derivative of the forces by the load factor, with which tools move (n_rows, dim) [force].

        A tool that moves acts as one at rest if the body, with all images, moves in the opposite direction.
        """
        cloud = self.body.cloud
        f, own = np.zeros((cloud.n_local, self.dim)), np.arange(cloud.n_owned, dtype=np.int32)
        for term in self.driven_tools:
            way = np.tile(-np.asarray(term.tool_way), (cloud.n_local, 1))
            Tangent(self.body, term.linearise(state)).forces(way, f, own)
        return self.body.gather(f)

    @property
    def _with_tools(self) -> list[Term]:
        """Return the terms of rigid tools (not collective)."""
        return [term for term in self.terms if type(term).tool_work is not Term.tool_work]

    @property
    def joined(self) -> LocalIndex:
        """Return pairs (n, 2) of local particles that terms hold together in every direction (not collective)."""
        return np.concatenate([term.joined for term in self.terms])

    @property
    def parts(self) -> list[str]:
        """Return the names of the parts of the problem, for the run record (not collective)."""
        damage = [] if self.damage is None else [f"damage {self.damage.name}"]
        return ["families", *(part for term in self.terms for part in term.parts), *damage]

    def clock(self, t: float) -> Clock:
        """Return load parameter and physical time at a load parameter (not collective)."""
        return Clock(t, t * self.duration, (t - self.converged) * self.duration, self.converged)

    def state(self, u: Float, t: float = 0.0) -> State:
        """Return the state at unknowns (n_rows, dim) and a load parameter.

        The last state is returned again if nothing has changed (collective).
        """
        last = self._last
        expansion = None if self.body.expansion is None else self.body.expansion.at(t)
        same = last is not None and last.t == t and last.expansion is expansion and np.array_equal(last.u, u)
        damaged = self._last_version != self.version
        moved, damaged = (total(self.body.cloud.comm, [int(not same), int(damaged)]) > 0).tolist()
        if last is None or moved:
            self._last = last = State(self.body, u.copy(), self.clock(t))
        elif damaged:
            self._last = last = last.after_damage(self.clock(t))
        self._last_version = self.version
        return last

    def admissible(self, state: State) -> bool:
        """Return True if the forces are defined at a state on every rank."""
        here = [term.admissible(state) for term in self.terms]
        return not anywhere(self.body.cloud.comm, not all(here))

    def internal_force(self, state: State, of_solver: bool = True) -> Float | None:
        """Return the forces of all terms except loads (n_rows, dim) [force]; None on all ranks if they are undefined.

        Without ``of_solver``, terms that only help a solver are omitted.
        """
        terms = [term for term in self.terms if not term.load and (of_solver or not term.of_solver)]
        # Exchange ghosts here, since a term might request them on one rank only.
        _ = state.u_local
        here = [term.admissible(state) for term in terms]
        if anywhere(self.body.cloud.comm, not all(here)):
            return None
        return self.force_of(terms, state)

    def external_force(self, state: State) -> Float:
        """Return the forces of loads (n_rows, dim) [force]."""
        loads = [term for term in self.terms if term.load]
        return -self.force_of(loads, state)

    def given(self, t: float) -> tuple[Float, Float]:
        """Return the prescribed displacements [length] and the loads on the undeformed body [force] (n_rows, dim)."""
        prescribed = self.supports.prescribed(t)
        return prescribed, self.external_force(self.state(np.zeros(self.supports.fixed.shape), t))

    def force_without_strain(self, t: float) -> Float | None:
        """Return the forces of the material of an expanding body at zero displacement (n_rows, dim) [force].

        None if the body does not expand. The residual is compared with these forces if neither loads nor supports act.
        """
        if self.body.expansion is None:
            return None
        state = State(self.body, np.zeros((self.body.cloud.n_rows, self.dim)), self.clock(t))
        last, version = self._unstrained, self.version
        if last is None or last[0] is not state.expansion or last[1] != version:
            self._unstrained = last = state.expansion, version, self.force_of([self.material_term], state)
        return last[2]

    def force_of(self, terms: Sequence[Term], state: State) -> Float:
        """Return the sum of the contributions of terms to the residual at an admissible state (n_rows, dim) [force]."""
        if any(term.horizons for term in terms):
            _ = state.u_local
        r = np.zeros_like(state.u)
        for term in terms:
            term.add_row_force(state, r)
        coupling = [term for term in terms if term.horizons]
        if coupling:
            f = np.zeros((self.body.cloud.n_local, self.dim))
            while coupling:
                term = coupling.pop(0)
                other = next((one for one in coupling if term.add_force_together(one, state, f)), None)
                if other is None:
                    term.add_force(state, f)
                else:
                    coupling.remove(other)
            r += self.body.gather(f)
        return r

    def linearised(self, state: State) -> Tangent:
        """Return the tangent at a state, which is applied without assembly."""
        _ = state.u_local
        products = [product for term in self.terms for product in term.linearise(state)]
        if state is self._last:
            # The state frees its memory for the moduli, so it is not cached.
            self._last = None
        return Tangent(self.body, products)

    def stiffest(self, state: State) -> Tangent:
        """Return a tangent that bounds those near a state from above: all facets that may touch a tool do."""
        _ = state.u_local
        return Tangent(self.body, [product for term in self.terms for product in term.stiffest(state)])

    def energies(self, state: State) -> dict[str, float]:
        """Return the energies of the terms by name (``Term.energy_of``: ``strain``, ``control``, ...) [energy]."""
        names = dict.fromkeys(["strain", "control", *(term.energy_of for term in self.terms)])
        sums = dict.fromkeys(names, 0.0)
        for term in self.terms:
            sums[term.energy_of] += term.energy(state)
        found = total(self.body.cloud.comm, list(sums.values()))
        return {name: float(value) for name, value in zip(sums, found, strict=True)}

    def arrays(self) -> dict[str, KeptArray]:
        """Return the arrays that a restart needs besides unknowns and bonds, by term and array name (not collective).

        Terms of the same name are numbered from the second on.
        """
        found: dict[str, KeptArray] = {}
        count: Counter[str] = Counter()
        for term in self.terms:
            name = type(term).__name__
            count[name] += 1
            unique = name if count[name] == 1 else f"{name}#{count[name]}"
            found |= {f"{unique}.{of}": array for of, array in term.arrays().items()}
        return found if self.last_step is None else {**found, **self.last_step.arrays()}

    def restored(self, t: float) -> None:
        """Continue from a load parameter, after the arrays of the terms have been read."""
        self.converged = t
        for term in self.terms:
            if term.arrays():
                term.restored()
        for _, rigid in self.rigid_bodies:
            rigid.restored()
        if self.inertia is not None:
            self.inertia.restored_at(t)

    def commit(self, state: State) -> None:
        """Commit a converged state: update all history variables."""
        if self.damage is not None:
            self.soften(state)
            self.damage.keep(state)
        for term in self.terms:
            term.before_commit(state)
        for term in self.terms:
            term.commit(state)
        for _, rigid in self.rigid_bodies:
            rigid.commit()
        if self.last_step is not None:
            self.last_step.commit(state)
        self.converged = state.t

    def start_from(self, state: State) -> None:
        """Prepare the terms for solves or time steps that start from a state."""
        for _, rigid in self.rigid_bodies:
            rigid.start_from(state.clock.before, state.t)
        for term in self.terms:
            term.start_from(state)

    @property
    def pattern(self) -> int:
        """Return a number that increases if stencils of terms change (not collective)."""
        return sum(term.pattern for term in self.terms)

    def follow(self, state: State) -> bool:
        """Update what terms hold during a solve to an equilibrium; return True if it has to be solved again."""
        return any([term.follow(state) for term in self.terms])

    def update_multipliers(self, state: State) -> bool:
        """Update the multipliers of all terms at an equilibrium; return True if it has to be solved again.

        A motion has none: multipliers that stay would push a body that leaves its tool.
        """
        if self.inertia is not None:
            return False
        return any([term.update_multipliers(state) for term in self.terms])

    def objection(self, state: State) -> str:
        """Return the reason for which a term rejects an equilibrium as the end of a step; empty if none does."""
        return next((why for why in [term.objection(state) for term in self.terms] if why), "")

    def revert(self) -> None:
        """Restore bonds, multipliers and solved fields of the last committed state."""
        self.revert_bonds()
        for term in self.terms:
            term.revert_multipliers()
        for field in self.fields:
            field.revert()

    def revert_bonds(self) -> None:
        """Restore bonds and rigid bodies of the last committed state; solved fields keep the current step."""
        for term, rigid in self.rigid_bodies:
            rigid.revert()
            term.version += 1
        if self.damage is not None:
            self._bonds_changed(rebuild=self.damage.revert())

    def advance(self, before: float, t: float) -> None:
        """Begin the step from the converged load parameter ``before`` to ``t``, and solve staggered fields."""
        self.converged = before
        for field in self.fields:
            field.advance(before, t)

    def plastic_growth(self, state: State) -> float:
        """Return the largest increase of the plastic strain if the step ends at a state [-]."""
        return largest(self.body.cloud.comm, self.material_term.plastic_growth(state))

    def break_bonds(self, state: State, most: int | None = None) -> int:
        """Break bonds beyond their final drive, about ``most`` at once, largest first; return the number of pairs.

        If no bond is beyond it, bonds break by the strain of a family, if damage evolution and driving variable allow
        it. Return 0 if bonds do not fail.
        """
        if self.damage is None:
            return 0
        broken = self.damage.break_bonds(state, most)
        if not broken and self.damage.breaks_by_family_strain:
            strain = self.material_term.family_strain(state)
            broken = 0 if strain is None else self.damage.break_families(strain, most)
        if broken:
            self._bonds_changed(rebuild=True)
        return broken

    def soften(self, state: State) -> float:
        """Accept the damage at a state; return the largest change of a degradation factor [-]."""
        assert self.damage is not None
        change = self.damage.soften(state)
        if change > 0.0:
            self._bonds_changed(rebuild=False)
        return change

    def reset_bonds(self, stored: tuple[Float, ...]) -> None:
        """Restore a stored state of the bonds (``Damage.stored``) in which the same bonds are broken."""
        assert self.damage is not None
        self.damage.reset(stored)
        self._bonds_changed(rebuild=False)

    def bonds_restored(self) -> None:
        """Update after the state of the bonds was set from outside, and commit it."""
        assert self.bond_damage is not None
        self.bond_damage.bonds.commit()
        self._bonds_changed(rebuild=True)

    def _bonds_changed(self, rebuild: bool) -> None:
        """Notify terms of bonds that have lost or regained force; if ``rebuild``, of broken or mended bonds."""
        assert self.damage is not None
        for term in self.terms:
            term.bonds_changed(rebuild)
        self.damage.version += 1
        self.damage.breaks += rebuild

    @property
    def softens(self) -> bool:
        """Return True if bonds lose their force gradually (not collective)."""
        return self.damage is not None and self.damage.softens

    def freeze(self, frozen: bool) -> None:
        """Fix damage, or let it follow the displacement (not collective)."""
        if self.damage is not None:
            self.damage.freeze(frozen)


class Tangent:
    """Represent the tangent ``K`` of a problem at a state.

    Parameters
    ----------
    body : Body
        The body.
    products : sequence of Product
        Summands of the tangent.

    Notes
    -----
    Application is collective.
    """

    def __init__(self, body: Body, products: Sequence[Product]) -> None:
        self.body = body
        self.products = list(products)
        self._loops = _loops(self.products)
        blocks = [product.blocks for product in self.products if product.blocks is not None]
        self.blocks: Float | None = np.sum(blocks, axis=0) if blocks else None

    def __call__(self, du: Float) -> Float:
        """Return ``K du`` (n_rows, dim) [force]; the next call may overwrite it."""
        found = self.body.overlap(du, self.forces)
        if self.blocks is not None:
            n = len(self.blocks)
            found[:n] += np.einsum("pij,pj->pi", self.blocks, du[:n])
        return found

    def forces(self, du: Float, f: Float, particles: LocalIndex) -> None:
        """Add the forces of the families of some own particles (not collective): all arrays (n_local, dim)."""
        for add in self._loops:
            add(du, f, particles)

    def softened(self) -> Tangent:
        """Return the tangent without its constraint; itself if there is none (not collective)."""
        if self.constraint() is None:
            return self
        return Tangent(self.body, [product for product in self.products if product.constraint() is None])

    def constraint(self) -> ConstraintProduct | None:
        """Return the stiff low-rank part of the tangent; None if there is none (not collective)."""
        return next((product.constraint() for product in self.products if product.constraint() is not None), None)

    @property
    def n_stiff(self) -> int:
        """Return the number of particles in the stencils of stiff products on this rank (not collective)."""
        stiff = [product.stiff() for product in self.products]
        return sum(product.n_entries for product in stiff if product is not None)

    def columns_of_virtual(self) -> Iterator[tuple[int, int, Float]]:
        """Yield virtual row, component and column (n_rows, dim) of each virtual unknown.

        The next iteration may overwrite the column.
        """
        cloud = self.body.cloud
        for v in range(cloud.n_virtual_global):
            for c in range(cloud.dim):
                unit = np.zeros((cloud.n_rows, cloud.dim))
                if cloud.n_virtual:
                    unit[cloud.n_owned + v, c] = 1.0
                yield v, c, self(unit)

    def stiffness(self) -> Float:
        """Return ``sum_p W_p dP/dF`` of every own particle (n_owned, dim, dim, dim, dim) [energy] (not collective)."""
        found = [D for D in (product.stiffness() for product in self.products) if D is not None]
        return np.asarray(found[0] if len(found) == 1 else np.sum(found, axis=0))

    def point_blocks(self) -> Float:
        """Return the diagonal block of each own particle (n_owned, dim, dim) [force / length].

        Softening bonds contribute their secant. Coupling of a particle with its own image is omitted (collective).
        """
        cloud, dim = self.body.cloud, self.body.dim
        found = np.zeros((cloud.n_local, dim, dim))
        unknown = [product for product in self.products if not product.add_point_blocks(found)]
        cloud.mirror(found)
        cloud.halo.reverse(found)
        blocks = found[: cloud.n_owned]
        if unknown:
            blocks += diagonal_blocks_of_rows(self.body, unknown)
        return blocks if self.blocks is None else np.asarray(blocks + self.blocks)

    def strength(self) -> Float:
        """Return the trace of ``stiffness`` (n_owned,) [energy] (not collective)."""
        found = [s for s in (product.strength() for product in self.products) if s is not None]
        return np.asarray(found[0] if len(found) == 1 else np.sum(found, axis=0))


def _loops(products: Sequence[Product]) -> list[Loop]:
    """Return the loops that add the forces of all products, two products in one loop if that is faster."""
    left = list(products)
    loops: list[Loop] = []
    while left:
        product = left.pop(0)
        loop: Loop = product.add_product
        for other in left:
            both = product.together(other)
            if both is not None:
                left.remove(other)
                loop = both
                break
        loops.append(loop)
    return loops


def diagonal_blocks_of_rows(body: Body, products: Sequence[Product]) -> Float:
    """Return the blocks on the diagonal of the rows that products add, (n_owned, dim, dim) [force / length].

    The rows are assembled for it (collective).
    """
    cloud, dim = body.cloud, body.dim
    sparsity = build_sparsity(cloud, body.with_centres.point_ptr, body.with_centres.members)
    entries = Entries.zeros(sparsity)
    for product in products:
        product.add_rows(entries)
    sparsity.complete(entries.ghost, entries.diag, entries.off, dim)
    return np.asarray(entries.diag[positions_of_own_blocks(sparsity.owned, sparsity.n_own_columns, dim)])
