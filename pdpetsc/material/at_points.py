"""Materials at their gradient points."""

from __future__ import annotations

from collections.abc import Callable, Iterable
from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np

from pdpetsc.arrays import Float, GlobalIndex, Mask
from pdpetsc.errors import CaseError
from pdpetsc.material.base import HistoryKernels, Material
from pdpetsc.material.stress_free import StressFreeStrain, StressFreeStretch, Unexpanded
from pdpetsc.material.thermal import Thermal

# Number of points that are compared first; most differences occur there.
SOME = 100


@dataclass(frozen=True, eq=False)
class Law:
    """The law of points of one temperature.

    Attributes
    ----------
    rows : slice or (n,) int64
        The points among those of the material.
    material : Material
        The law.
    kernels : HistoryKernels
        Its loops.
    constants : float64
        The constants that they read.
    """

    rows: slice | GlobalIndex
    material: Material
    kernels: HistoryKernels
    constants: Float

    @staticmethod
    def of(material: Material, dim: int, rows: slice | GlobalIndex = slice(None)) -> Law:
        """Return the law for a dimension at points ``rows``."""
        return Law(rows, material, material.history_kernels(dim), material.constants(dim))

    def of_step(self, dt: float) -> Law:
        """Return the law for a step of duration ``dt`` [time], unchanged if it does not read that."""
        if not self.material.reads_step:
            return self
        return replace(self, constants=np.append(self.constants[:-1], dt))

    @property
    def time(self) -> tuple[float, ...]:
        """Return the duration of the step for laws that depend on it, nothing for others."""
        return (float(self.constants[-1]),) if self.material.timed else ()


