"""Two parts of the surface that move as one."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from pdpetsc.arrays import Mask
from pdpetsc.declare.body_contact import Tied
from pdpetsc.discrete.communicator import anywhere, count_nonzero, largest
from pdpetsc.errors import CaseError
from pdpetsc.gradient.base import StencilMembers
from pdpetsc.problem.body import Body
from pdpetsc.problem.supports import Supports
from pdpetsc.terms.facet_contact import FixedPoints
from pdpetsc.terms.facing import Search, both_ends, corners_of, sides_of
from pdpetsc.terms.point_springs import PointSprings

# Default stiffness over that of contact [-].
TIED = 100.0
# Displacements that differ by less than this share of the largest one are equal.
SAME = 1e-9


class TiedForces(PointSprings):
    """Compute the forces ``-c A (u - u')`` at the middles of the overlaps of undeformed facets.

    Parameters
    ----------
    body : Body
        Particles with their surface.
    declared : Tied
        Declared tie.
    one, other : (n_facets,) bool
        Facets of both parts.
    stiffness, spacing, name
        As for ``BodyContactForces``.

    Attributes
    ----------
    points : FixedPoints
        The middles of the overlaps.
    spacing : float
        The coarser spacing [length].

    Notes
    -----
    Construction and the methods are collective.
    """

    energy_of = "tie"

    def __init__(
        self, body: Body, declared: Tied, one: Mask, other: Mask, stiffness: float, spacing: float, name: str
    ) -> None:
        cloud = body.cloud
        mine, _, theirs = sides_of(body, one, other, cloud.horizon, *corners_of(body, name))
        search = Search(cloud, mine, theirs, declared.gap * spacing)
        rest = np.zeros((cloud.n_local, body.dim))
        search.renew(rest)
        pairs = search.pairs(rest)
        pairs = pairs.chosen(np.abs(pairs.gap) <= declared.gap * spacing)
        if not anywhere(cloud.comm, len(pairs.rows)):
            raise CaseError(f"No facets of {name} overlap within a gap of {declared.gap:g} spacings; raise the gap.")
        ptr, members, weights = both_ends(mine, theirs, pairs)
        stencils = StencilMembers(mine.owner[pairs.rows], ptr, members)
        body.overlap.couple(stencils.owner)
        x = mine.x[pairs.rows] + pairs.one
        points = FixedPoints(x, pairs.area, np.arange(len(pairs.rows)), stencils, weights)
        super().__init__(body, points, np.tile(stiffness * np.eye(body.dim), (len(pairs.rows), 1, 1)), declared.name)
        self.points, self.spacing = points, spacing
        # An own particle at both ends of each pair.
        self.joined = np.stack([members[ptr[:-1]], members[ptr[1:] - 1]], axis=1)

    # Pairs are of particles without a common family.
    within_families = False

    def refuse_held_apart(self, supports: Supports, times: Sequence[float], name: str) -> None:
        """Raise CaseError if displacement conditions alone move both facets of a pair, and differently (collective)."""
        cloud, of = self.body.cloud, self.points.stencils
        n, ties = cloud.n_owned, supports.ties
        given = supports.fixed if ties is None else supports.fixed & ~ties.tied
        free = cloud.halo.with_ghosts(~given[:n])[of.members]
        held = np.add.reduceat(free, of.point_ptr[:-1], dtype=np.int64) == 0 if len(self.points.x) else free
        if not anywhere(cloud.comm, held):
            return
        for t in times:
            u = supports.prescribed(t)[:n]
            apart = np.abs(self.points.moved(self.body.with_ghosts(u))) > SAME * largest(cloud.comm, np.abs(u))
            if twice := count_nonzero(cloud.comm, (apart & held).any(axis=1)):
                raise CaseError(
                    f"{name} ties {twice} pairs of facets that displacement conditions hold apart at step time {t:g}. "
                    f"Leave the tie out, or release one side."
                )
