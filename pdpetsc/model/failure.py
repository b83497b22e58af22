"""Which bonds have failed, and how far: the state of bond damage."""

from __future__ import annotations

import numpy as np

from pdpetsc.arrays import Float, GlobalIndex
from pdpetsc.bond_based import Neighbourhood
from pdpetsc.damage import BondDamage
from pdpetsc.discrete.communicator import agreed, largest, total
from pdpetsc.errors import CaseError

# Bonds this close to the most overstretched one break with it: symmetric pairs, and both ends of one bond.
TOGETHER = 1e-8


class BondFailure:
    """Integrity and critical elongation of the bonds of the own particles.

    A bond is held from both of its ends, on two ranks perhaps; ``keys`` tell that the two are one.

    Parameters
    ----------
    bonds : Neighbourhood
        The bonds.
    law : BondDamage
        How they fail.

    Attributes
    ----------
    integrity : (n_bonds,) float64
        Force over elastic force [-]: 1 intact, 0 broken.
    limit : (n_bonds,) float64
        Elongation at which each first fails [length].
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

    def __init__(self, bonds: Neighbourhood, law: BondDamage) -> None:
        cloud, families = bonds.cloud, bonds.families
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
        self.length = bonds.length
        with agreed(cloud.comm):
            stretch = law.critical(bonds.length, self.middle)
            bad = np.flatnonzero(~(np.isfinite(stretch) & (stretch > 0.0)))
            if len(bad):
                length, value = bonds.length[bad[0]], stretch[bad[0]]
                raise CaseError(f"The critical stretch of a bond of length {length:g} is {value:g}, not positive.")
        self.limit: Float = stretch * bonds.length
        self.integrity: Float = np.ones(len(bonds.length))
        self.commit()

    def commit(self) -> None:
        """Keep the present state (not collective)."""
        self._kept = self.integrity.copy()

    def revert(self) -> None:
        """Go back to the state last kept (not collective)."""
        self.integrity[:] = self._kept

    def break_most(self, e: Float) -> int:
        """Break the bonds most beyond their limit and those within 1e-8 of them; return how many pairs (collective).

        Parameters
        ----------
        e : (n_bonds,) float64
            Elongations [length].
        """
        if self.law.final_ratio > 1.0:
            raise CaseError("Newton and relaxation take bonds that snap; softening bonds need the event-driven solver.")
        over = np.where(self.integrity > 0.0, e / self.limit, 0.0)
        most = largest(self._comm, float(over.max(initial=0.0)))
        if most <= 1.0:
            return 0
        broken = over >= max(1.0, most * (1.0 - TOGETHER))
        self.integrity[broken] = 0.0
        return int(total(self._comm, np.count_nonzero(broken))) // 2

    def dissipated(self, k: Float) -> float:
        """Return what bonds of stiffness k have dissipated [energy] (collective)."""
        return float(total(self._comm, self.law.dissipated(self.integrity, k, self.limit).sum()))
