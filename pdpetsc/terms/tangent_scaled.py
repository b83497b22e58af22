"""The zero-energy control that follows a material that yields, as a term."""

from __future__ import annotations

from collections.abc import Mapping
from functools import cached_property
from typing import NamedTuple

import numpy as np

from pdpetsc.arrays import Float, GlobalIndex, LocalIndex
from pdpetsc.control.base import Control, ZeroEnergyControl
from pdpetsc.control.tangent_scaled import Yielding
from pdpetsc.gradient.base import GradientOperator, ListedProduct, SameGradient
from pdpetsc.kernels.assembly import assemble_kernel
from pdpetsc.kernels.sparsity import transpose
from pdpetsc.problem.body import Body
from pdpetsc.problem.damage import Damage
from pdpetsc.problem.state import State
from pdpetsc.problem.term import Entries, KeptArray, LinearisedTerm
from pdpetsc.terms.control import ControlForces, ControlTangent
from pdpetsc.terms.material_points import MaterialPoints
from pdpetsc.terms.softening import Softening, softening_parts


class Families(NamedTuple):
    """The families of a control at a state.

    Attributes
    ----------
    e : (n_owned,) float64
        Size of what the elastic control resists [energy^(1/2)].
    forces : (n_entries, dim) float64
        Forces of the elastic control on the members of each family [force].
    secant : Control
        The control with the stiffness that it has at the state, without the integrity that fades.
    """

    e: Float
    forces: Float
    secant: Control


class TangentScaledForces(ControlForces):
    """Forces of a control that yields with the material of each particle (``control.tangent_scaled``).

    The tangent is ``sum_i (q/e)_i M_i + b_i m_i (x) m_i`` with the matrices ``M_i`` of the families of the elastic
    control, their forces ``m_i = M_i u`` and the bend ``b_i`` of ``q(e)``.

    Parameters
    ----------
    body, name, control, damage
        As for ``ControlForces``; ``control`` is the elastic one.
    matter : MaterialPoints
        The material that it follows.
    least : float
        Share of its stiffness that it keeps at least [-].

    Notes
    -----
    Construction is collective.
    """

    def __init__(
        self, body: Body, name: str, control: Control, material_term: MaterialPoints, least: float,
        damage: Damage | None = None,
    ) -> None:  # fmt: skip
        super().__init__(body, name, control, damage)
        self._material_term, self._least = material_term, least
        self._yielding = Yielding.unloaded(body.cloud.n_owned)
        self._share = np.ones(body.cloud.n_owned)
        material_term.followers.append(self._see)

    @property
    def linear(self) -> bool:  # type: ignore[override]
        """Return False."""
        return False

    @property
    def has_history(self) -> bool:
        """Return True."""
        return True

    @cached_property
    def entries(self) -> tuple[GlobalIndex, LocalIndex]:
        """Return the families with their centre first."""
        return self._whole.stencils

    @cached_property
    def by_particle(self) -> tuple[GlobalIndex, GlobalIndex, GlobalIndex]:
        """Return their entries by particle (not collective)."""
        found: tuple[GlobalIndex, GlobalIndex, GlobalIndex] = transpose(*self.entries, self.body.cloud.n_local)
        return found

    def arrays(self) -> Mapping[str, KeptArray]:
        """Return what the families remember."""
        return {"yielding": KeptArray(np.arange(self.body.cloud.n_owned, dtype=np.int32), self._yielding.kept)}

    def at(self, state: State) -> Control:
        """Return the control with the secant stiffness of its families, and the integrity of the bonds, at a state."""
        secant, fading = self.families(state).secant, self._fading(state)
        return secant if fading is None else secant.faded(fading)

    def families(self, state: State) -> Families:
        """Return the families at a state, computed once."""

        def make() -> Families:
            u, (ptr, members) = state.u_local, self.entries
            forces = self.control.family_forces(u)
            # Relative to the centre, so that what moves the family as a whole does not round.
            eta = u[members] - np.repeat(u[members[ptr[:-1]]], np.diff(ptr), axis=0)
            doubled = np.add.reduceat(np.einsum("ei,ei->e", forces, eta), ptr[:-1])
            e = np.sqrt(np.maximum(doubled, 0.0))
            return Families(e, forces, self.control.scaled(self._yielding.secant(e)))

        changed = 0 if self.damage is None else self.damage.version
        return state.kept(("families", self.version, changed, id(self.control)), make)

    def energy(self, state: State) -> float:
        """Return the energy of the control, with what its yielding has lost."""
        e = self.families(state).e
        beyond_secant = self._yielding.energy(e) - 0.5 * self._yielding.secant(e) * e**2
        return super().energy(state) + float(beyond_secant.sum())

    def linearised(self, state: State) -> LinearisedTerm:
        """Return the tangent of the secant, of its change, and of the integrity where it fades."""
        families, fading = self.families(state), self._fading(state)
        softening: list[Softening] = []
        if fading is not None and self.damage is not None and self.damage.bonds.softens:
            gradient = self.damage.gradient(state)
            v, opposite = families.secant.bond_forces(state.u_local), self.damage.damageable.opposite
            softening = softening_parts(state, gradient, v, opposite.of_vectors)
        faded = None if fading is None else self.control.faded(fading).family_forces(state.u_local)
        return TangentScaledTangent(
            self, self.at(state), softening, self._yielding.bend(families.e), families.forces, faded
        )

    def commit(self, state: State) -> None:
        """Take the sizes at a state for good, and the slope ahead from the material as it was found there."""
        self._yielding.commit(self.families(state).e, np.clip(self._share, self._least, 1.0))
        self.version += 1

    def _see(self, state: State) -> None:
        """Note the tangent modulus of a state that the material is about to take for good."""
        self._share = self._material_term.tangent_share(state)

    def _fading(self, state: State) -> Float | None:
        return None if self.damage is None else self._effect.fading(self.damage.phi(state))