class MaterialAtPoints:
    """A material, its gradient points, and its history there.

    Parameters
    ----------
    material : Material
        The law.
    points : int64
        Numbers of its gradient points on this rank.
    dim : int
        Dimension of the body.
    factor : (n_points,) float64 or None
        Factor of the moduli of a graded material at each of these points [-].
    x : (n_points, dim) float64, optional
        Positions of the particles of these points [length], the origin by default.
    expands : bool
        True if the body has a stress-free deformation. In plane strain the law is then that of a solid.
    thermal : Thermal, optional
        The dependence of the law on temperature.

    Attributes
    ----------
    history : (n_points, n_history) float64
        History variables, overwritten in place, or position-dependent data of the law; no columns for a law of F only.
    """

    def __init__(
        self, material: Material, points: GlobalIndex, dim: int, factor: Float | None, x: Float | None = None,
        expands: bool = False, thermal: Thermal | None = None,
    ) -> None:  # fmt: skip
        self.material, self.dim = material, dim
        self._expands = expands
        self.inside = 3 if expands and dim == 2 and material.plane == "strain" else dim
        self._by_temperature = None if thermal is None or thermal.law is None else thermal
        self.law = Law.of(material, self.inside)
        self.put_at(points, factor, x)

    def put_at(self, points: GlobalIndex, factor: Float | None, x: Float | None = None) -> None:
        """Assign the material to other, undeformed points."""
        self.points = points
        self.factor = factor
        self.history = self.undeformed(np.zeros((len(points), self.dim)) if x is None else x)

    def undeformed(self, x: Float) -> Float:
        """Return the history of undeformed points of particles at ``x`` (n, dim)."""
        in_space = self.inside > self.dim
        return self.material.history_in_space(x) if in_space else self.material.history_at(self.dim, x)

    def at(self, dt: float = 0.0, conditions: Conditions | None = None) -> MaterialLaw:
        """Return the law: stress, tangent and energy as functions of F.

        Parameters
        ----------
        dt : float
            Physical time since the last converged step [time].
        conditions : Conditions, optional
            Conditions of the points; no eigenstrain by default.
        """
        return MaterialLaw(self, dt, self.conditions() if conditions is None else conditions)

    def conditions(
        self, strain: Float | None = None, factor: Float | None = None, temperature: Float | None = None
    ) -> Conditions:
        """Return the stress-free deformation and the laws of the points.

        Parameters
        ----------
        strain : (n, 3, 3) float64, optional
            Eigenstrains [-].
        factor : (n,) float64, optional
            Factor of the moduli at the temperature of the points [-].
        temperature : (n,) float64, optional
            Temperature of the points, for a law that depends on it.
        """
        factors = [by for by in (self.factor, factor) if by is not None]
        multiplier = np.asarray(np.prod(factors, axis=0)) if factors else None
        if not self._expands:
            return Conditions(Unexpanded(self.points, self.dim, multiplier), (self.law,))
        strain = np.zeros((len(self.points), 3, 3)) if strain is None else strain
        kind = StressFreeStrain if self.material.small_strain else StressFreeStretch
        free = kind(self.points, self.dim, multiplier, self.inside, strain)
        return Conditions(free, self.laws_at(temperature))

    def laws_at(self, temperature: Float | None) -> tuple[Law, ...]:
        """Return the law of each temperature of the points (n,).

        Raises
        ------
        CaseError
            Laws differ in their history or in the symmetry of their tangent.
        """
        if temperature is None or self._by_temperature is None or not len(temperature):
            return (self.law,)
        levels, of = np.unique(temperature, return_inverse=True)
        order = np.argsort(of, kind="stable")
        parts = np.split(order, np.cumsum(np.bincount(of, minlength=len(levels)))[:-1])
        laws = [self._by_temperature.material_at(float(level), self.material) for level in levels]
        for level, law in zip(levels, laws, strict=True):
            width = law.history_at(self.inside, np.zeros((1, self.inside))).shape[1]
            alike = law.symmetric == self.material.symmetric and law.may_fail == self.material.may_fail
            if width != self.history.shape[1] or not alike:
                raise CaseError(
                    f"The law of a Thermal material is of another kind at temperature {level:g} than its material: "
                    f"what it remembers and its symmetry must be the same everywhere."
                )
        return tuple(
            Law.of(law, self.inside, rows if len(laws) > 1 else slice(None))
            for rows, law in zip(parts, laws, strict=True)
        )

    @property
    def varies(self) -> bool:
        """Return True if the law depends on temperature by more than a factor of the moduli."""
        return self._by_temperature is not None

    def plastic_strain(self) -> Float:
        """Return the accumulated plastic strain at its points (n,) [-]."""
        return self.material.plastic_strain(self.history)

    @property
    def has_history(self) -> bool:
        """Return True if its stress depends on converged steps."""
        return self.material.has_history

    def largest_modulus(self, factor: Float | None = None) -> float:
        """Return the largest entry of its small-strain stiffness [stress], 0 if it has no points here.

        ``factor`` (n,) is an additional factor of the moduli [-].
        """
        if len(self.points) == 0:
            return 0.0
        multiplier = self.conditions(factor=factor).free.multiplier
        return self.material.largest_modulus(self.dim) * (1.0 if multiplier is None else float(multiplier.max()))


@dataclass(frozen=True, eq=False)
class Conditions:
    """Stress-free deformation and laws of the points of a material.

    Attributes
    ----------
    free : Unexpanded
        Map of the stress-free deformation.
    laws : tuple of Law
        One for each temperature at which the law differs.
    """

    free: Unexpanded
    laws: tuple[Law, ...]


