"""Which bonds have failed, and how far: the state of bond damage."""

from __future__ import annotations

import numpy as np

from pdpetsc.arrays import Float, GlobalIndex, Mask
from pdpetsc.damage.laws import BondDamage
from pdpetsc.discrete.cloud import Cloud
from pdpetsc.discrete.communicator import agreed, largest, total
from pdpetsc.discrete.families import Families
from pdpetsc.errors import CaseError

# Bonds this close to the most overstretched one break with it: symmetric pairs, and both ends of one bond.
TOGETHER = 1e-8


class FailingBonds:
    """Integrity and critical elongation of the bonds of the own particles.

    A bond is held from both of its ends, on two ranks perhaps; ``keys`` tell that the two are one.

    Parameters
    ----------
    cloud, families
        The bonds.
    law : BondDamage
        How they fail.
    protected : (n_local,) bool, optional
        Particles whose bonds do not fail.

    Attributes
    ----------
    integrity : (n_bonds,) float64
        What the force of each bond is multiplied with [-]: 1 intact, 0 broken.
    worst : (n_bonds,) float64
        Largest stretch over the critical one so far [-], or that of the last equilibrium where bonds heal.
    limit : (n_bonds,) float64
        Critical elongation [length], infinite for protected bonds.
    frozen : bool
        Whether the integrity stays while the displacement changes.
    length : (n_bonds,) float64
        Reference length [length].
    keys : (n_bonds, 3) int64
        Global ids of both ends, the lower first, and the relative place of the second: the same from both ends.
    middle : (n_bonds, dim) float64
        Middle of each bond with its first end at home [length].

    Raises
    ------
    CaseError
        A critical stretch is not positive, on every rank.

    Notes
    -----
    Construction is collective.
    """

    def __init__(self, cloud: Cloud, families: Families, law: BondDamage, protected: Mask | None = None) -> None:
        self.law = law
        self._comm = cloud.comm
        order, centres, neighbours = cloud.order, families.centres, families.neighbours
        low = order[centres] <= order[neighbours]
        one, other = np.where(low, centres, neighbours), np.where(low, neighbours, centres)
        relative = cloud.place[other] - cloud.place[one]
        self.keys: GlobalIndex = np.stack([cloud.gid[one], cloud.gid[other], relative], axis=1)
        self.middle: Float = 0.5 * (cloud.x[one] + cloud.x[other])
        if cloud.images is not None:
            home = np.concatenate([np.zeros((cloud.n_owned, cloud.dim)), cloud.offset])
            self.middle -= home[one]
        self.length: Float = np.linalg.norm(families.bonds(cloud.x), axis=1)
        with agreed(cloud.comm):
            stretch = law.critical(self.length, self.middle)
            bad = np.flatnonzero(~(np.isfinite(stretch) & (stretch > 0.0)))
            if len(bad):
                length, value = self.length[bad[0]], stretch[bad[0]]
                raise CaseError(f"The critical stretch of a bond of length {length:g} is {value:g}, not positive.")
        self.limit: Float = stretch * self.length
        if protected is not None:
            self.limit[protected[centres] | protected[neighbours]] = np.inf
        self._first = np.asarray(cloud.gid[centres] == self.keys[:, 0])
        self.integrity: Float = np.ones(len(self.length))
        self.worst: Float = np.zeros(len(self.length))
        self.frozen = False
        self.commit()

    @property
    def intact(self) -> Mask:
        """Return which bonds are not broken (n_bonds,)."""
        return np.asarray(self.integrity > 0.0)

    @property
    def softens(self) -> bool:
        """Return whether the integrity follows the displacement now."""
        return self.law.final > self.law.onset and not self.frozen

    def commit(self) -> None:
        """Keep the present state (not collective)."""
        self._kept = self.integrity.copy(), self.worst.copy()

    def revert(self) -> None:
        """Go back to the state last kept (not collective)."""
        self.integrity[:], self.worst[:] = self._kept

    def at(self, e: Float) -> tuple[Float, Float]:
        """Return integrity (n_bonds,) [-] and its derivative by the elongation [1 / length] at elongations e."""
        return self._following(e) if self.softens else (self.integrity, np.zeros_like(e))

    def _following(self, e: Float) -> tuple[Float, Float]:
        """Return both as they are where damage is not held."""
        law = self.law
        x = e / self.limit
        present, slope = np.ones_like(e), np.zeros_like(e)
        # No bond breaks while equilibrium is sought: past its final stretch it keeps what is left of it there.
        fading = np.flatnonzero((x > law.onset) & self.intact)
        present[fading] = np.maximum(law.integrity(np.minimum(x[fading], law.final)), 0.0)
        follows = law.effect.follows(present, self.integrity) & self.intact
        moving = fading[follows[fading] & (x[fading] < law.final)]
        slope[moving] = law.slope(x[moving]) / self.limit[moving]
        return np.where(follows, present, self.integrity), slope

    def most_stretched(self, e: Float, band: float) -> tuple[Float, float]:
        """Return weights ``1 / limit / count`` of the bonds within ``band`` of the largest stretch, and that stretch.

        It is over the critical one [-], of bonds that have not failed (collective).
        """
        x = np.where(self.intact, e / self.limit, 0.0)
        found = largest(self._comm, float(x.max(initial=0.0)))
        near = (x >= (1.0 - band) * found) & (found > 0.0)
        count = float(total(self._comm, np.count_nonzero(near)))
        return np.where(near, 1.0 / (self.limit * max(count, 1.0)), 0.0), found

    def fading(self, e: Float) -> float:
        """Return by how much the integrity of a bond would change at most at elongations e [-] (collective)."""
        return largest(self._comm, float(np.abs(self.integrity - self._following(e)[0]).max(initial=0.0)))

    def soften(self, e: Float) -> float:
        """Take the integrity at elongations e for good; return the largest change of any bond (collective)."""
        T, _ = self._following(e)
        if self.frozen:
            # Sweeps with damage held end because it only grows; also that of bonds that heal, which do so in Newton.
            T = np.minimum(T, self.integrity)
        change = float(np.abs(self.integrity - T).max(initial=0.0))
        # A bond that has lost everything breaks at equilibrium, not here.
        self.integrity[:] = np.where(self.intact, np.maximum(T, np.finfo(float).tiny), 0.0)
        self.worst[:] = self.law.effect.reached(e / self.limit, self.worst)
        return largest(self._comm, change)

    def break_bonds(self, e: Float, most: int | None = None) -> int:
        """Break bonds past their final stretch, the worst first; return how many pairs (collective).

        Parameters
        ----------
        e : (n_bonds,) float64
            Elongations [length].
        most : int, optional
            So many pairs at once, and those that tie with the last of them. Where absent the worst one of bonds that
            snap, because its force goes to its neighbours, and all of bonds that soften.
        """
        if most is None and self.law.final == self.law.onset:
            most = 1
        over = e / self.limit
        if self.law.final > self.law.onset:
            # A bond that has been past its final stretch may have lost its force, even if it is shorter now.
            over = self.law.effect.reached(over, self.worst)
        over = np.where(self.intact, over, 0.0)
        return self._break_worst(over, most)

    def tear(self, strain: Float, most: int | None = None) -> int:
        """Break bonds on which the strain of a gradient is past their final stretch; return how many (collective).

        Parameters
        ----------
        strain : (n_bonds,) float64
            Tensile strain on every bond that the gradients of its centre tell [-]; the larger of both ends counts.
        most : int, optional
            As in ``break_bonds``.
        """
        most = 1 if most is None and self.law.final == self.law.onset else most
        over = np.where(self.intact, strain * self.length / self.limit, 0.0)
        own = np.flatnonzero(over >= self.law.final)
        keys = np.concatenate(self._comm.allgather(self.keys[own]))
        values = np.concatenate(self._comm.allgather(over[own]))
        if len(keys) == 0:
            return 0
        given, bonds, mine = self._matched(keys)
        found = np.zeros(max(int(given.max()), int(mine.max(initial=0))) + 1)
        np.maximum.at(found, given, values)
        over[bonds] = np.maximum(over[bonds], found[mine])
        return self._break_worst(np.where(self.intact, over, 0.0), most)

    def _break_worst(self, over: Float, most: int | None) -> int:
        """Break bonds of which ``over`` is past the final stretch, the worst first; return how many pairs."""
        worst = largest(self._comm, float(over.max(initial=0.0)))
        if worst < self.law.final or worst == 0.0:
            return 0
        least = self.law.final
        if most is not None:
            parts = self._comm.allgather(np.sort(over[over >= least])[::-1][: 2 * most])
            candidates = np.sort(np.concatenate(parts))[::-1]
            least = max(least, float(candidates[min(2 * most, len(candidates)) - 1]) * (1.0 - TOGETHER))
        broken = over >= least
        self.integrity[broken] = 0.0
        self.worst[broken] = np.maximum(self.worst, over)[broken]
        return int(total(self._comm, np.count_nonzero(broken))) // 2

    def damaged(self) -> tuple[GlobalIndex, Float]:
        """Return keys (n, 3) and states (n, 2), integrity and worst, of damaged bonds, each from its first end only."""
        mine = np.flatnonzero((self.integrity < 1.0) & self._first)
        return self.keys[mine], np.stack([self.integrity[mine], self.worst[mine]], axis=1)

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
        self.integrity[bonds[here]], self.worst[bonds[here]] = states[found[here]].T
        return int(np.count_nonzero(self._first[bonds[here]]))

    def _matched(self, keys: GlobalIndex) -> tuple[GlobalIndex, GlobalIndex, GlobalIndex]:
        """Return a number for every given key (n, 3), bonds held here that may be among them, and their numbers.

        Bonds with the same key have the same number (not collective).
        """
        near = np.isin(self.keys[:, 0], keys[:, 0]) & np.isin(self.keys[:, 1], keys[:, 1])
        bonds = np.flatnonzero(near)
        _, number = np.unique(np.concatenate([keys, self.keys[bonds]]), axis=0, return_inverse=True)
        number = number.reshape(-1)
        return number[: len(keys)], bonds, number[len(keys) :]

    def count_broken(self) -> int:
        """Return how many pairs have lost their bond (collective)."""
        return int(total(self._comm, np.count_nonzero(~self.intact))) // 2

    def dissipated(self, k: Float) -> float:
        """Return what linear bonds of stiffness k have dissipated [energy] (collective)."""
        lost = np.flatnonzero(self.integrity < 1.0)
        x = np.where(self.integrity[lost] > 0.0, self.worst[lost], np.maximum(self.worst[lost], self.law.final))
        return float(total(self._comm, self.law.dissipated(self.integrity[lost], x, k[lost], self.limit[lost]).sum()))
