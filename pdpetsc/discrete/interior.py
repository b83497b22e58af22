"""Search for particles further than a horizon from the surface of the body, from families only."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from pdpetsc.arrays import Float, Mask
from pdpetsc.discrete.cloud import HORIZON_TOLERANCE, Cloud
from pdpetsc.discrete.communicator import total
from pdpetsc.discrete.families import Families
from pdpetsc.kernels.interior import family_moments, lacks_members, largest_of_members, marked_within

# Approximate distance of surface particles from the surface [spacings].
BESIDE = 0.5
# A thin body is inclined against the coordinate axes if the relative off-diagonal part of the second moments of its
# families exceeds INCLINED in the mean (straight bodies), or CURVED in the root mean square (curved bodies).
INCLINED = 0.03
CURVED = 0.15
# A set is used if it has at least this share of the particles inside along the longest axis.
FEW = 0.05
UNIT_BALL = {1: 2.0, 2: np.pi, 3: 4.0 / 3.0 * np.pi}


@dataclass(frozen=True)
class Interior:
    """Store the own particles whose families represent the planes on which a body can separate.

    Attributes
    ----------
    along : (n_owned, dim) bool
        Particles for planes normal to each coordinate axis: those further than a horizon from the surface. In a thin
        body, which has almost none, particles further than a horizon from its ends along the axis; none along axes on
        which the body is shorter than two horizons.
    axes : list of int
        Axes with such particles on any rank.
    thin : bool
        Whether the body is thin.
    aligned : bool
        False for a thin body inclined against the coordinate axes.
    """

    along: Mask
    axes: list[int]
    thin: bool
    aligned: bool


def interior(cloud: Cloud, families: Families) -> Interior:
    """Find the particles further than a horizon from the surface, or in a thin body from its ends.

    A particle is at the surface if its family lies on one side of it: opposite to the first moment of the family, or
    along the direction in which the family is flattest. It is at an end if its family lies on one side along the axis.
    A particle is inside if none of these is closer than the horizon minus half a spacing, their own distance from the
    surface.

    If the body has enough of them, only particles are used for which all particles within a horizon are inside: bonds
    cut by a crack near its tip leave families with members on all sides. Images behind mirror planes and in periodic
    cells count as members.

    Notes
    -----
    Collective.
    """
    surface = _Surface(cloud, families)
    dim, comm = cloud.dim, cloud.comm
    inside = surface.beyond(surface.lacks_a_side())
    deep = surface.beyond(~inside)
    along = np.stack([surface.beyond(surface.lacks_along(unit)) for unit in np.eye(dim)], axis=1)
    count = total(comm, np.count_nonzero(np.column_stack([deep, inside, along]), axis=0))
    enough = count > FEW * count[2:].max()
    if enough[:2].any():
        chosen = deep if enough[0] else inside
        return Interior(np.repeat(chosen[:, None], dim, axis=1), list(range(dim)), thin=False, aligned=True)
    enough = enough[2:]
    along &= enough
    second = surface.second[along.any(axis=1)]
    a, b = np.triu_indices(dim, 1)
    off, on = 2.0 * second[:, a, b], second[:, a, a] + second[:, b, b]
    sums = total(comm, np.stack([one.sum(axis=0) for one in (off, on, off**2, on**2)]))
    inclined = (np.abs(sums[0]) > INCLINED * sums[1]) | (sums[2] > CURVED**2 * sums[3])
    # The orientation of the cross-section of a body, normal to its long axes, does not matter.
    aligned = not (inclined & (enough[a] | enough[b])).any()
    return Interior(along, [int(axis) for axis in np.flatnonzero(enough)], thin=True, aligned=aligned)


class _Surface:
    """Store moments of families for the search of the surface."""

    def __init__(self, cloud: Cloud, families: Families) -> None:
        n, dim = cloud.n_owned, cloud.dim
        self.cloud = cloud
        self.bonds = families.indptr, families.neighbours, cloud.x
        self.reach = cloud.local_horizon[:n] * (1.0 + 2.0 * HORIZON_TOLERANCE)
        self.first, self.second, count = np.empty((n, dim)), np.empty((n, dim, dim)), np.zeros(cloud.n_local)
        family_moments(*self.bonds, cloud.volume, self.reach, count[:n], self.first, self.second)
        # Particles of the largest family nearby have equal parts of the ball.
        count[:n] += 1.0
        cloud.halo.forward(count)
        most = count[:n].copy()
        largest_of_members(*self.bonds, self.reach, count, most)
        self.beside = BESIDE * cloud.local_horizon[:n] * (UNIT_BALL[dim] / most) ** (1.0 / dim)

    def lacks_a_side(self) -> Mask:
        """Return which families lie on one side of their particle (n_owned,)."""
        first = self.first
        size = np.linalg.norm(first, axis=1, keepdims=True)
        outward = np.divide(-first, size, out=np.zeros_like(first), where=size > 0.0)
        flattest = np.linalg.eigh(self.second)[1][:, :, 0]
        return np.asarray((self._lacks(outward) & (size[:, 0] > 0.0)) | self._lacks(flattest) | self._lacks(-flattest))

    def lacks_along(self, unit: Float) -> Mask:
        """Return which families lie on one side of their particle along a direction (n_owned,)."""
        along = np.tile(unit, (self.cloud.n_owned, 1))
        return np.asarray(self._lacks(along) | self._lacks(-along))

    def _lacks(self, direction: Float) -> Mask:
        """Return which families have no member along a direction of each (n_owned, dim)."""
        found = np.empty(self.cloud.n_owned, dtype=bool)
        lacks_members(*self.bonds, self.reach, direction, self.beside, found)
        return found

    def beyond(self, surface: Mask) -> Mask:
        """Return which own particles are further than a horizon from the surface at marked particles (collective)."""
        cloud, n = self.cloud, self.cloud.n_owned
        marked, near = cloud.halo.with_ghosts(surface.astype(float)), np.empty(n, dtype=bool)
        marked_within(*self.bonds, np.minimum(self.reach, cloud.local_horizon[:n] - self.beside), marked, near)
        return np.asarray(~(surface | near))
