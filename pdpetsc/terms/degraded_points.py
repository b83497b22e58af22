"""Damage at gradient points: material and control are degraded together, from one energy."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from typing import Any, TypeAlias

import numpy as np
import scipy

from pdpetsc.arrays import Float, GlobalIndex, LocalIndex, Lookup, Mask, entries_of
from pdpetsc.control.base import Control
from pdpetsc.control.tangent_scaled import YieldingFamilies
from pdpetsc.damage.point_damage import AssignedPointDamage, Driven, FailingPoints
from pdpetsc.declare.cracks import Crack
from pdpetsc.discrete.communicator import agreed, anywhere, largest
from pdpetsc.discrete.crack_images import images_of_cloud
from pdpetsc.errors import CaseError
from pdpetsc.gradient.base import GradientOperator, Moduli, SameGradient, StencilMembers
from pdpetsc.gradient.products import PointProduct, Product, SofteningProduct
from pdpetsc.kernels.gradient import residual_kernel
from pdpetsc.kernels.principal_rows import symmetric_axes
from pdpetsc.kernels.sparsity import sum_by
from pdpetsc.material.base import Material
from pdpetsc.material.closed_sliding import SlidingPart
from pdpetsc.material.point_laws import PointLaws
from pdpetsc.problem.body import Body
from pdpetsc.problem.damage import DamageModel
from pdpetsc.problem.state import State
from pdpetsc.problem.term import KeptArray
from pdpetsc.terms.control import ControlForces
from pdpetsc.terms.material_points import MaterialPoints

# Points whose drive exceeds this share of the onset compute the final drive of their own direction.
NEAR_ONSET = 0.5
# Number of points whose families are listed at once.
MOST_LISTED = 4096
# Remaining share of the stiffness of a failed point and the control of its particle. It holds detached pieces in place,
# with forces far below those of intact points.
RESIDUAL = 1e-8
# Number of bisections for the distance of a point from a crack: its error is a thousandth of the width of a family.
HALVINGS = 10
# Number of directions in which Gc is checked, by dimension.
FAN = {2: 36, 3: 200}
# Zero-energy control whose energies drive the points of its families.
DrivingControl: TypeAlias = Control | YieldingFamilies


class DegradedPoints(MaterialPoints, DamageModel):
    """Compute forces of ``sum_p W_p [phi_p (psi_open + psi_control) + psi_closed]``, degradation factor ``phi_p``.

    ``DegradedControl`` computes the forces of the control. The derivative of ``phi_p`` by the displacement is in the
    tangent of this term: ``dphi/dY (P_open . g + f_control) (x) (P_open . g + f_control)`` for each point that fails.

    Parameters
    ----------
    body, operator, materials, material_of, factor
        As for ``MaterialPoints``.
    damage_laws : AssignedPointDamage
        Declared damage, with the law of each particle.
    control : DrivingControl or None
        Zero-energy control of the intact body.

    Raises
    ------
    CaseError
        The strength is too high for the fracture energy and the horizon, or the split does not fit a material.

    Notes
    -----
    Construction is collective.
    """

    def __init__(
        self, body: Body, operator: GradientOperator, materials: Sequence[Material], material_of: LocalIndex,
        factor: Float | None, damage_laws: AssignedPointDamage, control: DrivingControl | None,
    ) -> None:  # fmt: skip
        super().__init__(body, operator, materials, material_of, factor)
        self.damage_laws, self._control = damage_laws, control
        split = damage_laws.split
        with agreed(body.cloud.comm):
            E = np.array([material.young_modulus() for material in materials])
            closed = [split.closed_part(material) for material in materials]
            varies = body.thermals is not None and any(one is not None and one.law for one in body.thermals)
            if varies and any(part is not None for part in closed):
                raise CaseError(
                    f"{type(split).__name__} is made once from each material, and a law of Thermal is another one "
                    f"at every temperature; take split=pd.split.Whole(), or a factor of the moduli."
                )
            for material, part in zip(materials, closed, strict=True):
                flows = type(material).plastic_strain is not Material.plastic_strain
                if part is not None and flows and material.kind(body.dim) not in ("solid", "strain"):
                    raise CaseError(
                        f"{type(split).__name__} reads the volume of a point, and in plane stress and in bars that "
                        f"of {type(material).__name__} changes as it flows; take split=pd.split.Whole()."
                    )
        kept = [part for part in closed if part is not None]
        self._closed = MaterialPoints(body, operator, kept, material_of, factor) if kept else None
        # The closed part if its faces slide.
        self._sliding = self._closed if self._closed is not None and self._closed.has_history else None
        moduli = E[material_of] * (1.0 if factor is None else factor)
        self._soft = RESIDUAL * moduli[operator.owner]
        share = np.array([1.0 if part is None else part.open_share(body.dim) for part in closed])
        with agreed(body.cloud.comm):  # functions of place may fail on one rank
            onset_energy = damage_laws.onset_energy(moduli, body.cloud.x[: body.cloud.n_owned]) * share[material_of]
        self.points = FailingPoints(damage_laws.curves(operator.owner), onset_energy[operator.owner], body.dim)
        self.failing, self.name = self.points, type(damage_laws.laws[0]).__name__
        self._refuse_strength()
        # Without strain, the width of a family along the first axis replaces that along the largest strain.
        everything = np.arange(operator.n_points)
        final = self._final(everything, np.tile(np.eye(body.dim)[0], (operator.n_points, 1)))
        self.points.final[:] = np.where(self.points.spared, 1.0, final)
        self.points.commit()
        self._volume = operator.sum_over_points(operator.volume)
        if damage_laws.cracks:
            self._start_cracks(damage_laws.cracks)
        # Points that failed further in the last load step.
        self._advanced = np.empty(0, dtype=np.int64)
        # Work of friction in closed cracks [energy / volume], and the degradation factors at which it was computed.
        self._rubbed = np.zeros(operator.n_points)
        self._phi_of_work = self.points.phi.copy()

    def _start_cracks(self, cracks: Sequence[Crack]) -> None:
        """Let all points fail whose family a crack cuts along its normal, with the nearest crack (collective)."""
        points = np.flatnonzero(~self.points.spared)
        x = self.body.cloud.x[self.operator.owner[points]]
        nearest, normal = np.full(len(points), np.inf), np.zeros_like(x)
        for crack in cracks:
            with agreed(self.body.cloud.comm):
                distance, along = self._distance(crack, points, x)
            if not anywhere(self.body.cloud.comm, np.isfinite(distance)):
                raise CaseError(
                    f"The {type(crack).__name__} in cracks of PointDamage cuts no family of a point that may fail. Put "
                    f"it in the body, outside protected regions."
                )
            nearer = distance < nearest
            nearest[nearer], normal[nearer] = distance[nearer], along[nearer]
        cut = np.isfinite(nearest)
        self.points.final[points[cut]] = self._final(points[cut], normal[cut])
        self.points.start_failed(points[cut], normal[cut])
        self._direct()

    def _distance(self, crack: Crack, points: GlobalIndex, x: Float) -> tuple[Float, Float]:
        """Compute the distances (n,) [length] of points at ``x`` from a crack along its normals (n, dim).

        They are infinite if the crack and its images do not cut the families of the points.
        """
        nearest, normal = np.full(len(points), np.inf), np.zeros_like(x)
        images = images_of_cloud(crack, self.body.cloud)
        for sign, shift in zip(images.sign, images.shift, strict=True):
            along = sign * crack.normals(sign * (x - shift))
            if along.shape != x.shape or not np.allclose(np.linalg.norm(along, axis=1), 1.0, rtol=0.0, atol=1e-6):
                raise CaseError(f"The normals of a {type(crack).__name__} must be unit vectors {x.shape}.")
            low, high = self._reaches(points, along)

            def cuts(rows: LocalIndex | slice, low: Float, high: Float) -> Mask:
                ends = (sign * (x[rows] + reach[:, None] * along[rows] - shift) for reach in (low, high))
                return crack.cuts(*ends)

            here = np.flatnonzero(cuts(slice(None), low, high)).astype(np.int32)
            away = np.maximum(-low, high)[here]
            step = 0.5 * away
            for _ in range(HALVINGS):
                less = away - step
                away = np.where(cuts(here, -less, less), less, away)
                step = 0.5 * step
            nearer = away < nearest[here]
            nearest[here[nearer]], normal[here[nearer]] = away[nearer], along[here[nearer]]
        return nearest, normal

    def _direct(self) -> None:
        """Tell closed parts whose faces slide the normals of the cracks."""
        for part in [] if self._sliding is None else self._sliding.materials:
            part.history[:, : self.body.dim] = self.points.normal[part.points]

    def _refuse_strength(self) -> None:
        """Raise CaseError if points would store more energy at the onset than the crack may dissipate (collective)."""
        points, cloud = self.points, self.body.cloud
        fails, comm = np.flatnonzero(~points.spared), cloud.comm
        owner = self.operator.owner[fails]
        reach, place = self._reach()[owner], cloud.x[owner]
        # A function of the direction may have its minimum off the axes.
        fan, shares = _fan(self.body.dim) if self.damage_laws.varies else np.eye(self.body.dim)[:1], []
        for along in fan:
            with agreed(comm):
                Gc = self.damage_laws.crack_energy(owner, place, np.tile(along, (len(place), 1)))
            share = 2.0 * reach * points.onset_energy[fails] / Gc
            shares.append(largest(comm, share, initial=0.0))
        worst = max(shares)
        if worst >= 1.0:
            horizon, normal = cloud.horizon, ", ".join(f"{n:.2g}" for n in fan[shares.index(worst)])
            what = "onset" if all(law.strength is None for law in self.damage_laws.laws) else "strength"
            across = f" for a crack across ({normal})" if self.damage_laws.varies else ""
            stiffest = largest(comm, self._soft, initial=0.0) / RESIDUAL
            strengths = [law.strength for law in self.damage_laws.laws if isinstance(law.strength, float | int)]
            if strengths and max(strengths) > stiffest:
                raise CaseError(
                    f"The strength {max(strengths):g} of PointDamage is above E = {stiffest:g} of the material; check "
                    f"the units."
                )
            raise CaseError(
                f"The {what} of PointDamage stores more at the onset of damage than its Gc takes with a horizon of "
                f"{horizon:g}{across}; take a horizon below {horizon / worst:g}, or a lower {what}."
            )

    def _reach(self) -> Float:
        """Return half the largest width of a failing band at each own particle (n_owned,) [length]."""
        return self.body.families.reach(self.body.cloud.x)

    def _final(self, points: GlobalIndex, along: Float) -> Float:
        """Compute the final drive r (n,) of some points for cracks normal to directions (n, dim) (collective)."""
        with agreed(self.body.cloud.comm):
            final = self.points.final_of(points, self._specific_energy(points, along))
            if (final[~self.points.spared[points]] <= 1.0).any():
                raise CaseError("The Gc of PointDamage is too small for its strength in a direction; raise it there.")
        return final

    def _specific_energy(self, points: GlobalIndex, along: Float) -> Float:
        """Compute ``Gc / w`` (n,) [energy / volume] of some points for cracks normal to directions (n, dim)."""
        owner = self.operator.owner[points]
        low, high = self._reaches(points, along)
        Gc = self.damage_laws.crack_energy(owner, self.body.cloud.x[owner], along)
        return np.asarray(Gc / np.maximum(high - low, np.finfo(float).tiny))

    def _reaches(self, points: GlobalIndex, along: Float) -> tuple[Float, Float]:
        """Compute how far the stencils of some points reach from their particles against and along directions (n, dim).

        Both are (n,) [length], the first one not positive. With a control the stencil is the whole family of the
        particle: the energy of its control drives all its points.
        """
        low, high = np.zeros((2, len(points)))
        for begin in range(0, len(points), MOST_LISTED):
            some = slice(begin, begin + MOST_LISTED)
            stencils = self._driving_stencils(points[some])
            size, first, x = np.diff(stencils.point_ptr), stencils.point_ptr[:-1], self.body.cloud.x
            xi = x[stencils.members] - np.repeat(x[self.operator.owner[points[some]]], size, axis=0)
            reach = np.einsum("ei,ei->e", xi, np.repeat(along[some], size, axis=0))
            low[some], high[some] = np.minimum.reduceat(reach, first), np.maximum.reduceat(reach, first)
        return low, high

    def _driving_stencils(self, points: GlobalIndex) -> StencilMembers:
        """Return the particles whose displacements drive some points, those of the points first (not collective)."""
        if self._control is None:
            return self.operator.at(points)
        return self._control.families_at(self.operator.owner[points])

    @property
    def linear(self) -> bool:  # type: ignore[override]
        """Return True if the forces are linear: damage is held and no crack can close."""
        return super().linear and self.frozen and self._closed is None

    @property
    def piecewise_linear(self) -> bool:
        """Return True if the forces are linear as long as no point fails."""
        return self._linear and self._closed is None

    has_history = True

    # A point that fails couples its whole family if there is a control.
    whole_families = True

    @property
    def lost(self) -> Mask | None:
        """Return the points that had failed at the last converged step (n_points,)."""
        return self.points.gone

    @property
    def symmetric(self) -> bool:  # type: ignore[override]
        """Return True if the tangents of all materials and closed parts are symmetric."""
        return super().symmetric and (self._closed is None or self._closed.symmetric)

    # Interface of a damage model.

    forces_have_energy = True
    conduction_version = 0

    @property
    def conducting_points(self) -> Float:
        """Return the degradation factors of the points (n_points,): failed points insulate."""
        return self.points.phi

    softens = True

    def driven(self, state: State) -> Driven:
        """Compute drive and degradation factor of the points at a state (collective)."""

        def make() -> Driven:
            Y = np.maximum(self._open_energy(state), 0.0)
            return self.points.following(np.sqrt(Y / self.points.onset_energy))

        return state.kept(("driven", self.version, self.frozen, self.points.slack), make)

    def _open_energy(self, state: State) -> Float:
        """Compute ``Y = psi_open + psi_control`` (n_points,) [energy / volume]."""
        F = self.deformation(state)
        Y = self.laws(state).energy(F) + self._unresolved_energy(state)
        if self._closed is not None:  # the closed part only lowers Y: far below the onset it does not matter
            Y = Y - self._closed.laws(state).energy(F, NEAR_ONSET**2 * self.points.onset_energy < Y)
        if self._sliding is not None:
            Y = Y - self._of_sliding(self._sliding, SlidingPart.slipped, state) - self.points.released
        return Y

    def _released(self, state: State, points: GlobalIndex, normal: Float) -> Float:
        """Compute the energy density (n,) that slip releases if cracks of normals (n, dim) begin at some points.

        Y excludes it. Otherwise Y would jump as a crack begins, and the energy would not balance (collective).
        """
        assert self._sliding is not None
        F, only = self.deformation(state), np.zeros(self.operator.n_points, dtype=bool)
        only[points] = True
        energy = []
        for along in (0.0, normal):
            self.points.normal[points] = along
            self._direct()
            of_closed = self._sliding.laws(state).energy(F, only)[points]
            energy.append(of_closed + self._of_sliding(self._sliding, SlidingPart.slipped, state)[points])
        return np.asarray(energy[0] - energy[1])

    def _of_sliding(
        self, sliding: MaterialPoints, quantity: Callable[[Any, Float, Float], Float], state: State
    ) -> Float:
        """Compute an energy density of closed parts whose faces slide (n_points,) from F and history (collective)."""
        found = np.zeros(self.operator.n_points)
        for law in sliding.laws(state).materials:
            law.density_of(quantity, self.deformation(state), found)
        return found

    def _unresolved_energy(self, state: State) -> Float:
        """Compute the part of Y that does not depend on F: ``psi_control`` (n_points,) [energy / volume]."""
        if self._control is None:
            return np.zeros(self.operator.n_points)
        return np.asarray((self._control.family_energy(state.u_local) / self._volume)[self.operator.owner])

    def _followed(self, state: State) -> tuple[Float, Float, Float, Float]:
        """Return largest drives, final drives, degradation factors (n_points,) and normals at a state (collective).

        The last value holds the normals (n_points, dim) of the cracks that begin, zero at other points.

        The width of a family is that normal to the crack that begins when damage is first accepted beyond the onset. It
        is fixed for the rest of the load step. Otherwise sweeps and Newton might alternate between two directions.
        """
        points, x = self.points, self.driven(state).x
        final, normal = points.final.copy(), np.zeros_like(points.normal)
        ahead = np.flatnonzero((points.largest <= 1.0) & (x > NEAR_ONSET) & ~points.spared)
        if anywhere(self.body.cloud.comm, len(ahead)):
            across = self._across(state, ahead, x)
            final[ahead] = self._final(ahead, across)
            normal[ahead] = np.where(x[ahead, None] > 1.0, across, 0.0)
        kappa = np.maximum(points.kappa, x)
        return kappa, final, points.phi_of(kappa, final), normal

    def _across(self, state: State, points: GlobalIndex, x: Float) -> Float:
        """Compute unit normals (n, dim) of the crack at some points, for the drives x of all points (collective).

        The normal is the first principal direction of the mean of ``M_q`` over the members of the family. ``M_q`` is
        the mean square of the relative displacements in the family of q, without rotation and compression, over that of
        its bonds: ``M = <strain>^2 / dim + sum z (x) z / sum |xi|^2``. The residual of the gradient is ``z = eta - (F -
        I) xi``. Strain alone is oblique near a tip, and its shear cancels between both sides.
        """
        cloud, operator, dim = self.body.cloud, self.operator, self.body.dim
        of_owners, number = entries_of(operator.points_of, operator.owner[points])
        families = operator.at(of_owners)
        wanted = np.zeros(cloud.n_local)
        wanted[families.members] = 1.0
        cloud.halo.reverse(wanted)
        near = (np.maximum(x, self.points.kappa) > NEAR_ONSET) & (wanted[operator.owner] > 0.0)
        apart = np.zeros((operator.n_points, dim, dim))
        apart[near] = self._apart(state, np.flatnonzero(near))
        of_particles = cloud.halo.with_ghosts(operator.mean_over_points(apart, cloud.n_owned))
        cloud.mirror(of_particles)
        one, ptr = np.ones(len(families.members)), families.point_ptr[number]
        sums = scipy.sparse.csr_matrix((one, families.members, ptr), shape=(len(points), cloud.n_local))
        M = (sums @ of_particles.reshape(cloud.n_local, -1)).reshape(-1, dim, dim)
        return np.asarray(np.linalg.eigh(M)[1][:, :, -1])

    def _apart(self, state: State, points: GlobalIndex) -> Float:
        """Compute ``M_q`` of some points q (n, dim, dim) [-] (not collective)."""
        dim, stencils = self.body.dim, self.operator.at(points)
        F = super().deformation(state)[points]
        square, residual = np.empty(len(points)), np.empty((len(points), dim, dim))
        data = stencils.owner, stencils.point_ptr, stencils.members, self.body.cloud.x, state.u_local
        residual_kernel(dim)(*data, F, square, residual)
        strain = 0.5 * (F + F.transpose(0, 2, 1)) - np.eye(dim)
        if not self._linear:
            residual = F.transpose(0, 2, 1) @ residual @ F
            strain = 0.5 * (F.transpose(0, 2, 1) @ F - np.eye(dim))
        stretch, axes = symmetric_axes(strain)
        M = np.einsum("pik,pk,pjk->pij", axes, np.maximum(stretch, 0.0) ** 2 / dim, axes)
        return np.asarray(M + residual / square[:, None, None])

    def fading(self, state: State) -> float:
        """Return the largest change of a degradation factor that a state would cause [-]."""
        phi = self._followed(state)[2]
        return largest(self.body.cloud.comm, np.abs(phi - self.points.phi), initial=0.0)

    def soften(self, state: State) -> float:
        """Accept the damage at a state; return the largest change of a degradation factor [-].

        The damage depends only on the last converged step and this state, so that sweeps lower one energy.
        """
        points = self.points
        before = points.phi.copy()
        points.largest[:], points.final[:], points.phi[:], normal = self._followed(state)
        begun = np.flatnonzero(normal.any(axis=1))
        points.normal[begun] = normal[begun]
        if self._sliding is not None and anywhere(self.body.cloud.comm, len(begun)):
            points.released[begun] = self._released(state, begun, normal[begun])
        self._direct()
        change = largest(self.body.cloud.comm, np.abs(points.phi - before), initial=0.0)
        self.conduction_version += change > 0.0
        return change

    def keep(self, state: State) -> None:
        """Commit the damage at a converged state (not collective).

        A crack that began in a sweep, at a point that has not failed in the end, is forgotten.
        """
        points = self.points
        self._advanced = np.flatnonzero((points.largest > points.kappa) & (points.phi > 0.0) & (points.phi < 1.0))
        points.commit()
        for part in [] if self._sliding is None else self._sliding.materials:
            part.history[self.points.kappa[part.points] <= 1.0] = 0.0

    def commit(self, state: State) -> None:
        """Update histories of materials, slip of closed cracks, and softening curves at a converged state."""
        super().commit(state)
        if self._sliding is not None:
            self._commit_slip(self._sliding, state)
        self._stretch(state, self._advanced)

    def _commit_slip(self, sliding: MaterialPoints, state: State) -> None:
        """Update slip and the work of friction."""
        # A point that fails further has slipped with all of its faces, at the friction of the present state.
        phi = self.points.phi
        self._rubbed += (1.0 - phi) * self._of_sliding(sliding, SlidingPart.rubbed, state)
        self._rubbed += (self._phi_of_work - phi) * self._of_sliding(sliding, SlidingPart.slipped, state)
        self._phi_of_work = phi.copy()
        sliding.laws(state).commit(self.deformation(state))

    def _stretch(self, state: State, failing: GlobalIndex) -> None:
        """Stretch the curves of points that fail further to ``Gc / w`` of their present direction (collective).

        No force changes: the state stays in equilibrium. The faces keep their normal, on which forces of closed and of
        pressurised cracks depend.
        """
        comm = self.body.cloud.comm
        if not anywhere(comm, len(failing)):
            return
        across = self._across(state, failing, self.points.kappa)
        with agreed(comm):
            energy = self._specific_energy(failing, across)
        self.points.stretch(failing, energy)

    def revert(self) -> bool:
        """Undo the damage since the last ``keep``; return False, since no weights change."""
        self.points.revert()
        self._direct()
        self.conduction_version += 1
        return False

    def stored(self) -> tuple[Float, ...]:
        """Return copies of degradation factors, drives, normals and energies that slip released (not collective)."""
        points = self.points
        arrays = points.phi, points.largest, points.final, points.normal, points.released
        return tuple(array.copy() for array in arrays)

    def reset(self, stored: tuple[Float, ...]) -> None:
        """Restore stored values (not collective)."""
        points = self.points
        points.phi[:], points.largest[:], points.final[:], points.normal[:], points.released[:] = stored
        self._direct()
        self.conduction_version += 1

    # Forces, tangent, energy and outputs.

    def deformation(self, state: State) -> Float:
        """Return ``F_p`` (n_points, dim, dim) [-]; I at failed points if there is no closed part."""
        return self._without_failed(super().deformation(state))

    def _without_failed(self, F: Float) -> Float:
        """Replace gradients F (n_points, dim, dim) [-] of failed points by I if there is no closed part."""
        failed = self.points.gone
        if self._closed is not None or not failed.any():
            return F
        F = F.copy()
        F[failed] = np.eye(self.body.dim)
        return F

    def point_gradient(self, state: State) -> Float:
        """Return F of the points (n_points, dim, dim) [-], including failed ones."""
        return super().deformation(state)

    def stress(self, state: State) -> Float:
        """Compute ``phi P_open + P_closed`` (n_points, dim, dim) [stress]."""
        P = self._degraded_stress(state)
        failed, soft, strain = self._residual(state)
        P[failed] += soft[:, None, None] * strain
        return P

    def moduli_sets(self, state: State) -> Moduli:
        """Compute ``phi A_open + A_closed``, damage held."""
        F = self.deformation(state)
        A = self._degraded(state, lambda laws, only: laws.moduli(F, only))
        failed, residual = self._residual_moduli(state)
        A[failed] += residual
        return Moduli(A)

    def _degraded_stress(self, state: State) -> Float:
        """Compute ``phi P_open + P_closed`` (n_points, dim, dim) [stress] in a new array."""
        F = self.deformation(state)
        return self._degraded(state, lambda laws, only: laws.stress(F, only))

    def _residual_moduli(self, state: State) -> tuple[GlobalIndex, Float]:
        """Return failed points at a state, and their residual moduli (n, dim, dim, dim, dim) [stress]."""
        failed, soft, _ = self._residual(state)
        one = np.eye(self.body.dim)
        symmetric = 0.5 * (np.einsum("ik,mn->imkn", one, one) + np.einsum("in,mk->imkn", one, one))
        return failed, soft[:, None, None, None, None] * symmetric

    def point_energy(self, state: State) -> Float:
        """Compute ``phi psi_open + psi_closed`` and the work of slip (n_points,) [energy / volume]."""
        F = self.deformation(state)
        psi = self._degraded(state, lambda laws, only: laws.energy(F, only))
        failed, soft, strain = self._residual(state)
        psi[failed] += 0.5 * soft * np.einsum("pij,pij->p", strain, strain)
        return np.asarray(psi + self._rubbed + (1.0 - self.driven(state).phi) * self.points.released)

    def _degraded(self, state: State, of: Callable[[PointLaws, Mask | None], Float]) -> Float:
        """Compute ``phi (whole - closed) + closed`` of a quantity of the points (n_points, ...).

        ``of`` computes it for laws; its second argument marks the required points.
        """
        whole, phi = of(self.laws(state), None), self.driven(state).phi
        each = phi.reshape(-1, *(1,) * (whole.ndim - 1))
        if self._closed is None:
            return np.asarray(each * whole)
        closed = of(self._closed.laws(state), phi < 1.0)
        return np.asarray(each * whole + (1.0 - each) * closed)

    def _residual(self, state: State) -> tuple[GlobalIndex, Float, Float]:
        """Return failed points at a state, their residual modulus [stress], and the symmetric part of F - I there.

        They store ``1/2 soft eps : eps``. It holds detached pieces in place, with forces far below those of intact
        points.
        """
        failed = np.flatnonzero(self.driven(state).phi == 0.0)
        H = self.point_gradient(state)[failed] - np.eye(self.body.dim)
        return failed, self._soft[failed], 0.5 * (H + H.transpose(0, 2, 1))

    def linearise(self, state: State) -> list[Product]:
        """Return ``G^T W (phi A_open + A_closed) G`` and, unless damage is held, the derivative of phi."""
        found: list[Product] = [PointProduct(self.operator, self.moduli_sets(state))]
        return found if self.frozen else [*found, self._softening(state)]

    def _open_stress(self, state: State) -> Float:
        """Compute ``P_open`` (n_points, dim, dim) [stress], without damage."""
        F = self.deformation(state)
        P = self.laws(state).stress(F)
        return P if self._closed is None else P - self._closed.laws(state).stress(F)

    def _softening(self, state: State) -> Product:
        """Return ``W dphi/dY v (x) v`` of failing points, ``v = dY/du`` over the members of their stencil."""
        active, b = self._failing_by_drive(state)
        stencils, v = self._drive_gradient(state, active)
        return SofteningProduct(stencils, self.body.cloud.n_owned, v, v, b)

    def softened(self, state: State, stress: Float) -> Product:
        """Return ``W dphi/dY (G^T stress) (x) v`` of failing points, the change of ``G^T W phi stress`` by damage.

        ``stress`` (n_points, dim, dim) [stress].
        """
        active, b = self._failing_by_drive(state)
        stencils, v = self._drive_gradient(state, active)
        # The operator lists its points in ascending order.
        order = np.argsort(active)
        some = self.operator.at(active[order])
        each = np.einsum("eij,ej->ei", np.repeat(stress[active[order]], np.diff(some.point_ptr), axis=0), some.g)
        forces = sum_by(places_of(some, order, stencils, self.body.cloud.n_local), each, len(v))
        return SofteningProduct(stencils, self.body.cloud.n_owned, forces, v, b)

    def _failing_by_drive(self, state: State) -> tuple[GlobalIndex, Float]:
        """Return the points that fail, and their ``W dphi/dY`` (n,) [volume^2 / energy] (collective)."""
        points, driven = self.points, self.driven(state)
        active = self._by_stencil(np.flatnonzero(driven.fails))
        b = self.operator.volume * 0.5 * driven.slope / (np.maximum(driven.x, 1.0) * points.onset_energy)
        return active, b[active]

    def _by_stencil(self, points: GlobalIndex) -> GlobalIndex:
        """Sort points by the owners of their driving stencils."""
        return points

    def dissipation_gradient(self, state: State) -> Float:
        """Compute the derivative of the dissipated energy by the unknowns, of failing points (n_rows, dim) [force].

        ``sum_p -W Y dphi/dY v`` (collective).
        """
        driven = self.driven(state)
        active = np.flatnonzero(driven.fails)
        stencils, v = self._drive_gradient(state, active)
        each = (-0.5 * self.operator.volume * driven.slope * driven.x)[active]
        f = np.zeros_like(state.u_local)
        np.add.at(f, stencils.members, v * np.repeat(each, np.diff(stencils.point_ptr))[:, None])
        return self.body.gather(f)

    def _drive_gradient(self, state: State, points: GlobalIndex) -> tuple[StencilMembers, Float]:
        """Return the particles that drive some points, and ``v = dY/du`` of each (n_entries, dim) [stress / length]."""
        P, some = self._open_stress(state), self.operator.at(points)
        v = np.einsum("eij,ej->ei", np.repeat(P[points], np.diff(some.point_ptr), axis=0), some.g)
        if self._control is None:
            return some, v
        families = self._control.families_at(some.owner)
        whole = self._control.forces_at(state.u_local, some.owner)
        whole /= np.repeat(self._volume[some.owner], np.diff(families.point_ptr))[:, None]
        whole += sum_by(places_of(some, np.arange(len(points)), families, self.body.cloud.n_local), v, len(whole))
        return families, whole

    def share(self, state: State) -> Float:
        """Return the mean degradation factor of the points of each particle (n_owned,) [-], at least ``RESIDUAL``."""
        return np.maximum(self._of_particles(self.driven(state).phi), RESIDUAL)

    def _of_particles(self, values: Float) -> Float:
        return np.asarray(self.operator.sum_over_points(self.operator.volume * values) / self._volume)

    def local_damage(self) -> Float:
        """Return ``1 - phi``, the mean over the points of each own particle (n_owned,) [-] (not collective)."""
        return 1.0 - self._of_particles(self.points.phi)

    def dissipation_density(self) -> Float:
        """Compute the mean of ``-int Y dphi`` over the points of each own particle (n_owned,) [energy / volume]."""
        return self._of_particles(self.points.dissipated())

    def energy_by_strain(self, state: State) -> Float:
        """Compute the derivative of the energy density by the eigenstrain at constant F (n_points, 3, 3)."""
        F = self.deformation(state)
        return self._degraded(state, lambda laws, only: laws.energy_by_strain(F))

    def energy_by_temperature(self, state: State, temperature: Float, step: float) -> Float:
        """Compute the derivative of the degraded energy density by the temperature of the law (n_points,)."""
        F, at = self.deformation(state), temperature[self.operator.owner]
        return self._degraded(state, lambda laws, only: laws.energy_by_temperature(F, at, step))

    def out_of_plane(self, state: State) -> tuple[Float, Float, Float]:
        """Return stretch, P and Cauchy stress normal to a plane or line body (n_owned,)."""
        F = self.deformation(state)
        stretch, whole, sigma = self.laws(state).out_of_plane(F)
        # The ratio of both stresses is that of the intact material.
        current = np.divide(sigma, whole, out=np.ones_like(sigma), where=whole != 0.0)
        P = self._degraded(state, lambda laws, only: laws.out_of_plane(F)[1])
        return self._mean(stretch), self.mean_stress(P), self.mean_stress(P * current)

    def energy_at(self, state: State, F: Float, volume: Float) -> Float:
        """Compute the energy density of all points (n_points,) at other gradients F, with the damage of the state."""
        return self._degraded(state, lambda laws, only: laws.energy(F, only))

    def arrays(self) -> Mapping[str, KeptArray]:
        """Return the histories of the materials and the damage of the points."""
        points, owner = self.points, self.operator.owner
        of_slip: dict[str, KeptArray] = {}
        if self._sliding is not None:
            of_slip = {f"closed_{name}": array for name, array in self._sliding.arrays().items()}
            of_slip["work_of_friction"] = KeptArray(owner, self._rubbed)
            of_slip["released_by_slip"] = KeptArray(owner, points.released)
        return {
            **super().arrays(),
            **of_slip,
            "phi": KeptArray(owner, points.phi, 0.0, 1.0),
            "largest_drive": KeptArray(owner, points.kappa, 0.0),
            "start_drive": KeptArray(owner, points.start),
            "final_drive": KeptArray(owner, points.final, 1.0),
            "dissipated": KeptArray(owner, points.spent),
            "crack_normal": KeptArray(owner, points.normal, -1.0, 1.0),
        }

    def restored(self) -> None:
        """Update after the arrays have been read from a checkpoint (not collective)."""
        super().restored()
        self.points.largest[:] = self.points.kappa
        self.points.commit()
        self._phi_of_work = self.points.phi.copy()
        self.conduction_version += 1


class DegradedControl(ControlForces):
    """Compute the forces of a zero-energy control whose families are degraded with the points of their particle.

    Parameters
    ----------
    body, name, control
        As for ``ControlForces``.
    points : DegradedPoints
        Points that determine the degradation factor.
    """

    def __init__(self, body: Body, name: str, control: Control, points: DegradedPoints) -> None:
        super().__init__(body, name, control)
        self._points = points

    @property
    def linear(self) -> bool:  # type: ignore[override]
        """Return True if damage is held."""
        return self._points.frozen

    def at(self, state: State) -> Control:
        """Return the control with the degradation factor of each particle at a state."""
        points = self._points
        key = "degraded control", points.version, points.frozen
        return state.kept(key, lambda: self.control.scaled(points.share(state)))

    def control_of(self, operator: GradientOperator, state: State) -> SameGradient | None:
        """Return the data of the forces at a state."""
        return self.at(state).shared_gradient(operator)


def _fan(dim: int) -> Float:
    """Return unit vectors (n, dim) in all directions, one of each opposite pair, the first along the first axis."""
    if dim == 1:
        return np.ones((1, 1))
    if dim == 2:
        angle = np.pi * np.arange(FAN[2]) / FAN[2]
        return np.stack([np.cos(angle), np.sin(angle)], axis=1)
    z = np.arange(FAN[3]) / FAN[3]
    angle = np.pi * (3.0 - np.sqrt(5.0)) * np.arange(FAN[3])  # the golden angle spreads them evenly
    flat = np.sqrt(1.0 - z**2)
    return np.stack([flat * np.cos(angle), flat * np.sin(angle), z], axis=1)


def places_of(of: StencilMembers, rows: GlobalIndex, stencils: StencilMembers, n_local: int) -> GlobalIndex:
    """Return the index of each member of ``of`` (n_entries,) in ``stencils``, whose rows ``rows`` it represents."""

    def keys(number: GlobalIndex, one: StencilMembers) -> GlobalIndex:
        return np.asarray(np.repeat(number, np.diff(one.point_ptr)) * np.int64(n_local) + one.members)

    return Lookup(keys(np.arange(len(stencils.owner)), stencils)).of(keys(rows, of))
