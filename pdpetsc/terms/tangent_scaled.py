"""Tangent-scaled zero-energy control as a term."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from functools import cached_property
from typing import NamedTuple

import numpy as np

from pdpetsc.arrays import Float
from pdpetsc.control.base import Control, ZeroEnergyControl
from pdpetsc.control.tangent_scaled import Yielding, YieldingFamilies
from pdpetsc.gradient.base import StencilMembers
from pdpetsc.gradient.products import Product, RankOneProduct
from pdpetsc.problem.body import Body
from pdpetsc.problem.damage import Damage
from pdpetsc.problem.state import State
from pdpetsc.problem.term import KeptArray
from pdpetsc.terms.control import ControlForces
from pdpetsc.terms.degraded_points import DegradedControl, DegradedPoints, DrivingControl
from pdpetsc.terms.material_points import MaterialPoints


class YieldedFamilies(NamedTuple):
    """Store the families of a control at a state.

    Attributes
    ----------
    e : (n_owned,) float64
        Root of twice the energy of the elastic control [energy^(1/2)].
    forces : (n_entries, dim) float64
        Forces of the elastic control on the members of each family [force].
    secant : Control
        Control with the secant stiffness of the state, without the degradation factor.
    """

    e: Float
    forces: Float
    secant: Control


class TangentScaledForces(ControlForces):
    """Compute forces of a control that yields with the material of each particle (``control.tangent_scaled``).

    The tangent is ``sum_i (q/e)_i M_i + b_i m_i (x) m_i``. ``M_i`` are the matrices of the families of the elastic
    control, ``m_i = M_i u`` their forces, and ``b_i`` is the bend of ``q(e)``.

    Parameters
    ----------
    body, name, control, damage
        As for ``ControlForces``; ``control`` is elastic.
    material_term : MaterialPoints
        Material that scales the control.
    least : float
        Smallest remaining share of the stiffness [-].

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

    linear = False

    piecewise_linear = False

    has_history = True

    @cached_property
    def _members(self) -> StencilMembers:
        """Return the families with their centre first."""
        return StencilMembers(np.arange(self.body.cloud.n_owned, dtype=np.int32), *self._whole.stencils)

    def arrays(self) -> Mapping[str, KeptArray]:
        """Return the history variables of the families."""
        return {"yielding": KeptArray(np.arange(self.body.cloud.n_owned, dtype=np.int32), self._yielding.kept)}

    def at(self, state: State) -> Control:
        """Return the control with the secant stiffness of its families, and ``phi`` of the bonds, at a state."""
        secant, fading = self.families(state).secant, self._fading(state)
        return secant if fading is None else secant.faded(fading)

    def families(self, state: State) -> YieldedFamilies:
        """Return the families at a state, cached."""

        def make() -> YieldedFamilies:
            u, ptr, members = state.u_local, self._members.point_ptr, self._members.members
            forces = self.control.family_forces(u)
            # Displacements relative to the centre, so that a translation of the family causes no round-off.
            eta = u[members] - np.repeat(u[members[ptr[:-1]]], np.diff(ptr), axis=0)
            doubled = np.add.reduceat(np.einsum("ei,ei->e", forces, eta), ptr[:-1])
            e = np.sqrt(np.maximum(doubled, 0.0))
            return YieldedFamilies(e, forces, self.control.scaled(self._yielding.secant(e)))

        changed = 0 if self.damage is None else self.damage.version
        return state.kept(("families", self.version, changed, id(self.control)), make)

    def energy(self, state: State) -> float:
        """Compute the energy of the control, including the loss by yielding."""
        e = self.families(state).e
        beyond_secant = self._yielding.energy(e) - 0.5 * self._yielding.secant(e) * e**2
        return super().energy(state) + float(beyond_secant.sum())

    def linearise(self, state: State) -> list[Product]:
        """Return the secant, the derivative of the degradation factor if any, and ``b_i h_i (x) m_i`` of the families.

        ``h_i`` are the forces ``m_i`` with the degradation factor.
        """
        families, fading = self.families(state), self._fading(state)
        m, bend = families.forces, self._yielding.bend(families.e)
        h = m if fading is None else self.control.faded(fading).family_forces(state.u_local)
        bending = RankOneProduct(self._members, self.body.cloud.n_owned, h, m, bend)
        return [self.at(state), *self._softening(state, families.secant), bending]

    def commit(self, state: State) -> None:
        """Accept the sizes at a state, and the next slope from the tangent of the material there."""
        self._yielding.commit(self.families(state).e, np.clip(self._share, self._least, 1.0))
        self.version += 1

    def before_commit(self, state: State) -> None:
        """Read the tangent modulus of the material."""
        self._share = self._material_term.tangent_share(state)

    def _fading(self, state: State) -> Float | None:
        return None if self.damage is None else self._effect.fading(self.damage.phi(state))


class DegradedTangentScaled(TangentScaledForces):
    """Compute forces of a control that yields with the material and is degraded with the points of its particle.

    The energy is ``sum_i share_i U_i(e_i)``. ``U_i`` are the energies of the yielding families, and ``share_i`` is the
    mean degradation factor of the points of the particle.

    Parameters
    ----------
    body, name, least
        As for ``TangentScaledForces``.
    families : YieldingFamilies
        Families that drive the points.
    points : DegradedPoints
        Material that scales and degrades the control.
    """

    def __init__(self, body: Body, name: str, families: YieldingFamilies, points: DegradedPoints, least: float) -> None:
        super().__init__(body, name, families.control, points, least)
        self._points, self._yielding = points, families.yielding

    def at(self, state: State) -> Control:
        """Return the control with the secant stiffness and the degradation factor of each particle at a state."""
        points = self._points
        key = "degraded control", self.version, points.version, points.frozen
        return state.kept(key, lambda: self.families(state).secant.scaled(self._points.share(state)))

    def energy(self, state: State) -> float:
        """Compute the energy of the control, including the losses by yielding and damage."""
        return float(self._points.share(state) @ self._yielding.energy(self.families(state).e))

    def linearise(self, state: State) -> list[Product]:
        """Return the secant and ``share_i b_i m_i (x) m_i`` of the families, damage held."""
        families = self.families(state)
        bend = self._points.share(state) * self._yielding.bend(families.e)
        n = self.body.cloud.n_owned
        return [self.at(state), RankOneProduct(self._members, n, families.forces, families.forces, bend)]


def degraded_control(
    declared: ZeroEnergyControl, body: Body, control: Control, points: Callable[[DrivingControl], DegradedPoints]
) -> tuple[DegradedPoints, ControlForces]:
    """Build the failing points from the control that drives them, and the term of that control."""
    name = type(declared).__name__
    if declared.least_share is None:
        term = points(control)
        return term, DegradedControl(body, name, control, term)
    families = YieldingFamilies(control, Yielding.unloaded(body.cloud.n_owned))
    term = points(families)
    return term, DegradedTangentScaled(body, name, families, term, declared.least_share)


def control_forces(
    declared: ZeroEnergyControl,
    body: Body,
    control: Control,
    material_term: MaterialPoints,
    damage: Damage | None = None,
) -> ControlForces:
    """Build the term of a control, tangent-scaled if declared (collective)."""
    name = type(declared).__name__
    if declared.least_share is None:
        return ControlForces(body, name, control, damage)
    return TangentScaledForces(body, name, control, material_term, declared.least_share, damage)
