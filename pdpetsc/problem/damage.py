"""Damage of the bonds of a body, and the interface of damage for load steps."""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Iterator
from contextlib import contextmanager
from typing import Protocol

import numpy as np

from pdpetsc.arrays import Float, GlobalIndex, Mask
from pdpetsc.damage.criterion import DamageableBonds, DrivingVariable, Gradient
from pdpetsc.damage.laws import BondDamage, Marking
from pdpetsc.damage.several import AssignedLaws, DamageOf
from pdpetsc.damage.state import FailingBonds
from pdpetsc.declare.region import Region
from pdpetsc.discrete.communicator import agreed, anywhere
from pdpetsc.errors import CaseError
from pdpetsc.kernels.bonds import bond_force_kernel
from pdpetsc.problem.body import Body
from pdpetsc.problem.state import State

# A bond counts as at its largest drive if its degradation factor would exceed the value there by less than this [-].
AT_LARGEST = 1e-4


class Failing(Protocol):
    """Describe the state of bonds or points that fail: whether it is frozen, and the tolerance at the largest drive."""

    frozen: bool
    slack: float


class DamageModel(ABC):
    """Define the interface of damage for load steps.

    Attributes
    ----------
    name : str
        Name of the law.
    failing : Failing
        State of the bonds or points that fail.
    softens : bool
        Whether force is lost gradually.
    version, breaks : int
        Increase if a degradation factor changes, and if bonds break or mend, respectively.

    Notes
    -----
    Every method is collective unless stated otherwise. ``Problem`` calls the methods that change damage, and notifies
    the terms.
    """

    name: str
    failing: Failing
    softens: bool
    version: int = 0
    breaks: int = 0
    # Whether bonds also break by the strain of a family, and whether bonds that have not failed may regain force.
    breaks_by_family_strain: bool = False
    reversible: bool = False
    # Whether all forces derive from one energy. Then an equilibrium without negative pivots is a minimum.
    forces_have_energy: bool = False

    @property
    def of_bonds(self) -> Damage | None:
        """Return the damage of bonds; None if no bond fails (not collective)."""
        return None

    @property
    def timed(self) -> bool:
        """Return True if the driving variable depends on time (not collective)."""
        return False

    @property
    def conduction_version(self) -> int:
        """Return a number that increases if the conductivity of bonds or points changes (not collective)."""
        return self.breaks

    @property
    def conducting_bonds(self) -> Float | None:
        """Return the remaining share of the conductivity of each bond (n_bonds,) [-]; None if unchanged.

        Not collective.
        """
        return None

    @property
    def conducting_points(self) -> Float | None:
        """Return the remaining share of the conductivity of each gradient point (n_points,) [-]; None if unchanged.

        Not collective.
        """
        return None

    @property
    def frozen(self) -> bool:
        """Return True if damage stays constant while the displacement changes (not collective)."""
        return self.failing.frozen

    def freeze(self, frozen: bool) -> None:
        """Fix damage, or let it follow the displacement (not collective)."""
        if self.frozen != frozen:
            self.failing.frozen = frozen
            self.version += 1

    @contextmanager
    def loading(self) -> Iterator[None]:
        """Let bonds and points at their largest drive lose force in the tangent of the body (not collective)."""
        failing, frozen = self.failing, self.frozen
        failing.slack, failing.frozen = AT_LARGEST, False
        self.version += 1
        try:
            yield
        finally:
            failing.slack, failing.frozen = 0.0, frozen
            self.version += 1

    @abstractmethod
    def keep(self, state: State) -> None:
        """Commit the damage at a converged state."""

    @abstractmethod
    def revert(self) -> bool:
        """Undo the damage since the last ``keep``; return True if bonds have mended."""

    def break_bonds(self, state: State, most: int | None = None) -> int:
        """Break bonds beyond their final drive, about ``most`` at once, largest first; return the number of pairs."""
        return 0

    def break_families(self, strain: Float, most: int | None = None) -> int:
        """Break bonds by the tensile strain of their families (n_bonds,) [-], largest first; return how many pairs."""
        return 0

    @abstractmethod
    def fading(self, state: State) -> float:
        """Return the largest change of a degradation factor that a state would cause [-]."""

    @abstractmethod
    def soften(self, state: State) -> float:
        """Accept the damage at a state; return the largest change of a degradation factor [-]."""

    def dissipation_gradient(self, state: State) -> Float | None:
        """Return the derivative of the dissipated energy by the unknowns (n_rows, dim) [force]; None if unknown."""
        return None

    @abstractmethod
    def stored(self) -> tuple[Float, ...]:
        """Return a copy of the state, degradation factors and largest drives, for ``reset`` (not collective)."""

    @abstractmethod
    def reset(self, stored: tuple[Float, ...]) -> None:
        """Restore a stored state (not collective)."""


