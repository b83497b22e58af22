"""The zero-energy control as a term."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from pdpetsc.arrays import Float, GlobalIndex, LocalIndex
from pdpetsc.control.base import Control, ControlMatrix, Stiffness
from pdpetsc.discrete.sparsity import Sparsity
from pdpetsc.gradient.base import GradientOperator, SameGradient
from pdpetsc.material.base import Material
from pdpetsc.problem.body import Body
from pdpetsc.problem.damage import Damage
from pdpetsc.problem.state import State
from pdpetsc.problem.term import Entries, LinearisedTerm, Term
from pdpetsc.terms.softening import Softening, softening_parts


class ControlForces(Term):
    """Forces linear in the displacement that resist what the gradients do not see.

    Parameters
    ----------
    body : Body
        Particles and bonds.
    name : str
        What it is called in the record.
    control : Control
        The control of the body as it is at the start.
    damage : Damage, optional
        The bonds that fail; the control has their integrity as the effect of the damage law says.

    Notes
    -----
    Construction is collective.
    """

    horizons = 2
    energy_of = "control"

    def __init__(self, body: Body, name: str, control: Control, damage: Damage | None = None) -> None:
        self.body = body
        self.name = name
        self.damage = damage
        self._whole = control
        self.control: Control = self._whole
        self._matrix: tuple[Control, Sparsity, ControlMatrix] | None = None
        self._shared: tuple[Control, GradientOperator, SameGradient | None] | None = None
        if damage is not None:
            self._effect = damage.bonds.law.effect
            self._follow(False)
            damage.followers.append(self._follow)

    @property
    def parts(self) -> list[str]:
        """Return its name."""
        return [f"control {self.name}"]

    @property
    def linear(self) -> bool:  # type: ignore[override]
        """Return whether its forces are linear: damage does not change them together with the displacement."""
        return self.damage is None or not self.damage.bonds.softens or not self._fades

    @property
    def symmetric(self) -> bool:  # type: ignore[override]
        """Return whether no integrity scales its forces alone."""
        return self.damage is None or not self._fades

    @property
    def whole_families(self) -> bool:
        """Return True."""
        return True

    @property
    def stencils(self) -> tuple[GlobalIndex, LocalIndex] | None:
        """Return the families with their centre first."""
        return self._whole.stencils

    @property
    def _fades(self) -> bool:
        return self._effect.fading(np.ones(1)) is not None

    def at(self, state: State) -> Control:
        """Return the control with the integrity of the bonds at a state."""
        if self.damage is None:
            return self.control
        fading = self._effect.fading(self.damage.phi(state))
        if fading is None:
            return self.control
        # Kept with the state, so that its matrix is made once.
        return state.kept(("control", self.damage.version, id(self.control)), lambda: self.control.faded(fading))

    def add_force(self, state: State, f: Float) -> None:
        """Add the forces of the control."""
        self.at(state).force(state.u_local, f, self.body.families.everyone)

    def control_of(self, operator: GradientOperator, state: State) -> SameGradient | None:
        """Return what its forces take where no integrity scales them."""
        control = self.at(state)
        return self.shared_gradient(control, operator) if control is self.control else None

    def energy(self, state: State) -> float:
        """Return the energy of the control."""
        u_local = state.u_local
        return self.at(state).force(u_local, np.zeros_like(u_local), self.body.families.everyone)

    def linearised(self, state: State) -> LinearisedTerm:
        """Return its constant matrix, and what the derivative of the integrity adds where it fades."""
        control = self.at(state)
        softening: list[Softening] = []
        if self.damage is not None and self._fades and self.damage.bonds.softens:
            gradient = self.damage.gradient(state)
            v, opposite = self.control.bond_forces(state.u_local), self.damage.damageable.opposite
            softening = softening_parts(state, gradient, v, opposite.of_vectors)
        return ControlTangent(self, control, softening)

    def matrix(self, control: Control, sparsity: Sparsity) -> ControlMatrix:
        """Return the matrix of the control, made once (collective)."""
        if self._matrix is None or self._matrix[0] is not control or self._matrix[1] is not sparsity:
            self._matrix = control, sparsity, control.matrix(sparsity)
        return self._matrix[2]

    def shared_gradient(self, control: Control, operator: GradientOperator) -> SameGradient | None:
        """Return what its forces take where the control uses the gradient of ``operator``, else None."""
        if self._shared is None or self._shared[0] is not control or self._shared[1] is not operator:
            self._shared = control, operator, control.of_gradient(operator)
        return self._shared[2]

    def _follow(self, rebuild: bool) -> None:
        """Rebuild the control with the present integrity of the bonds."""
        assert self.damage is not None
        self.control = self._whole.damaged(self._effect.of_control(self.damage.bonds.phi))


class ControlTangent(LinearisedTerm):
    """The tangent of a zero-energy control."""

    def __init__(self, term: ControlForces, control: Control, softening: list[Softening]) -> None:
        self._term, self._control, self._softening = term, control, softening

    def add_product(self, du: Float, f: Float, particles: LocalIndex) -> None:
        """Add the forces of the control."""
        self._control.force(du, f, particles)
        for softening in self._softening:
            softening.add_product(du, f, particles)

    def add_rows(self, entries: Entries) -> None:
        """Add its constant matrix, and what its falling bonds add (collective)."""
        dim = self._term.body.dim
        self._term.matrix(self._control, entries.sparsity).add(dim, entries.diag, entries.off)
        for softening in self._softening:
            softening.add_rows(entries)

    def add_point_blocks(self, blocks: Float) -> bool:
        """Add those of its constant matrix."""
        return self._control.add_point_blocks(blocks)

    def shared_gradient(self, operator: GradientOperator) -> SameGradient | None:
        """Return what its forces take where they can share the loop over a gradient, else None."""
        return None if self._softening else self._term.shared_gradient(self._control, operator)


def stiffness_of(body: Body, materials: Sequence[Material], material_of: LocalIndex, factor: Float | None) -> Stiffness:
    """Return the small-strain stiffness of the own particles, which scales a control (not collective)."""
    dim = body.dim
    factor = np.ones(body.cloud.n_owned) if factor is None else factor
    kappa = np.array([material.bulk_like_modulus(dim) for material in materials])[material_of] * factor
    moduli = np.array([material.moduli(dim) for material in materials])
    return Stiffness(kappa, moduli, material_of, factor)
