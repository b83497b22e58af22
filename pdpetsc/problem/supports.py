"""Prescribed unknowns."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from pdpetsc.arrays import Float, GlobalIndex, LocalIndex, Mask
from pdpetsc.declare.conditions import Displacement, MeanStrain, Value, evaluated
from pdpetsc.discrete.communicator import agreed, total
from pdpetsc.kernels.sparsity import first_moments
from pdpetsc.problem.body import Body
from pdpetsc.problem.cell import CellRows
from pdpetsc.problem.prescribed import Prescribed

# A family is cut in a direction where its first moment is more than this share of what one side alone would have.
ONE_SIDED = 0.9


@dataclass(frozen=True)
class _Held:
    """One component of a displacement on the particles ``where``."""

    name: str
    condition: Displacement
    axis: int
    value: Value
    where: GlobalIndex


class Supports:
    """Prescribed unknowns of a case on this rank.

    Parameters
    ----------
    body : Body
        Whose unknowns they are.
    cell : CellRows, optional
        The virtual unknowns of a periodic cell.

    Attributes
    ----------
    fixed : (n_rows, dim) bool
        Prescribed degrees of freedom.
    given : Prescribed
        Which conditions prescribe them.

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
        if cell is not None and cell.here:
            # Entries of the virtual rows that stand for no component.
            cell.rows(self.fixed)[len(cell.sizes) :] = True

    def prescribe(
        self, condition: Displacement, components: Sequence[tuple[int, Value]], where: GlobalIndex, name: str
    ) -> None:
        """Prescribe components of the displacement of some own particles.

        Particles may have several conditions that agree; ``prescribed`` compares their values.
        """
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

    def prescribed(self, t: float) -> Float:
        """Return the prescribed unknowns at step time ``t`` (n_rows, dim) [length], 0 where free.

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
        return u

    def held_by_condition(self) -> list[tuple[str, str, int]]:
        """Return the name of every displacement, the components that it prescribes, and of how many particles."""
        found: dict[str, tuple[str, int]] = {}
        for held in self._held:
            axes, _ = found.get(held.name, ("", 0))
            found[held.name] = axes + "xyz"[held.axis], len(held.where)
        here = np.array([count for _, count in found.values()], dtype=np.int64)
        counts = total(self.body.cloud.comm, here)
        return [(name, axes, int(count)) for (name, (axes, _)), count in zip(found.items(), counts, strict=True)]

    def held_at_cut_families(self) -> int:
        """Return how many particles are held in the direction in which their family is cut, beside ones that are free.

        There the gradient weights do not satisfy the divergence theorem: uniform stress is not in equilibrium, and the
        stress of the outermost layer comes out as 2/3 of the true one at the smallest horizon, whatever the spacing.
        """
        cloud, families, lattice = self.body.cloud, self.body.families, self.body.families.lattice
        n, dim = cloud.n_owned, cloud.dim
        free = np.ones((cloud.n_local, dim))
        free[:n] = ~self.fixed[:n]
        cloud.halo.forward(free)
        if lattice is None:
            one_sided = _one_sided(families.indptr, families.neighbours, cloud.x, cloud.volume)
        else:
            irregular, one_sided = lattice.irregular, np.empty((n, dim), dtype=bool)
            found = _one_sided(irregular.indptr, irregular.neighbours, irregular.cloud.x, irregular.cloud.volume)
            one_sided[irregular.local[: irregular.n]] = found[: irregular.n]
            one_sided[lattice.shared] = lattice.of_shared(found[irregular.n :])
        cut = self.fixed[:n] & one_sided
        for axis in np.flatnonzero(cut.any(axis=0)):
            cut[:, axis] &= families.with_any(free[:, axis] > 0.0)
        return int(total(cloud.comm, np.count_nonzero(cut.any(axis=1))))


def _one_sided(indptr: GlobalIndex, neighbours: LocalIndex, x: Float, volume: Float) -> Mask:
    """Return along which axes families lie on one side of their centre (n, dim)."""
    moment = np.empty((len(indptr) - 1, x.shape[1]))
    size = np.empty_like(moment)
    first_moments(indptr, neighbours, x, volume, moment, size)
    return np.asarray(np.abs(moment) > ONE_SIDED * size)
