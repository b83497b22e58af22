"""Materials at gradient points that are not free of stress where they are undeformed."""

from __future__ import annotations

import numpy as np

from pdpetsc.arrays import Float, GlobalIndex
from pdpetsc.material.at_points import MaterialAtPoints
from pdpetsc.material.base import Material


class ExpandedAtPoints(MaterialAtPoints):
    """A material with a stress-free deformation ``F_theta = I + eps`` at each of its points.

    ``F_e = F F_theta^-1``, ``P = J_theta P_e(F_e) F_theta^-T`` and
    ``A_imkn = J_theta (A_e)_iakb (F_theta^-1)_ma (F_theta^-1)_nb``; the energy per undeformed volume is
    ``J_theta psi_e(F_e)``.
    The linear material sees ``F - eps``. ``J_theta`` is that of space: what a plane body or a bar does not show expands
    as well. A body in plane strain is a solid with ``F_zz = 1`` here, because its elastic part is strained across the
    plane.

    Parameters
    ----------
    material, points, dim, factor, x
        As for ``MaterialAtPoints``.
    """

    def __init__(self, material: Material, points: GlobalIndex, dim: int, factor: Float | None, x: Float) -> None:
        self._solid = dim == 2 and material.plane == "strain"
        super().__init__(material, points, dim, factor, x)
        inside = 3 if self._solid else dim
        self._kernels = material.history_kernels(inside)
        self._constants = material.constants(inside)

    def put_at(self, points: GlobalIndex, factor: Float | None, x: Float | None = None) -> None:
        """Put the material at other points, undeformed ones without strain."""
        super().put_at(points, factor, x)
        if self._solid:
            self.history = self.material.history_in_space(np.zeros((len(points), 2)) if x is None else x)
        self._rows = np.arange(len(points))
        self.expand(np.zeros((len(points), 3, 3)), None)

    def expand(self, strain: Float, factor: Float | None) -> None:
        """Give its points strains without stress (n, 3, 3) [-] and what multiplies their moduli besides (n,) [-]."""
        inside = 3 if self._solid else self.dim
        stretch = np.eye(3) + strain
        self._strain = np.ascontiguousarray(strain[:, :inside, :inside])
        self._inverse = np.linalg.inv(stretch[:, :inside, :inside])
        self._J = np.linalg.det(stretch)
        # What the body does not show expands by.
        self._hidden = stretch[:, range(self.dim, 3), range(self.dim, 3)]
        given = [one for one in (self.factor, factor) if one is not None]
        self._multiplier = None if not given else np.asarray(np.prod(given, axis=0))

    def stress(self, F: Float, P: Float) -> None:
        """Write P (all points, dim, dim) at its points."""
        P[self.points] = self._stress(F[self.points])[:, : self.dim, : self.dim]

    def _stress(self, F: Float) -> Float:
        """Return P of its points (n, inside, inside) for F (n, dim, dim) there."""
        elastic = self._elastic(F)
        P = np.empty_like(elastic)
        self._kernels.stress(elastic, self._rows, self._constants, self.history, P)
        if not self.material.linear:
            P = self._J[:, None, None] * (P @ self._inverse.transpose(0, 2, 1))
        return self._times(P)

    def tangent(self, F: Float, A: Float) -> None:
        """Write A (all points, dim, dim, dim, dim) at its points."""
        d = self.dim
        A[self.points] = self._tangent(F[self.points], self._rows)[:, :d, :d, :d, :d]

    def _tangent(self, F: Float, rows: GlobalIndex) -> Float:
        """Return A of some of its points (n, inside, ...) for F (n, dim, dim) there."""
        elastic, d = self._elastic(F, rows), 3 if self._solid else self.dim
        A = np.empty((len(rows), d, d, d, d))
        self._kernels.tangent(elastic, np.arange(len(rows)), self._constants, self.history[rows], A)
        if not self.material.linear:
            inverse, J = self._inverse[rows], self._J[rows]
            A = A.reshape(len(rows), -1, d) @ inverse.transpose(0, 2, 1)
            A = np.einsum("pma,piakn->pimkn", J[:, None, None] * inverse, A.reshape(-1, d, d, d, d))
        return self._times(A, rows)

    def same_tangent(self, F: Float) -> Float | None:
        """Return A (dim, dim, dim, dim) of a linear material that has the same everywhere, else None."""
        alike = self.material.linear and not self.has_history and self._multiplier is None and len(self.points) > 0
        if not alike or not np.all(self.history == self.history[:1]):
            return None
        d, first = self.dim, self._rows[:1]
        return np.asarray(self._tangent(F[self.points[:1]], first)[0, :d, :d, :d, :d])

    def energy(self, F: Float, psi: Float) -> None:
        """Write the energy density (all points,) at its points."""
        found = np.empty(len(self.points))
        self._kernels.energy(self._elastic(F[self.points]), self._rows, self._constants, self.history, found)
        psi[self.points] = self._times(found if self.material.linear else self._J * found)

    def commit(self, F: Float) -> None:
        """Make the state at F (all points, dim, dim) the one that the next step starts from."""
        self._kernels.commit(self._elastic(F[self.points]), self._rows, self._constants, self.history)

    def out_of_plane_stress(self, F: Float) -> Float:
        """Return ``P_zz`` at its points (n,) [stress] where F (n, dim, dim) are theirs; 0 except in plane strain."""
        return self._stress(F)[:, 2, 2] if self._solid else np.zeros(len(F))

    def hidden_stretch(self, F: Float) -> Float:
        """Return the product of the stretches that F (n, dim, dim) at its points does not show (n,) [-]."""
        if self._solid or self.dim == 3:
            return np.ones(len(F))
        elastic = self.material.hidden_stretch(self._elastic(F), self.history)
        if self.material.linear:
            return np.asarray(elastic + (self._hidden - 1.0).sum(axis=1))
        return np.asarray(elastic * self._hidden.prod(axis=1))

    def defined(self, F: Float) -> bool:
        """Return whether it has a stress at F (all points, dim, dim)."""
        inside = F[self.points]
        if not self.material.defined(self._elastic(inside), self._rows, self.history):
            return False
        return not self.material.may_fail or bool(np.isfinite(self._stress(inside)).all())

    def plastic_growth(self, F: Float) -> float:
        """Return how much the plastic strain grows at most if the step ends at F (all points, dim, dim) [-]."""
        if not self.has_history or not len(self.points):
            return 0.0
        after = self.history.copy()
        self._kernels.commit(self._elastic(F[self.points]), self._rows, self._constants, after)
        return float((self.material.plastic_strain(after) - self.plastic_strain()).max())

    def largest_modulus(self) -> float:
        """Return the largest entry of its small-strain stiffness [stress], 0 where it has no points here."""
        if len(self.points) == 0:
            return 0.0
        most = 1.0 if self._multiplier is None else float(self._multiplier.max())
        return self.material.largest_modulus(self.dim) * most

    def _elastic(self, F: Float, rows: GlobalIndex | None = None) -> Float:
        """Return what is left of F (n, dim, dim) when the stress-free deformation is taken off (n, inside, inside)."""
        chosen = slice(None) if rows is None else rows
        if self._solid:
            whole = np.zeros((len(F), 3, 3))
            whole[:, :2, :2] = F
            whole[:, 2, 2] = 1.0
            F = whole
        if self.material.linear:
            return np.ascontiguousarray(F - self._strain[chosen])
        return np.ascontiguousarray(F @ self._inverse[chosen])

    def _times(self, values: Float, rows: GlobalIndex | None = None) -> Float:
        if self._multiplier is None:
            return values
        chosen = self._multiplier if rows is None else self._multiplier[rows]
        return np.asarray(values * chosen.reshape(-1, *(1,) * (values.ndim - 1)))
