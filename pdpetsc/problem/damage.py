"""Damage of the bonds of a body."""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Iterator
from contextlib import contextmanager
from typing import Protocol

import numpy as np

from pdpetsc.arrays import Float, GlobalIndex, LocalIndex, Mask
from pdpetsc.damage.criterion import DamageableBonds, DrivingVariable, Gradient
from pdpetsc.damage.laws import BondDamage, Marking
from pdpetsc.damage.several import AssignedLaws, DamageOf
from pdpetsc.damage.state import FailingBonds
from pdpetsc.declare.region import Region
from pdpetsc.discrete.communicator import agreed, total
from pdpetsc.errors import CaseError
from pdpetsc.kernels.bonds import bond_force_kernel
from pdpetsc.problem.body import Body
from pdpetsc.problem.state import State

# A bond whose degradation factor would be above that of its largest drive by less than this is at its largest drive
# [-].
AT_LARGEST = 1e-4


class Failing(Protocol):
    """The state of what fails: whether it is held, and how close to its largest drive it fails further."""

    frozen: bool
    slack: float


class DamageModel(ABC):
    """Damage as the march from one equilibrium to the next sees it.

    Attributes
    ----------
    version, breaks : int
        Grow whenever a degradation factor changes; and whenever bonds break or mend.

    Notes
    -----
    Every method is collective but where it says otherwise. Methods that change damage are called by ``Problem``, which
    lets terms follow.
    """

    version: int = 0
    breaks: int = 0
    # Whether bonds also break by the strain of a family, and whether what has not failed may regain force.
    breaks_by_family_strain: bool = False
    reversible: bool = False
    # Whether all forces derive from one energy, so that an equilibrium without negative pivots is a minimum of it.
    forces_have_energy: bool = False

    @property
    @abstractmethod
    def name(self) -> str:
        """Return the name of the law (not collective)."""

    @property
    def of_bonds(self) -> Damage | None:
        """Return it as the damage of bonds, None where no bond fails (not collective)."""
        return None

    @property
    def timed(self) -> bool:
        """Return whether the drive depends on time (not collective)."""
        return False

    @property
    def conduction_version(self) -> int:
        """Return a number that grows whenever bonds or points conduct less heat, or more again (not collective)."""
        return self.breaks

    @property
    def conducting_bonds(self) -> Float | None:
        """Return the share of its conductivity that each bond has (n_bonds,) [-]; None for all (not collective)."""
        return None

    @property
    def conducting_points(self) -> Float | None:
        """Return that of each gradient point (n_points,) [-]; None for all (not collective)."""
        return None

    @property
    @abstractmethod
    def softens(self) -> bool:
        """Return whether force is lost gradually (not collective)."""

    @property
    @abstractmethod
    def failing(self) -> Failing:
        """Return the state of what fails (not collective)."""

    @property
    def frozen(self) -> bool:
        """Return whether damage stays while the displacement changes (not collective)."""
        return self.failing.frozen

    def freeze(self, frozen: bool) -> None:
        """Let damage stay, or follow the displacement (not collective)."""
        if self.frozen != frozen:
            self.failing.frozen = frozen
            self.version += 1

    @contextmanager
    def loading(self) -> Iterator[None]:
        """Let what is at its largest drive lose force in the tangent of the body (not collective)."""
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
        """Keep the damage at a converged state."""

    @abstractmethod
    def revert(self) -> bool:
        """Take back what failed since the last ``keep``; return whether bonds have mended."""

    def break_bonds(self, state: State, most: int | None = None) -> int:
        """Break bonds past their final drive, about ``most`` at once, the worst first; return how many pairs."""
        return 0

    def break_families(self, strain: Float, most: int | None = None) -> int:
        """Break bonds by the tensile strain of their families (n_bonds,) [-], likewise; return how many pairs."""
        return 0

    @abstractmethod
    def fading(self, state: State) -> float:
        """Return by how much a degradation factor would change at most [-]."""

    @abstractmethod
    def soften(self, state: State) -> float:
        """Take the damage at a state for good; return the largest change of a degradation factor [-]."""

    def dissipation_gradient(self, state: State) -> Float | None:
        """Return the derivative of the dissipated energy by the unknowns (n_rows, dim) [force]; None if not known."""
        return None

    @abstractmethod
    def stored(self) -> tuple[Float, ...]:
        """Return a copy of the state, degradation factors and largest drives, for ``reset`` (not collective)."""

    @abstractmethod
    def reset(self, stored: tuple[Float, ...]) -> None:
        """Go back to a stored state (not collective)."""


