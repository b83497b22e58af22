"""Places of images of particles: periods away, and behind mirror planes."""

from __future__ import annotations

import itertools
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from pdpetsc.arrays import Float, GlobalIndex
from pdpetsc.declare.symmetry import Symmetry
from pdpetsc.discrete.communicator import Comm, total
from pdpetsc.errors import CaseError

# A particle this close to a mirror plane, as a share of its horizon, lies on it.
ON_PLANE = 1e-6


@dataclass(frozen=True)
class Places:
    """Store the places of images: particle ``x`` is at ``sign * x + shift`` in each place.

    A place with row ``q`` below has the number ``q - home``; 0 is home. Rows with the same mirror image are
    consecutive, one for each period, with opposite periods at opposite ends.

    Attributes
    ----------
    sign : (n_places, dim) float64
        -1 along the axes of the planes that the place is behind, else 1.
    shift : (n_places, dim) float64
        Translation [length].
    period : (n_places, dim) float64
        Whole periods in ``shift`` [length].
    n_periods : int
        Number of places behind the same planes, an odd number.
    planes : dict of int to float
        Position of each plane on its axis [length].
    """

    sign: Float
    shift: Float
    period: Float
    n_periods: int
    planes: dict[int, float]

    @classmethod
    def of(cls, dim: int, planes: Sequence[Symmetry], periods: Sequence[Float]) -> Places:
        """Build all places behind any of the planes and ``periods`` away; the middle period must be zero."""
        sign, shift, period = [], [], []
        for behind in itertools.product((False, True), repeat=len(planes)):
            flip, to = np.ones(dim), np.zeros(dim)
            for plane, mirrored in zip(planes, behind, strict=True):
                if mirrored:
                    flip[plane.number], to[plane.number] = -1.0, 2.0 * plane.at
            for away in periods:
                sign.append(flip)
                shift.append(to + away)
                period.append(away)
        crossed = {plane.number: float(plane.at) for plane in planes}
        return cls(np.array(sign), np.array(shift), np.array(period), len(periods), crossed)

    @property
    def n(self) -> int:
        """Return the number of places, including home."""
        return len(self.sign)

    @property
    def home(self) -> int:
        """Return the row of the place without image."""
        return self.n_periods // 2

    @property
    def mirrors(self) -> tuple[Float, Float]:
        """Return sign and shift of every combination of planes (n_mirrors, dim); the first one contains no plane."""
        rows = slice(self.home, None, self.n_periods)
        return self.sign[rows], self.shift[rows] - self.period[rows]

    def behind(self, place: GlobalIndex) -> GlobalIndex:
        """Return the number of the combination of planes that places are behind (n,), 0 for none.

        Combinations are numbered by the bits of their planes: ``^`` gives the combination of two successive ones.
        """
        return np.asarray((place + self.home) // self.n_periods)

    def opposite(self, place: GlobalIndex) -> GlobalIndex:
        """Return the places of home as seen from these (n,)."""
        if self.n == 1:
            return place
        behind, period = np.divmod(place + self.home, self.n_periods)
        return np.asarray(behind * self.n_periods + self.n_periods - 1 - period - self.home)

    def at_home(self, place: GlobalIndex, x: Float) -> Float:
        """Return the positions at home of points ``x`` (n, dim) whose images are in these places [length]."""
        if self.n == 1:
            return x
        row = place + self.home
        return np.asarray(self.sign[row] * (x - self.shift[row]))


def refuse_beyond(comm: Comm, planes: Sequence[Symmetry], x: Float, reach: Float) -> None:
    """Raise on all ranks unless the particles ``x`` (n, dim) lie on one side of every mirror plane (collective)."""
    dim = x.shape[1]
    for plane in planes:
        if plane.number >= dim:
            raise CaseError(f"There is no Symmetry across {plane.axis} of particles with {dim} coordinates.")
        apart = x[:, plane.number] - plane.at
        on_side = [np.count_nonzero(apart > ON_PLANE * reach), np.count_nonzero(apart < -ON_PLANE * reach)]
        ahead, behind, n = (int(count) for count in total(comm, [*on_side, len(x)]))
        wrong = n - max(ahead, behind)
        if wrong:
            raise CaseError(
                f"{wrong} of {n} particles lie on or beyond the mirror plane {plane.axis} = {plane.at:g}; give those "
                f"of one side alone, with the plane where their cells end."
            )
