"""Common kinematics of laws with history that are evaluated for many points at once."""

from __future__ import annotations

from abc import abstractmethod
from collections.abc import Iterator
from dataclasses import dataclass
from typing import Any, ClassVar, NamedTuple

import numpy as np

from pdpetsc.arrays import Float, GlobalIndex
from pdpetsc.material.base import HistoryKernels, HistoryMaterial, Kind
from pdpetsc.material.roots import rising_roots

# Number of points of a block, whose arrays fit the cache.
BLOCK = 4096


class Step(NamedTuple):
    """The end of a step at a block of points.

    Attributes
    ----------
    F : (all points, dim, dim) float64
        Deformation gradients [-].
    points : (n,) int64
        The points of the block.
    history : (n, n_history) float64
        Their history, which ``commit`` overwrites.
    kind : {"solid", "strain", "stress", "bar"}
        Kind of body.
    frame, response
        Trial strains ``frame.strain`` with their axes; the response of the law to them.
    """

    F: Float
    points: GlobalIndex
    history: Float
    kind: Kind
    frame: Any
    response: Any

    @property
    def dim(self) -> int:
        """Return the number of rows of the deformation gradients."""
        return int(self.F.shape[-1])


@dataclass(frozen=True)
class SteppedMaterial(HistoryMaterial):
    """A law of the strains of a solid at the end of a step, for a solid, a plane body or a bar.

    In plane stress the out-of-plane strain, in a bar both lateral strains, follow from zero stress at every point.
    """

    may_fail: ClassVar[bool] = True

    @abstractmethod
    def respond(self, strain: Float, state: Float, dt: Float, moduli: bool) -> Any:
        """Compute the response at the end of a step: stresses, moduli and more; the third row is out of plane."""

    # Kinematics: from F to strains, from the response of the law to P, A, energy and history.

    @abstractmethod
    def _state(self, history: Float, dim: int) -> Float:
        """Return the columns of the history that the law reads (n, n_state)."""

    @abstractmethod
    def _trial(self, F: Float, points: GlobalIndex, history: Float, kind: Kind) -> Any:
        """Return trial strains with their axes."""

    @abstractmethod
    def _write_stress(self, step: Step, P: Float) -> None: ...

    @abstractmethod
    def _write_tangent(self, step: Step, A: Float) -> None: ...

    @abstractmethod
    def _energy(self, step: Step) -> Float: ...

    @abstractmethod
    def _remember(self, step: Step) -> None: ...

    @abstractmethod
    def _hidden_strain(self, step: Step) -> Float:
        """Return the sum of the hidden logarithmic strains (n,) [-]."""

    @property
    def shear_and_bulk(self) -> tuple[float, float]:
        """Return ``mu, K`` of the solid [stress]."""
        return 0.5 * self.E / (1.0 + self.nu), self.E / (3.0 * (1.0 - 2.0 * self.nu))

    def constants(self, dim: int) -> Float:
        """Return the duration of the step, which is set for laws with a ``duration``."""
        return np.zeros(1)

    def thickness_stretch(self, F: Float) -> Float:
        """Return the hidden stretches of the elastic law; for those of the law see ``hidden_stretch``."""
        return np.asarray(np.linalg.det(F) ** -self.lateral_strain_ratio(F.shape[-1]))

    def history_kernels(self, dim: int) -> HistoryKernels:
        """Return loops over blocks of points around ``respond``."""
        kind = self.kind(dim)

        def stress(F: Float, select: GlobalIndex, constants: Float, history: Float, P: Float) -> None:
            for step in self._steps(F, select, constants[-1], history, kind):
                self._write_stress(step, P)

        def tangent(F: Float, select: GlobalIndex, constants: Float, history: Float, A: Float) -> None:
            for step in self._steps(F, select, constants[-1], history, kind, moduli=True):
                self._write_tangent(step, A)

        def energy(F: Float, select: GlobalIndex, constants: Float, history: Float, psi: Float) -> None:
            for step in self._steps(F, select, constants[-1], history, kind):
                psi[step.points] = self._energy(step)

        def commit(F: Float, select: GlobalIndex, constants: Float, history: Float) -> None:
            for step in self._steps(F, select, constants[-1], history, kind):
                self._remember(step)

        return HistoryKernels(stress, tangent, energy, commit)

    def hidden_stretch(self, F: Float, history: Float, dt: float = 0.0) -> Float:
        """Return the out-of-plane stretch in plane stress, the product of both lateral ones in 1D, else 1 (n,) [-]."""
        kind = self.kind(F.shape[-1])
        across = np.ones(len(F))
        if kind in ("stress", "bar"):
            for step in self._steps(F, np.arange(len(F)), dt, history, kind):
                across[step.points] = np.exp(self._hidden_strain(step))
        return across

    def out_of_plane_stress(self, F: Float, history: Float, dt: float = 0.0) -> Float:
        """Return the out-of-plane stress after the return (n,) [stress] in plane strain; ``F_zz`` is 1."""
        P = np.empty(len(F))
        for step in self._steps(F, np.arange(len(F)), dt, history, "strain"):
            P[step.points] = step.response[0][:, 2]
        return P

    def _steps(
        self, F: Float, select: GlobalIndex, dt: float, history: Float, kind: Kind, moduli: bool = False
    ) -> Iterator[Step]:
        """Yield blocks of points of F at the end of a step of duration ``dt``."""
        for first in range(0, len(select), BLOCK):
            points, rows = select[first : first + BLOCK], history[first : first + BLOCK]
            frame = self._trial(F, points, rows, kind)
            given = frame.strain, self._state(rows, F.shape[-1]), np.full(len(points), dt)
            free = kind in ("stress", "bar")
            response = self.free_across(*given, kind, moduli) if free else self.respond(*given, moduli)
            yield Step(F, points, rows, kind, frame, response)

    def free_across(self, strain: Float, state: Float, dt: Float, kind: Kind, moduli: bool) -> Any:
        """Compute the response for zero hidden stress; write the hidden strains to ``strain`` (n, ...).

        The stress increases with the strain, so every iterate bounds the solution. The first three columns of strains
        and stresses are 11, 22 and 33, or principal values.
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


def condensed(moduli: Float, kind: Kind) -> Float:
    """Return the moduli condensed for zero hidden stress (n, k, k)."""
    if kind == "stress":
        return np.asarray(moduli - moduli[:, :, 2:3] * moduli[:, 2:3, :] / moduli[:, 2:3, 2:3])
    if kind == "bar":
        both = moduli[:, :, 1:2] + moduli[:, :, 2:3]
        return np.asarray(moduli - both * moduli[:, 2:3, :] / both[:, 2:3, :])
    return moduli