class Damage(DamageModel):
    """The bonds of a body that can fail.

    Parameters
    ----------
    body : Body
        Whose bonds they are.
    bonds : FailingBonds
        Their state.
    driving_variable : DrivingVariable
        What drives their damage.
    finite : bool
        Whether elongations are those of the current length, or along the first direction of a bond.
    damageable : DamageableBonds
        The bonds as the drive reads them.

    Notes
    -----
    Every method is collective but where it says otherwise.
    """

    def __init__(
        self,
        body: Body,
        bonds: FailingBonds,
        driving_variable: DrivingVariable,
        finite: bool,
        damageable: DamageableBonds,
    ) -> None:
        self.body = body
        self.bonds = bonds
        self.driving_variable = driving_variable
        self.finite = finite
        self.damageable = damageable

    @property
    def name(self) -> str:
        """Return the name of the declared law (not collective)."""
        return type(self.bonds.law).__name__

    @property
    def of_bonds(self) -> Damage:
        """Return itself (not collective)."""
        return self

    @property
    def failing(self) -> FailingBonds:
        """Return the state of the bonds (not collective)."""
        return self.bonds

    @property
    def timed(self) -> bool:
        """Return whether the drive depends on time (not collective)."""
        return self.driving_variable.timed

    @property
    def conducting_bonds(self) -> Float:
        """Return 1 for bonds that are not broken, else 0 (n_bonds,) (not collective)."""
        return self.bonds.intact.astype(float)

    @property
    def softens(self) -> bool:
        """Return whether bonds lose their force gradually (not collective)."""
        return self.bonds.laws.softens

    @property
    def breaks_by_family_strain(self) -> bool:  # type: ignore[override]
        """Return True if bonds also break by the strain of a family (not collective)."""
        return self.bonds.law.effect.breaks_by_family_strain

    @property
    def reversible(self) -> bool:  # type: ignore[override]
        """Return whether bonds that have not broken may regain force (not collective)."""
        return self.bonds.law.effect.reversible

    @property
    def limit(self) -> Float:
        """Return the elongations at which bonds fail (n_bonds,) [length], infinite where protected (not collective).

        Raises
        ------
        TypeError
            The drive is not linear in the elongation.
        """
        if self.driving_variable.limit is None:
            raise TypeError(f"{type(self.driving_variable).__name__} has no elongation of failure.")
        limit = self.driving_variable.limit.copy()
        limit[self.bonds.protected] = np.inf
        return limit

    def driving_values(self, state: State) -> Float:
        """Return the drive of every bond (n_bonds,) [-], zero where it is protected."""
        return state.kept("drive", lambda: self._spared(self.driving_variable.at(state)))

    def phi(self, state: State) -> Float:
        """Return the degradation factor of every bond (n_bonds,) [-]."""
        return self._following(state)[0]

    def gradient(self, state: State) -> Gradient:
        """Return how the degradation factor of the bonds that lose it changes with the displacement."""
        _, softening, slope = self._following(state)
        return state.kept(
            ("gradient", self.version, self.bonds.frozen),
            lambda: self.driving_variable.gradient(state, softening, slope),
        )

    def _following(self, state: State) -> tuple[Float, GlobalIndex, Float]:
        """Return degradation factor, bonds whose degradation factor falls, and its derivative by their drive."""

        def follow() -> tuple[Float, GlobalIndex, Float]:
            bonds = self.bonds
            if bonds.softens:
                return bonds.following(self.driving_values(state))
            return bonds.phi, np.empty(0, dtype=np.int64), np.empty(0)

        return state.kept(("phi", self.version, self.bonds.frozen), follow)

    def _spared(self, x: Float) -> Float:
        """Return drives x without those of protected bonds."""
        if len(self.bonds.protected):
            x[self.bonds.protected] = 0.0
        return x

    def keep(self, state: State) -> None:
        """Keep the bonds, and what the driving variable remembers, at a converged state."""
        self.driving_variable.commit(state)
        self.bonds.commit()

    def revert(self) -> bool:
        """Take back what failed since the last ``keep``; return whether bonds have mended."""
        intact = self.bonds.intact
        self.bonds.revert()
        mended = int(np.any(intact != self.bonds.intact))
        return int(total(self.body.cloud.comm, mended)) > 0

    def break_bonds(self, state: State, most: int | None = None) -> int:
        """Break bonds past their final drive, about ``most`` at once, the worst first; return how many pairs."""
        return self.bonds.break_bonds(self.driving_values(state), most)

    def break_families(self, strain: Float, most: int | None = None) -> int:
        """Break bonds by the tensile strain of their families (n_bonds,) [-], likewise; return how many pairs."""
        over = self.driving_variable.at_strain(strain)
        return 0 if over is None else self.bonds.tear(self._spared(over), most)

    def fading(self, state: State) -> float:
        """Return by how much the degradation factor of a bond would change at most [-]."""
        return self.bonds.fading(self.driving_values(state))

    def soften(self, state: State) -> float:
        """Take the damage at a state for good; return the largest change of a degradation factor [-]."""
        return self.bonds.soften(self.driving_values(state))

    def stored(self) -> tuple[Float, ...]:
        """Return a copy of the state of the bonds, ``phi`` and largest drive, for ``reset`` (not collective)."""
        return self.bonds.phi.copy(), self.bonds.kappa.copy()

    def reset(self, stored: tuple[Float, ...]) -> None:
        """Go back to a state of the bonds (not collective)."""
        self.bonds.phi[:], self.bonds.kappa[:] = stored

    def most_driven(self, state: State, band: float) -> tuple[Float, float]:
        """Return how the largest drive grows with the unknowns, and that drive.

        Returns
        -------
        gradient : (n_rows, dim) float64
            Of the mean over the bonds that have not failed and are within ``band`` of the largest, relatively
            [1 / length]; zero where none is positive.
        largest : float
            [-]
        """
        body, family, u_local = self.body, self.body.families, state.u_local
        f = np.zeros_like(u_local)
        near, count, found = self.bonds.most_driven(self.driving_values(state), band)
        gradient = self.driving_variable.mean_gradient(state, near, count)
        along = np.zeros(len(family.neighbours))
        along[near] = gradient.along
        kernel = bond_force_kernel(body.dim, int(self.finite))
        kernel(family.indptr, family.neighbours, body.cloud.x, u_local, along, f)
        if gradient.nonlocal_part is not None:
            np.add.at(f, gradient.nonlocal_part.particles, gradient.nonlocal_part.by)
        for ends in gradient.ends:
            of_centre = np.bincount(family.centres[near], ends.factor, body.cloud.n_owned)
            members, ptr = body.with_centres.members, body.with_centres.point_ptr
            np.add.at(f, members, np.repeat(of_centre, np.diff(ptr))[:, None] * ends.by)
        return body.gather(f), found

    def dissipated(self, k: Float) -> Float | None:
        """Return what linear bonds of stiffness k have dissipated (n_bonds,) [energy]; None where no drive tells.

        Not collective.
        """
        lost, found = self.bonds.weakened, np.zeros(len(k))
        known = self.driving_variable.elastic_energy(lost, k[lost])
        if known is None:
            return None
        found[lost] = self.bonds.spent(lost, *known)
        return found

    def lost_bonds(self) -> Float:
        """Return ``1 - sum_j mu V_j / sum_j V_j`` (n_owned,) [-], mu 0 for broken bonds, else 1 (not collective)."""
        return self._lost(np.where(self.bonds.intact, 1.0, 0.0))

    def lost_volume(self) -> Float:
        """Return ``1 - sum_j T V_j / sum_j V_j`` (n_owned,) [-] with the ``phi`` T of the bonds (not collective)."""
        return self._lost(self.bonds.phi)

    def _lost(self, left: Float) -> Float:
        cloud, families = self.body.cloud, self.body.families
        centres, volume = families.centres, cloud.volume[families.neighbours]
        whole = np.bincount(centres, volume, cloud.n_owned)
        kept = np.bincount(centres, left * volume, cloud.n_owned)
        return np.asarray(1.0 - kept / np.where(whole > 0.0, whole, 1.0))


