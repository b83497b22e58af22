"""Displacements that are linear combinations of other displacements."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from pdpetsc.arrays import Float, GlobalIndex, LocalIndex, Mask, row_of_entries
from pdpetsc.discrete.cloud import Cloud
from pdpetsc.discrete.communicator import owners
from pdpetsc.discrete.halo import Halo


@dataclass(frozen=True)
class Combination:
    """Store tied displacement components of own particles, ``u_s = sum_m c_sm u_m + g_s(t)``.

    Attributes
    ----------
    particle, axis : (n,) int
        Own particle and component of each tied displacement.
    ptr : (n + 1,) int64
        Start of the terms of each sum.
    row : (n_terms,) int64
        Global row (``Cloud.row``) of the particle of each term, on any rank.
    of_axis : (n_terms,) int
        Component of each term.
    coefficient : (n_terms,) float64
        ``c_sm`` [-].
    """

    particle: LocalIndex
    axis: LocalIndex
    ptr: GlobalIndex
    row: GlobalIndex
    of_axis: LocalIndex
    coefficient: Float


class Ties:
    """Store all tied displacements of a body.

    Parameters
    ----------
    cloud : Cloud
        The particles.
    parts : sequence of Combination
        Combinations of each condition on this rank.

    Attributes
    ----------
    all : Combination
        All combinations.
    tied : (n_rows, dim) bool
        Components that are tied.
    independent : (n_rows, dim) bool
        Components that a tied component depends on, on any rank.

    Notes
    -----
    Construction and every method are collective.
    """

    def __init__(self, cloud: Cloud, parts: Sequence[Combination]) -> None:
        self._cloud = cloud
        starts = np.cumsum([0, *(part.ptr[-1] for part in parts)])
        ptr = [part.ptr[1:] + start for part, start in zip(parts, starts, strict=False)]
        self.all = Combination(
            np.concatenate([part.particle for part in parts]),
            np.concatenate([part.axis for part in parts]),
            np.concatenate([[0], *ptr]).astype(np.int64),
            np.concatenate([part.row for part in parts]),
            np.concatenate([part.of_axis for part in parts]),
            np.concatenate([part.coefficient for part in parts]),
        )
        rows, self._place = np.unique(self.all.row, return_inverse=True)
        owner, there = owners(cloud.comm, cloud.first, rows)
        self._halo = Halo(cloud.comm, cloud.n_owned, owner.astype(np.int32), there.astype(np.int32))
        self._sum_of = row_of_entries(self.all.ptr)
        self.tied: Mask = np.zeros((cloud.n_rows, cloud.dim), dtype=bool)
        self.tied[self.all.particle, self.all.axis] = True
        self.independent: Mask = np.zeros_like(self.tied)
        terms = self.forces_on_independent(np.ones(len(self.all.axis)), np.ones(len(self._sum_of)))
        self.independent[: cloud.n_owned] = terms > 0.0

    def sums(self, u: Float) -> Float:
        """Compute ``sum_m c_sm u_m`` (n,) for unknowns ``u`` (n_rows, dim) [length]."""
        return np.asarray(np.bincount(self._sum_of, self.all.coefficient * self.of_terms(u), len(self.all.axis)), float)

    def of_terms(self, u: Float) -> Float:
        """Return the component that each term depends on (n_terms,) of ``u`` (n_rows, dim)."""
        n = self._cloud.n_owned
        local = self._halo.with_ghosts(u[:n])
        return np.asarray(local[n + self._place, self.all.of_axis])

    def lumped_mass(self, mass: Float) -> Float:
        """Compute the mass that tied components add to independent ones (n_owned, dim), from all masses (n_rows,)."""
        size = np.abs(self.all.coefficient)
        sums = np.bincount(self._sum_of, size, len(self.all.axis))
        return self.forces_on_independent(mass[self.all.particle] * sums, size)

    def forces_on_independent(self, forces: Float, coefficient: Float | None = None) -> Float:
        """Compute the forces on independent components (n_owned, dim) from those on tied ones (n,) [force]."""
        n = self._cloud.n_owned
        local = np.zeros((n + self._halo.n_ghost, self._cloud.dim))
        coefficient = self.all.coefficient if coefficient is None else coefficient
        np.add.at(local, (n + self._place, self.all.of_axis), coefficient * forces[self._sum_of])
        self._halo.reverse(local)
        return local[:n]
