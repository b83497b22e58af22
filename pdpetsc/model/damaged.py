"""Correspondence with bonds that fail: forces of bonds scaled by their integrity, broken ones out of the gradient."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from pdpetsc.arrays import Float, GlobalIndex, LocalIndex, Mask
from pdpetsc.damage import BondDamage
from pdpetsc.discrete.cloud import Cloud
from pdpetsc.discrete.communicator import total
from pdpetsc.discrete.families import Families
from pdpetsc.errors import CaseError, FlatFamilies
from pdpetsc.gradient.base import GradientOperator, Scheme
from pdpetsc.kernels.gradient import bonds_of_entries, divergence_kernel
from pdpetsc.kernels.pattern import sum_by
from pdpetsc.material.base import Material
from pdpetsc.model.assembler import Assembler
from pdpetsc.model.correspondence import CorrespondenceModel
from pdpetsc.model.damaged_assembly import DamagedAssembler
from pdpetsc.model.failure import BondFailure
from pdpetsc.model.linearised import DamagedTangent, Linearised
from pdpetsc.stabilisation.base import Control, Stabilisation


class DamagedCorrespondenceModel(CorrespondenceModel):
    """Correspondence whose force states are multiplied with the integrity of the bonds, ``T = T_s omega P K^-1 xi``.

    ``f = H^T (W P(F))`` with the weights ``h_pk = T_ij g_pk``: gradients are those of the intact family, forces fade
    with the stretch of each bond. The tangent ``H^T (W A) G + d(H^T)/du (W P)`` is exact and not symmetric. A broken
    bond leaves shape tensor and gradient. A particle whose family is left too flat for a gradient has no stress any
    more; its neighbours' gradients and the control hold it. The effect of the damage law (``DamageEffect``) says
    whether bonds heal, what the control and the volumes do, and whether bonds that lie across the pull break with the
    strain of its gradient (``break_bonds``).

    Parameters
    ----------
    cloud, families, omega, scheme, materials, material_of, stabilisation, factor
        As for ``CorrespondenceModel``.
    damage : BondDamage
        How bonds fail.
    protected : (n_local,) bool, optional
        Particles whose bonds do not fail.

    References
    ----------
    Hashim et al., Eq. (45)-(54).

    Notes
    -----
    Construction is collective.
    """

    failure: BondFailure

    def __init__(
        self, cloud: Cloud, families: Families, omega: Float, scheme: Scheme, materials: Sequence[Material],
        material_of: LocalIndex, stabilisation: Stabilisation | None, factor: Float | None, damage: BondDamage,
        protected: Mask | None,
    ) -> None:  # fmt: skip
        super().__init__(cloud, families, omega, scheme, materials, material_of, stabilisation, factor)
        if any(law.has_history for law in self.laws):
            raise CaseError("Bond damage takes elastic materials; a material with history cannot lose bonds.")
        self._omega = omega
        self._scheme = scheme
        self._material_of = material_of
        self._factor = factor
        self._effect = damage.effect
        self.failure = BondFailure(cloud, families, damage, protected)
        self._whole_control = self.control
        self._take_operator(self.operator)
        self._take_integrity()

    @property
    def parts(self) -> list[str]:
        """Return what the body is made of."""
        return [*super().parts, f"damage {type(self.failure.law).__name__}"]

    @property
    def linear(self) -> bool:
        """Return whether materials are linear and damage stays."""
        return super().linear and not self.failure.softens

    @property
    def symmetric(self) -> bool:
        """Return False: forces are scaled, gradients are not."""
        return False

    @property
    def has_history(self) -> bool:
        """Return True."""
        return True

    def scaled_weights(self, of_bond: Float) -> Float:
        """Return ``h_pk = T_ij g_pk`` for numbers per bond (n_bonds,), centres included (not collective)."""
        h: Float = self.operator.g * np.append(of_bond, 0.0)[self.bond_of_entry][:, None]
        first = self.operator.point_ptr[:-1]
        h[first] = -np.add.reduceat(h, first, axis=0)
        return np.asarray(h)

    def put_forces(self, P: Float, u_local: Float, f: Float) -> None:
        """Add the forces of stresses ``P`` and of the control with the integrity of the bonds at ``u`` to ``f``.

        Not collective.
        """
        T, _ = self.failure.at(self.elongation(u_local))
        operator, h = self.operator, self.scaled_weights(T)
        divergence_kernel(self.dim)(operator.point_ptr, operator.members, h, operator.volume, P, f)
        control = self.control_at(T)
        if control is not None:
            control.force(u_local, f, self.families.everyone)

    def control_at(self, T: Float) -> Control | None:
        """Return the control where bonds have the integrity T (n_bonds,) (not collective)."""
        fading = self._effect.fading(T)
        return self.control if self.control is None or fading is None else self.control.faded(fading)

    def control_energy(self, u_local: Float) -> float:
        """Return the energy of the control with the integrity of the bonds at ``u`` on this rank [energy]."""
        control = self.control_at(self.failure.at(self.elongation(u_local))[0])
        return 0.0 if control is None else control.force(u_local, np.zeros_like(u_local), self.families.everyone)

    def linearised(self, u: Float) -> Linearised:
        """Return the tangent with the exact derivative of the integrity, where it is not frozen."""
        return DamagedTangent(self, u)

    def softening(self, u_local: Float, F: Float, slope: Float) -> tuple[GlobalIndex, Float, Float]:
        """Return numbers, forces and directions of the bonds whose integrity falls: ``v (x) m`` of each.

        Displacements with ghosts, the deformation there and ``dT/de`` (n_bonds,) are given (not collective).
        ``v = sum_p W_p P_p g_pk`` is the force of the intact bond on its second end, with that of the control where it
        fades too, ``m = dT/de n``.
        """
        bonds = np.flatnonzero(slope)
        falling = np.zeros(len(slope), dtype=bool)
        falling[bonds] = True
        operator = self.operator
        entries = np.flatnonzero((self.bond_of_entry >= 0) & np.append(falling, False)[self.bond_of_entry])
        point_of = np.repeat(np.arange(operator.n_points), np.diff(operator.point_ptr))[entries]
        P = self.stress(F)
        force = operator.volume[point_of, None] * np.einsum("tim,tm->ti", P[point_of], operator.g[entries])
        v = sum_by(self.bond_of_entry[entries], force, len(slope))[bonds]
        if self.control is not None and self._effect.fading(slope) is not None:
            v = v + self.control.bond_forces(u_local)[bonds]
        centres, neighbours = self.families.centres[bonds], self.families.neighbours[bonds]
        y = self.cloud.x[neighbours] + u_local[neighbours] - self.cloud.x[centres] - u_local[centres]
        m = slope[bonds, None] * y / np.linalg.norm(y, axis=1)[:, None]
        return bonds, np.asarray(v), np.asarray(m)

    def break_bonds(self, u: Float, most: int | None = None) -> int:
        """Break bonds past their final stretch or, where none is, those that a gradient tears; return how many pairs.

        Bonds that lie across the pull shorten with the material: a gradient that has no others left stretches without
        end and carries its stress through bonds that never reach their critical stretch. So a bond of a particle that
        has lost some also breaks when the tensile strain on it is past its final stretch, where the effect says so.
        """
        broken = super().break_bonds(u, most)
        if broken or not self._effect.tears:
            return broken
        assert self.failure is not None
        torn = self.failure.tear(self.tensile_strain(self.with_ghosts(u)), most)
        if torn:
            self._changed(rebuild=True)
        return torn

    def tensile_strain(self, u_local: Float) -> Float:
        """Return ``|<U_p - I>+ xi| / |xi|`` (n_bonds,) [-], the largest of the points of its centre that a bond serves.

        ``<.>+`` keeps the positive principal strains of the stretch ``U = (F^T F)^1/2``. It is the stretch of a bond
        along the largest principal strain, and more than its stretch along other directions. Zero where the centre has
        lost no bond (not collective).
        """
        operator, intact = self.operator, self.failure.intact
        hurt = np.zeros(self.cloud.n_owned, dtype=bool)
        hurt[self.families.centres[~intact]] = True
        strain = np.zeros(len(intact))
        points = np.flatnonzero(hurt[operator.owner] & (operator.volume > 0.0))
        if len(points) == 0:
            return strain
        F = self.deformation(u_local)[points]
        squares, axes = np.linalg.eigh(np.einsum("pki,pkj->pij", F, F))
        tension = np.maximum(np.sqrt(np.maximum(squares, 0.0)) - 1.0, 0.0)
        positive = np.einsum("pij,pj,pkj->pik", axes, tension, axes)
        size = np.diff(operator.point_ptr)[points]
        entries = np.repeat(operator.point_ptr[points] - np.cumsum(size) + size, size) + np.arange(size.sum())
        bonds, of = self.bond_of_entry[entries], np.repeat(np.arange(len(points)), size)
        served = (bonds >= 0) & operator.g[entries].any(axis=1)
        bonds, of = bonds[served], of[served]
        xi = self.cloud.x[self.families.neighbours[bonds]] - self.cloud.x[self.families.centres[bonds]]
        pulled = np.linalg.norm(np.einsum("eij,ej->ei", positive[of], xi), axis=1)
        np.maximum.at(strain, bonds, pulled / self.failure.length[bonds])
        return strain

    @property
    def restartable(self) -> bool:
        """Return True."""
        return True

    def energy(self, u: Float) -> tuple[float, float]:
        """Return ``sum_p W_p T_p psi_p``, with the mean integrity of the bonds of a point, and that of the control."""
        u_local = self.with_ghosts(u)
        T, _ = self.failure.at(self.elongation(u_local))
        psi = self.point_energy(self.deformation(u_local)) * self._at_points(T)
        both = total(self.cloud.comm, [float(self.operator.volume @ psi), self.control_energy(u_local)])
        return float(both[0]), float(both[1])

    def local_damage(self) -> Float:
        """Return ``1 - sum_j T V_j / sum_j V_j`` of the own particles (n_owned,) [-] (not collective)."""
        centres, n = self.families.centres, self.cloud.n_owned
        volume = self.cloud.volume[self.families.neighbours]
        left = np.bincount(centres, self.failure.integrity * volume, n)
        whole = np.bincount(centres, volume, n)
        return np.asarray(1.0 - left / np.where(whole > 0.0, whole, 1.0))

    def mean_stress(self, stress: Float) -> Float:
        """Return the mean of ``T_p`` times the stress over the points of each own particle (not collective)."""
        T = self._at_points(self.failure.integrity)
        return self._mean(stress * T.reshape(-1, *(1,) * (stress.ndim - 1)))

    def assembler(self) -> Assembler:
        """Return what fills the tangent matrix (collective)."""
        return DamagedAssembler(self)

    def _at_points(self, T: Float) -> Float:
        """Return the mean integrity of the bonds of every point (n_points,)."""
        sums = np.add.reduceat(np.append(T, 0.0)[self.bond_of_entry], self.operator.point_ptr[:-1])
        return np.asarray(sums / np.maximum(np.diff(self.operator.point_ptr) - 1, 1))

    def _changed(self, rebuild: bool) -> None:
        """Follow a change of the integrity, and of the broken bonds where ``rebuild`` (collective)."""
        if rebuild:
            self._take_operator(self._rebuilt())
        self._take_integrity()
        super()._changed(rebuild)

    def _take_operator(self, operator: GradientOperator) -> None:
        self.operator = operator
        self.bond_of_entry = np.empty(len(operator.members), dtype=np.int64)
        bonds_of_entries(
            operator.owner, operator.point_ptr, operator.members, self.families.indptr, self.families.neighbours,
            self.cloud.n_local, self.bond_of_entry,
        )  # fmt: skip
        law_of = self._material_of[operator.owner]
        for number, law in enumerate(self.laws):
            law.points = np.flatnonzero(law_of == number)
            law.factor = None if self._factor is None else self._factor[operator.owner[law.points]]

    def _take_integrity(self) -> None:
        if self._whole_control is not None:
            self.control = self._whole_control.damaged(self._effect.of_control(self.failure.integrity))

    def _rebuilt(self) -> GradientOperator:
        """Return the gradient over the bonds that are left; a particle whose family is too flat gets no volume."""
        centres, n = self.families.centres, self.cloud.n_owned
        detached = np.zeros(n, dtype=bool)
        while True:
            omega = np.where(self.failure.intact | detached[centres], self._omega, 0.0)
            try:
                operator = self._scheme.build(self.cloud, self.families, omega)
                break
            except FlatFamilies as flat:
                more = np.isin(self.cloud.gid[:n], flat.gid) & ~detached
                if int(total(self.cloud.comm, np.count_nonzero(more))) == 0:
                    raise
                detached |= more
        self.n_detached = int(total(self.cloud.comm, np.count_nonzero(detached)))
        volume = np.where(detached[operator.owner], 0.0, self._by_bonds_left(operator))
        return replace(operator, volume=volume)

    def _by_bonds_left(self, operator: GradientOperator) -> Float:
        """Return the volumes of the points: where the effect says so, bonds that are gone take their share with them.

        ``V_i sum_left omega V / sum_all omega V`` of a particle, divided among its points as the volumes of their
        neighbours: the force states of the bonds that are left stay as they were when a bond breaks, though the
        gradient is that of fewer bonds, and a point with one bond left across a crack does not carry a whole stress.
        """
        n, centres = self.cloud.n_owned, self.families.centres
        weight = self._omega * self.cloud.volume[self.families.neighbours]
        left = np.bincount(centres, weight * self.failure.intact, n) / np.bincount(centres, weight, n)
        left = self._effect.volume_left(left)
        whole = np.add.reduceat(self.cloud.volume[operator.members], operator.point_ptr[:-1])
        of_point = whole - self.cloud.volume[operator.owner]
        share = of_point / np.bincount(operator.owner, of_point, n)[operator.owner]
        hurt = (left < 1.0)[operator.owner]
        return np.where(hurt, (self.cloud.volume[:n] * left)[operator.owner] * share, operator.volume)
