"""Materials at gradient points that are not free of stress where they are undeformed."""

from __future__ import annotations

from collections.abc import Iterable, Iterator
from typing import NamedTuple

import numpy as np

from pdpetsc.arrays import Float, GlobalIndex, Mask
from pdpetsc.errors import CaseError
from pdpetsc.kernels.expanded import pull_back_kernel, pull_back_stress_kernel
from pdpetsc.material.at_points import MaterialAtPoints
from pdpetsc.material.base import HistoryKernels, Material
from pdpetsc.material.thermal import Thermal


class Law(NamedTuple):
    """A law with the points that obey it.

    Attributes
    ----------
    rows : (n,) int64
        Numbers of the points among those of the material.
    material : Material
        The law.
    kernels, constants
        Its loops, and what they read.
    """

    rows: GlobalIndex
    material: Material
    kernels: HistoryKernels
    constants: Float


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
    thermal : Thermal, optional
        What says how the law depends on temperature.
    """

    def __init__(
        self, material: Material, points: GlobalIndex, dim: int, factor: Float | None, x: Float,
        thermal: Thermal | None = None,
    ) -> None:  # fmt: skip
        self._solid = dim == 2 and material.plane == "strain"
        self._law = None if thermal is None or thermal.law is None else thermal
        super().__init__(material, points, dim, factor, x)
        inside = 3 if self._solid else dim
        self._kernels = material.history_kernels(inside)
        self._constants = material.constants(inside)
        self._groups = [Law(self._rows, material, self._kernels, self._constants)]

    def put_at(self, points: GlobalIndex, factor: Float | None, x: Float | None = None) -> None:
        """Put the material at other points, undeformed ones without strain."""
        super().put_at(points, factor, x)
        self._rows = np.arange(len(points))
        self._groups = [Law(self._rows, self.material, self._kernels, self._constants)]
        self.expand(np.zeros((len(points), 3, 3)), None)

    def undeformed(self, x: Float) -> Float:
        """Return the history of undeformed points of particles at ``x`` (n, dim): that of a solid in plane strain."""
        return self.material.history_in_space(x) if self._solid else super().undeformed(x)

    def expand(self, strain: Float, factor: Float | None, temperature: Float | None = None) -> None:
        """Give its points strains without stress (n, 3, 3) [-].

        Parameters
        ----------
        factor : (n,) float64, optional
            What multiplies their moduli besides [-].
        temperature : (n,) float64, optional
            Their temperature, for a law that depends on it.
        """
        if temperature is not None:
            self._groups = self._at_temperatures(temperature)
        inside = 3 if self._solid else self.dim
        stretch = np.eye(3) + strain
        self._strain = np.ascontiguousarray(strain[:, :inside, :inside])
        self._inverse = np.linalg.inv(stretch[:, :inside, :inside])
        self._J = np.linalg.det(stretch)
        # What the body does not show expands by.
        self._hidden = stretch[:, range(self.dim, 3), range(self.dim, 3)]
        given = [one for one in (self.factor, factor) if one is not None]
        self._multiplier = None if not given else np.asarray(np.prod(given, axis=0))

    def at_time(self, t: float) -> None:
        """Let it be step time ``t`` from now on."""
        super().at_time(t)
        for law in self._groups:
            if law.material.timed:
                law.constants[-1] = t

    def stress(self, F: Float, P: Float) -> None:
        """Write P (all points, dim, dim) at its points."""
        P[self.points] = self._stress(F[self.points])[:, : self.dim, : self.dim]

    def _stress(self, F: Float) -> Float:
        """Return P of its points (n, inside, inside) for F (n, dim, dim) there."""
        elastic = self._elastic(F)
        P = np.empty_like(elastic)
        for (rows, _, kernels, constants), history in self._by_law():
            kernels.stress(elastic, rows, constants, history, P)
        if self.material.linear:
            return self._times(P)
        made = np.empty_like(P)
        pull_back_stress_kernel(P.shape[-1])(P, self._inverse, self._times(self._J), made)
        return made

    def tangent(self, F: Float, A: Float) -> None:
        """Write A (all points, dim, dim, dim, dim) at its points."""
        elastic, shown, inside = self._elastic(F[self.points]), self.dim, 3 if self._solid else self.dim
        made = np.empty((len(elastic), *(inside,) * 4))
        for (rows, _, kernels, constants), history in self._by_law():
            kernels.tangent(elastic, rows, constants, history, made)
        if self.material.linear:
            A[self.points] = self._times(made[:, :shown, :shown, :shown, :shown])
        else:
            pull_back_kernel(inside, shown)(made, self._inverse, self._times(self._J), self.points, A)

    def same_tangent(self, F: Float) -> Float | None:
        """Return A (dim, dim, dim, dim) of a linear material that has the same everywhere, else None."""
        alike = self.material.linear and not self.has_history and self._multiplier is None and self._law is None
        if not alike or not len(self.points) or not np.all(self.history == self.history[:1]):
            return None
        d = 3 if self._solid else self.dim
        A, first = np.empty((1, d, d, d, d)), self._rows[:1]
        self._kernels.tangent(np.eye(d)[None], first, self._constants, self.history[:1], A)
        return np.asarray(A[0, : self.dim, : self.dim, : self.dim, : self.dim])

    def energy(self, F: Float, psi: Float) -> None:
        """Write the energy density (all points,) at its points."""
        psi[self.points] = self._energy(self._elastic(F[self.points]), self._by_law())

    def _energy(self, elastic: Float, laws: Iterable[tuple[Law, Float]]) -> Float:
        """Return the energy density of its points (n,) by laws with their histories, at what is left of F."""
        found = np.empty(len(self.points))
        for (rows, _, kernels, constants), history in laws:
            kernels.energy(elastic, rows, constants, history, found)
        return self._times(found if self.material.linear else self._J * found)

    def energy_by_strain(self, F: Float) -> Float:
        """Return the derivative of the energy density at its points by their strain without stress, F held (n, 3, 3).

        ``S = psi F_theta^-1 - F_e^T P``, of the linear material ``-P`` [stress], where F (n, dim, dim) are theirs. What
        a plane body or a bar does not show has the first part alone: it is free there.
        """
        P, elastic = self._stress(F), self._elastic(F)
        inside, S = P.shape[-1], np.zeros((len(F), 3, 3))
        if self.material.linear:
            S[:, :inside, :inside] = -P
            return S
        S[:, :inside, :inside] = -np.einsum("pki,pkj->pij", elastic, P)
        psi = self._energy(elastic, self._by_law())
        S[:, :inside, :inside] += psi[:, None, None] * self._inverse
        for axis in range(inside, 3):
            S[:, axis, axis] += psi / self._hidden[:, axis - self.dim]
        return S

    def stress_along(self, F: Float, strain: Float, factor: Float, temperature: Float | None, step: float) -> Float:
        """Return how P (n, dim, dim) at its points changes with strain without stress, moduli and law, F held [stress].

        ``dP = tr(F_theta^-1 d) P - A : (F_e d) - P d F_theta^-T + c P`` with the change ``d`` of the strain (n, 3, 3)
        and that ``c`` of the logarithm of the factor of the moduli (n,); of the linear material ``-A : d + c P``. A law
        that depends on temperature (n,) otherwise changes by a central difference with a step [temperature].

        Parameters
        ----------
        F : (n, dim, dim) float64
            At its points [-].
        """
        d, elastic, P = self.dim, self._elastic(F), self._stress(F)
        inside = P.shape[-1]
        A, made = np.empty((len(elastic), *(inside,) * 4)), np.empty((len(elastic), *(inside,) * 4))
        for (rows, _, kernels, constants), history in self._by_law():
            kernels.tangent(elastic, rows, constants, history, made)
        shown = strain[:, :inside, :inside]
        if self.material.linear:
            change = -np.einsum("pimkn,pkn->pim", self._times(made), shown)
        else:
            pull_back_kernel(inside, inside)(made, self._inverse, self._times(self._J), np.arange(len(F)), A)
            change = -np.einsum("pimkn,pka,pan->pim", A, elastic, shown)
            change -= np.einsum("pia,pab,pmb->pim", P, shown, self._inverse)
            grown = np.einsum("pab,pba->p", self._inverse, shown)
            hidden = strain[:, range(inside, 3), range(inside, 3)]
            grown += (hidden / self._hidden[:, inside - d :]).sum(axis=1) if inside < 3 else 0.0
            change += grown[:, None, None] * P
        change += factor[:, None, None] * P
        if self._law is not None and temperature is not None and len(F):
            kept, ends = self._groups, []
            for by in (step, -step):
                self._groups = self._at_temperatures(temperature + by)
                ends.append(self._stress(F))
            self._groups = kept
            change += (ends[0] - ends[1]) / (2.0 * step)
        return np.asarray(change[:, :d, :d])

    def energy_by_temperature(self, F: Float, temperature: Float, step: float) -> Float:
        """Return the derivative of the energy density of its law by temperature (n,), F and strains held.

        By central differences with a step [temperature], at temperatures (n,), where F (n, dim, dim) are those of its
        points; zeros where the law does not depend on it.
        """
        if self._law is None or not len(F):
            return np.zeros(len(F))
        elastic = self._elastic(F)
        up, down = (
            self._energy(elastic, ((law, self.history[law.rows]) for law in self._at_temperatures(temperature + by)))
            for by in (step, -step)
        )
        return np.asarray((up - down) / (2.0 * step))

    def commit(self, F: Float) -> None:
        """Make the state at F (all points, dim, dim) the one that the next step starts from."""
        elastic = self._elastic(F[self.points])
        for (rows, _, kernels, constants), history in self._by_law():
            kernels.commit(elastic, rows, constants, history)
            if history is not self.history:
                self.history[rows] = history

    def out_of_plane_stress(self, F: Float) -> Float:
        """Return ``P_zz`` at its points (n,) [stress] where F (n, dim, dim) are theirs; 0 except in plane strain."""
        return self._stress(F)[:, 2, 2] if self._solid else np.zeros(len(F))

    def hidden_stretch(self, F: Float) -> Float:
        """Return the product of the stretches that F (n, dim, dim) at its points does not show (n,) [-]."""
        if self._solid or self.dim == 3:
            return np.ones(len(F))
        left, elastic = self._elastic(F), np.empty(len(F))
        for law, history in self._by_law():
            t = self._time(law.material, law.constants)
            elastic[law.rows] = law.material.hidden_stretch(left[law.rows], history, *t)
        if self.material.linear:
            return np.asarray(elastic + (self._hidden - 1.0).sum(axis=1))
        return np.asarray(elastic * self._hidden.prod(axis=1))

    def defined(self, F: Float, lost: Mask | None = None) -> bool:
        """Return whether it has a stress at F (all points, dim, dim), but for points that are lost (all points,)."""
        inside = F[self.points]
        elastic, kept = self._elastic(inside), np.ones(len(inside), dtype=bool) if lost is None else ~lost[self.points]
        for law, history in self._by_law():
            here = kept[law.rows]
            if not law.material.defined(elastic, law.rows[here], history[here]):
                return False
        return not self.material.may_fail or bool(np.isfinite(self._stress(inside)[kept]).all())

    def plastic_growth(self, F: Float) -> Float:
        """Return how much plastic strain grows at its points (n,) [-] if the step ends at F (all points, dim, dim)."""
        grown = np.zeros(len(self.points))
        if not self.has_history or not len(self.points):
            return grown
        elastic = self._elastic(F[self.points])
        for law, history in self._by_law():
            after = history.copy()
            law.kernels.commit(elastic, law.rows, law.constants, after)
            grown[law.rows] = law.material.plastic_strain(after) - law.material.plastic_strain(history)
        return grown

    def largest_modulus(self) -> float:
        """Return the largest entry of its small-strain stiffness [stress], 0 where it has no points here."""
        if len(self.points) == 0:
            return 0.0
        most = 1.0 if self._multiplier is None else float(self._multiplier.max())
        return self.material.largest_modulus(self.dim) * most

    def _at_temperatures(self, temperature: Float) -> list[Law]:
        """Return the points that have one temperature, with the law there.

        Raises
        ------
        CaseError
            A law keeps another history than the others, or has a tangent of another symmetry.
        """
        if self._law is None or not len(temperature):
            return [Law(self._rows, self.material, self._kernels, self._constants)]
        levels, of = np.unique(temperature, return_inverse=True)
        order = np.argsort(of, kind="stable")
        parts = np.split(order, np.cumsum(np.bincount(of, minlength=len(levels)))[:-1])
        inside = 3 if self._solid else self.dim
        laws = [self._law.material_at(float(level), self.material) for level in levels]
        for level, law in zip(levels, laws, strict=True):
            kept = law.history_at(inside, np.zeros((1, inside))).shape[1]
            alike = law.symmetric == self.material.symmetric and law.timed == self.material.timed
            if kept != self.history.shape[1] or not alike or law.may_fail != self.material.may_fail:
                raise CaseError(
                    f"The law of a Thermal material is of another kind at temperature {level:g} than its material: "
                    f"what it remembers, its symmetry and whether it depends on time must be the same everywhere."
                )
        made = [
            Law(rows, law, law.history_kernels(inside), law.constants(inside))
            for rows, law in zip(parts, laws, strict=True)
        ]
        for one in made:
            if one.material.timed:
                one.constants[-1] = self._constants[-1]
        return made

    def _by_law(self) -> Iterator[tuple[Law, Float]]:
        """Yield each law with the history of its points."""
        for law in self._groups:
            yield law, self.history if len(self._groups) == 1 else self.history[law.rows]

    def elastic_response(self, F: Float, P: Float, A: Float) -> tuple[Float, Float, Float, Float]:
        """Return what is left of F without expansion, with stress and tangent there, and A at F = I, unscaled."""
        d, elastic = self.dim, self._elastic(F[self.points])
        stress = np.empty_like(elastic)
        tangent = np.empty((len(elastic), *(elastic.shape[-1],) * 4))
        rest = np.empty((len(elastic), *(d,) * 4))
        for law, history in self._by_law():
            law.kernels.stress(elastic, law.rows, law.constants, history, stress)
            law.kernels.tangent(elastic, law.rows, law.constants, history, tangent)
            rest[law.rows] = law.material.moduli(d)
        return elastic[:, :d, :d], stress[:, :d, :d], tangent[:, :d, :d, :d, :d], rest

    def _elastic(self, F: Float) -> Float:
        """Return what is left of F (n, dim, dim) when the stress-free deformation is taken off (n, inside, inside)."""
        if self._solid:
            whole = np.zeros((len(F), 3, 3))
            whole[:, :2, :2] = F
            whole[:, 2, 2] = 1.0
            F = whole
        if self.material.linear:
            return np.ascontiguousarray(F - self._strain)
        return np.ascontiguousarray(F @ self._inverse)

    def _times(self, values: Float) -> Float:
        if self._multiplier is None:
            return values
        return np.asarray(values * self._multiplier.reshape(-1, *(1,) * (values.ndim - 1)))