class TangentScaledTangent(ControlTangent):
    """The tangent of a control that follows: that of its secant, and ``b_i h_i (x) m_i`` of every family.

    Parameters
    ----------
    term, control, falling
        As for ``ControlTangent``, of the secant.
    bend : (n_owned,) float64
        ``b_i`` [1 / energy].
    m : (n_entries, dim) float64
        ``m_i``, forces of the elastic control [force].
    h : (n_entries, dim) float64 or None
        ``h_i``, forces with the integrity that fades [force]; ``m_i`` where None.
    """

    def __init__(
        self, term: TangentScaledForces, control: Control, softening: list[Softening], bend: Float,
        m: Float, h: Float | None,
    ) -> None:  # fmt: skip
        super().__init__(term, control, softening)
        self._families = term
        n, dim = len(bend), term.body.dim
        ptr, members = term.entries
        one = np.eye(dim)
        self._A = np.tile(np.einsum("im,kn->imkn", one, one), (n, 1, 1, 1, 1))
        self._operator = GradientOperator(np.arange(n, dtype=np.int32), ptr, members, m, bend)
        self._h = m if h is None else h
        self._product = ListedProduct(self._operator, self._A, h)

    def add_product(self, du: Float, f: Float, particles: LocalIndex) -> None:
        """Add the forces of both."""
        super().add_product(du, f, particles)
        self._product.add(particles, du, f)

    def add_rows(self, entries: Entries) -> None:
        """Add the rows of both (collective)."""
        super().add_rows(entries)
        operator, sparsity = self._operator, entries.sparsity
        for rows, own in entries.row_sets():
            assemble_kernel(self._families.body.dim)(
                rows.first, rows.diag_ptr, rows.off_ptr, rows.columns, *sparsity.locals_of_columns,
                *self._families.by_particle, operator.point_ptr, operator.members, self._h, operator.g,
                operator.volume, self._A, own, entries.off,
            )  # fmt: skip

    def add_point_blocks(self, blocks: Float) -> bool:
        """Add those of both."""
        known = super().add_point_blocks(blocks)
        if known:
            self._product.add_point_blocks(blocks)
        return known

    def shared_gradient(self, operator: GradientOperator) -> SameGradient | None:
        """Return None: its forces are not those of the secant alone."""
        return None


def control_forces(
    declared: ZeroEnergyControl,
    body: Body,
    control: Control,
    material_term: MaterialPoints,
    damage: Damage | None = None,
) -> ControlForces:
    """Return the term of a built control: one that yields with the material where it is declared to (collective)."""
    name = type(declared).__name__
    if declared.least_share is None:
        return ControlForces(body, name, control, damage)
    return TangentScaledForces(body, name, control, material_term, declared.least_share, damage)
