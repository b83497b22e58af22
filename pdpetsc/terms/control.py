"""Zero-energy control as a term."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from pdpetsc.arrays import Float, GlobalIndex, LocalIndex
from pdpetsc.control.base import Control, Stiffness
from pdpetsc.gradient.base import GradientOperator, SameGradient
from pdpetsc.gradient.products import Product
from pdpetsc.material.base import Material
from pdpetsc.problem.body import Body
from pdpetsc.problem.damage import Damage
from pdpetsc.problem.state import State
from pdpetsc.problem.term import Term
from pdpetsc.terms.softening import softening_products


class ControlForces(Term):
    """Compute forces linear in the displacement that resist zero-energy modes.

    Parameters
    ----------
    body : Body
        Particles and bonds.
    name : str
        Name in the run record.
    control : Control
        Control of the initial body.
    damage : Damage, optional
        Damage of bonds; the damage evolution of its law defines the degradation factor of the control.

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
        if damage is not None:
            self._effect = damage.bonds.law.effect
            self.bonds_changed(False)

    @property
    def parts(self) -> list[str]:
        """Return the name of the control."""
        return [f"control {self.name}"]

    piecewise_linear = True

    @property
    def linear(self) -> bool:  # type: ignore[override]
        """Return True if the forces are linear: no degradation factor changes them with the displacement."""
        return self.damage is None or not self.damage.bonds.softens or not self._fades

    @property
    def symmetric(self) -> bool:  # type: ignore[override]
        """Return True if no degradation factor scales the forces only."""
        return self.damage is None or not self._fades

    whole_families = True

    @property
    def stencils(self) -> tuple[GlobalIndex, LocalIndex] | None:
        """Return the families with their centre first."""
        return self._whole.stencils

    @property
    def _fades(self) -> bool:
        return self._effect.fading(np.ones(1)) is not None

    def at(self, state: State) -> Control:
        """Return the control with the degradation factor of the bonds at a state."""
        if self.damage is None:
            return self.control
        fading = self._effect.fading(self.damage.phi(state))
        if fading is None:
            return self.control
        # Cached with the state, so that its matrix is built once.
        return state.kept(("control", self.damage.version, id(self.control)), lambda: self.control.faded(fading))

    def add_force(self, state: State, f: Float) -> None:
        """Add the forces of the control."""
        self.at(state).force(state.u_local, f, self.body.families.everyone)

    def control_of(self, operator: GradientOperator, state: State) -> SameGradient | None:
        """Return the data of the forces if no degradation factor scales them."""
        control = self.at(state)
        return control.shared_gradient(operator) if control is self.control else None

    def energy(self, state: State) -> float:
        """Return the energy of the control."""
        return self.at(state).energy(state.u_local, self.body.families.everyone)

    def linearise(self, state: State) -> list[Product]:
        """Return the control, and the derivative of the degradation factor if there is one."""
        return [self.at(state), *self._softening(state, self.control)]

    def _softening(self, state: State, unfaded: Control) -> list[Product]:
        """Return the products of softening bonds, for the control without the current degradation factor."""
        if self.damage is None or not self._fades or not self.damage.bonds.softens:
            return []
        v, opposite = unfaded.bond_forces(state.u_local), self.damage.bonds.of.opposite
        return softening_products(state, self.damage.gradient(state), v, opposite.of_vectors)

    def bonds_changed(self, rebuild: bool) -> None:
        """Rebuild the control with the current degradation factor of the bonds."""
        if self.damage is not None:
            self.control = self._whole.damaged(self._effect.of_control(self.damage.bonds.phi))


def stiffness_of(body: Body, materials: Sequence[Material], material_of: LocalIndex, factor: Float | None) -> Stiffness:
    """Compute the small-strain stiffness of the own particles, which scales a control (not collective)."""
    dim = body.dim
    factor = np.ones(body.cloud.n_owned) if factor is None else factor
    kappa = np.array([material.bulk_like_modulus(dim) for material in materials])[material_of] * factor
    moduli = np.array([material.moduli(dim) for material in materials])
    return Stiffness(kappa, moduli, material_of, factor)
