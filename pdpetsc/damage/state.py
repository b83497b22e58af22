"""State of bond damage."""

from __future__ import annotations

import numpy as np

from pdpetsc.arrays import Float, GlobalIndex, Mask
from pdpetsc.damage.criterion import DamageableBonds
from pdpetsc.damage.laws import BondDamage
from pdpetsc.damage.several import AssignedLaws, DamageOf
from pdpetsc.discrete.communicator import anywhere, largest, total
from pdpetsc.discrete.families import reached_back

# Driving variables are equal if they differ by less than this share. Those of mirror images differ by 1e-12 after a
# direct linear solve and by 1e-8 after an iterative one, those of other bonds by 1e-5 or more. Breaking of equal bonds,
# and of a bond at its final driving variable, therefore does not depend on the order of particles or on units.
TOGETHER = 1e-7


class FailingBonds:
    """Degradation factor and largest driving variable of the bonds of the own particles.

    A bond is stored from both ends, possibly on two ranks; ``of.keys`` identifies it. If horizons differ, a bond may be
    stored from one end only. ``x`` in the methods is the driving variable of every bond (n_bonds,) [-], zero if it is
    protected.

    Parameters
    ----------
    bonds : DamageableBonds
        The bonds.
    laws : AssignedLaws
        Damage laws of the bonds.
    law : BondDamage or DamageOf
        The declared law, with a resolved criterion.

    Attributes
    ----------
    phi : (n_bonds,) float64
        Degradation factor of each bond [-]: 1 intact, 0 broken.
    kappa : (n_bonds,) float64
        Largest driving variable so far [-], or that of the last equilibrium if damage is reversible; of intact bonds
        only since the last stored state.
    protected : (n,) int64
        Bonds that do not fail.
    frozen : bool
        True if the degradation factor is constant while the displacement changes.
    slack : float
        Bonds whose present degradation factor exceeds the stored one by less than this follow their driving variable
        too [-]: 0 except for a tangent for further loading.
    of : DamageableBonds
        The bonds.
    """

    def __init__(self, bonds: DamageableBonds, laws: AssignedLaws, law: BondDamage | DamageOf) -> None:
        self.law = law
        self.laws = laws
        self._onset, self._final = laws.onset(), laws.final()
        self._comm = bonds.cloud.comm
        self.of = bonds
        self.protected: GlobalIndex = np.flatnonzero(laws.of_bond < 0)
        self.phi: Float = np.ones(bonds.families.n_bonds)
        self.kappa: Float = np.zeros(bonds.families.n_bonds)
        self.frozen = False
        self.slack = 0.0
        self.commit()

    @property
    def length(self) -> Float:
        """Return the reference length of every bond (n_bonds,) [length], computed on use."""
        return self.of.length

    @property
    def intact(self) -> Mask:
        """Return a mask of unbroken bonds (n_bonds,)."""
        return np.asarray(self.phi > 0.0)

    @property
    def softens(self) -> bool:
        """Return True if the degradation factor follows the displacement now."""
        return self.laws.softens and not self.frozen

    def commit(self) -> None:
        """Store the present state of the weakened bonds (not collective)."""
        lost = self.weakened
        self._kept = lost, self.phi[lost], self.kappa[lost]

    def revert(self) -> None:
        """Restore the last stored state; intact bonds have no history (not collective)."""
        lost, phi, kappa = self._kept
        # New zeros take no memory until they are written.
        self.phi[:], self.kappa = 1.0, np.zeros(len(self.phi))
        self.phi[lost], self.kappa[lost] = phi, kappa

    def following(self, x: Float) -> tuple[Float, GlobalIndex, Float]:
        """Compute the damage at driving variables x, without updating it (not collective).

        Returns
        -------
        phi : (n_bonds,) float64
            [-]
        softening : (n,) int64
            Bonds whose degradation factor changes with the driving variable, ascending.
        slope : (n,) float64
            Derivative of the degradation factor by the driving variable [-].
        """
        laws, final = self.laws, self._final
        present = np.ones_like(x)
        # Bonds break at equilibrium only: beyond its final driving variable a bond has the degradation factor at that
        # value.
        past_onset = np.flatnonzero((x > self._onset) & self.intact)
        present[past_onset] = np.maximum(laws.phi(np.minimum(x, final)[past_onset], past_onset), 0.0)
        follows = self.law.effect.follows(present, self.phi + self.slack) & self.intact
        softening = past_onset[follows[past_onset] & (x < final)[past_onset]]
        return np.where(follows, present, self.phi), softening, laws.slope(x[softening], softening)

    def most_driven(self, x: Float, band: float) -> tuple[GlobalIndex, float, float]:
        """Return the bonds within ``band`` of the largest driving variable, their number, and that variable [-].

        Only unbroken bonds count. The bonds are those of this rank, their number that of all ranks. If no driving
        variable is positive, there are no bonds and the number is 1 (collective).
        """
        x = np.where(self.intact, x, 0.0)
        found = largest(self._comm, x, initial=0.0)
        near = np.flatnonzero((x >= (1.0 - band) * found) & (found > 0.0))
        count = float(total(self._comm, len(near)))
        return near, max(count, 1.0), found

    def fading(self, x: Float) -> float:
        """Return the largest change of a degradation factor for driving variables x [-] (collective)."""
        return largest(self._comm, np.abs(self.phi - self.following(x)[0]), initial=0.0)

    def fails(self, x: Float) -> bool:
        """Return True if the force of a bond changes at driving variables x, or if one breaks (collective)."""
        over = np.where(self.intact, x / self._final, 0.0)
        breaks = float(over.max(initial=0.0)) >= 1.0 - TOGETHER
        fades = self.laws.softens and bool(np.any(self.following(x)[0] != self.phi))
        return anywhere(self._comm, breaks or fades)

    def soften(self, x: Float) -> float:
        """Update the degradation factor for driving variables x; return the largest change of any bond (collective)."""
        if not self.laws.softens:
            return 0.0
        T = self.following(x)[0]
        if self.frozen:
            # Sweeps with frozen damage end because damage only grows. Reversible damage decreases in Newton iterations
            # only.
            T = np.minimum(T, self.phi)
        change = np.abs(self.phi - T)
        # A bond without remaining force breaks at equilibrium, not here.
        self.phi[:] = np.where(self.intact, np.maximum(T, np.finfo(float).tiny), 0.0)
        self.kappa[:] = self.law.effect.reached(x, self.kappa)
        return largest(self._comm, change, initial=0.0)

    def break_bonds(self, x: Float, most: int | None = None) -> int:
        """Break bonds at or beyond their final driving variable, largest first; return the number of pairs.

        Collective.

        Parameters
        ----------
        x : (n_bonds,) float64
            Driving variables [-]; they are equal within ``TOGETHER``.
        most : int, optional
            Largest number of pairs at once, plus those equal to the last. By default one pair if any bond snaps,
            because its neighbours take over its force, else all pairs.
        """
        if self.laws.softens:
            # A bond that has exceeded its final driving variable may have lost its force, even if the variable is
            # smaller now.
            x = self.law.effect.reached(x, self.kappa)
        return self._break_worst(x, most)

    def tear(self, x: Float, most: int | None = None) -> int:
        """Break bonds by the strain of their family; return the number of pairs (collective).

        Parameters
        ----------
        x : (n_bonds,) float64
            Driving variables for the tensile strain of every bond, from the gradients of its centre [-]. The larger
            value of both ends counts.
        most : int, optional
            As in ``break_bonds``.
        """
        over = np.where(self.intact, x, 0.0)
        own = np.flatnonzero(over >= (1.0 - TOGETHER) * self._final)
        keys = np.concatenate(self._comm.allgather(self.of.keys(own)))
        values = np.concatenate(self._comm.allgather(over[own]))
        if len(keys) == 0:
            return 0
        given, bonds, mine = self._matched(keys)
        found = np.zeros(max(int(given.max()), int(mine.max(initial=0))) + 1)
        np.maximum.at(found, given, values)
        over[bonds] = np.maximum(over[bonds], found[mine])
        return self._break_worst(over, most)

    def _break_worst(self, x: Float, most: int | None) -> int:
        """Break unbroken bonds at or beyond their final driving variable, largest first; return the number of pairs.

        Bonds are compared by driving variable over final driving variable, which may differ between laws.
        """
        if most is None and self.laws.snaps:
            most = 1
        x = np.where(self.intact, x, 0.0)
        over, least = x / self._final, 1.0 - TOGETHER
        if largest(self._comm, over, initial=0.0) < least:
            return 0
        if most is not None:
            past = np.flatnonzero(over >= least)
            ends = np.concatenate([over[past], over[past[self._twice(past)]]])
            parts = self._comm.allgather(np.sort(ends)[::-1][: 2 * most])
            candidates = np.sort(np.concatenate(parts))[::-1]
            least = max(least, float(candidates[min(2 * most, len(candidates)) - 1]) * (1.0 - TOGETHER))
        broken = np.flatnonzero(over >= least)
        self.phi[broken] = 0.0
        self.kappa[broken] = np.maximum(self.kappa[broken], x[broken])
        return self._pairs(broken)

    def damaged(self) -> tuple[GlobalIndex, Float]:
        """Return keys (n, 3) and states (n, 2), ``phi`` and ``kappa``, of damaged bonds, from the first end only."""
        mine = self.weakened
        mine = mine[self._first(mine)]
        return self.of.keys(mine), np.stack([self.phi[mine], self.kappa[mine]], axis=1)

    def restore(self, keys: GlobalIndex, states: Float) -> int:
        """Set the states of the bonds of these keys on this rank; return the number of their first ends.

        Not collective.
        """
        given, bonds, mine = self._matched(keys)
        if len(bonds) == 0 or len(given) == 0:
            return 0
        row = np.full(max(int(given.max()), int(mine.max())) + 1, -1, dtype=np.int64)
        row[given] = np.arange(len(keys))
        found = row[mine]
        here = found >= 0
        self.phi[bonds[here]], self.kappa[bonds[here]] = states[found[here]].T
        return int(np.count_nonzero(self._first(bonds[here])))

    def _matched(self, keys: GlobalIndex) -> tuple[GlobalIndex, GlobalIndex, GlobalIndex]:
        """Return a number for every key (n, 3), candidate bonds on this rank, and the numbers of these bonds.

        Bonds with the same key have the same number (not collective).
        """
        families, end = self.of.families, np.isin(self.of.cloud.gid, keys[:, :2])
        bonds = np.flatnonzero(end[families.centres] & end[families.neighbours])
        _, number = np.unique(np.concatenate([keys, self.of.keys(bonds)]), axis=0, return_inverse=True)
        number = number.reshape(-1)
        return number[: len(keys)], bonds, number[len(keys) :]

    def count_broken(self) -> int:
        """Return the number of pairs with a broken bond (collective)."""
        return self._pairs(np.flatnonzero(~self.intact))

    def _pairs(self, bonds: GlobalIndex) -> int:
        """Return the number of pairs of selected bonds (n,), selected from both ends (collective)."""
        return int(total(self._comm, len(bonds) + np.count_nonzero(self._twice(bonds)))) // 2

    def _first(self, bonds: GlobalIndex) -> Mask:
        """Return which of selected bonds (n,) are stored from their first end, or from one end only."""
        cloud, families = self.of.cloud, self.of.families
        i, j = cloud.gid[families.centres[bonds]], cloud.gid[families.neighbours[bonds]]
        return np.asarray(~reached_back(cloud, families, bonds) | (i <= j))

    def _twice(self, bonds: GlobalIndex) -> Mask:
        """Return which of selected bonds (n,) count twice in sums over both ends.

        These are bonds of a particle with its own mirror image, and bonds stored from one end only.
        """
        cloud, families = self.of.cloud, self.of.families
        one, other = families.centres[bonds], families.neighbours[bonds]
        place = cloud.place[other]
        itself = (cloud.gid[one] == cloud.gid[other]) & (cloud.places.opposite(place) == place)
        return np.asarray(~reached_back(cloud, families, bonds) | itself)

    @property
    def weakened(self) -> GlobalIndex:
        """Return the bonds that have lost some or all of their force (n,), ascending."""
        return np.flatnonzero(self.phi < 1.0)

    def spent(self, lost: GlobalIndex, energy: Float, degree: float) -> Float:
        """Compute the dissipated energy of linear bonds (n,) [energy] (not collective).

        Parameters
        ----------
        lost : (n,) int64
            The ``weakened`` bonds.
        energy : (n,) float64
            Elastic energy of each at driving variable 1 [energy].
        degree : float
            Power of the driving variable in this energy [-].
        """
        x = np.where(self.phi[lost] > 0.0, self.kappa[lost], np.maximum(self.kappa[lost], self._final[lost]))
        return self.laws.dissipated(self.phi[lost], x, energy, degree, lost)
