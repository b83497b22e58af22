"""Prescribed and tied unknowns: ``u = C q + g(t)``."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from functools import cached_property

import numpy as np

from pdpetsc.arrays import Float, GlobalIndex, LocalIndex, Mask
from pdpetsc.declare.conditions import Displacement, MeanStrain, Value, evaluated
from pdpetsc.discrete.communicator import agreed, anywhere, count_nonzero, total
from pdpetsc.errors import CaseError
from pdpetsc.kernels.sparsity import first_moments
from pdpetsc.problem.body import Body
from pdpetsc.problem.cell import CellRows
from pdpetsc.problem.prescribed import Prescribed
from pdpetsc.problem.ties import Combination, Ties

# A family is cut in a direction if its first moment exceeds this share of that of a one-sided family.
ONE_SIDED = 0.9


@dataclass(frozen=True)
class _Held:
    """Store one prescribed component of the displacement of the particles ``where``."""

    name: str
    condition: Displacement
    axis: int
    value: Value
    where: GlobalIndex


class Supports:
    """Express the unknowns ``u = C q + g(t)`` by independent ones ``q``, on this rank.

    A prescribed component has the value g. A tied component is ``sum_m c_sm u_m + g``. All other components are
    independent. Vectors of solvers have the size of u; their entries for prescribed and tied components are not used.
    Residuals are ``C^T r``, and tangents ``C^T K C`` with 1 on the diagonal of those components.

    Parameters
    ----------
    body : Body
        The body.
    cell : CellRows, optional
        Virtual unknowns of a periodic cell.

    Attributes
    ----------
    fixed : (n_rows, dim) bool
        Prescribed and tied degrees of freedom.
    given : Prescribed
        Conditions that prescribe the degrees of freedom.

    Notes
    -----
    Every method is collective.
    """

    def __init__(self, body: Body, cell: CellRows | None = None) -> None:
        self.body = body
        self.cell = cell
        self.fixed: Mask = np.zeros((body.cloud.n_rows, body.dim), dtype=bool)
        self._held: list[_Held] = []
        self.given = Prescribed(body.cloud)
        self._strains: list[tuple[MeanStrain, int, float]] = []
        self._combinations: list[tuple[Combination, Callable[[float], Float]]] = []
        if cell is not None and cell.here:
            # Entries of the virtual rows without a component.
            cell.rows(self.fixed)[len(cell.sizes) :] = True

    def prescribe(
        self, condition: Displacement, components: Sequence[tuple[int, Value]], where: GlobalIndex, name: str
    ) -> None:
        """Prescribe components of the displacement of some own particles.

        Several agreeing conditions may hold the same particles; ``prescribed`` compares their values.

        Raises
        ------
        CaseError
            A component is tied already.
        """
        if self.ties is not None:
            tied = sum(np.count_nonzero(self.ties.tied[where, axis]) for axis, _ in components)
            twice = int(total(self.body.cloud.comm, tied))
            if twice:
                raise CaseError(f"{name} prescribes {twice} displacements that another condition ties already.")
        for axis, value in components:
            self.fixed[where, axis] = True
            self._held.append(_Held(name, condition, axis, value, where))
            self.given.add(name, "xyz"[axis], where)

    def prescribe_strain(self, condition: MeanStrain, components: Sequence[tuple[int, float]]) -> None:
        """Prescribe components of the mean strain of the cell."""
        assert self.cell is not None
        for unknown, value in components:
            self._strains.append((condition, unknown, value))
            if self.cell.here:
                self.cell.rows(self.fixed)[unknown] = True

    def tie(self, combination: Combination, values: Callable[[float], Float], name: str) -> None:
        """Tie components of own particles to others, ``u_s = sum_m c_sm u_m + g_s(t)``.

        Parameters
        ----------
        combination : Combination
            Tied components of own particles, with the components that they depend on.
        values : callable
            ``g_s`` at a load parameter (n,) [length].
        name : str
            Name of the condition, for messages.

        Raises
        ------
        CaseError
            A component is prescribed or tied already, or depends on a tied component.
        """
        cloud, where = self.body.cloud, (combination.particle, combination.axis)
        entries = combination.particle.astype(np.int64) * cloud.dim + combination.axis
        repeated = len(entries) - len(np.unique(entries))
        twice = int(total(cloud.comm, np.count_nonzero(self.fixed[where]) + repeated))
        if twice:
            raise CaseError(f"{name} ties {twice} displacements that another condition prescribes or ties already.")
        self.fixed[where] = True
        self._combinations.append((combination, values))
        self.__dict__.pop("ties", None)
        ties = self.ties
        assert ties is not None
        chained = count_nonzero(cloud.comm, ties.tied & ties.independent)
        if chained:
            raise CaseError(f"{name} leaves {chained} tied displacements on which other tied ones depend.")

    @cached_property
    def ties(self) -> Ties | None:
        """Return the tied components of the body; None if there are none."""
        if not self._combinations:
            return None
        return Ties(self.body.cloud, [combination for combination, _ in self._combinations])

    @property
    def reacting(self) -> Mask:
        """Return the components on which constraints act with a force (n_rows, dim)."""
        return self.fixed if self.ties is None else self.fixed | self.ties.independent

    def completed(self, u: Float, g: Float | float = 0.0) -> Float:
        """Compute ``C q + g`` (n_rows, dim) [length] for the independent entries of ``u`` (n_rows, dim).

        Without ``g`` the result is the change that belongs to a change ``u`` of the independent entries.
        """
        values = np.where(self.fixed, g, u)
        if self.ties is not None:
            values[self.ties.all.particle, self.ties.all.axis] += self.ties.sums(values)
        return values

    def reduced(self, f: Float) -> Float:
        """Compute ``C^T f`` (n_rows, dim) [force], 0 for prescribed and tied components."""
        return np.where(self.fixed, 0.0, self.on_independent(f))

    def on_independent(self, f: Float) -> Float:
        """Compute forces (n_rows, dim) [force], those on tied components where these depend on others."""
        if self.ties is None:
            return f
        values, tied = f.copy(), (self.ties.all.particle, self.ties.all.axis)
        values[tied] = 0.0
        values[: self.body.cloud.n_owned] += self.ties.forces_on_independent(f[tied])
        return values

    def lumped_mass(self, mass: Float) -> Float:
        """Compute masses of the independent unknowns (n_rows,) from those of all unknowns (n_rows,).

        They are the row sums of ``|C|^T M |C|``, the largest of each particle. For every motion that satisfies the
        constraints, the kinetic energy is at most that with these masses. A time step that is stable for M is therefore
        stable for them.
        """
        if self.ties is None:
            return mass
        lumped = np.repeat(mass[:, None], self.body.dim, axis=1)
        lumped[: self.body.cloud.n_owned] += self.ties.lumped_mass(mass)
        return np.asarray(lumped.max(axis=1))

    def violation(self, modes: Float) -> Float:
        """Compute the violation of constraints by displacements (n_owned, dim) [length], 0 for free components."""
        u = np.zeros(self.fixed.shape)
        u[: len(modes)] = modes
        violated = np.where(self.fixed, u, 0.0)
        if self.ties is not None:
            violated[self.ties.all.particle, self.ties.all.axis] -= self.ties.sums(u)
        return violated[: len(modes)]

    def prescribed(self, t: float) -> Float:
        """Compute ``g`` at load parameter ``t`` (n_rows, dim) [length], 0 for independent components.

        Raises
        ------
        SolveError
            A function of the case fails, or two conditions prescribe different values of the same particle.
        """
        u = np.zeros(self.fixed.shape)
        cloud = self.body.cloud
        x = cloud.x[: cloud.n_owned]
        with agreed(cloud.comm):
            values = [held.condition.value(held.value, x[held.where], t) for held in self._held]
            what = "schedule of a MeanStrain condition"
            factors = [float(evaluated(what, strain.schedule, (), t, t)) for strain, _, _ in self._strains]
        self.given.refuse_different(values, t)
        for held, found in zip(self._held, values, strict=True):
            u[held.where, held.axis] = found
        if self.cell is not None and self.cell.here:
            for (_, unknown, value), factor in zip(self._strains, factors, strict=True):
                self.cell.rows(u)[unknown] += self.cell.sizes[unknown] * value * factor
        with agreed(cloud.comm):
            for combination, g in self._combinations:
                u[combination.particle, combination.axis] = g(t)
        return u

    def refuse_held_across(self) -> None:
        """Raise CaseError if particles on both sides of a period are held, and the mean strain between them is unknown.

        Images move with the mean strain, and the result would depend on where the cell begins. A single particle holds
        the body in place only.
        """
        if self.cell is None:
            return
        cloud, known = self.body.cloud, {unknown for _, unknown, _ in self._strains}
        fixed = cloud.halo.with_ghosts(self.fixed[: cloud.n_owned])
        period = cloud.places.period[cloud.place + cloud.places.home]
        for unknown, (a, b) in enumerate(self.cell.components):
            for axis, along in ((a, b), (b, a)):
                held = fixed[: cloud.n_owned, axis]
                across = held & self.body.families.with_any(fixed[:, axis] & (period[:, along] != 0.0))
                if unknown not in known and anywhere(cloud.comm, across) and count_nonzero(cloud.comm, held) > 1:
                    strain = "xyz"[a] + "xyz"[b]
                    raise CaseError(
                        f"Displacements {'xyz'[axis]} are prescribed on both sides of a period along {'xyz'[along]}, "
                        f"whose mean strain {strain} is unknown. Prescribe it too, with MeanStrain({strain}=0.0)."
                    )

    def held_by_condition(self) -> list[tuple[str, str, int]]:
        """Return name, prescribed components and number of particles of every displacement condition."""
        found: dict[str, tuple[str, int]] = {}
        for held in self._held:
            axes, _ = found.get(held.name, ("", 0))
            found[held.name] = axes + "xyz"[held.axis], len(held.where)
        here = np.array([count for _, count in found.values()], dtype=np.int64)
        counts = total(self.body.cloud.comm, here)
        return [(name, axes, int(count)) for (name, (axes, _)), count in zip(found.items(), counts, strict=True)]

    def held_components(self) -> list[tuple[str, int, GlobalIndex]]:
        """Return name, component and own particles of each prescribed component, by condition (not collective)."""
        return [(held.name, held.axis, held.where) for held in self._held]

    def held_at_cut_families(self) -> int:
        """Count the particles held in the direction in which their family is cut, next to free particles.

        The gradient weights of such particles violate the divergence theorem: uniform stress is not in equilibrium. The
        stress of the outermost layer is then 2/3 of the exact one at the smallest horizon, for any spacing.
        """
        cloud, families, lattice = self.body.cloud, self.body.families, self.body.families.lattice
        n, dim = cloud.n_owned, cloud.dim
        free = cloud.halo.with_ghosts(~self.fixed[:n])
        if lattice is None:
            one_sided = _one_sided(families.indptr, families.neighbours, cloud.x, cloud.volume)
        else:
            irregular, one_sided = lattice.irregular, np.empty((n, dim), dtype=bool)
            found = _one_sided(irregular.indptr, irregular.neighbours, irregular.cloud.x, irregular.cloud.volume)
            one_sided[irregular.local[: irregular.n]] = found[: irregular.n]
            one_sided[lattice.shared] = lattice.of_shared(found[irregular.n :])
        cut = self.fixed[:n] & one_sided
        for axis in np.flatnonzero(cut.any(axis=0)):
            cut[:, axis] &= families.with_any(free[:, axis].copy())
        return count_nonzero(cloud.comm, cut.any(axis=1))


def _one_sided(indptr: GlobalIndex, neighbours: LocalIndex, x: Float, volume: Float) -> Mask:
    """Return the axes along which families lie on one side of their centre (n, dim)."""
    moment = np.empty((len(indptr) - 1, x.shape[1]))
    size = np.empty_like(moment)
    first_moments(indptr, neighbours, x, volume, moment, size)
    return np.asarray(np.abs(moment) > ONE_SIDED * size)
