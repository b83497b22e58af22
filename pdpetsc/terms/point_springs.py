"""Linear springs at points of the surface."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence

import numpy as np

from pdpetsc.arrays import Float, GlobalIndex, LocalIndex, Mask
from pdpetsc.gradient.products import Product
from pdpetsc.problem.body import Body
from pdpetsc.problem.state import State
from pdpetsc.problem.term import Term
from pdpetsc.terms.facet_contact import FixedPoints

# Facets of a curved side resist sliding by the angles between them, which tells nothing of the side itself: directions
# held by less than this share of the stiffness are free.
FACETED = 0.05


class PointSprings(Term):
    """Compute the forces ``f_k = -sum_p w_p(x_k) A_p C_p v_p`` for the relative displacements ``v_p`` of points.

    Parameters
    ----------
    body : Body
        Particles with their surface.
    points : FixedPoints
        The points.
    stiffness : (n_points, dim, dim) float64
        Symmetric ``C_p`` [stress / length].
    name : str
        Prefix of the columns in the history.

    Notes
    -----
    The methods are collective.
    """

    stiff = True
    horizons = 2

    def __init__(self, body: Body, points: FixedPoints, stiffness: Float, name: str) -> None:
        self.body, self._points, self._stiffness, self._name = body, points, stiffness, name

    @property
    def stencils(self) -> tuple[GlobalIndex, LocalIndex]:
        """Return the members of the points (not collective)."""
        return self._points.stencils.point_ptr, self._points.stencils.members

    def _force(self, state: State) -> Float:
        """Compute the forces at the points (n_points, dim) [force] (collective)."""
        v = self._moved(state)
        return np.asarray(-self._points.area[:, None] * np.einsum("pij,pj->pi", self._stiffness, v))

    def _moved(self, state: State) -> Float:
        """Compute the relative displacements of the points (n_points, dim) [length] (collective)."""
        u = state.u_local
        return state.kept((self, "moved"), lambda: self._points.moved(u))

    def add_force(self, state: State, f: Float) -> None:
        """Subtract the forces of the springs."""
        self._points.spread(self._force(state), f)

    def linearise(self, state: State) -> Sequence[Product]:
        """Return ``A_p C_p`` at all points."""
        return [self._points.product(self.body.cloud.n_owned, np.arange(len(self._stiffness)), self._stiffness)]

    def energy(self, state: State) -> float:
        """Return ``sum_p A_p v_p . C_p v_p / 2`` of this rank [energy]."""
        return -0.5 * float((self._force(state) * self._moved(state)).sum())

    def numbers(self) -> Mapping[str, Callable[[State], float]]:
        """Return the sum of the forces at the points by component."""

        def component(axis: int) -> Callable[[State], float]:
            return lambda state: float(self._force(state)[:, axis].sum())

        return {f"{self._name}_{'xyz'[axis]}": component(axis) for axis in range(self.body.dim)}


class FoundationForces(PointSprings):
    """Springs between the facets of a surface and the ground.

    Parameters
    ----------
    body : Body
        Particles with their surface.
    points : FixedPoints
        The facets.
    normals : (n_points, dim) float64
        Their unit normals in the undeformed body [-].
    normal, tangential : float
        Stiffness along and across the normals [stress / length].
    name : str
        Prefix of the columns in the history.
    """

    energy_of = "foundation"

    def __init__(
        self, body: Body, points: FixedPoints, normals: Float, normal: float, tangential: float, name: str
    ) -> None:  # fmt: skip
        along = normals[:, :, None] * normals[:, None, :]
        across = np.eye(body.dim) - along
        super().__init__(body, points, normal * along + tangential * across, name)
        n, owner = body.cloud.n_owned, points.stencils.owner
        held = (normal > 0.0) * along + (tangential > 0.0) * across
        sums, area = np.zeros((n, body.dim, body.dim)), np.bincount(owner, points.area, n)
        np.add.at(sums, owner, points.area[:, None, None] * held)
        squares, axes = np.linalg.eigh(sums / np.where(area > 0.0, area, 1.0)[:, None, None])
        squares[squares <= FACETED * squares[:, -1:]] = 0.0
        # Square root of the mean projector on the directions that springs hold.
        self._root = np.einsum("nij,nj,nkj->nik", axes, np.sqrt(squares), axes)

    @property
    def grounded(self) -> Mask:
        """Return the displacements of the particles with springs (n_owned, dim) (not collective)."""
        return np.repeat(self._root.any(axis=(1, 2))[:, None], self.body.dim, axis=1)

    def resisted(self, modes: Float) -> Float:
        """Return the part of displacements (n_owned, dim) in the directions that springs hold."""
        return np.asarray(np.einsum("nij,nj->ni", self._root, modes))
