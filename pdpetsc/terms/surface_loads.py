"""Dead loads on facets of the surface."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import TypeAlias

import numpy as np

from pdpetsc.arrays import Float, GlobalIndex
from pdpetsc.declare.conditions import SurfacePressure, Traction
from pdpetsc.discrete.communicator import agreed, total
from pdpetsc.discrete.surface import Surface
from pdpetsc.errors import CaseError, SolveError
from pdpetsc.problem.body import Body
from pdpetsc.problem.state import State
from pdpetsc.problem.term import LinearisedTerm, Term
from pdpetsc.terms.dead_loads import SHOWN

# Facets look in the direction of a given normal where the cosine between the two is above this.
LOOKS = np.cos(np.pi / 4.0)

# Forces of some facets (n, dim) [force] at their centroids (n, dim), with their vector areas (n, dim), at a step time.
_OfFacets: TypeAlias = Callable[[Float, Float, float], Float]


@dataclass(frozen=True)
class _OnFacets:
    """A load on the facets ``where``."""

    where: GlobalIndex
    forces: _OfFacets


class SurfaceLoads(Term):
    """Tractions on facets, ``f_k = sum_f N_f(x_k) t_f |a_f|``, and pressures, ``t_f |a_f| = -p a_f``.

    Since ``N_f`` is linear-exact the forces have the resultant and the moment of the tractions at the centroids.

    Parameters
    ----------
    body : Body
        Particles and bonds, with their surface.

    Notes
    -----
    Construction and every method are collective.
    """

    load = True

    def __init__(self, body: Body) -> None:
        self.body = body
        self._applied: list[_OnFacets] = []
        self._resultants: list[tuple[str, float, Float]] = []
        self._last: tuple[float, Float] | None = None

    @property
    def parts(self) -> list[str]:
        """Return nothing: loads have a record of their own."""
        return []

    @property
    def resultants(self) -> list[tuple[str, float, Float]]:
        """Return name, step time and sum of the forces (dim,) [force] of every load, at a step time when it acts."""
        return self._resultants

    def add_row_force(self, state: State, r: Float) -> None:
        """Subtract the forces at the step time of the state."""
        r -= self.forces(state.t)

    def linearised(self, state: State) -> LinearisedTerm | None:
        """Return None: they do not depend on the displacement."""
        return None

    def forces(self, t: float) -> Float:
        """Return the external forces at step time ``t`` (n_rows, dim) [force]; not to be changed."""
        if self._last is None or self._last[0] != t:
            self._last = t, self._sum(self._applied, t)
        return self._last[1]

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

        self._add(_OnFacets(self._facets(condition, normal, name), forces), name)

    def add_pressure(self, condition: SurfacePressure, name: str) -> None:
        """Add a pressure on the facets of its region."""

        def forces(x: Float, area: Float, t: float) -> Float:
            return np.asarray(-condition.values(x, t)[:, None] * area)

        self._add(_OnFacets(self._facets(condition, None, name), forces), name)

    def _facets(self, condition: Traction | SurfacePressure, normal: Float | None, name: str) -> GlobalIndex:
        """Return the facets of a condition's region on this rank."""
        surface, cloud = self._surface, self.body.cloud
        mask = surface.select(cloud, condition.region, name)
        if normal is not None:
            mask &= surface.area @ normal > LOOKS * np.linalg.norm(surface.area, axis=1)
            if int(total(cloud.comm, np.count_nonzero(mask))) == 0:
                raise CaseError(
                    f"No facet in the region of {name} looks along its normal {np.round(normal, 6).tolist()}; let it "
                    f"point out of the body, or leave it out."
                )
        return np.flatnonzero(mask)

    def _add(self, applied: _OnFacets, name: str) -> None:
        """Take in a load and note its resultant."""
        self._applied.append(applied)
        self._last = None
        try:
            n = self.body.cloud.n_owned
            sums = [total(self.body.cloud.comm, self._sum([applied], t)[:n].sum(axis=0)) for t in SHOWN]
        except SolveError as error:
            raise CaseError(str(error)) from error
        acting = next((number for number, force in enumerate(sums) if force.any()), 0)
        self._resultants.append((name, SHOWN[acting], sums[acting]))

    def _sum(self, loads: list[_OnFacets], t: float) -> Float:
        """Return the sum of loads at step time ``t`` (n_rows, dim) [force]."""
        cloud, surface = self.body.cloud, self._surface
        on_facets = np.zeros_like(surface.area)
        with agreed(cloud.comm):
            for applied in loads:
                where = applied.where
                on_facets[where] += applied.forces(surface.x[where], surface.area[where], t)
        f = np.zeros((cloud.n_local, cloud.dim))
        surface.spread(on_facets, f)
        return self.body.gather(f)

    @property
    def _surface(self) -> Surface:
        assert self.body.surface is not None
        return self.body.surface
