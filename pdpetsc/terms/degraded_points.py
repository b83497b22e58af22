"""Damage at gradient points: material and control lose their force together, from one energy."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from typing import NamedTuple

import numpy as np

from pdpetsc.arrays import Float, GlobalIndex, LocalIndex, Mask
from pdpetsc.control.base import Control
from pdpetsc.damage.point_damage import FailingPoints, PointDamage
from pdpetsc.discrete.communicator import agreed, largest, total
from pdpetsc.errors import CaseError
from pdpetsc.gradient.base import GradientOperator, Moduli, StencilMembers
from pdpetsc.gradient.products import PointProduct, Product, SofteningProduct
from pdpetsc.kernels.gradient import bonds_of_entries
from pdpetsc.material.base import Material
from pdpetsc.problem.body import Body
from pdpetsc.problem.damage import DamageModel
from pdpetsc.problem.state import State
from pdpetsc.problem.term import KeptArray, Term
from pdpetsc.terms.control import ControlForces
from pdpetsc.terms.material_points import MaterialPoints

# Points whose drive is above this share of that of the onset take the final drive of their own direction.
NEAR_ONSET = 0.5
# A control keeps this share of its stiffness where all points of a particle have failed.
LEAST = 1e-12


class Driven(NamedTuple):
    """The points at a state.

    Attributes
    ----------
    x : (n_points,) float64
        Drive [-].
    phi, slope : (n_points,) float64
        Degradation factor, and its derivative by the drive where it falls [-].
    fails : (n_points,) bool
        Where it falls.
    """

    x: Float
    phi: Float
    slope: Float
    fails: Mask


class DegradedPoints(MaterialPoints, DamageModel):
    """Forces of ``sum_p W_p [phi_p (psi_open + psi_control) + psi_closed]``, ``phi_p`` the degradation factor.

    The forces of the control are those of ``DegradedControl``; the derivative of ``phi_p`` by the displacement is in
    the tangent of this term, ``dphi/dY (P_open . g + f_control) (x) (P_open . g + f_control)`` for each point that
    fails.

    Parameters
    ----------
    body, operator, materials, material_of, factor
        As for ``MaterialPoints``.
    law : PointDamage
        As declared.
    spared : (n_owned,) bool
        Particles whose points do not fail.
    control : Control or None
        The zero-energy control of the intact body.

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
        factor: Float | None, law: PointDamage, spared: Mask, control: Control | None,
    ) -> None:  # fmt: skip
        super().__init__(body, operator, materials, material_of, factor)
        self.law, self._control = law, control
        with agreed(body.cloud.comm):
            E = np.array([material.young_modulus() for material in materials])
            closed = [law.split.closed_part(material) for material in materials]
            varies = body.thermals is not None and any(one is not None and one.law for one in body.thermals)
            if varies and any(part is not None for part in closed):
                raise CaseError(
                    f"{type(law.split).__name__} is made once from each material, and a law of Thermal is another one "
                    f"at every temperature; take split=pd.split.Whole(), or a factor of the moduli."
                )
            for material, part in zip(materials, closed, strict=True):
                flows = type(material).plastic_strain is not Material.plastic_strain
                if part is not None and flows and material.kind(body.dim) not in ("solid", "strain"):
                    raise CaseError(
                        f"{type(law.split).__name__} reads the volume of a point, and in plane stress and in bars that "
                        f"of {type(material).__name__} changes as it flows; take split=pd.split.Whole()."
                    )
        kept = [part for part in closed if part is not None]
        self._closed = MaterialPoints(body, operator, kept, material_of, factor) if kept else None
        moduli = E[material_of] * (1.0 if factor is None else factor)
        share = np.array([1.0 if part is None else part.open_share(body.dim) for part in closed])
        with agreed(body.cloud.comm):  # functions of place may fail on one rank
            onset_energy = law.onset_energy(moduli, body.cloud.x[: body.cloud.n_owned]) * share[material_of]
        self.points = FailingPoints(law.curve, onset_energy[operator.owner], spared[operator.owner])
        self._refuse_strength()
        # The width of a family along the axes stands for that along the largest strain before there is any.
        everything = np.arange(operator.n_points)
        self.points.final[:] = self._final(everything, np.tile(np.eye(body.dim)[0], (operator.n_points, 1)))
        self.points.commit()
        self._volume = operator.sum_over_points(operator.volume)
        self._in_family = self._places_in_family()

    def _refuse_strength(self) -> None:
        """Raise CaseError where points would store more at the onset than the crack may take (collective)."""
        points, families, cloud = self.points, self.body.families, self.body.cloud
        length = np.linalg.norm(families.bonds(cloud.x), axis=1)
        reach = np.maximum.reduceat(np.append(length, 0.0), families.indptr[:-1])[self.operator.owner]
        place, comm, worst = cloud.x[self.operator.owner], cloud.comm, 0.0
        for axis in np.eye(self.body.dim):
            with agreed(comm):
                Gc = self.law.crack_energy(place, np.tile(axis, (len(place), 1)))
            share = 2.0 * reach * points.onset_energy / Gc
            worst = max(worst, largest(comm, float(np.where(points.spared, 0.0, share).max(initial=0.0))))
        if worst >= 1.0:
            horizon = self.body.cloud.horizon
            what = "strength" if self.law.onset is None else "onset"
            raise CaseError(
                f"The {what} of PointDamage stores more at the onset of damage than its Gc takes with a horizon of "
                f"{horizon:g}; take a horizon below {horizon / worst:g}, or a lower {what}."
            )

    def _final(self, points: GlobalIndex, along: Float) -> Float:
        """Return r (n,) of some points for cracks across directions (n, dim) (collective)."""
        with agreed(self.body.cloud.comm):
            Gc = self.law.crack_energy(self.body.cloud.x[self.operator.owner[points]], along)
            final = self.points.final_of(points, Gc / np.maximum(self._width(points, along), np.finfo(float).tiny))
            if (final[~self.points.spared[points]] <= 1.0).any():
                raise CaseError("The Gc of PointDamage is too small for its strength in a direction; raise it there.")
        return final

    def _width(self, points: GlobalIndex, along: Float) -> Float:
        """Return how far stencils of some points reach along directions (n, dim), to both sides (n,) [length].

        With a control it is the whole family of the particle: the energy of its control drives all of its points.
        """
        if not len(points):
            return np.zeros(0)
        ptr, members, owner = self.operator.point_ptr, self.operator.members, self.operator.owner[points]
        rows: GlobalIndex | LocalIndex = points
        if self._control is not None:
            (ptr, members), rows = self._control.stencils, owner
        entries, first = _entries(ptr, rows)
        x, size = self.body.cloud.x, np.diff(first)
        xi = x[members[entries]] - np.repeat(x[owner], size, axis=0)
        reach = np.einsum("ei,ei->e", xi, np.repeat(along, size, axis=0))
        return np.asarray(np.maximum.reduceat(reach, first[:-1]) - np.minimum.reduceat(reach, first[:-1]))

    def _places_in_family(self) -> GlobalIndex:
        """Return the place of each entry of the operator among the members of all families, centres first."""
        operator, families = self.operator, self.body.families
        bond = np.empty(len(operator.members), dtype=np.int64)
        bonds_of_entries(
            operator.owner, operator.point_ptr, operator.members, families.indptr, families.neighbours,
            self.body.cloud.n_local, bond,
        )  # fmt: skip
        centre = operator.owner[np.repeat(np.arange(operator.n_points), np.diff(operator.point_ptr))]
        return np.where(bond < 0, families.indptr[centre] + centre, bond + centre + 1)

    @property
    def name(self) -> str:
        """Return the name of the law."""
        return type(self.law).__name__

    @property
    def linear(self) -> bool:  # type: ignore[override]
        """Return whether forces are linear: damage is held and no crack can close."""
        return self._linear and self.frozen and self._closed is None

    @property
    def piecewise_linear(self) -> bool:
        """Return whether they are as long as nothing fails."""
        return self._linear and self._closed is None

    @property
    def has_history(self) -> bool:
        """Return True."""
        return True

    @property
    def whole_families(self) -> bool:
        """Return True: a point that fails couples its whole family if there is a control."""
        return True

    @property
    def lost(self) -> Mask | None:
        """Return which points have failed."""
        return np.asarray(self.points.phi == 0.0)

    @property
    def timed(self) -> bool:  # type: ignore[override]
        """Return whether a material depends on time."""
        return super().timed

    # What a damage model is asked.

    forces_have_energy = True

    @property
    def softens(self) -> bool:
        """Return True."""
        return True

    @property
    def failing(self) -> FailingPoints:
        """Return the state of the points."""
        return self.points

    def driven(self, state: State) -> Driven:
        """Return drive and degradation factor of the points at a state (collective)."""

        def make() -> Driven:
            x = np.sqrt(np.maximum(self._open_energy(state), 0.0) / self.points.onset_energy)
            phi, fails, slope = self.points.following(x)
            return Driven(x, phi, slope, fails)

        return state.kept(("driven", self.version, self.frozen, self.points.slack), make)

    def _open_energy(self, state: State) -> Float:
        """Return ``Y = psi_open + psi_control`` (n_points,) [energy / volume]."""
        F = self.deformation(state)
        Y = self.laws(state).energy(F)
        if self._closed is not None:
            Y = Y - self._closed.laws(state).energy(F)
        if self._control is not None:
            Y = Y + (self._control_energy(state) / self._volume)[self.operator.owner]
        return Y

    def control_forces(self, state: State) -> Float:
        """Return the forces of the intact control on the members of all families (n_entries, dim) [force]."""
        control = self._control
        assert control is not None
        return state.kept(("control forces", id(self)), lambda: control.family_forces(state.u_local))

    def _control_energy(self, state: State) -> Float:
        assert self._control is not None
        ptr, members = self._control.stencils
        u, m = state.u_local, self.control_forces(state)
        eta = u[members] - np.repeat(u[members[ptr[:-1]]], np.diff(ptr), axis=0)
        return np.asarray(0.5 * np.add.reduceat(np.einsum("ei,ei->e", m, eta), ptr[:-1]))

    def _followed(self, state: State) -> tuple[Float, Float, Float]:
        """Return largest and final drives and degradation factors (n_points,), taken at a state (collective).

        The width of a family is that across the crack that begins, as long as its point has not failed.
        """
        points, x = self.points, self.driven(state).x
        final = points.final.copy()
        ahead = np.flatnonzero((points.kappa <= 1.0) & (x > NEAR_ONSET) & ~points.spared)
        if int(total(self.body.cloud.comm, len(ahead))):
            final[ahead] = self._final(ahead, self._across(state, ahead, x))
        kappa = np.maximum(points.kappa, x)
        return kappa, final, points.phi_of(kappa, final)

    def _across(self, state: State, points: GlobalIndex, x: Float) -> Float:
        """Return unit normals (n, dim) of the crack at some points, for the drives x of all points (collective).

        The normal is the first principal direction of the mean of ``M_q`` over the members of the family. ``M_q`` is
        the mean square of the relative displacements in the family of q, without rotation and compression, over that
        of its bonds: ``M = <strain>^2 / dim + sum z (x) z / sum |xi|^2`` with the residual of the gradient,
        ``z = eta - (F - I) xi``. Strain alone is oblique beside a tip; its shear cancels between the two sides.
        """
        cloud, operator, dim = self.body.cloud, self.operator, self.body.dim
        gradient, u = super().deformation(state), state.u_local
        near = np.flatnonzero(np.maximum(x, self.points.kappa) > NEAR_ONSET)
        F, owner = gradient[near], operator.owner[near]
        entries, first = _entries(operator.point_ptr, near)
        members, size = operator.members[entries], np.diff(first)
        xi, eta = (v[members] - np.repeat(v[owner], size, axis=0) for v in (cloud.x, u))
        z = eta - np.einsum("eij,ej->ei", np.repeat(F - np.eye(dim), size, axis=0), xi)
        strain = 0.5 * (F + F.transpose(0, 2, 1)) - np.eye(dim)
        if not self._linear:
            z = np.einsum("eji,ej->ei", np.repeat(F, size, axis=0), z)
            strain = 0.5 * (np.einsum("pki,pkj->pij", F, F) - np.eye(dim))
        stretch, axes = np.linalg.eigh(strain)
        apart = np.zeros((operator.n_points, dim, dim))
        apart[near] = np.einsum("pik,pk,pjk->pij", axes, np.maximum(stretch, 0.0) ** 2 / dim, axes)
        if len(near):
            square = np.add.reduceat(np.einsum("ei,ei->e", xi, xi), first[:-1])
            apart[near] += np.add.reduceat(np.einsum("ei,ej->eij", z, z), first[:-1]) / square[:, None, None]
        of_particles = np.zeros((cloud.n_local, dim, dim))
        of_particles[: cloud.n_owned] = operator.mean_over_points(apart, cloud.n_owned)
        cloud.halo.forward(of_particles)
        if len(cloud.sign):
            of_particles[cloud.n_owned :] *= np.einsum("gi,gj->gij", cloud.sign, cloud.sign)
        if not len(points):
            return np.empty((0, dim))
        own = operator.owner[points]
        begin = operator.point_ptr[operator.points_of[own]]
        size = operator.point_ptr[operator.points_of[own + 1]] - begin
        first = np.concatenate([[0], np.cumsum(size)])
        entries = np.arange(first[-1]) + np.repeat(begin - first[:-1], size)
        M = np.add.reduceat(of_particles[operator.members[entries]], first[:-1])
        return np.asarray(np.linalg.eigh(M)[1][:, :, -1])

    def fading(self, state: State) -> float:
        """Return by how much a degradation factor would change at most [-]."""
        phi = self._followed(state)[2]
        return largest(self.body.cloud.comm, float(np.abs(phi - self.points.phi).max(initial=0.0)))

    def soften(self, state: State) -> float:
        """Take the damage at a state for good; return the largest change of a degradation factor [-]."""
        points = self.points
        before = points.phi.copy()
        points.kappa[:], points.final[:], points.phi[:] = self._followed(state)
        return largest(self.body.cloud.comm, float(np.abs(points.phi - before).max(initial=0.0)))

    def keep(self, state: State) -> None:
        """Keep the damage at a converged state (not collective)."""
        self.points.commit()

    def revert(self) -> bool:
        """Take back what failed since the last ``keep``; no weights change."""
        self.points.revert()
        return False

    def stored(self) -> tuple[Float, ...]:
        """Return a copy of degradation factors, largest and final drives (not collective)."""
        return self.points.phi.copy(), self.points.kappa.copy(), self.points.final.copy()

    def reset(self, stored: tuple[Float, ...]) -> None:
        """Go back to them (not collective)."""
        self.points.phi[:], self.points.kappa[:], self.points.final[:] = stored

    # Forces, tangent, energy and outputs.

    def deformation(self, state: State) -> Float:
        """Return ``F_p`` (n_points, dim, dim) [-]; I at points that have failed if a closed crack keeps nothing."""
        F = super().deformation(state)
        failed = self.points.phi == 0.0
        if self._closed is not None or not failed.any():
            return F
        F = F.copy()
        F[failed] = np.eye(self.body.dim)
        return F

    def stress(self, state: State) -> Float:
        """Return ``phi P_open + P_closed`` (n_points, dim, dim) [stress]."""
        return self._degraded(state, lambda term: term.laws(state).stress(self.deformation(state)))

    def moduli_sets(self, state: State) -> Moduli:
        """Return ``phi A_open + A_closed``, damage held."""
        return Moduli(self._degraded(state, lambda term: term.laws(state).moduli(self.deformation(state))))

    def point_energy(self, state: State) -> Float:
        """Return ``phi psi_open + psi_closed`` (n_points,) [energy / volume]."""
        return self._degraded(state, lambda term: term.laws(state).energy(self.deformation(state)))

    def _degraded(self, state: State, of: Callable[[MaterialPoints], Float]) -> Float:
        """Return ``phi (whole - closed) + closed`` of a number of the points (n_points, ...)."""
        whole = of(self)
        phi = self.driven(state).phi.reshape(-1, *(1,) * (whole.ndim - 1))
        if self._closed is None:
            return np.asarray(phi * whole)
        closed = of(self._closed)
        return np.asarray(phi * (whole - closed) + closed)

    def add_force_together(self, other: Term, state: State, f: Float) -> bool:
        """Return False: the forces of the control have the degradation factor too."""
        return False

    def linearise(self, state: State) -> list[Product]:
        """Return ``G^T W (phi A_open + A_closed) G`` and, unless damage is held, what the derivative of phi adds."""
        found: list[Product] = [PointProduct(self.operator, self.moduli_sets(state))]
        return found if self.frozen else [*found, self._softening(state)]

    def _softening(self, state: State) -> Product:
        """Return ``W dphi/dY v (x) v`` of the points that fail, ``v = dY/du`` over the members of their stencil."""
        driven, operator = self.driven(state), self.operator
        active = np.flatnonzero(driven.fails)
        F, dim = self.deformation(state), self.body.dim
        P = self.laws(state).stress(F)
        if self._closed is not None:
            P = P - self._closed.laws(state).stress(F)
        by_energy = 0.5 * driven.slope / (np.maximum(driven.x, 1.0) * self.points.onset_energy)
        b = (operator.volume * by_energy)[active]
        entries, first = _entries(operator.point_ptr, active)
        size = np.diff(first)
        v = np.einsum("eij,ej->ei", np.repeat(P[active], size, axis=0), operator.g[entries])
        owner = operator.owner[active]
        if self._control is None:
            stencils = StencilMembers(owner, first, operator.members[entries])
            return SofteningProduct(stencils, self.body.cloud.n_owned, v, v, b)
        ptr, members = self._control.stencils
        of, begin = _entries(ptr, owner)
        whole = self.control_forces(state)[of] / np.repeat(self._volume[owner], np.diff(begin))[:, None]
        place = self._in_family[entries] - np.repeat(ptr[owner] - begin[:-1], size)
        for i in range(dim):
            whole[:, i] += np.bincount(place, v[:, i], len(whole))
        return SofteningProduct(StencilMembers(owner, begin, members[of]), self.body.cloud.n_owned, whole, whole, b)

    def share(self, state: State) -> Float:
        """Return the mean degradation factor of the points of each own particle (n_owned,) [-]."""
        return self._of_particles(self.driven(state).phi)

    def _of_particles(self, values: Float) -> Float:
        return np.asarray(self.operator.sum_over_points(self.operator.volume * values) / self._volume)

    def local_damage(self) -> Float:
        """Return ``1 - phi``, the mean over the points of each own particle (n_owned,) [-] (not collective)."""
        return 1.0 - self._of_particles(self.points.phi)

    def dissipation_density(self) -> Float:
        """Return the mean of ``-int Y dphi`` over the points of each own particle (n_owned,) [energy / volume]."""
        return self._of_particles(self.points.dissipated())

    def cauchy_stress(self, state: State) -> Float:
        """Return the mean Cauchy stress over the points of each own particle (n_owned, dim, dim) [stress]."""
        return self.mean_stress(self.laws(state).cauchy_of(self.stress(state), self.deformation(state)))

    def out_of_plane(self, state: State) -> tuple[Float, Float, Float]:
        """Return stretch, P and Cauchy stress across a line or plane body (n_owned,)."""
        F = self.deformation(state)
        stretch, whole, sigma = self.laws(state).out_of_plane(F)
        # Both stresses are in the ratio of that of what is whole.
        current = np.divide(sigma, whole, out=np.ones_like(sigma), where=whole != 0.0)
        P = self._degraded(state, lambda term: term.laws(state).out_of_plane(F)[1])
        return self._mean(stretch), self.mean_stress(P), self.mean_stress(P * current)

    def energy_at(self, state: State, F: Float, volume: Float) -> Float:
        """Return the energy density of all points (n_points,) at other gradients F, with the damage of the state."""
        return self._degraded(state, lambda term: term.laws(state).energy(F))

    def arrays(self) -> Mapping[str, KeptArray]:
        """Return the histories of the materials, and what the points have lost."""
        points, owner = self.points, self.operator.owner
        kept = {"phi": points.phi, "largest_drive": points.kappa, "final_drive": points.final}
        return {**super().arrays(), **{name: KeptArray(owner, values) for name, values in kept.items()}}

    def restored(self) -> None:
        """Follow what has been read from a checkpoint (not collective)."""
        super().restored()
        self.points.commit()


class DegradedControl(ControlForces):
    """A zero-energy control whose families lose their stiffness with the points of their particle.

    Parameters
    ----------
    body, name, control
        As for ``ControlForces``.
    points : DegradedPoints
        What degrades it.
    """

    def __init__(self, body: Body, name: str, control: Control, points: DegradedPoints) -> None:
        super().__init__(body, name, control)
        self._points = points

    @property
    def linear(self) -> bool:  # type: ignore[override]
        """Return whether damage is held."""
        return self._points.frozen

    def at(self, state: State) -> Control:
        """Return the control with the degradation factor of each particle at a state."""
        points = self._points
        share = np.maximum(points.share(state), LEAST)
        return state.kept(("degraded control", points.version, points.frozen), lambda: self.control.scaled(share))


def _entries(ptr: GlobalIndex, rows: GlobalIndex | LocalIndex) -> tuple[GlobalIndex, GlobalIndex]:
    """Return the entries of some stencils, and where those of each begin (n + 1,)."""
    size: GlobalIndex = np.diff(ptr)[rows]
    first: GlobalIndex = np.concatenate([[0], np.cumsum(size)])
    within: GlobalIndex = np.arange(first[-1])
    return np.repeat(ptr[rows] - first[:-1], size) + within, first