class Damage(DamageModel):
    """Represent the damage of the bonds of a body.

    Parameters
    ----------
    body : Body
        The body.
    bonds : FailingBonds
        State of the bonds.
    driving_variable : DrivingVariable
        Driving variable of the damage.

    Notes
    -----
    Every method is collective unless stated otherwise.
    """

    def __init__(self, body: Body, bonds: FailingBonds, driving_variable: DrivingVariable) -> None:
        self.body, self.bonds, self.driving_variable = body, bonds, driving_variable
        self.failing, self.softens, self.name = bonds, bonds.laws.softens, type(bonds.law).__name__
        effect = bonds.law.effect
        self.breaks_by_family_strain, self.reversible = effect.breaks_by_family_strain, effect.reversible

    @property
    def of_bonds(self) -> Damage:
        """Return itself (not collective)."""
        return self

    @property
    def timed(self) -> bool:
        """Return True if the driving variable depends on time (not collective)."""
        return self.driving_variable.timed

    @property
    def conducting_bonds(self) -> Float:
        """Return 1 for each bond that is not broken, else 0 (n_bonds,) (not collective)."""
        return self.bonds.intact.astype(float)

    @property
    def limit(self) -> Float:
        """Return the elongations at which bonds fail (n_bonds,) [length], infinite for protected ones (not collective).

        Raises
        ------
        TypeError
            The driving variable is not linear in the elongation.
        """
        if self.driving_variable.limit is None:
            raise TypeError(f"{type(self.driving_variable).__name__} has no elongation of failure.")
        limit = self.driving_variable.limit.copy()
        limit[self.bonds.protected] = np.inf
        return limit

    def driving_values(self, state: State) -> Float:
        """Compute the driving variable of every bond (n_bonds,) [-], zero for protected bonds."""
        return state.kept("drive", lambda: self._spared(self.driving_variable.at(state)))

    def phi(self, state: State) -> Float:
        """Return the degradation factor of every bond (n_bonds,) [-]."""
        return self._following(state)[0]

    def gradient(self, state: State) -> Gradient:
        """Compute the derivative of the degradation factors by the displacement, for bonds that soften."""
        _, softening, slope = self._following(state)
        return state.kept(
            ("gradient", self.version, self.bonds.frozen),
            lambda: self.driving_variable.gradient(state, softening, slope),
        )

    def _following(self, state: State) -> tuple[Float, GlobalIndex, Float]:
        """Return degradation factor, indices of softening bonds, and their derivative by the driving variable."""

        def follow() -> tuple[Float, GlobalIndex, Float]:
            bonds = self.bonds
            if bonds.softens:
                return bonds.following(self.driving_values(state))
            return bonds.phi, np.empty(0, dtype=np.int64), np.empty(0)

        return state.kept(("phi", self.version, self.bonds.frozen), follow)

    def _spared(self, x: Float) -> Float:
        """Set the driving variable x of protected bonds to zero."""
        if len(self.bonds.protected):
            x[self.bonds.protected] = 0.0
        return x

    def keep(self, state: State) -> None:
        """Commit the bonds and the history of the driving variable at a converged state."""
        self.driving_variable.commit(state)
        self.bonds.commit()

    def revert(self) -> bool:
        """Undo the damage since the last ``keep``; return True if bonds have mended."""
        intact = self.bonds.intact
        self.bonds.revert()
        return anywhere(self.body.cloud.comm, intact != self.bonds.intact)

    def break_bonds(self, state: State, most: int | None = None) -> int:
        """Break bonds beyond their final drive, about ``most`` at once, largest first; return the number of pairs."""
        return self.bonds.break_bonds(self.driving_values(state), most)

    def break_families(self, strain: Float, most: int | None = None) -> int:
        """Break bonds by the tensile strain of their families (n_bonds,) [-], largest first; return how many pairs."""
        over = self.driving_variable.at_strain(strain)
        return 0 if over is None else self.bonds.tear(self._spared(over), most)

    def fading(self, state: State) -> float:
        """Return the largest change of the degradation factor of a bond that a state would cause [-]."""
        return self.bonds.fading(self.driving_values(state))

    def fails(self, state: State) -> bool:
        """Return True if the force of a bond changes at a state, or if one breaks."""
        return self.bonds.fails(self.driving_values(state))

    def soften(self, state: State) -> float:
        """Accept the damage at a state; return the largest change of a degradation factor [-]."""
        return self.bonds.soften(self.driving_values(state))

    def stored(self) -> tuple[Float, ...]:
        """Return a copy of the state of the bonds, ``phi`` and largest drive, for ``reset`` (not collective)."""
        return self.bonds.phi.copy(), self.bonds.kappa.copy()

    def reset(self, stored: tuple[Float, ...]) -> None:
        """Restore a stored state of the bonds (not collective)."""
        self.bonds.phi[:], self.bonds.kappa[:] = stored

    def most_driven(self, state: State, band: float) -> tuple[Float, float]:
        """Compute the gradient of the largest driving variable by the unknowns, and its value.

        Returns
        -------
        gradient : (n_rows, dim) float64
            Mean gradient over the unfailed bonds within the relative distance ``band`` of the largest [1 / length];
            zero if no driving variable is positive.
        largest : float
            Largest driving variable [-].
        """
        body, family, u_local = self.body, self.body.families, state.u_local
        f = np.zeros_like(u_local)
        near, count, found = self.bonds.most_driven(self.driving_values(state), band)
        gradient = self.driving_variable.mean_gradient(state, near, count)
        along = np.zeros(len(family.neighbours))
        along[near] = gradient.along
        kernel = bond_force_kernel(body.dim, int(self.bonds.of.finite))
        kernel(family.indptr, family.neighbours, body.cloud.x, u_local, along, f)
        if gradient.nonlocal_part is not None:
            np.add.at(f, gradient.nonlocal_part.particles, gradient.nonlocal_part.by)
        for ends in gradient.ends:
            of_centre = np.bincount(family.centres[near], ends.factor, body.cloud.n_owned)
            members, ptr = body.with_centres.members, body.with_centres.point_ptr
            np.add.at(f, members, np.repeat(of_centre, np.diff(ptr))[:, None] * ends.by)
        return body.gather(f), found

    def dissipated(self, k: Float) -> Float | None:
        """Compute the energy dissipated by linear bonds of stiffness k (n_bonds,) [energy].

        None if the driving variable does not determine it. Not collective.
        """
        lost, found = self.bonds.weakened, np.zeros(len(k))
        known = self.driving_variable.elastic_energy(lost, k[lost])
        if known is None:
            return None
        found[lost] = self.bonds.spent(lost, *known)
        return found

    def lost_bonds(self) -> Float:
        """Compute ``1 - sum_j b_j V_j / sum_j V_j`` (n_owned,) [-], b = 0 for broken bonds, else 1 (not collective)."""
        return self._lost(np.where(self.bonds.intact, 1.0, 0.0))

    def lost_volume(self) -> Float:
        """Compute ``1 - sum_j phi_j V_j / sum_j V_j`` (n_owned,) [-] with the degradation factors of the bonds.

        Not collective.
        """
        return self._lost(self.bonds.phi)

    def _lost(self, left: Float) -> Float:
        families, volume = self.body.families, self.body.cloud.volume
        whole, kept = families.sums(volume[families.neighbours]), families.sums(families.weights(left, volume))
        return np.asarray(1.0 - kept / np.where(whole > 0.0, whole, 1.0))