class MaterialLaw:
    """Stress, tangent and energy at the points of a material, as functions of F and history without side effects.

    Only ``commit`` changes the history of the material.

    Parameters
    ----------
    of : MaterialAtPoints
        Material, points and history.
    dt : float
        Physical time since the last converged step [time].
    conditions : Conditions
        Stress-free deformation and laws of the points.
    """

    def __init__(self, of: MaterialAtPoints, dt: float, conditions: Conditions) -> None:
        self.of = of
        self.material, self.points, self.dim, self.has_history = of.material, of.points, of.dim, of.has_history
        self.free = conditions.free
        self._dt = dt
        self._laws = [law.of_step(dt) for law in conditions.laws]

    @cached_property
    def _expansion(self) -> StressFreeStrain:
        assert isinstance(self.free, StressFreeStrain)
        return self.free

    def stress(self, F: Float, P: Float, only: Mask | None = None) -> None:
        """Write P (all points, dim, dim) at its points, or at those in ``only`` (all points,), for F of all points.

        Laws of a body with eigenstrain write it at all of their points.
        """
        self.free.stress(self._evaluate("stress", *self.free.elastic(F), self.free.room(P), only=only), P)

    def tangent(self, F: Float, A: Float, only: Mask | None = None) -> None:
        """Write A (all points, dim, dim, dim, dim), likewise."""
        self.free.tangent(self._evaluate("tangent", *self.free.elastic(F), self.free.room(A), only=only), A)

    def energy(self, F: Float, psi: Float, only: Mask | None = None) -> None:
        """Write the energy density (all points,), likewise."""
        self.free.energy(self._evaluate("energy", *self.free.elastic(F), self.free.room(psi), only=only), psi)

    def density_of(self, quantity: Callable[[Material, Float, Float], Float], F: Float, psi: Float) -> None:
        """Write an energy density (all points,) at its points: ``quantity`` of the law, its F and history (n, ...)."""
        part, select = self.free.elastic(F)
        room = self.free.room(psi)
        for law in self._laws:
            rows = select[law.rows]
            room[rows] = quantity(law.material, part[rows], self.of.history[law.rows])
        self.free.energy(room, psi)

    def commit(self, F: Float) -> None:
        """Commit the state at F (all points, dim, dim) as the start of the next step."""
        self._advance(F, self.of.history)

    def plastic_strain(self) -> Float:
        """Return the accumulated plastic strain of the last converged state at its points (n,) [-]."""
        return self.of.plastic_strain()

    def plastic_strain_after(self, F: Float) -> Float:
        """Return the accumulated plastic strain at its points (n,) [-] if the step ends at F (all points, dim, dim)."""
        after = self.of.history.copy()
        self._advance(F, after)
        return self.material.plastic_strain(after)

    def plastic_growth(self, F: Float) -> Float:
        """Return the growth of plastic strain at its points (n,) [-] if the step ends at F (all points, dim, dim)."""
        if not self.has_history or not len(self.points):
            return np.zeros(len(self.points))
        return np.asarray(self.plastic_strain_after(F) - self.plastic_strain())

    def elastic_response(self, F: Float) -> tuple[Float, Float, Float, Float]:
        """Return F_e, P_e, A_e (n, ...) of the law at its points and A at F = I (n or 1, ...), without factors.

        ``F`` is that of all points.
        """
        d, part = self.dim, self.free.elastic_part(F[self.points])
        P, A = np.empty_like(part), np.empty((len(part), *(part.shape[-1],) * 4))
        self._evaluate("stress", part, self._rows, P)
        self._evaluate("tangent", part, self._rows, A)
        rest = np.empty((len(part) if len(self._laws) > 1 else 1, *(d,) * 4))
        for law in self._laws:
            rest[law.rows] = law.material.moduli(d)
        return part[:, :d, :d], P[:, :d, :d], A[:, :d, :d, :d, :d], rest

    def same_tangent(self, F: Float) -> Float | None:
        """Return A (dim, dim, dim, dim) if it is equal at all its points for F (all points, dim, dim), else None."""
        of, linear = self.of, self.material.linear
        if self.has_history or self.free.multiplier is not None or len(self._laws) > 1 or not len(self.points):
            return None
        one = np.eye(of.inside)[None] if linear else F[self.points[:1]]
        if not linear and (
            self.free.expands or not np.all(F[self.points[:SOME]] == one) or not np.all(F[self.points] == one)
        ):
            return None
        if not np.all(of.history == of.history[:1]):  # data of the position, such as fibre directions
            return None
        A, law = np.empty((1, *(of.inside,) * 4)), self._laws[0]
        law.kernels.tangent(one, np.zeros(1, dtype=np.int64), law.constants, of.history[:1], A)
        return np.asarray(A[0, : self.dim, : self.dim, : self.dim, : self.dim])

    def out_of_plane_stress(self, F: Float) -> Float:
        """Return ``P_zz`` at its points (n,) [stress] for their F (n, dim, dim); 0 except in plane strain."""
        if self.dim != 2 or self.material.plane == "stress":
            return np.zeros(len(F))
        if self.free.expands:
            return self._first_piola(self.free.elastic_part(F))[:, 2, 2]
        law = self._laws[0]
        P = law.material.out_of_plane_stress(F, self.of.history, *law.time)
        return P if self.free.multiplier is None else P * self.free.multiplier

    def hidden_stretch(self, F: Float) -> Float:
        """Return the product of the hidden stretches for F (n, dim, dim) at its points (n,) [-]."""
        if self.free.expands and (self.dim == 3 or self.of.inside == 3):
            return np.ones(len(F))
        part, across = self.free.elastic_part(F), np.empty(len(F))
        for law in self._laws:
            across[law.rows] = law.material.hidden_stretch(part[law.rows], self.of.history[law.rows], *law.time)
        return self.free.hidden(across)

    def strained(self, F: Float) -> tuple[Float, Float]:
        """Return elastic and stress-free part of F (n, dim, dim) at its points.

        The stress-free part, (n or 1, dim, dim), is 1 for linear laws.
        """
        return self.free.elastic_part(F)[:, : self.dim, : self.dim], self._expansion.stretch

    def defined(self, F: Float, lost: Mask | None = None) -> bool:
        """Return True if it has a stress at F (all points, dim, dim), ignoring lost points (all points,)."""
        part, select = self.free.elastic(F)
        intact = np.ones(len(self.points), dtype=bool) if lost is None else ~lost[self.points]
        for law in self._laws:
            here = intact[law.rows]
            if not law.material.defined(part, select[law.rows][here], self.of.history[law.rows][here]):
                return False
        if not self.material.may_fail:
            return True
        P = np.empty_like(F)
        self.stress(F, P)
        return bool(np.isfinite(P[self.points[intact]]).all())

    def energy_by_strain(self, F: Float) -> Float:
        """Return the derivative of the energy density by the eigenstrain at constant F (n, 3, 3) [stress].

        ``F`` (n, dim, dim) is that of its points.
        """
        part = self.free.elastic_part(F)
        return self._expansion.energy_by_strain(part, self._first_piola(part), self._energy_density(part, self._laws))

    def energy_by_temperature(self, F: Float, temperature: Float, step: float) -> Float:
        """Return the derivative of the energy density of its law by temperature (n,) at constant F and strain.

        By central differences with a step [temperature] at temperatures (n,), for F (n, dim, dim) of its points; zeros
        for a law that does not depend on temperature.
        """
        if not self.of.varies or not len(F):
            return np.zeros(len(F))
        part = self.free.elastic_part(F)
        up, down = (
            self._energy_density(part, [law.of_step(self._dt) for law in self.of.laws_at(temperature + by)])
            for by in (step, -step)
        )
        return np.asarray((up - down) / (2.0 * step))

    @property
    def _rows(self) -> GlobalIndex:
        return np.arange(len(self.points))

    def _evaluate(
        self, quantity: str, F: Float, select: GlobalIndex, result: Float, laws: Iterable[Law] | None = None,
        only: Mask | None = None,
    ) -> Float:  # fmt: skip
        """Write stress, tangent or energy of laws at the rows ``select`` of F and return the result."""
        for law in self._laws if laws is None else laws:
            loop, rows = getattr(law.kernels, quantity), law.rows
            if only is not None and not self.free.expands:
                rows = self._rows[rows][only[self.points[rows]]]
            loop(F, select[rows], law.constants, self.of.history[rows], result)
        return result

    def _first_piola(self, elastic: Float) -> Float:
        P = self._evaluate("stress", elastic, self._rows, np.empty_like(elastic))
        return self._expansion.first_piola(P)

    def _energy_density(self, elastic: Float, laws: Iterable[Law]) -> Float:
        psi = self._evaluate("energy", elastic, self._rows, np.empty(len(elastic)), laws)
        return self._expansion.energy_density(psi)

    def _advance(self, F: Float, history: Float) -> None:
        """Overwrite the history of the last converged step with that of a step ending at F (all points, dim, dim)."""
        part, select = self.free.elastic(F)
        for law in self._laws:
            rows = history[law.rows]
            law.kernels.commit(part, select[law.rows], law.constants, rows)
            history[law.rows] = rows
