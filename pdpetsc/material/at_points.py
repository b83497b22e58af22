"""Materials at the gradient points that they apply to."""

from __future__ import annotations

import numpy as np

from pdpetsc.arrays import Float, GlobalIndex, Mask
from pdpetsc.material.base import Material

# Points that are compared first, most of the time to find a difference.
SOME = 100


class MaterialAtPoints:
    """A material and the gradient points that obey it, with what it remembers of converged steps there.

    Parameters
    ----------
    material : Material
        The law.
    points : int64
        Numbers of its gradient points on this rank.
    dim : int
        Dimension of the body.
    factor : (n_points,) float64 or None
        What multiplies its moduli at each of these points [-], where it is graded.
    x : (n_points, dim) float64, optional
        Positions of the particles whose points they are [length], for what depends on place; the origin by default.

    Attributes
    ----------
    history : (n_points, n_history) float64
        What it remembers, to be overwritten in place, or what it reads of the place; no columns where its stress
        depends on F alone.
    """

    def __init__(
        self, material: Material, points: GlobalIndex, dim: int, factor: Float | None, x: Float | None = None
    ) -> None:
        self.material = material
        self.dim = dim
        self._kernels = material.history_kernels(dim)
        self._constants = material.constants(dim)
        self.put_at(points, factor, x)

    def put_at(self, points: GlobalIndex, factor: Float | None, x: Float | None = None) -> None:
        """Put the material at other points, undeformed ones."""
        self.points = points
        self.factor = factor
        self.history = self.undeformed(np.zeros((len(points), self.dim)) if x is None else x)

    def undeformed(self, x: Float) -> Float:
        """Return the history of undeformed points of particles at ``x`` (n, dim), as wide as that of its points."""
        return self.material.history_at(self.dim, x)

    def at_time(self, t: float) -> None:
        """Let it be step time ``t`` from now on."""
        if self.material.timed:
            self._constants[-1] = t

    def stress(self, F: Float, P: Float) -> None:
        """Write P (all points, dim, dim) at its points."""
        self._kernels.stress(F, self.points, self._constants, self.history, P)
        self._scale(P)

    def tangent(self, F: Float, A: Float) -> None:
        """Write A (all points, dim, dim, dim, dim) at its points."""
        self._kernels.tangent(F, self.points, self._constants, self.history, A)
        self._scale(A)

    def elastic_response(self, F: Float, P: Float, A: Float) -> tuple[Float, Float, Float, Float]:
        """Return F, P, A at its points (n, ...) and A at F = I (n or 1, ...), without what multiplies its moduli.

        Parameters
        ----------
        F, P, A
            Of all points.
        """
        by = 1.0 if self.factor is None else self.factor.reshape(-1, 1, 1)
        at, rest = self.points, self.material.moduli(self.dim)[None]
        return F[at], P[at] / by, A[at] / np.reshape(by, (-1, 1, 1, 1, 1)), rest

    def same_tangent(self, F: Float) -> Float | None:
        """Return A (dim, dim, dim, dim) where it is the same at all its points for F (all points, dim, dim), else None.

        It is where F is, or does not count, and neither history nor a factor differs from point to point.
        """
        if self.has_history or self.factor is not None or not len(self.points):
            return None
        one = F[self.points[:1]]
        if not self.material.linear and not (np.all(F[self.points[:SOME]] == one) and np.all(F[self.points] == one)):
            return None
        if not np.all(self.history == self.history[:1]):  # numbers of the place, as the direction of fibres
            return None
        A = np.empty((1, *one.shape[1:], *one.shape[1:]))
        self._kernels.tangent(one, np.zeros(1, dtype=np.int64), self._constants, self.history[:1], A)
        return np.asarray(A[0])

    def energy(self, F: Float, psi: Float) -> None:
        """Write the energy density (all points,) at its points."""
        self._kernels.energy(F, self.points, self._constants, self.history, psi)
        self._scale(psi)

    def commit(self, F: Float) -> None:
        """Make the state at F (all points, dim, dim) the one that the next step starts from."""
        self._kernels.commit(F, self.points, self._constants, self.history)

    def out_of_plane_stress(self, F: Float) -> Float:
        """Return ``P_zz`` at its points (n,) [stress] where F (n, dim, dim) are theirs; 0 except in plane strain."""
        if self.dim != 2 or self.material.plane == "stress":
            return np.zeros(len(F))
        P = self.material.out_of_plane_stress(F, self.history, *self._time(self.material, self._constants))
        return P * (1.0 if self.factor is None else self.factor)

    def hidden_stretch(self, F: Float) -> Float:
        """Return the product of the stretches that F (n, dim, dim) at its points does not show (n,) [-]."""
        return self.material.hidden_stretch(F, self.history, *self._time(self.material, self._constants))

    def defined(self, F: Float, lost: Mask | None = None) -> bool:
        """Return whether it has a stress at F (all points, dim, dim), but for points that are lost (all points,)."""
        rows = np.arange(len(self.points)) if lost is None else np.flatnonzero(~lost[self.points])
        if not self.material.defined(F, self.points[rows], self.history[rows]):
            return False
        if not self.material.may_fail:
            return True
        P = np.empty_like(F)
        self.stress(F, P)
        return bool(np.isfinite(P[self.points[rows]]).all())

    def plastic_growth(self, F: Float) -> Float:
        """Return how much plastic strain grows at its points (n,) [-] if the step ends at F (all points, dim, dim)."""
        if not self.has_history or not len(self.points):
            return np.zeros(len(self.points))
        after = self.history.copy()
        self._kernels.commit(F, self.points, self._constants, after)
        return np.asarray(self.material.plastic_strain(after) - self.plastic_strain())

    def plastic_strain(self) -> Float:
        """Return the accumulated plastic strain at its points (n,) [-]."""
        return self.material.plastic_strain(self.history)

    @property
    def has_history(self) -> bool:
        """Return whether its stress depends on converged steps."""
        return self.material.has_history

    def largest_modulus(self) -> float:
        """Return the largest entry of its small-strain stiffness [stress], 0 where it has no points here."""
        if len(self.points) == 0:
            return 0.0
        return self.material.largest_modulus(self.dim) * (1.0 if self.factor is None else float(self.factor.max()))

    @staticmethod
    def _time(material: Material, constants: Float) -> tuple[float, ...]:
        """Return the step time that the constants of a law hold; nothing where it does not depend on it."""
        return (float(constants[-1]),) if material.timed else ()

    def _scale(self, values: Float) -> None:
        if self.factor is not None:
            values[self.points] *= self.factor.reshape(-1, *(1,) * (values.ndim - 1))
