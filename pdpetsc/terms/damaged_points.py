"""Correspondence with failing bonds: ``phi`` scales the forces of bonds, and broken bonds leave the gradient."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import replace
from functools import cached_property

import numpy as np

from pdpetsc.arrays import Float, LocalIndex, Mask, row_of_entries
from pdpetsc.damage.criterion import Gradient
from pdpetsc.discrete.communicator import agreed, anywhere, count_nonzero
from pdpetsc.errors import CaseError, FlatFamilies
from pdpetsc.gradient.base import GradientOperator, Moduli, Scheme, add_divergence
from pdpetsc.gradient.products import PointProduct, Product
from pdpetsc.kernels.gradient import bonds_of_entries
from pdpetsc.kernels.sparsity import sum_by
from pdpetsc.material.base import Material
from pdpetsc.problem.body import Body
from pdpetsc.problem.damage import Damage
from pdpetsc.problem.state import State
from pdpetsc.problem.term import KeptArray, Term
from pdpetsc.terms.kept_history import KeptHistory
from pdpetsc.terms.material_points import MaterialPoints
from pdpetsc.terms.softening import softening_products

# Share of a family that is rounding of its sum.
NOTHING = 1e-12


class DamagedPoints(MaterialPoints):
    """Compute correspondence forces with force states scaled by ``phi`` of the bonds, ``T = phi omega P K^-1 xi``.

    The forces are ``f = H^T (W P(F))`` with the weights ``h_pk = phi_ij g_pk``. Gradients are those of the intact
    family; forces decrease with the driving variable of each bond. The tangent ``H^T (W A) G + d(H^T)/du (W P)`` is
    exact and not symmetric.

    A broken bond leaves shape tensor and gradient. A particle whose remaining family is too flat for a gradient has no
    stress any more. The gradients of its neighbours and the control hold it. The damage evolution of the law defines
    the effect on volumes and on bonds normal to the tension.

    Parameters
    ----------
    body, materials, material_of, factor
        As for ``MaterialPoints``.
    omega : (n_bonds,) float64
        Influence of every bond [-].
    scheme : Scheme
        Scheme of the gradients.
    damage : Damage
        Damage of the bonds.
    weigh : callable, optional
        Changes the weights of the gradient of the scheme (collective).

    Raises
    ------
    CaseError
        A family is too small or flat, on every rank; or damage depends on plastic strain, and no material yields.

    References
    ----------
    Hashim, Eq. (45)-(54).

    Notes
    -----
    Construction is collective.
    """

    symmetric = False

    def __init__(
        self, body: Body, omega: Float, scheme: Scheme, materials: Sequence[Material], material_of: LocalIndex,
        factor: Float | None, damage: Damage, weigh: Callable[[GradientOperator], GradientOperator] | None = None,
    ) -> None:  # fmt: skip
        # Forces of bonds that soften have weights of their own, which are listed.
        softens = damage.bonds.laws.softens
        self._families = replace(body.families, grid=None) if softens else body.families
        built = scheme.build(body.cloud, self._families, omega)
        weights = built if weigh is None else weigh(built)
        super().__init__(body, weights, materials, material_of, factor)
        self._whole = None if weights is built else self.operator
        self._omega = omega
        self._scheme = scheme
        self._material_of = material_of
        self._history = self._undeformed()
        self._factor = factor
        self.damage = damage
        self._effect = damage.bonds.law.effect
        self._take_operator(self.operator)
        flows = [type(one).plastic_strain is not Material.plastic_strain for one in materials]
        if damage.driving_variable.reads_flow and not any(flows):
            raise CaseError("Plastic strain drives damage, and no material of this body flows; take one that does.")

    @property
    def driving_points(self) -> DamagedPoints:
        return self

    def _undeformed(self) -> KeptHistory | None:
        """Return the initial histories of the materials; None without history (not collective)."""
        if not any(at_points.has_history for at_points in self.materials):
            return None
        return KeptHistory(self.operator, self.materials, self._material_of, self.body.cloud.x)

    @property
    def gradients(self) -> GradientOperator:
        """Return the gradient operator of the unbroken bonds."""
        return self.operator

    @property
    def lost(self) -> Mask:
        """Return the points of particles without gradient (n_points,)."""
        return self._dead

    @property
    def piecewise_linear(self) -> bool:
        """Return True if materials are linear."""
        return self._linear

    @property
    def linear(self) -> bool:  # type: ignore[override]
        """Return True if materials are linear and damage is constant."""
        return self._linear and not self.damage.bonds.softens

    # The sparsity is that of whole families, which broken bonds do not change.
    whole_families = True

    has_history = True

    def temperature(self, state: State) -> Float | None:
        """Return the temperature of the points (n_points,); None without temperature (collective)."""
        return None if state.temperature is None else state.temperature[self.operator.owner]

    def deformation(self, state: State) -> Float:
        """Return ``F_p`` (n_points, dim, dim) [-]; I for a particle without gradient."""
        F = super().deformation(state)
        F[self._dead] = np.eye(self.body.dim)
        return F

    def commit(self, state: State) -> None:
        """Update the histories of materials at a converged state, also for points that change when bonds break."""
        super().commit(state)
        if self._history is not None:
            self._history.take(self.operator, self.materials)

    def arrays(self) -> Mapping[str, KeptArray]:
        """Return the histories of the materials with history, by number, and the arrays of the driving variable."""
        found = {} if self._history is None else self._history.arrays(self.materials)
        own = np.arange(self.body.cloud.n_owned, dtype=np.int32)
        return found | {name: KeptArray(own, values) for name, values in self.damage.driving_variable.arrays().items()}

    def restored(self) -> None:
        """Write the histories that were read to the points of the unbroken bonds."""
        super().restored()
        if self._history is not None:
            self._history.give(self.operator, self.materials)

    @cached_property
    def _of_family(self) -> Float:
        """Return the sum of ``omega V`` over the family of each own particle (n_owned,) [volume]."""
        families = self.body.families
        return families.sums(families.weights(self._omega, self.body.cloud.volume))

    @cached_property
    def bond_of_entry(self) -> LocalIndex:
        """Return the bond of every entry of the operator (n_entries,), -1 for centres."""
        return self._bonds_of(self.operator)

    def _bonds_of(self, operator: GradientOperator) -> LocalIndex:
        """Return the bond of every entry of an operator (n_entries,), -1 for centres."""
        families = self.body.families
        bond = np.empty(len(operator.members), dtype=np.int32)
        bonds_of_entries(
            operator.owner, operator.point_ptr, operator.members, families.indptr, families.neighbours,
            self.body.cloud.n_local, bond,
        )  # fmt: skip
        return bond

    def scaled_weights(self, of_bond: Float) -> Float:
        """Compute ``h_pk = phi_ij g_pk`` for numbers per bond (n_bonds,), centres included (not collective)."""
        h: Float = self.operator.g * np.append(of_bond, 0.0)[self.bond_of_entry][:, None]
        first = self.operator.point_ptr[:-1]
        h[first] = -np.add.reduceat(h, first, axis=0)
        return np.asarray(h)

    def add_force(self, state: State, f: Float) -> None:
        """Add ``H^T (W P)`` with the degradation factor of the bonds at the state."""
        T, P = self.damage.phi(state), self.stress(state)
        if self._broken_or_intact(T):
            self.operator.divergence(P, f)
        else:
            add_divergence(self.operator, self.scaled_weights(T), P, f)

    def add_force_together(self, other: Term, state: State, f: Float) -> bool:
        """Add the forces of a control on the same gradient too, unless a factor scales only those of this term."""
        whole = self._broken_or_intact(self.damage.phi(state))
        return whole and super().add_force_together(other, state, f)

    def linearise(self, state: State) -> list[Product]:
        """Return ``H^T (W A) G + d(H^T)/du (W P)``, with the exact derivative of ``phi`` unless frozen."""
        T, softens = self.damage.phi(state), self.damage.bonds.softens
        A = Moduli(self.laws(state).moduli(self.deformation(state)))
        # If all bonds are broken or intact, forces have the weights of the gradient, and a control may share the loop.
        h = None if self._broken_or_intact(T) else self.scaled_weights(T)
        return [PointProduct(self.operator, A, h, lambda: self._share(T)), *(self._softening(state) if softens else [])]

    def _broken_or_intact(self, T: Float) -> bool:
        """Return True if every bond is, for factors ``T`` (n_bonds,), so that forces have the weights of the gradient.

        A bond without force that softens is in the gradient until it breaks at the next equilibrium.
        """
        return not self.damage.bonds.softens and bool(np.all((T == 0.0) | (T == 1.0)))

    def _share(self, T: Float) -> Float:
        """Compute the mean degradation factor of the unbroken bonds of each own particle (n_owned,) [-]."""
        families = self.body.families
        return np.asarray(families.sums(T) / np.maximum(families.sums(self.damage.bonds.intact), 1.0))

    def _softening(self, state: State) -> list[Product]:
        """Return the derivative of the degradation factors of softening bonds in the tangent.

        ``v = sum_p W_p P_p g_pk`` is the force of the intact bond on its second end.
        """
        gradient = self.damage.gradient(state)
        v = self._forces(self.stress(state), gradient)
        return softening_products(state, gradient, v, self.damage.bonds.of.opposite.of_vectors)

    def _forces(self, P: Float, gradient: Gradient) -> Float:
        """Compute the force of the intact bond on its second end (n_bonds, dim) [force] from stresses at points.

        Zero for bonds outside the gradient of the degradation factor.
        """
        operator, n = self.operator, len(self.body.families.neighbours)
        softening = np.zeros(n + 1, dtype=bool)
        softening[gradient.bonds] = True
        entries = np.flatnonzero(softening[self.bond_of_entry])
        point_of = row_of_entries(operator.point_ptr)[entries]
        force = operator.volume[point_of, None] * np.einsum("tim,tm->ti", P[point_of], operator.g[entries])
        return np.asarray(sum_by(self.bond_of_entry[entries], force, n))

    def family_strain(self, state: State) -> Float:
        """Compute ``|<U_p - I>+ xi| / |xi|`` (n_bonds,) [-], the largest over the points of the centre of each bond.

        ``<.>+`` keeps the positive principal strains of the stretch ``U = (F^T F)^1/2``. Only points that the bond
        serves count. The result is the stretch of a bond along the largest principal strain, and exceeds its stretch
        along other directions. It is zero if the centre has lost no bond.

        Bonds normal to the tension shorten with the material. A gradient with only such bonds left stretches without
        end, and transmits its stress through bonds that never reach their critical stretch.
        """
        operator, cloud, families = self.operator, self.body.cloud, self.body.families
        bonds_here = self.damage.bonds
        hurt = np.zeros(cloud.n_owned, dtype=bool)
        hurt[families.centres[~bonds_here.intact]] = True
        strain = np.zeros(len(bonds_here.intact))
        deformation, free = self.strained(state)
        points = np.flatnonzero(hurt[operator.owner] & (operator.volume > 0.0))
        if len(points) == 0:
            return strain
        F = deformation[points]
        squares, axes = np.linalg.eigh(np.einsum("pki,pkj->pij", F, F))
        tension = np.maximum(np.sqrt(np.maximum(squares, 0.0)) - 1.0, 0.0)
        positive = np.einsum("pij,pj,pkj->pik", axes, tension, axes)
        part = operator.at(points)
        bonds, of = self._bonds_of(part), row_of_entries(part.point_ptr)
        served = (bonds >= 0) & part.g.any(axis=1)
        bonds, of = bonds[served], of[served]
        xi = cloud.x[families.neighbours[bonds]] - cloud.x[families.centres[bonds]]
        if free is not None:  # use the force-free length of the bond
            xi = np.einsum("eij,ej->ei", free[points[of]], xi)
        pulled = np.linalg.norm(np.einsum("eij,ej->ei", positive[of], xi), axis=1)
        np.maximum.at(strain, bonds, pulled / bonds_here.of.lengths_of(bonds))
        return strain

    def energy(self, state: State) -> float:
        """Compute ``sum_p W_p phi_p psi_p``, with the mean degradation factor of the unbroken bonds of a point.

        The volume of a point has lost the share of its broken bonds already.
        """
        T, left = self.damage.phi(state), self._at_points(self.damage.bonds.intact.astype(float))
        phi = self._at_points(T) / np.where(left > 0.0, left, 1.0)
        return float(self.operator.volume @ (self.point_energy(state) * phi))

    def local_damage(self) -> Float:
        """Compute ``1 - sum_j phi V_j / sum_j V_j`` of the own particles (n_owned,) [-] (not collective)."""
        return self.damage.lost_volume()

    def mean_stress(self, stress: Float) -> Float:
        """Compute the mean of ``phi_p`` times the stress over the points of each own particle (not collective)."""
        T = np.where(self._dead, 0.0, self._at_points(self.damage.bonds.phi))
        return self._mean(stress * T.reshape(-1, *(1,) * (stress.ndim - 1)))

    def _at_points(self, T: Float) -> Float:
        """Compute the mean degradation factor of the bonds of every point (n_points,)."""
        families = self.body.families
        if self.operator.n_points == self.body.cloud.n_owned:  # over whole families
            return np.asarray(families.sums(T) / np.maximum(np.diff(families.indptr), 1))
        sums = np.add.reduceat(np.append(T, 0.0)[self.bond_of_entry], self.operator.point_ptr[:-1])
        return np.asarray(sums / np.maximum(np.diff(self.operator.point_ptr) - 1, 1))

    def bonds_changed(self, rebuild: bool) -> None:
        """Rebuild the gradient without broken bonds (collective)."""
        if rebuild:
            self._take_operator(self._rebuilt())

    def _take_operator(self, operator: GradientOperator) -> None:
        self.operator = operator
        self._dead = operator.volume <= 0.0
        self.__dict__.pop("bond_of_entry", None)
        number_of = self._material_of[operator.owner]
        for number, at_points in enumerate(self.materials):
            points = np.flatnonzero(number_of == number)
            of = operator.owner[points]
            at_points.put_at(points, None if self._factor is None else self._factor[of], self.body.cloud.x[of])
        if self._history is not None:
            with agreed(self.body.cloud.comm):
                self._history.give(operator, self.materials)

    def _rebuilt(self) -> GradientOperator:
        """Build the gradient over the unbroken bonds; a particle whose family is too flat gets no volume."""
        cloud, families = self.body.cloud, self.body.families
        n, broken = cloud.n_owned, np.flatnonzero(~self.damage.bonds.intact)
        detached = np.zeros(n, dtype=bool)
        while True:
            omega = np.array(self._omega)
            omega[broken[~detached[families.centres[broken]]]] = 0.0
            try:
                operator = self._scheme.build(cloud, self._families, omega)
                break
            except FlatFamilies as flat:
                more = np.isin(cloud.gid[:n], flat.gid) & ~detached
                if not anywhere(cloud.comm, more):
                    raise
                detached |= more
        self.n_detached = count_nonzero(cloud.comm, detached)
        volume = np.where(detached[operator.owner], 0.0, self._by_bonds_left(operator))
        return self._with_weights_left(operator).changed(volume=volume)

    def _with_weights_left(self, operator: GradientOperator) -> GradientOperator:
        """Return the operator with the initial weights of families that have lost no bond.

        Conforming weights depend on the whole body, but a broken bond changes only those of its two ends: the faces of
        a growing crack have no facets.
        """
        if self._whole is None:
            return operator
        n = self.body.cloud.n_owned
        hurt = np.zeros(n, dtype=bool)
        hurt[self.body.families.centres[~self.damage.bonds.intact]] = True
        operator, whole = operator.listed, self._whole.listed
        g = operator.g.copy()
        of, before = (one.owner[row_of_entries(one.point_ptr)] for one in (operator, whole))
        g[~hurt[of]] = whole.g[~hurt[before]]
        return replace(operator, g=g)

    def _by_bonds_left(self, operator: GradientOperator) -> Float:
        """Compute the volumes of the points; if the damage evolution requires it, broken bonds reduce them.

        The volume of a particle is ``V_i sum_left omega V / sum_all omega V``, distributed over its points like the
        volumes of their neighbours. The force states of the remaining bonds then do not change when a bond breaks,
        although the gradient is that of fewer bonds. A point with one remaining bond across a crack does not carry a
        full stress.
        """
        cloud, families, n = self.body.cloud, self.body.families, self.body.cloud.n_owned
        broken = np.flatnonzero(~self.damage.bonds.intact)
        weight = self._omega[broken] * cloud.volume[families.neighbours[broken]]
        left = 1.0 - np.bincount(families.centres[broken], weight, n) / self._of_family
        left[left < NOTHING] = 0.0
        left = self._effect.volume_left(left)
        share = np.ones(operator.n_points)
        if operator.n_points > n:
            whole = np.add.reduceat(cloud.volume[operator.members], operator.point_ptr[:-1])
            of_point = whole - cloud.volume[operator.owner]
            share = of_point / np.bincount(operator.owner, of_point, n)[operator.owner]
        hurt = (left < 1.0)[operator.owner]
        return np.where(hurt, (cloud.volume[:n] * left)[operator.owner] * share, operator.volume)
