"""Laws with history that are written for many points of a solid at once: what their kinematics have in common."""

from __future__ import annotations

from abc import abstractmethod
from collections.abc import Iterator
from dataclasses import dataclass
from typing import Any, ClassVar

import numpy as np

from pdpetsc.arrays import Float, GlobalIndex
from pdpetsc.material.base import HistoryMaterial, Kind
from pdpetsc.material.roots import rising_roots

# Points that are computed together: their arrays stay in the cache.
BLOCK = 4096


@dataclass(frozen=True)
class SteppedMaterial(HistoryMaterial):
    """A law that answers to the strains of a solid at the end of a step, in a solid, a plane body or a bar.

    In plane stress the strain across the plane is found at every point from no stress there, in a bar the two lateral
    ones.
    """

    may_fail: ClassVar[bool] = True

    @abstractmethod
    def respond(self, strain: Float, state: Float, dt: Float, moduli: bool) -> Any:
        """Return what a step ends with: a tuple that begins with stresses and moduli, whose third row is across."""

    @property
    def timed(self) -> bool:
        """Return whether the last of its constants is the step time."""
        return self.duration is not None

    @property
    def shear_and_bulk(self) -> tuple[float, float]:
        """Return ``mu, K`` of the solid [stress]."""
        return 0.5 * self.E / (1.0 + self.nu), self.E / (3.0 * (1.0 - 2.0 * self.nu))

    def constants(self, dim: int) -> Float:
        """Return the step time, which is put there before every step."""
        return np.zeros(1)

    def thickness_stretch(self, F: Float) -> Float:
        """Return the hidden stretches of the elastic law; ``hidden_stretch`` has those of the law itself."""
        stretch: Float = np.linalg.det(F) ** -self.lateral_strain_ratio(F.shape[-1])
        return stretch

    def time_of_step(self, t: float | None, before: Float) -> Float:
        """Return the time since step times ``before`` (n,) [time]; 0 where ``t`` is None or rates do not count."""
        return np.zeros(len(before)) if t is None or self.duration is None else self.duration * (t - before)

    def free_across(self, strain: Float, state: Float, dt: Float, kind: Kind, moduli: bool) -> Any:
        """Return the response where hidden strains, written into ``strain`` (n, ...), leave no stress across the body.

        The stress grows with the strain, so that every strain tried bounds the one that is looked for. The first three
        columns of strains and stresses are 11, 22 and 33, or principal values.
        """
        mu, K = self.shear_and_bulk
        lam = K - 2.0 * mu / 3.0
        hidden = [2] if kind == "stress" else [1, 2]

        def lateral(x: Float, rows: GlobalIndex) -> tuple[Float, Float, Float]:
            strain[rows[:, None], hidden] = x[:, None]
            stress, slopes = self.respond(strain[rows], state[rows], dt[rows], True)[:2]
            return stress[:, 2], slopes[:, 2, hidden].sum(axis=1), np.abs(stress).max(axis=1)

        elastic = -lam / (lam + 2.0 * mu) * (strain[:, 0] + strain[:, 1])
        x = rising_roots(lateral, elastic if kind == "stress" else -self.nu * strain[:, 0], lam + 2.0 * mu)
        strain[:, hidden] = x[:, None]
        return self.respond(strain, state, dt, moduli)


def blocks(select: GlobalIndex, history: Float) -> Iterator[tuple[GlobalIndex, Float]]:
    """Yield points with their rows of the history, which may be written."""
    for first in range(0, len(select), BLOCK):
        yield select[first : first + BLOCK], history[first : first + BLOCK]
