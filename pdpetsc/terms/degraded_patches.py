"""Damage at gradient points with one dilatation for each patch of particles."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from functools import partial

import numpy as np

from pdpetsc.arrays import Float, GlobalIndex, LocalIndex, Mask, entries_of
from pdpetsc.damage.point_damage import AssignedPointDamage
from pdpetsc.errors import CaseError
from pdpetsc.gradient.base import GradientOperator, Patches, Scheme, StencilMembers
from pdpetsc.gradient.products import Product
from pdpetsc.kernels.sparsity import sum_by
from pdpetsc.material.base import Material
from pdpetsc.problem.body import Body
from pdpetsc.problem.state import State
from pdpetsc.terms.degraded_points import DegradedPoints, DrivingControl, places_of
from pdpetsc.terms.mean_dilatation import PatchPoints, Response


class DegradedPatchPoints(DegradedPoints):
    """Compute forces of ``sum_p W_p [phi_p (psi_open + share mu m^2 + psi_control) + psi_closed]`` with patches.

    ``psi_open`` and ``psi_closed`` are those of ``F_bar``, with the mean dilatation ``<theta>`` of the patch. The rest
    is ``m = <theta> - theta``. The part of the energy that depends only on ``<theta>`` therefore has the mean
    degradation factor of the patch. A crack that cuts the family of one point of a patch drives all its points. The
    width of the failing band is therefore that of the patch with its families.

    Parameters
    ----------
    body, operator, materials, material_of, factor, damage_laws, control
        As for ``DegradedPoints``.
    patches : Patches
        Points that share a dilatation.

    Raises
    ------
    CaseError
        The split depends on more of the strain than the dilatation; also as for ``DegradedPoints`` and ``PatchPoints``.

    Notes
    -----
    Construction is collective.
    """

    horizons = 3
    constrained = True

    def __init__(
        self, body: Body, operator: GradientOperator, materials: Sequence[Material], material_of: LocalIndex,
        factor: Float | None, damage_laws: AssignedPointDamage, patches: Patches, control: DrivingControl | None,
    ) -> None:  # fmt: skip
        split = type(damage_laws.split).__name__
        if damage_laws.split.exact:
            raise CaseError(
                f"{split} reads every principal strain, and points that share dilatations have their mean in each; "
                f"take split=pd.split.Volumetric() or pd.split.Whole(), or the scheme in MeanDilatation alone."
            )
        self._edge = patches.edge
        self._sharing = PatchPoints(body, operator, materials, material_of, factor, patches)
        super().__init__(body, operator, materials, material_of, factor, damage_laws, control)

    @property
    def stencils(self) -> tuple[GlobalIndex, LocalIndex] | None:
        """Return the particles of patches with their families."""
        return self._sharing.stencils

    within_families = False

    @property
    def patch_of_point(self) -> GlobalIndex:
        """Return the patch of every point (n_points,)."""
        return self._sharing.patch_of_point

    def dependents(self, marked: Float) -> Mask:
        """Return the own particles that share a patch with a marked local particle (collective)."""
        return self._sharing.dependents(marked)

    def admissible(self, state: State) -> bool:
        """Return True if materials are defined and, unless all are linear, ``det F > 0`` at all points."""
        self.laws(state)  # collective: compute it on every rank
        return self._sharing.admissible(state) and super().admissible(state)

    def deformation(self, state: State) -> Float:
        """Return ``F_bar`` (n_points, dim, dim) [-]; I at failed points if there is no closed part."""
        return self._without_failed(self._sharing.shared(state).F_bar)

    def response(self, state: State) -> Response:
        """Compute the stresses at an admissible state, damage included."""

        def make() -> Response:
            P_bar = super(DegradedPatchPoints, self)._degraded_stress(state)
            return self._sharing.respond(state, P_bar, self._rest(state))

        return state.kept(("degraded response", self.version, self.frozen, self.points.slack), make)

    def _degraded_stress(self, state: State) -> Float:
        return self.response(state).P.copy()

    def point_energy(self, state: State) -> Float:
        """Compute ``phi (psi_open + share mu m^2) + psi_closed`` (n_points,) [energy / volume]."""
        return np.asarray(super().point_energy(state) + 0.5 * self._rest(state) * self._missing(state) ** 2)

    def energy_at(self, state: State, F: Float, volume: Float) -> Float:
        """Compute the energy density of all points (n_points,) at other gradients F and volumes (n_points,)."""
        shared = self._sharing.shared_at(state, F, volume)
        energy = super().energy_at(state, self._without_failed(shared.F_bar), volume)
        return np.asarray(energy + 0.5 * self._rest(state) * shared.missing**2)

    def cauchy_stress(self, state: State) -> Float:
        """Compute the mean of ``P F^T / det F`` (n_owned, dim, dim) [stress]; of P if linear."""
        P, F = self.stress(state), self.point_gradient(state)
        if self._linear:
            return self.mean_stress(P)
        return self.mean_stress(np.einsum("pik,pjk->pij", P, F) / np.linalg.det(F)[:, None, None])

    def linearise(self, state: State) -> list[Product]:
        """Return the tangent of points and patches and, unless damage is held, the derivative of phi."""
        F = self.deformation(state)
        moduli = self._degraded(state, lambda laws, only: laws.moduli(F, only))
        residual = self._residual_moduli(state)
        found = self._sharing.products(state, self.response(state), moduli, self._rest(state), residual)
        return found if self.frozen else [*found, self._softening(state)]

    def _rest(self, state: State) -> Float:
        return np.asarray(self.driven(state).phi * self._sharing.rest)

    def _missing(self, state: State) -> Float:
        return self._sharing.shared(state).missing

    def _unresolved_energy(self, state: State) -> Float:
        """Compute ``share mu m^2 + psi_control`` (n_points,) [energy / volume]."""
        return np.asarray(super()._unresolved_energy(state) + 0.5 * self._sharing.rest * self._missing(state) ** 2)

    def _reach(self) -> Float:
        """Return half the largest width of a failing band at each own particle (n_owned,) [length]."""
        return np.asarray(super()._reach() + 0.5 * self._edge * np.sqrt(self.body.dim))

    def _driving_stencils(self, points: GlobalIndex) -> StencilMembers:
        """Return the particles of the patches of some points with their families (not collective)."""
        patches, of = self._sharing.patches, self.patch_of_point[points]
        entries, first = entries_of(patches.point_ptr, of)
        return StencilMembers(patches.owner[of], first, patches.members[entries])

    def _by_stencil(self, points: GlobalIndex) -> GlobalIndex:
        """Sort points by the owners of their patches."""
        return points[np.argsort(self.patch_of_point[points], kind="stable")]

    def _drive_gradient(self, state: State, points: GlobalIndex) -> tuple[StencilMembers, Float]:
        """Return the particles that drive some points, and ``v = dY/du`` of each (n_entries, dim) [stress / length]."""
        operator, sharing = self.operator, self._sharing
        F, _, missing = sharing.shared(state)
        scale, by_F = sharing.dilatation_by_F(F, missing)
        P = self._open_stress(state)
        r = sharing.conjugate(self.deformation(state), P, sharing.rest * missing)
        own = scale[:, None, None] * P - r[:, None, None] * by_F
        b = sharing.vectors(sharing.weight[:, None, None] * by_F)
        stencils = self._driving_stencils(points)
        entries, _ = entries_of(sharing.patches.point_ptr, self.patch_of_point[points])
        v = np.repeat(r[points], np.diff(stencils.point_ptr))[:, None] * b[entries]
        # Operator and control list their points and families in ascending order.
        order = np.argsort(points)
        some = operator.at(points[order])
        of_points = np.einsum("eij,ej->ei", np.repeat(own[points[order]], np.diff(some.point_ptr), axis=0), some.g)
        parts: list[tuple[StencilMembers, Float]] = [(some, of_points)]
        if self._control is not None:
            families, m = self._control.families_at(some.owner), self._control.forces_at(state.u_local, some.owner)
            parts.append((families, m / np.repeat(self._volume[some.owner], np.diff(families.point_ptr))[:, None]))
        for of, values in parts:
            place = places_of(of, order, stencils, self.body.cloud.n_local)
            v += sum_by(place, values, len(v))
        return stencils, v


def failing_points(
    scheme: Scheme, body: Body, operator: GradientOperator, materials: Sequence[Material], material_of: LocalIndex,
    factor: Float | None, damage_laws: AssignedPointDamage,
) -> Callable[[DrivingControl | None], DegradedPoints]:  # fmt: skip
    """Return a function that builds the failing points of a scheme from the control that drives them (collective)."""
    declared = body, operator, materials, material_of, factor, damage_laws
    if scheme.patches is None:
        return partial(DegradedPoints, *declared)
    return partial(DegradedPatchPoints, *declared, scheme.patches)