def _nowhere(region: Region, what: str) -> Mask:
    raise CaseError(f"The {what} is known in a case only.")


def make_damage(
    law: BondDamage | DamageOf, body: Body, omega: Float, k: Float | None, finite: bool,
    material_of: LocalIndex | None = None, factor: Float | None = None, mark: Marking = _nowhere,
) -> Damage:  # fmt: skip
    """Return the damage of the bonds of a body: the criterion resolved with them, and what drives them built.

    Parameters
    ----------
    law : BondDamage or DamageOf
        As declared.
    body : Body
        Whose bonds they are.
    omega, k : (n_bonds,) float64
        Their influence [-], and their elastic stiffness from one end [force / length], None where no criterion reads
        it.
    finite : bool
        Whether elongations are those of the current length, or along the first direction of a bond.
    material_of : (n_owned,) int32, optional
        Number of the material of each own particle; one material where absent.
    factor : (n_owned,) float64, optional
        What grading multiplies its moduli with [-].
    mark : callable, optional
        Marks the local particles in a region (n_local,), if there are laws for regions or protected regions.

    Raises
    ------
    CaseError
        The criterion does not fit the bonds, on every rank.

    Notes
    -----
    Collective.
    """
    bonds = DamageableBonds.of(body.cloud, body.families, omega, k, finite, material_of, factor)
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
    return Damage(body, failing, driving_variable, finite, bonds)
