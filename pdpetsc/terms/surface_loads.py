"""Dead loads on facets of the surface."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import TypeAlias

import numpy as np

from pdpetsc.arrays import Float, GlobalIndex
from pdpetsc.declare.conditions import SurfacePressure, Traction
from pdpetsc.declare.region import Named, Region
from pdpetsc.discrete.communicator import agreed, anywhere, bounds, total
from pdpetsc.errors import CaseError, SolveError
from pdpetsc.problem.body import Body
from pdpetsc.terms.prescribed_loads import SHOWN, PrescribedLoads

# A facet faces the direction of a normal if the cosine of the angle between the two is above this.
LOOKS = np.cos(np.pi / 4.0)
# A facet belongs to a side of a box if the cosine between its normal and an axis is above this.
ON_SIDE = 1.0 - 1e-9
# Tractions are equal if they differ by less than this share.
SAME = 1e-9

# Forces of some facets (n, dim) [force] at their centroids (n, dim), with their vector areas (n, dim), at a load
# parameter.
_OfFacets: TypeAlias = Callable[[Float, Float, float], Float]


@dataclass(frozen=True)
class _OnFacets:
    """Store a load on the facets ``where``."""

    where: GlobalIndex
    forces: _OfFacets


class SurfaceLoads(PrescribedLoads):
    """Apply tractions on facets, ``f_k = sum_f N_f(x_k) t_f |a_f|``, and pressures, ``t_f |a_f| = -p a_f``.

    Since ``N_f`` is linear-exact, the forces have the resultant and the moment of the tractions at the centroids.

    Parameters
    ----------
    body : Body
        Particles and bonds, with their surface.

    Notes
    -----
    Construction and every method are collective.
    """

    def __init__(self, body: Body) -> None:
        super().__init__(body)
        self._applied: list[_OnFacets] = []

    def add_traction(self, condition: Traction, name: str) -> None:
        """Add a traction on the facets of its region."""
        dim = self.body.dim
        with agreed(self.body.cloud.comm):
            components = condition.components(dim)
            normal = condition.unit_normal(dim) if len(condition.normal) else None

        def forces(x: Float, area: Float, t: float) -> Float:
            found, size = np.zeros_like(area), np.linalg.norm(area, axis=1)
            for axis, value in components:
                found[:, axis] = condition.value(value, x, t) * size
            return found

        facets = self._facets(condition.region, normal, name)
        sides = self._sides(facets)
        tagged = isinstance(condition.region, Named) and condition.region.name in self.body.known_surface.tags
        if normal is None and not tagged and len(sides) > 1 and self._uniform(facets, forces):
            raise CaseError(
                f"The region of {name} holds facets on {len(sides)} sides of the body, and a traction acts on "
                f"each: write one of them, {', '.join(f'{side!r}' for side in sides)}, as its region."
            )
        self._add(_OnFacets(facets, forces), sides, name)

    def add_pressure(self, condition: SurfacePressure, name: str) -> None:
        """Add a pressure on the facets of its region."""

        def forces(x: Float, area: Float, t: float) -> Float:
            return np.asarray(-condition.values(x, t)[:, None] * area)

        facets = self._facets(condition.region, None, name)
        self._add(_OnFacets(facets, forces), self._sides(facets), name)

    def _facets(self, region: Region, normal: Float | None, name: str) -> GlobalIndex:
        """Return the facets in a region on this rank that face the direction of a normal, if there is one."""
        surface, cloud = self.body.known_surface, self.body.cloud
        mask = surface.select(cloud, region, name)
        if normal is not None:
            mask &= surface.area @ normal > LOOKS * np.linalg.norm(surface.area, axis=1)
            if not anywhere(cloud.comm, mask):
                raise CaseError(
                    f"No facet in the region of {name} looks along its normal {np.round(normal, 6).tolist()}; let it "
                    f"point out of the body, or leave it out."
                )
        return np.flatnonzero(mask)

    def _sides(self, facets: GlobalIndex) -> list[str]:
        """Return the sides of a box that hold facets; none if a facet is on no side (collective).

        A slab at the end of a bar contains facets of its top and bottom too. A staircase has more area than the curve
        that it approximates.
        """
        area, comm = self.body.known_surface.area[facets], self.body.cloud.comm
        along = area / np.linalg.norm(area, axis=1)[:, None]
        sides = np.array([np.count_nonzero(sign * along > ON_SIDE, axis=0) for sign in (-1.0, 1.0)])
        count = total(comm, [*sides.ravel(), len(area)])
        of_sides, every = count[:-1].reshape(sides.shape), count[-1]
        if int(of_sides.sum()) != int(every):
            return []
        return [f"{'-+'[sign]}{'xyz'[axis]}" for axis, sign in np.argwhere(of_sides.T > 0)]

    def _uniform(self, facets: GlobalIndex, forces: _OfFacets) -> bool:
        """Return True if a traction is the same on all facets at all times, and not always zero (collective).

        A function that tells sides apart is not.
        """
        comm, area, acts = self.body.cloud.comm, self.body.known_surface.area[facets], False
        for at in SHOWN:
            try:
                with agreed(comm):
                    t = forces(self.body.known_surface.x[facets], area, at) / np.linalg.norm(area, axis=1)[:, None]
            except SolveError:  # reported with the resultant, or by the run
                return False
            low, high = bounds(comm, t)
            size = np.abs([low, high]).max()
            acts |= size > 0.0
            if not np.all(high - low <= SAME * size):
                return False
        return bool(acts)

    def _add(self, applied: _OnFacets, sides: list[str], name: str) -> None:
        """Store a load on sides of a box and record its resultant."""
        self._applied.append(applied)
        self._note(f"{name} on {', '.join(sides)}" if len(sides) > 1 else name, lambda t: self._sum([applied], t))

    def _evaluated(self, t: float) -> Float:
        return self._sum(self._applied, t)

    def _sum(self, loads: list[_OnFacets], t: float) -> Float:
        """Return the sum of loads at load parameter ``t`` (n_rows, dim) [force]."""
        cloud, surface = self.body.cloud, self.body.known_surface
        on_facets = np.zeros_like(surface.area)
        with agreed(cloud.comm):
            for applied in loads:
                where = applied.where
                on_facets[where] += applied.forces(surface.x[where], surface.area[where], t)
        f = np.zeros((cloud.n_local, cloud.dim))
        surface.spread(on_facets, f)
        return self.body.gather(f)
