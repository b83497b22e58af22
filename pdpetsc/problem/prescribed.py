"""Conditions that prescribe the displacement or temperature of the same particles."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from pdpetsc.arrays import Float, GlobalIndex, LocalIndex
from pdpetsc.discrete.cloud import Cloud
from pdpetsc.discrete.communicator import anywhere, largest
from pdpetsc.errors import SolveError

# Prescribed values are equal if they differ by less than this share of the largest prescribed value.
SAME_VALUE = 1e-12


class Prescribed:
    """Store which conditions prescribe which particles, to compare values on particles with several conditions.

    Parameters
    ----------
    cloud : Cloud
        The particles.

    Notes
    -----
    Every method is collective.
    """

    def __init__(self, cloud: Cloud) -> None:
        self._cloud = cloud
        self._given: list[tuple[str, str, GlobalIndex | LocalIndex]] = []
        # Numbers of the later and the earlier condition, and the indices of their common particles in both.
        self._shared: list[tuple[int, int, GlobalIndex, GlobalIndex]] = []

    @property
    def shared(self) -> bool:
        """Return True if two conditions prescribe the same unknown of a particle of the body."""
        return bool(self._shared)

    def add(self, name: str, what: str, own: GlobalIndex | LocalIndex) -> None:
        """Add a condition ``name`` that prescribes ``what`` of own particles."""
        for number, (_, other, earlier) in enumerate(self._given):
            if other == what:
                _, here, there = np.intersect1d(own, earlier, assume_unique=True, return_indices=True)
                if anywhere(self._cloud.comm, len(here)):
                    self._shared.append((len(self._given), number, here, there))
        self._given.append((name, what, own))

    def refuse_different(self, values: Sequence[Float], t: float) -> None:
        """Raise SolveError if two conditions prescribe different values of a particle at load parameter ``t``.

        Parameters
        ----------
        values : sequence of (n,) float64
            The values of each condition on its own particles, in the order in which conditions were added.

        Raises
        ------
        SolveError
            Values differ by more than ``SAME_VALUE`` of the largest one; the same error on every rank.
        """
        if not self._shared:
            return
        cloud = self._cloud
        size = largest(cloud.comm, max((float(np.abs(one).max(initial=0.0)) for one in values), default=0.0))
        for later, earlier, here, there in self._shared:
            name, what, own = self._given[later]
            one, other = values[later][here], values[earlier][there]
            bad = np.flatnonzero(~(np.abs(one - other) <= SAME_VALUE * size))
            ours = [
                (int(cloud.gid[p]), cloud.x[p].tolist(), float(one[k]), float(other[k]))
                for k, p in zip(bad, own[here[bad]], strict=True)
            ]
            different = sorted(found for of_rank in cloud.comm.allgather(ours) for found in of_rank)
            if different:
                gid, x, value, expected = different[0]
                at = ", ".join(f"{coordinate:g}" for coordinate in x)
                raise SolveError(
                    f"At step time {t:.6g}: {name} prescribes {what} of {len(different)} "
                    f"particle{'s' if len(different) > 1 else ''} a second time with another value: {value:.10g} for "
                    f"particle {gid} at ({at}), where {self._given[earlier][0]} has {expected:.10g}; let both "
                    f"prescribe the same value, or leave these particles out of one of them."
                )