def _nowhere(region: Region, what: str) -> Mask:
    raise CaseError(f"The {what} is known in a case only.")


def make_damage(law: BondDamage | DamageOf, body: Body, bonds: DamageableBonds, mark: Marking = _nowhere) -> Damage:
    """Build the damage of the bonds of a body, with resolved criterion and driving variable.

    Parameters
    ----------
    law : BondDamage or DamageOf
        Declared damage.
    body : Body
        The body.
    bonds : DamageableBonds
        Bonds of the body.
    mark : callable, optional
        Marks the local particles in a region (n_local,), for laws of regions and protected regions.

    Raises
    ------
    CaseError
        The criterion does not fit the bonds; raised on every rank.

    Notes
    -----
    Collective.
    """
    of_bond = law.assign(bonds, mark)
    laws = AssignedLaws([one.resolved(bonds) for one in law.all_laws], of_bond)
    with agreed(body.cloud.comm):
        driving_variable = laws.build(bonds)
        if driving_variable.is_nonlocal and body.cloud.varies and not body.cloud.mutual:
            names = ", ".join(type(one.criterion).__name__ for one in laws.laws)
            raise CaseError(
                f"{names} reads the families of both ends of a bond, and where the horizon "
                f"differs from place to place not all have one; take a drive of the own elongation, or one horizon."
            )
    failing = FailingBonds(bonds, laws, laws.laws[0] if law.all_laws[0] is law else law)
    return Damage(body, failing, driving_variable)
