"""Which bonds have failed, and how far: the state of bond damage."""

from __future__ import annotations

import numpy as np

from pdpetsc.arrays import Float, GlobalIndex, Mask
from pdpetsc.damage.criterion import DamageableBonds
from pdpetsc.damage.laws import BondDamage
from pdpetsc.damage.several import AssignedLaws, DamageOf
from pdpetsc.discrete.communicator import largest, total
from pdpetsc.discrete.families import reached_back

# Drives that differ by less than this share are the same: those of mirror images differ by 1e-12 after a direct linear
# solve and by 1e-8 after an iterative one, those of other bonds by 1e-5 and more. So neither the order of particles nor
# their units decide which of several equal bonds break, or whether a bond at its final drive breaks.
TOGETHER = 1e-7


class FailingBonds:
    """Degradation factor of the bonds of the own particles, and how far what drives their damage has been.

    A bond is held from both of its ends, on two ranks perhaps; ``of.keys`` tells that the two are one. Where horizons
    differ it may be held from the end alone that reaches the other. What is called ``x``
    in the methods is the drive of every bond (n_bonds,) [-], zero where it is protected.

    Parameters
    ----------
    bonds : DamageableBonds
        The bonds.
    laws : AssignedLaws
        How they fail.
    law : BondDamage or DamageOf
        What is declared, its criterion resolved where there is one.

    Attributes
    ----------
    phi : (n_bonds,) float64
        What the force of each bond is multiplied with [-]: 1 intact, 0 broken.
    kappa : (n_bonds,) float64
        Largest drive so far [-], or that of the last equilibrium where bonds heal.
    protected : (n,) int64
        Bonds that do not fail.
    frozen : bool
        Whether the degradation factor stays while the displacement changes.
    slack : float
        Bonds whose degradation factor at their present drive is above the kept one by less than this follow their drive
        too [-]: 0 but where a tangent for further loading is wanted.
    of : DamageableBonds
        The bonds.
    length : (n_bonds,) float64
        Their length [length].
    """

    def __init__(self, bonds: DamageableBonds, laws: AssignedLaws, law: BondDamage | DamageOf) -> None:
        self.law = law
        self.laws = laws
        self._onset, self._final = laws.onset(), laws.final()
        self._comm = bonds.cloud.comm
        self.of, self.length = bonds, bonds.length
        self.protected: GlobalIndex = np.flatnonzero(laws.of_bond < 0)
        # Bonds to the own mirror image, which has the other end, and those of ends that do not reach back: what is
        # counted from both ends counts them twice.
        keys = bonds.keys()
        own = keys[:, 0] == keys[:, 1]
        alone = ~reached_back(bonds.cloud, bonds.families, bonds.length)
        self._first: Mask = alone | (bonds.cloud.gid[bonds.families.centres] == keys[:, 0])
        self._twice: Mask = alone | (own & (bonds.cloud.places.opposite(keys[:, 2]) == keys[:, 2]))
        self.phi: Float = np.ones(len(self.length))
        self.kappa: Float = np.zeros(len(self.length))
        self.frozen = False
        self.slack = 0.0
        self.commit()

    @property
    def intact(self) -> Mask:
        """Return which bonds are not broken (n_bonds,)."""
        return np.asarray(self.phi > 0.0)

    @property
    def softens(self) -> bool:
        """Return True if the degradation factor follows the displacement now."""
        return self.laws.softens and not self.frozen

    def commit(self) -> None:
        """Keep the present state (not collective)."""
        self._kept = self.phi.copy(), self.kappa.copy()

    def revert(self) -> None:
        """Go back to the state last kept (not collective)."""
        self.phi[:], self.kappa[:] = self._kept

    def following(self, x: Float) -> tuple[Float, GlobalIndex, Float]:
        """Return what damage that is not held is at drives x (not collective).

        Returns
        -------
        phi : (n_bonds,) float64
            [-]
        softening : (n,) int64
            Bonds whose degradation factor changes with their drive, ascending.
        slope : (n,) float64
            Its derivative by the drive [-].
        """
        laws, final = self.laws, self._final
        present = np.ones_like(x)
        # No bond breaks while equilibrium is sought: past its final drive it keeps what is left of it there.
        past_onset = np.flatnonzero((x > self._onset) & self.intact)
        present[past_onset] = np.maximum(laws.phi(np.minimum(x, final)[past_onset], past_onset), 0.0)
        follows = self.law.effect.follows(present, self.phi + self.slack) & self.intact
        softening = past_onset[follows[past_onset] & (x < final)[past_onset]]
        return np.where(follows, present, self.phi), softening, laws.slope(x[softening], softening)

    def most_driven(self, x: Float, band: float) -> tuple[GlobalIndex, float, float]:
        """Return the bonds within ``band`` of the largest drive, their number, and that drive [-].

        Of bonds that have not failed, those of this rank; their number is that of all ranks, and there are none where
        no drive is positive; the number is 1 then (collective).
        """
        x = np.where(self.intact, x, 0.0)
        found = largest(self._comm, float(x.max(initial=0.0)))
        near = np.flatnonzero((x >= (1.0 - band) * found) & (found > 0.0))
        count = float(total(self._comm, len(near)))
        return near, max(count, 1.0), found

    def fading(self, x: Float) -> float:
        """Return by how much the degradation factor of a bond would change at most at drives x [-] (collective)."""
        return largest(self._comm, float(np.abs(self.phi - self.following(x)[0]).max(initial=0.0)))

    def soften(self, x: Float) -> float:
        """Take the degradation factor at drives x for good; return the largest change of any bond (collective)."""
        T = self.following(x)[0]
        if self.frozen:
            # Sweeps with damage held end because it only grows; also that of bonds that heal, which do so in Newton.
            T = np.minimum(T, self.phi)
        change = float(np.abs(self.phi - T).max(initial=0.0))
        # A bond that has lost everything breaks at equilibrium, not here.
        self.phi[:] = np.where(self.intact, np.maximum(T, np.finfo(float).tiny), 0.0)
        self.kappa[:] = self.law.effect.reached(x, self.kappa)
        return largest(self._comm, change)

    def break_bonds(self, x: Float, most: int | None = None) -> int:
        """Break bonds at or past their final drive, the worst first; return how many pairs (collective).

        Parameters
        ----------
        x : (n_bonds,) float64
            Drives [-]; those within ``TOGETHER`` of each other are the same.
        most : int, optional
            So many pairs at once, and those that tie with the last of them. Where absent the worst one of bonds that
            snap, because its force goes to its neighbours, and all of bonds that soften.
        """
        if most is None and self.laws.snaps:
            most = 1
        over = x
        if self.laws.softens:
            # A bond that has been past its final drive may have lost its force, even if it is driven less now.
            over = self.law.effect.reached(x, self.kappa)
        over = np.where(self.intact, over, 0.0)
        return self._break_worst(over, most)

    def tear(self, x: Float, most: int | None = None) -> int:
        """Break bonds that the strain of a gradient drives past their final drive; return how many pairs (collective).

        Parameters
        ----------
        x : (n_bonds,) float64
            Drives at the tensile strain on every bond that the gradients of its centre tell [-]; the larger of both
            ends counts.
        most : int, optional
            As in ``break_bonds``.
        """
        most = 1 if most is None and self.laws.snaps else most
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
        return self._break_worst(np.where(self.intact, over, 0.0), most)

    def _break_worst(self, driving_variable: Float, most: int | None) -> int:
        """Break bonds whose drive is at or past the final one, the worst first; return how many pairs.

        Bonds are compared by their drive over the final one, which may differ from law to law.
        """
        over, least = driving_variable / self._final, 1.0 - TOGETHER
        if largest(self._comm, float(over.max(initial=0.0))) < least:
            return 0
        if most is not None:
            past = over >= least
            ends = np.concatenate([over[past], over[past & self._twice]])
            parts = self._comm.allgather(np.sort(ends)[::-1][: 2 * most])
            candidates = np.sort(np.concatenate(parts))[::-1]
            least = max(least, float(candidates[min(2 * most, len(candidates)) - 1]) * (1.0 - TOGETHER))
        broken = over >= least
        self.phi[broken] = 0.0
        self.kappa[broken] = np.maximum(self.kappa, driving_variable)[broken]
        return self._pairs(broken)

    def damaged(self) -> tuple[GlobalIndex, Float]:
        """Return keys (n, 3) and states (n, 2), ``phi`` and worst, of damaged bonds, each from its first end only."""
        mine = np.flatnonzero((self.phi < 1.0) & self._first)
        return self.of.keys(mine), np.stack([self.phi[mine], self.kappa[mine]], axis=1)

    def restore(self, keys: GlobalIndex, states: Float) -> int:
        """Set the states of those of the given bonds that are held here; return how many from their first end.

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
        return int(np.count_nonzero(self._first[bonds[here]]))

    def _matched(self, keys: GlobalIndex) -> tuple[GlobalIndex, GlobalIndex, GlobalIndex]:
        """Return a number for every given key (n, 3), bonds held here that may be among them, and their numbers.

        Bonds with the same key have the same number (not collective).
        """
        families, end = self.of.families, np.isin(self.of.cloud.gid, keys[:, :2])
        bonds = np.flatnonzero(end[families.centres] & end[families.neighbours])
        _, number = np.unique(np.concatenate([keys, self.of.keys(bonds)]), axis=0, return_inverse=True)
        number = number.reshape(-1)
        return number[: len(keys)], bonds, number[len(keys) :]

    def count_broken(self) -> int:
        """Return how many pairs have lost their bond (collective)."""
        return self._pairs(~self.intact)

    def _pairs(self, chosen: Mask) -> int:
        """Return how many pairs the chosen bonds (n_bonds,), chosen from both ends, are (collective)."""
        return int(total(self._comm, np.count_nonzero(chosen) + np.count_nonzero(chosen & self._twice))) // 2

    @property
    def weakened(self) -> GlobalIndex:
        """Return the bonds that have lost some or all of their force (n,), ascending."""
        return np.flatnonzero(self.phi < 1.0)

    def spent(self, lost: GlobalIndex, energy: Float, degree: float) -> Float:
        """Return what each of some linear bonds has dissipated (n,) [energy] (not collective).

        Parameters
        ----------
        lost : (n,) int64
            Those that are ``weakened``.
        energy : (n,) float64
            Elastic energy of each where its drive is 1 [energy].
        degree : float
            With which power of the drive it grows [-].
        """
        x = np.where(self.phi[lost] > 0.0, self.kappa[lost], np.maximum(self.kappa[lost], self._final[lost]))
        return self.laws.dissipated(self.phi[lost], x, energy, degree, lost)
